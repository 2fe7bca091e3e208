"""All methods on the labelled drives of a folder: the table of docs/results.md.

    python benchmarks/real.py [--tune] FOLDER OUT [METHOD ...]

Runs every method on each labelled drive in FOLDER, with the given poses and with those of
small-gicp, at its default parameters. With --tune, also at those that a short ``dynaviz tune``
finds on the drive with implants and poses of small-gicp, where their gain on other implants is
proven. Writes counts, also of each mover, to docs/real.json, from which docs/generate.py draws the
tables; what it has of other drives and methods stays. Finished cells and searches in OUT are kept;
cells of changed code run again.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dynaviz as dv
from dynaviz.benchmarking.bench import bench
from dynaviz.benchmarking.leaderboard import BenchRow
from dynaviz.benchmarking.search import default_ranges
from dynaviz.benchmarking.tune import tune
from dynaviz.contracts import registry
from dynaviz.contracts.scan import Sequence
from dynaviz.errors import DataError, DynavizError
from dynaviz.sources.datasets import is_sequence
from dynaviz.synthetic.implants.panel import default_panel

DOCS = Path(__file__).resolve().parent.parent / "docs"
STORED = DOCS / "real.json"
GIVEN = "given"
ESTIMATED = "small-gicp"
TUNED = "tuned"
FRAMES = 30  # of a drive, spread over it, on which parameters are searched; shorter drives are not
TRIALS = (
    4  # of a search, on one sequence with implants; another one tells whether the gain is proven
)
PARAMETERS = 2  # that a search varies: the first ones of a method
KITTI = "CC BY-NC-SA 3.0"
SHARE_ALIKE = "CC BY-NC-SA 4.0"
FACTS = {  # where a drive was recorded, its licence, and what is labelled
    "kitti_tracking_0011": ("Karlsruhe, Germany", KITTI, "boxes in the view of one camera"),
    "kitti_tracking_0012": (
        "Karlsruhe, Germany; the car stands",
        KITTI,
        "boxes in the view of one camera",
    ),
    "nuscenes_scene-0916": ("Singapore, Queenstown; 2 Hz", SHARE_ALIKE, "boxes all around"),
    "semantickitti_08": ("Karlsruhe, Germany", KITTI, "points of the first scan"),
    "argoverse2_7fab2350": ("Pittsburgh, USA", SHARE_ALIKE, "boxes all around"),
}


def drives(folder: Path) -> Iterator[tuple[Path, Sequence]]:
    """The labelled sequences in a folder, one of each name."""
    found: set[str] = set()

    def within(place: Path) -> Iterator[tuple[Path, Sequence]]:
        if is_sequence(str(place)):
            with contextlib.suppress(DataError):  # of several sequences, which are found below
                yield place, dv.open(place)
                return
        for child in sorted(each for each in place.iterdir() if each.is_dir()):
            yield from within(child)

    for place, sequence in within(folder):
        if sequence.has_labels and sequence.name not in found:
            found.add(sequence.name)
            yield place, sequence


def run(place: Path, name: str, poses: str, **cells: Any) -> list[BenchRow]:
    """The cells of a drive: methods at their defaults, or variants."""
    opening = {} if poses == GIVEN else {"poses": poses}
    plan = {
        "record": "none",
        "sequences": [{"path": str(place), "name": f"{name}-{poses}", **opening}],
        **cells,
    }
    return bench(plan, Path("runs", name)).rows


def search(place: Path, drive: Sequence, method: str) -> tuple[str, dict[str, Any] | None]:
    """The gain of a search in words, and the variant that it found if the gain is proven."""
    ranges = dict([*default_ranges(method).items()][:PARAMETERS])
    stride = len(drive) // FRAMES
    # methods with one panel share implants
    out = Path(TUNED, drive.name, "-".join(default_panel(without=method)))
    try:
        found = tune(
            place,
            method,
            out,
            trials=TRIALS,
            seeds=1,
            holdout=1,
            ranges=ranges,
            stride=stride,
            poses=ESTIMATED,
        )
    except DynavizError as error:  # implants need free paths
        return str(error), None
    variant = {"method": method, "name": TUNED, "config": str(found.preset.resolve())}
    better = found.proven and found.gain  # without a gain, the defaults are the best
    return str(found.gain or "no trial is better"), variant if better else None


def cell(drive: str, poses: str, row: BenchRow) -> tuple[dict[str, Any], list[tuple[str, int]]]:
    """The counts of a run, and its movers: class and instance, and dynamic points."""
    result = row.result
    chosen = row.cell.parameter_set
    if result is None or result.sections.breakdown is None:
        raise SystemExit(f"{row.folder}: {row.error}")
    movers = {
        f"{each.class_}/{each.instance}": (
            each.dynamic_removed,
            each.dynamic_removed + each.dynamic_kept,
        )
        for each in result.sections.breakdown.object
        if each.dynamic_removed + each.dynamic_kept
    }
    ordered = sorted(movers)
    defaults = registry.load("methods", chosen.method).Params()
    changed = {
        name: value for name, value in chosen.parameters.items() if value != getattr(defaults, name)
    }
    counts = {
        "drive": drive,
        "poses": poses,
        "method": chosen.method,
        "set": changed if chosen.variant else {},
        "static": [result.counts["static_kept"], result.counts["static_removed"]],
        "removed": [movers[each][0] for each in ordered],
    }
    return counts, [(each, movers[each][1]) for each in ordered]


def save(found: dict[str, list[dict[str, Any]]], methods: list[str], tuned: bool) -> None:
    """Replace in the file what was run again.

    Some methods on the drives that were found, tuned as well or not.
    """
    stored = (
        json.loads(STORED.read_text(encoding="utf-8"))
        if STORED.exists()
        else {name: [] for name in found}
    )
    drives = {row["name"] for row in found["drives"]}

    def stays(name: str, row: dict[str, Any]) -> bool:
        again = name == "drives" or (
            row["method"] in methods and (tuned or not row.get("set", True))
        )
        return row.get("drive", row.get("name")) not in drives or not again

    def place(row: dict[str, Any]) -> list[Any]:
        return [
            bool(row.get(of)) if of == "set" else row.get(of, "")
            for of in ("name", "drive", "set", "poses", "method")
        ]

    parts = []
    for name, rows in found.items():
        rows = sorted([*rows, *(row for row in stored[name] if stays(name, row))], key=place)
        # one row per line
        parts.append(f'"{name}": [\n' + ",\n".join(map(json.dumps, rows)) + "\n]")
    STORED.write_text("{\n" + ",\n".join(parts) + "\n}\n", encoding="utf-8")


def main() -> None:
    """Run what is missing, and write the file and the pages."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("methods", nargs="*", metavar="METHOD")
    parser.add_argument("--tune", action="store_true")
    options = parser.parse_args()
    methods = options.methods or [handle.name for handle in registry.handles("methods")]
    folder = options.folder.resolve()
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    facts = {}
    cells = []
    searches = []
    with contextlib.chdir(out):  # estimated poses are kept there
        for place, drive in drives(folder):
            rows = [
                (poses, row)
                for poses in (GIVEN, ESTIMATED)
                for row in run(place, drive.name, poses, methods=methods)
            ]  # fmt: skip
            for method in methods if options.tune and len(drive) >= FRAMES else ():
                gain, variant = search(place, drive, method)
                searches.append({"drive": drive.name, "method": method, "gain": gain})
                print(f"{drive.name}, {method}: {gain}", flush=True)
                for poses in (GIVEN, ESTIMATED) if variant else ():
                    found = run(place, drive.name, poses, variants=[variant])
                    rows += [(poses, row) for row in found if row.cell.parameter_set.variant]
            counted = [cell(drive.name, poses, row) for poses, row in rows]
            cells += [counts for counts, _ in counted]
            where, licence, labelled = FACTS.get(drive.name, ("", "", ""))
            known = {
                "where": where,
                "licence": licence,
                "labelled": labelled,
                "sensor": drive.sensor.title,
            }
            facts[drive.name] = {**known, "frames": len(drive), "movers": counted[0][1]}
    found = {
        "drives": [{"name": name, **fact} for name, fact in facts.items()],
        "cells": cells,
        "searches": searches,
    }
    save(found, methods, options.tune)
    subprocess.run([sys.executable, DOCS / "generate.py"], check=True)


if __name__ == "__main__":
    main()
