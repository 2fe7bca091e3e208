"""A leaderboard that anyone can recompute.

Entries with digests, scored under every protocol from the stored labels.
"""
