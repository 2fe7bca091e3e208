"""Recordings of several runs on the same points, merged into one."""
