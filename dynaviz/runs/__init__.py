"""Runs: executed on tiles or live, opened again, replayed and explained."""
