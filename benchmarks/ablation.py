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
from dynaviz_methods import ground_height, judgement, seethrough, sky, staying, trails
from dynaviz_methods.seethrough import ALONE, FOOT, REMOVED, WAITED, SeeThrough, SeeThroughParams

CHOSEN = (
    "hdl64_town", "hdl64_poor_poses", "hdl64_standing", "vlp32c_square", "vlp16_street", "vlp16_twenty", "vlp16_hall",
    "mid360_hall",
)  # fmt: skip
PARTS = {  # constants to change, and reasons whose points are kept
    "full method": ({}, ()),
    "no feet": ({}, (FOOT,)),
    "feet above the map's ground, not the scan's": ({"seethrough.LEAST": 1 << 30}, ()),
    "no lone voxels": ({}, (ALONE,)),
    "no waiting rule": ({}, (WAITED,)),
    "waiting objects may be hit again": ({"judgement.LEFT": -1e9}, ()),
    "single rays show that objects waited": ({"judgement.LEAVES": -1.0}, ()),
    "no following": ({"judgement.PROOF": 1 << 30}, ()),
    "followed objects may be hit again": ({"judgement.STAYS": 1.0, "judgement.STAYS_SURE": 1.0}, ()),
    "what was long dynamic follows like anything else": ({"judgement.SURE": 1 << 30}, ()),
    "what was there before may follow": ({"trails.BEFORE": trails.NEVER}, ()),
    "objects with what stays": ({"staying.MANY": 1 << 30}, ()),
    "nothing stays because it was there from the beginning": ({"staying.SINCE": 2.0}, ()),
    "nothing is kept because something always is there": ({"staying.ALWAYS": 2.0}, ()),
    "dynamic objects as a whole": (
        {"seethrough.FIRM": 1e30, "seethrough.UNTOUCHED": -1.0, "staying.MANY": 1 << 30, "staying.ALWAYS": 2.0},
        (),
    ),
    "places far away may be empty": ({"seethrough.FAR": 1e9}, ()),
    "objects that waited as a whole": ({"seethrough.UNTOUCHED": -1.0}, ()),
    "the map's ground near the sensor, not the scan's": ({"ground_height.NEAR": 0.0}, ()),
    "the map's ground far away, not the scan's": ({"ground_height.SWAY": 0.0}, ()),
    "feet up to 0.8 m away": ({"seethrough.UNDER": 4}, ()),
    "neither following nor waiting": ({"judgement.PROOF": 1 << 30}, (WAITED,)),
    "no limit of height": ({"seethrough.HIGHEST": 1e9}, ()),
    "no objects: lone voxels only": ({"judgement.FEW": 1 << 30}, (WAITED,)),
    "ground twice as steep": ({"ground_height.SLOPE": 0.2}, ()),
    "no rays into the sky": ({"sky.COARSE": 1e9}, ()),
    "rays into the sky pass the points next to it": ({"sky.AROUND": 0}, ()),
    "pits are ground": ({"ground_height.PIT": 1e9}, ()),
}
PARAMETERS = {
    "guard": (0.0, 0.2, 0.4),
    "resolution": (0.15, 0.2),
    "votes": (2, 5),
    "share": (0.25, 0.45),
    "ground_height": (-100.0, 0.1, 0.3),
    "gap": (0.2, 0.4),
}
MODULES = {of.__name__.rpartition(".")[2]: of for of in (seethrough, judgement, staying, ground_height, trails, sky)}


def scores(
    scans: list[Scan], sensor: Sensor, params: SeeThroughParams, kept: tuple[int, ...] = ()
) -> tuple[float, float]:
    """SA and DA, percent; points with the reasons ``kept`` are not removed."""
    method = SeeThrough(params)
    method.begin(Context(Extent.of(*scans), sensor))
    for scan in scans:
        method.observe(scan.without_truth())
    removed = REMOVED & ~np.isin(np.arange(len(REMOVED)), kept)
    answers = np.concatenate([removed[method.label(scan.without_truth()).reasons] for scan in scans])
    truth = np.concatenate([scan.labels for scan in scans])
    return 100 * (~answers[truth == Label.STATIC]).mean(), 100 * answers[truth == Label.DYNAMIC].mean()


def rows(scans: list[Scan], sensor: Sensor) -> dict[str, tuple[float, float]]:
    """Every variant on one scene."""
    found, default = {}, SeeThroughParams()
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
    lines = ["| variant | AA mean | " + " | ".join(by_scene) + " |", "|---|" + "---|" * (len(by_scene) + 1)]
    for variant in next(iter(by_scene.values())):
        pairs = [found[variant] for found in by_scene.values()]
        mean = np.mean([np.sqrt(sa * da) for sa, da in pairs])
        lines.append(f"| {variant} | {mean:.1f} | " + " | ".join(f"{sa:.1f} / {da:.1f}" for sa, da in pairs) + " |")
    (out / "ablation.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
