"""Recordings and pictures: the only package that imports rerun."""
