"""What errors of the poses cost each method, on sequences with ground truth or implants.

    python benchmarks/poses.py [--methods NAME ...] [--sensor NAME] [--metres 0.05] [--degrees 0.2] [--seed 1]
        SEQUENCE ...

Runs each method with the given poses and with three kinds of added errors, and prints SA / DA / AA. Jitter is
independent from frame to frame. Drift is the sum of independent steps; its standard deviation at the last frame is as
large as that of jitter. The points of a frame move with the sensor.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np

import dynaviz as dv
from dynaviz.arrays import F64
from dynaviz.contracts import registry
from dynaviz.contracts.scan import Scan, Sequence, SequenceView
from dynaviz.spatial import geometry
from dynaviz.synthetic.simulate.poses import transforms


@dataclass(frozen=True)
class Displaced(SequenceView):
    """A sequence with errors of its poses, T_sensor_estimated (frames, 4, 4)."""

    whole: Sequence
    errors: F64

    def __getitem__(self, position: int) -> Scan:
        scan = self.whole[position]
        T_world_estimated = geometry.compose(scan.T_world_sensor, self.errors[position])
        displacement = geometry.compose(T_world_estimated, geometry.inverse(scan.T_world_sensor))
        points, origins = (geometry.apply(displacement, each) for each in (scan.points, scan.origins))
        return replace(scan, points=points.astype(np.float32), origins=origins, T_world_sensor=T_world_estimated)


def errors(frames: int, metres: float, degrees: float, seed: int) -> dict[str, F64]:
    """Pose errors by kind, T_sensor_estimated (frames, 4, 4)."""

    def of(noise: F64) -> F64:
        return transforms(metres * noise[:, :3], np.radians(degrees) * noise[:, 3:])

    jitter, steps = np.random.default_rng(seed).normal(size=(2, frames, 6))
    drift = steps.cumsum(0) / np.sqrt(frames)
    return {"jitter": of(jitter), "drift": of(drift), "both": geometry.compose(of(jitter), of(drift))}


def main() -> None:
    """Print a table for each sequence."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", nargs="+", metavar="SEQUENCE")
    parser.add_argument(
        "--methods", nargs="+", metavar="NAME", default=[handle.name for handle in registry.handles("methods")]
    )
    parser.add_argument("--sensor", metavar="NAME")
    parser.add_argument("--metres", type=float, default=0.05, help="standard deviation of the position, per axis")
    parser.add_argument("--degrees", type=float, default=0.2, help="standard deviation of the rotation, per axis")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for path in options.sequences:
        whole = dv.open(path, sensor=options.sensor)
        added = errors(len(whole), options.metres, options.degrees, options.seed)
        sequences = {"given poses": whole, **{kind: Displaced(whole, of) for kind, of in added.items()}}
        print(f"\n{path}\n\n| method | {' | '.join(sequences)} |\n|---|{'---|' * len(sequences)}")
        for method in options.methods:
            cells = [dv.run(method, sequence, record="none", maps=False).metrics for sequence in sequences.values()]
            scores = [" / ".join(f"{scored[name] or 0:.2f}" for name in ("SA", "DA", "AA")) for scored in cells]
            print(f"| `{method}` | {' | '.join(scores)} |", flush=True)


if __name__ == "__main__":
    main()
