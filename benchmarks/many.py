"""All methods on many simulated scenes, with seeds that were not used to develop SeeThrough.

    python benchmarks/many.py OUT [METHOD ...]        about twenty minutes on two cores; finished
        runs are kept
    python benchmarks/many.py --real OUT [METHOD ...]         the same on 22 scenes with the effects
        of real scans
    python benchmarks/many.py --sensors OUT [METHOD ...]      the same on 24 such scenes with twelve
        other sensors

Writes the scenes to OUT/scenes, runs every method with its default parameters on each, and writes
OUT/many.json and OUT/many.md: the AA of each method on every scene, its distribution, and on how
many scenes the method is first.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz.benchmarking.bench import bench
from dynaviz.contracts import registry
from dynaviz.contracts.sensors import load_sensor
from dynaviz.io.benchmark import BenchmarkWriter
from dynaviz.spatial import geometry
from dynaviz.synthetic.simulate.classes import CLASS_NAMES
from dynaviz.synthetic.simulate.presets import PRESETS
from dynaviz.synthetic.simulate.recording import build, record_sweeps
from dynaviz.synthetic.simulate.write import simulate

# pose errors, metres and degrees
FAIR = (0.015, 0.05)
GOOD = (0.005, 0.02)
POOR = (0.05, 0.2)


@dataclass(frozen=True)
class Variation:
    """A preset with some changed fields; slope: of the whole ground, percent."""

    name: str
    preset: str
    frames: int
    seed: int
    slope: float = 0.0
    changed: tuple[tuple[str, Any], ...] = ()


def _of(
    name: str, preset: str, frames: int, seed: int, slope: float = 0.0, **changed: Any
) -> Variation:
    return Variation(name, preset, frames, seed, slope, tuple(changed.items()))


SCENES = (
    _of("hdl32_street", "street_hdl64", 80, 108, sensor="hdl32e", pose_noise=FAIR),
    _of("hdl32_crowd", "square_vlp32c", 60, 109, sensor="hdl32e", traffic=1.5),
    _of("vlp16_street", "street_vlp16", 100, 113),
    _of("vlp16_fast", "street_vlp16", 80, 114, speed=8.0, pose_noise=FAIR),
    _of("vlp16_standing", "street_vlp16", 80, 115, speed=0.0),
    _of("vlp16_hill", "street_vlp16", 80, 116, slope=15.0),
    _of("vlp16_poor_poses", "street_vlp16", 80, 117, pose_noise=POOR),
    _of("vlp16_twenty", "street_vlp16", 20, 118, traffic=2.0),
    _of("vlp16_hall", "hall_vlp16", 120, 119),
    _of("vlp16_hall_crowd", "hall_vlp16", 100, 120, traffic=2.5, pose_noise=GOOD),
    _of("vlp16_square", "square_vlp32c", 80, 121, sensor="vlp16", speed=1.5),
    _of("mid360_hall", "hall_mid360", 150, 122),
    _of("mid360_square", "square_mid360", 150, 123),
    _of("mid360_street", "street_vlp16", 120, 124, sensor="mid360"),
    _of("hdl64_town", "street_hdl64", 40, 101),
    _of("hdl64_fast", "street_hdl64", 40, 102, speed=14.0, traffic=1.0),
    _of("hdl64_poor_poses", "street_hdl64", 40, 103, pose_noise=POOR),
    _of("hdl64_standing", "street_hdl64", 40, 104, speed=0.0),
    _of("hdl64_hill", "street_hdl64", 40, 106, slope=12.0),
    _of("hdl64_crowd", "square_vlp32c", 30, 107, sensor="hdl64e", traffic=2.0),
    _of("vlp32c_square", "square_vlp32c", 30, 110),
    _of("vlp32c_poor_poses", "square_vlp32c", 30, 111, pose_noise=POOR),
)
# number of frames, and of scenes
_FRAMES = {
    "hall_mid360_real": (50, 3),
    "hall_vlp16_real": (50, 4),
    "square_mid360_real": (40, 3),
    "square_vlp32c_real": (15, 3),
    "street_hdl64_real": (20, 4),
    "street_vlp16_real": (40, 5),
}
REAL = tuple(
    _of(f"{preset.removesuffix('_real')}_{seed}", preset, frames, seed)
    for preset, (frames, scenes) in _FRAMES.items()
    for seed in range(1100, 1100 + scenes)
)
# by seed
_SENSORS = {
    710: ("os1_128", "os2_128"),
    711: ("os0_128", "ruby128"),
    712: ("qt64", "xt32"),
    713: ("aeries2", "rs16"),
    714: ("avia", "pandar64"),
    715: ("vls128", "helios32"),
}
SENSORS = tuple(
    _of(f"{sensor}_{scene}", f"{scene}_vlp16_real", 25, seed, sensor=sensor)
    for seed, sensors in _SENSORS.items()
    for sensor in sensors
    for scene in ("street", "hall")
)


def write(variation: Variation, out: Path) -> None:
    """Simulate a scene in the public benchmark's layout, tilted by its slope."""
    if variation in REAL:
        simulate(variation.preset, out, variation.frames, variation.seed)
        return
    preset = replace(PRESETS[variation.preset], **dict(variation.changed))
    tilt = np.eye(4)
    angle = np.arctan(variation.slope / 100)
    tilt[:3, :3] = [
        [np.cos(angle), 0, -np.sin(angle)],
        [0, 1, 0],
        [np.sin(angle), 0, np.cos(angle)],
    ]
    merged = bool(load_sensor(preset.sensor).mounts)
    with BenchmarkWriter(out) as writer:
        scene = build(preset, variation.frames, variation.seed)
        for sweep in record_sweeps(scene, preset, variation.frames, variation.seed):
            points = geometry.transform(tilt, sweep.points)
            pose = geometry.compose(tilt, sweep.T_world_sensor)
            writer.append(
                sweep.index, points, pose, sweep.intensity, sweep.lidar if merged else None
            )
            writer.append_truth(points, sweep.labels, sweep.kinds, sweep.instances)
        facts = {"name": out.name, "title": variation.name.replace("_", " "), "preset": preset.name}
        writer.describe({**facts, "sensor": preset.sensor, "seed": variation.seed}, CLASS_NAMES)


def table(results: dict[str, dict[str, dict[str, float]]]) -> str:
    """Markdown tables: distribution of AA over the scenes for each method, and AA by scene."""
    methods = sorted({m for by in results.values() for m in by})
    methods.sort(key=lambda m: -np.mean([by[m]["AA"] for by in results.values() if m in by]))
    first = {
        m: sum(max(by, key=lambda k: by[k]["AA"]) == m for by in results.values()) for m in methods
    }
    lines = [
        "| method | AA mean | worst | quartile | median | quartile | best | SA mean | DA mean | "
        "least SA | first on |",
        "|---|" + "---|" * 10,
    ]
    for m in methods:
        aa = np.array([by[m]["AA"] for by in results.values()])
        sa, da = (np.array([by[m][score] for by in results.values()]) for score in ("SA", "DA"))
        spread = (
            aa.mean(),
            *np.percentile(aa, (0, 25, 50, 75, 100)),
            sa.mean(),
            da.mean(),
            sa.min(),
        )
        lines.append(
            f"| `{m}` | "
            + " | ".join(f"{x:.1f}" for x in spread)
            + f" | {first[m]} of {len(results)} |"
        )
    lines += [
        "",
        "| scene | " + " | ".join(f"`{m}`" for m in methods) + " |",
        "|---|" + "---|" * len(methods),
    ]
    for scene, by in results.items():
        lines.append(f"| {scene} | " + " | ".join(f"{by[m]['AA']:.1f}" for m in methods) + " |")
    return "\n".join(lines) + "\n"


def main(out: Path, methods: list[str], scenes: tuple[Variation, ...]) -> None:
    """Write missing scenes, run missing methods, and write the tables."""
    for scene in scenes:
        if not (out / "scenes" / scene.name).exists():
            (out / "scenes").mkdir(parents=True, exist_ok=True)
            write(scene, out / "scenes" / scene.name)
            print("written:", scene.name, flush=True)
    plan = {
        "methods": methods or [handle.name for handle in registry.handles("methods")],
        "sequences": [str(out / "scenes" / scene.name) for scene in scenes],
        "record": "none",
    }
    results: dict[str, dict[str, dict[str, float]]] = {}
    for result in bench(plan, out / "runs").results:
        figures = {name: result.metrics[name] or 0.0 for name in ("SA", "DA", "AA")}
        figures["seconds"] = result.runtime.mean_s or 0.0
        results.setdefault(result.sequence.name, {})[result.method] = figures
    (out / "many.json").write_text(json.dumps(results, indent=1))
    (out / "many.md").write_text(table(results))
    print(table(results))


if __name__ == "__main__":
    sets = {"--real": REAL, "--sensors": SENSORS}
    given = [argument for argument in sys.argv[1:] if argument not in sets]
    main(Path(given[0]), given[1:], next((sets[a] for a in sys.argv[1:] if a in sets), SCENES))
