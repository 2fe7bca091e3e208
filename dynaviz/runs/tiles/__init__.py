"""Runs of any length: the map is divided into tiles, each of which is a run of its own
(``docs/tiles.md``).
"""
