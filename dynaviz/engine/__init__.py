"""Runs a method on a sequence: the loop, its outputs, and answers of other programs.

Private: other packages do not import it.
"""
