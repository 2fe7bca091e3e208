"""Sequences that are made: simulated scenes, and movers implanted into real scans."""
