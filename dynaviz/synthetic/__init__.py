"""Sequences that are made: simulated scenes, and movers implanted into real scans.

Private: other packages do not import it.
"""
