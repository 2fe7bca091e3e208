"""Runs: executed on tiles or live, opened again, replayed and explained.

Private: other packages do not import it.
"""
