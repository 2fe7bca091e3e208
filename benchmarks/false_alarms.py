"""Findings of the doctor on correct sequences, of which there should be none.

    python benchmarks/false_alarms.py [--real FOLDER] [PART ...]

Every preset of the simulator, as it is and with motion during the sweep, jitter and drift of the
poses, at the start and in the middle of a drive; and the real sequences of a folder, if given. With
PART, only sequences whose name contains it. Prints a table; the exit code is 1 if a finding is
likely or certain.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import dynaviz as dv
from dynaviz.contracts.scan import Sequence
from dynaviz.diagnosis import Confidence, doctor
from dynaviz.synthetic.simulate import PRESETS

SWEEP = "sweep_s=0.1"
JITTER = "jitter_m=0.03&jitter_deg=0.1"
DRIFT = "drift_m=0.3&drift_deg=0.1"
VARIANTS = {  # options, and the frames that are examined
    SWEEP: "0:12",
    f"{SWEEP}&{JITTER}": "14:26",
    f"{JITTER}&{DRIFT}": "30:42",
    f"{SWEEP}&{JITTER}&{DRIFT}": "38:50",
}
SEEDS = (
    f"demo?seed=2&{SWEEP}",
    f"street_hdl64?seed=3&{SWEEP}&{JITTER}",
    f"square_vlp32c?seed=4&{SWEEP}",
)
REAL = {  # formats by folder, relative to the given one
    "kitti_tracking/training/velodyne/0012": "0:20",
    "semantickitti/sequences/08": "0:20",
    "unified/kitti_tracking_0012": "30:50",
    "argoverse2": "0:20",
}


def simulated() -> Iterator[tuple[str, str]]:
    """Preset with options, and frames."""
    for name in PRESETS:
        yield name, "0:12"
    for name in PRESETS:
        if name.endswith("_real"):
            yield f"{name}?seed=1", "20:32"
        else:
            yield from ((f"{name}?{options}", frames) for options, frames in VARIANTS.items())
    yield from ((options, "8:20") for options in SEEDS)


def sequences(real: Path | None, parts: list[str]) -> Iterator[tuple[str, Sequence]]:
    """Name and sequence of each case whose name contains one of the parts."""

    def chosen(name: str) -> bool:
        return not parts or any(part in name for part in parts)

    for name, frames in simulated():
        if chosen(name):
            # so that a slow sensor moves by a metre or more
            stride = 2 if "street_hdl64" not in name else 1
            first, last = (int(end) for end in frames.split(":"))
            yield (
                name,
                dv.open(
                    f"simulate:{name}",
                    frames=f"{first}:{first + (last - first) * stride}",
                    stride=stride,
                ),
            )
    for name, frames in REAL.items() if real else ():
        if chosen(name) and real and (real / name).exists():
            yield name, dv.open(real / name, frames=frames)


def main() -> int:
    """Print the findings of every sequence."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", metavar="PART")
    parser.add_argument("--real", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    alarms = total = 0
    print("| sequence | seconds | findings |\n|---|---|---|")
    for name, sequence in sequences(options.real, options.parts):
        start = time.process_time()
        total = total + 1
        findings = doctor(sequence).findings
        words = "; ".join(f"{f.name} ({f.confidence.name.lower()}): {f.problem}" for f in findings)
        print(f"| {name} | {time.process_time() - start:.1f} | {words or '-'} |", flush=True)
        alarms += any(finding.confidence <= Confidence.LIKELY for finding in findings)
    print(f"\n{alarms} of {total} sequences with a finding that is likely or certain")
    return int(alarms > 0)


if __name__ == "__main__":
    sys.exit(main())
