"""How each effect of the simulator changes the scores of every method.

``benchmarks/effects.py [OUT] [METHOD ...]``.

A street of 20 frames, VLP-16, 8 m/s, is simulated with each effect alone, as large as in the
``*_real`` presets, and with all of them. Every method runs with its default parameters. Writes
OUT/effects.json and OUT/effects.md, tables of SA and DA; finished runs are kept. About fifteen
minutes on two cores.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import dynaviz as dv
from dynaviz.contracts import registry
from dynaviz.contracts.scan import Label
from dynaviz.synthetic.simulate.effects import BEHAVIOUR
from dynaviz.synthetic.simulate.options import Chosen
from dynaviz.synthetic.simulate.presets import PRESETS, REAL
from dynaviz.synthetic.simulate.sequence import SimulatedSequence
from dynaviz.testing import InMemory

FRAMES = 20
SPEED = 8.0
SEED = 3

_OPTICAL = {name: value for name, value in REAL.active.items() if name not in BEHAVIOUR}
_ACTING = {name: getattr(REAL, name) for name in BEHAVIOUR}


def _of(*names: str, **more: Any) -> dict[str, Any]:
    return {**{name: getattr(REAL, name) for name in names}, **more}


ROWS: Mapping[str, dict[str, Any]] = {
    "none": {},
    "motion during the sweep, deskewed": _of("sweep_s"),
    "motion during the sweep, raw": _of("sweep_s", raw=1),
    "mixed pixels": _of("divergence_mrad"),
    "drop-outs": _of("dropout", "dropout_range", "dropout_incidence"),
    "range noise": _of("noise_range_m", "noise_incidence_m"),
    "beam angles": _of("beam_deg"),
    "blooming signs": _of("bloom_deg"),
    "multipath": _of("multipath"),
    "rain, 1 drop per m³": {"rain_per_m3": 1.0},
    "half-transparent vegetation": _of("vegetation_gap"),
    "glass": _of("glass"),
    "pose drift": _of("drift_m", "drift_deg"),
    "pose jitter": _of("jitter_m", "jitter_deg"),
    "walkers who brush": _of("brushing"),
    "cars that pass closely": _of("passing"),
    "crowds that touch": _of("crowds"),
    "doors": _of("doors"),
    "trolleys": _of("trolleys"),
    "people who sit down": _of("sitting"),
    "dogs": _of("animals"),
    "cars that park, wait and leave": _of("parking"),
    "all of the sensor": _OPTICAL,
    "all of the behaviour": _ACTING,
    "all": {**_OPTICAL, **_ACTING},
    "all, and rain": {**_OPTICAL, **_ACTING, "rain_per_m3": 1.0},
}


def scene(name: str, changed: dict[str, Any]) -> InMemory:
    """The street with some effects."""
    plain = PRESETS["demo"]
    preset = replace(plain, speed=SPEED, effects=replace(plain.effects, **changed))
    if "drift_m" in changed and "jitter_m" in changed:
        # as in the presets: drift and jitter replace the slow errors
        preset = replace(preset, pose_noise=(0.0, 0.0))
    sequence = SimulatedSequence(Chosen(preset, FRAMES, SEED, name))
    return InMemory([sequence[k] for k in range(FRAMES)], name, sequence.sensor)


def run(method: str, sequence: InMemory) -> tuple[float, float]:
    """SA and DA of a method, percent."""
    metrics = dv.run(method, sequence, record="none", maps=False).metrics
    return metrics["SA"] or 0.0, metrics["DA"] or 0.0


def table(results: Mapping[str, Any]) -> str:
    """Markdown: SA / DA of each method without effects, and the change of both by each effect,
    percent.
    """
    base = results["none"]["scores"]
    lines = ["| effect | dynamic points | " + " | ".join(f"`{method}`" for method in base) + " |"]
    lines.append("|---|---|" + "---|" * len(base))
    for name, row in results.items():
        cells = []
        for method, (sa, da) in base.items():
            now = row["scores"].get(method, (np.nan, np.nan))
            cells.append(
                f"{sa:.1f} / {da:.1f}"
                if name == "none"
                else f"{_change(now[0] - sa)} / {_change(now[1] - da)}"
            )
        lines.append(f"| {name} | {row['dynamic']:,} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _change(points: float) -> str:
    """A change with its sign, 0 if it is that when rounded, and bold from 5 points."""
    text = f"{points:+.1f}" if round(abs(points), 1) else "0"
    return f"**{text}**" if abs(points) >= 5 else text


def main(out: Path, methods: list[str]) -> None:
    """Run what is missing, and write the tables after each row."""
    out.mkdir(parents=True, exist_ok=True)
    stored = out / "effects.json"
    results: dict[str, Any] = json.loads(stored.read_text()) if stored.exists() else {}
    for name, changed in ROWS.items():
        row = results.setdefault(name, {"scores": {}})
        missing = [method for method in methods if method not in row["scores"]]
        if missing:
            sequence = scene(name, changed)
            row["points"] = sum(len(scan) for scan in sequence.scans)
            row["dynamic"] = sum(
                int((scan.labels == Label.DYNAMIC).sum()) for scan in sequence.scans
            )
            row["scores"] |= {method: run(method, sequence) for method in missing}
            stored.write_text(json.dumps(results, indent=1))
            (out / "effects.md").write_text(table(results))
            print(
                name,
                {
                    method: tuple(round(v, 1) for v in score)
                    for method, score in row["scores"].items()
                },
                flush=True,
            )
    print(table(results))


if __name__ == "__main__":
    arguments = sys.argv[1:]
    main(
        Path(arguments[0]) if arguments else Path("build/benchmarks/effects"),
        arguments[1:] or [handle.name for handle in registry.handles("methods")],
    )
