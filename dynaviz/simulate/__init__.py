"""Simulated scenes with exact ground truth."""

from dynaviz.simulate.presets import PRESETS, Preset
from dynaviz.simulate.recording import SimulatedSweep, record_sweeps
from dynaviz.simulate.write import simulate

__all__ = ["PRESETS", "Preset", "SimulatedSweep", "record_sweeps", "simulate"]
