"""A leaderboard that anyone can recompute: entries with digests, scored under every protocol from the stored labels."""
