"""The contribution of each part and parameter of SeeThrough.

python benchmarks/ablation.py OUT [SCENE ...]      writes OUT/ablation.md

A scene is a name in OUT/scenes, as written by ``benchmarks/many.py``, or any sequence, such as
``simulate:street_vlp16_real?frames=60`` or ``implant:path/to/sequence?seed=1``.
"""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from dynaviz import api
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.scan import Label, Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.spatial import scan_ground
from dynaviz_methods.seethrough import REMOVED, SeeThrough, SeeThroughParams, history, level, method
from dynaviz_methods.seethrough.method import FOOT
from dynaviz_methods.shared import sky

CHOSEN = (
    "hdl64_town", "hdl64_poor_poses", "hdl64_standing", "vlp32c_square", "vlp16_street",
    "vlp16_twenty", "vlp16_hall",
    "mid360_hall",
)  # fmt: skip
PARTS = {  # constants to change, and reasons whose points are kept
    "full method": ({}, ()),
    "no feet": ({}, (FOOT,)),
    "poses as they are": ({"level.OFF": 1e9}, ()),
    "no tracks": ({"history.DYNAMIC": 1.0}, ()),
    "no limit of height": ({"method.HIGHEST": 1e9}, ()),
    "ground twice as steep": ({"scan_ground.SLOPE": 0.2}, ()),
    "pits are ground": ({"scan_ground.PIT": 1e9}, ()),
    "no rays into the sky": ({"sky.COARSE": 1e9}, ()),
}
PARAMETERS = {
    "guard": (0.2, 0.4),
    "resolution": (0.15, 0.2),
    "votes": (2, 5),
    "near": (0.25, 1.0),
    "hit": (0.06, 0.24),
    "prior": (0.05, 0.2),
    "inherit": (0.25, 1.0),
    "ground_height": (0.1, 0.3),
    "join_angle": (0.4, 1.1),
}
MODULES = {of.__name__.rpartition(".")[2]: of for of in (history, level, method, scan_ground, sky)}


def scores(
    scans: list[Scan], sensor: Sensor, params: SeeThroughParams, kept: tuple[int, ...] = ()
) -> tuple[float, float]:
    """SA and DA, percent; points with the reasons ``kept`` are not removed."""
    running = SeeThrough(params)
    running.begin(Context(Extent.of(*scans), sensor))
    for scan in scans:
        running.observe(scan.without_truth())
    removed = REMOVED & ~np.isin(np.arange(len(REMOVED)), kept)
    answers = np.concatenate(
        [removed[running.label(scan.without_truth()).reasons] for scan in scans]
    )
    truth = np.concatenate([scan.labels for scan in scans])
    return 100 * (~answers[truth == Label.STATIC]).mean(), 100 * answers[
        truth == Label.DYNAMIC
    ].mean()


def rows(scans: list[Scan], sensor: Sensor) -> dict[str, tuple[float, float]]:
    """Every variant on one scene."""
    found = {}
    default = SeeThroughParams()
    for name, (constants, kept) in PARTS.items():
        with ExitStack() as stack:
            for path, value in constants.items():
                module, constant = path.split(".")
                stack.enter_context(patch.object(MODULES[module], constant, value))
            found[name] = scores(scans, sensor, default, kept)
    for name, values in PARAMETERS.items():
        for value in values:
            found[f"{name} = {value}"] = scores(scans, sensor, replace(default, **{name: value}))
    return found


def main(out: Path, names: list[str]) -> None:
    """Write the table."""
    out.mkdir(parents=True, exist_ok=True)
    by_scene = {}
    for name in names or CHOSEN:
        written = out / "scenes" / name
        sequence = api.open(written if written.exists() else name)
        by_scene[name] = rows([sequence[k] for k in range(len(sequence))], sequence.sensor)
        print(name, flush=True)
    lines = [
        "| variant | AA mean | " + " | ".join(by_scene) + " |",
        "|---|" + "---|" * (len(by_scene) + 1),
    ]
    for variant in next(iter(by_scene.values())):
        pairs = [found[variant] for found in by_scene.values()]
        mean = np.mean([np.sqrt(sa * da) for sa, da in pairs])
        lines.append(
            f"| {variant} | {mean:.1f} | "
            + " | ".join(f"{sa:.1f} / {da:.1f}" for sa, da in pairs)
            + " |"
        )
    (out / "ablation.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
