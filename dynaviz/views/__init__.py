"""Recordings and pictures: the only package that imports rerun.

Private: other packages do not import it.
"""
