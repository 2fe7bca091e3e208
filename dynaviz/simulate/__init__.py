"""Scenes with exact ground truth, made here: no download, no labelling by hand."""

from dynaviz.simulate.presets import PRESETS, Preset
from dynaviz.simulate.recording import Shot, shoot, simulate

__all__ = ["PRESETS", "Preset", "Shot", "shoot", "simulate"]
