"""Scenes with exact ground truth, made here: no download, no labelling by hand."""

from dynaviz.simulate.presets import PRESETS, Preset
from dynaviz.simulate.recording import SimulatedSweep, shoot, simulate

__all__ = ["PRESETS", "Preset", "SimulatedSweep", "shoot", "simulate"]
