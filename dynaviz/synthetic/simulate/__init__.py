"""Simulated scenes with exact ground truth."""

from dynaviz.synthetic.simulate.presets import PRESETS, Preset
from dynaviz.synthetic.simulate.recording import SimulatedSweep, record_sweeps
from dynaviz.synthetic.simulate.write import simulate

__all__ = ["PRESETS", "Preset", "SimulatedSweep", "record_sweeps", "simulate"]
