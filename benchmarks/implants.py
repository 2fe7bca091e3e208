"""Does the ranking of the methods by implants agree with the ranking by true labels? ``python benchmarks/implants.py``.

    python benchmarks/implants.py -o FOLDER [--frames N] [--seeds N] [SEQUENCE ...]

SEQUENCE is a path with ground truth, or ``simulate:PRESET``. Every registered method runs on each sequence, and on the
sequence with implants for each seed. Three rankings are compared, by Spearman's rank correlation of AA:

true      the sequence's own labels
implants  DA of the implants alone, SA of the points labelled static; counts of all seeds are added
panel     as above, on the sequence without its labels: SA of the points that the default panel leaves undisputed
"""

from __future__ import annotations

import argparse
import json
import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz import api, params, registry
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.implants.options import ImplantOptions
from dynaviz.implants.panel import default_panel
from dynaviz.implants.scene import CLASSES
from dynaviz.implants.sequence import ImplantedSequence
from dynaviz.scan import Label, Scan, Sequence
from dynaviz.simulate import simulate

DEFAULT = ("simulate:demo", "simulate:street_hdl64")


@dataclass(frozen=True)
class Unlabelled:
    """A sequence without its ground truth."""

    whole: Sequence
    has_labels: bool = False

    name = property(lambda self: self.whole.name)
    sensor = property(lambda self: self.whole.sensor)

    def __len__(self) -> int:
        return len(self.whole)

    def __getitem__(self, position: int) -> Scan:
        return self.whole[position].without_truth()


@dataclass(frozen=True)
class Cached:
    """A sequence read once."""

    name: str
    sensor: Any
    scans: list[Scan]
    has_labels: bool = True

    @staticmethod
    def of(sequence: Sequence, name: str) -> Cached:
        """Read a sequence."""
        return Cached(name, sequence.sensor, [sequence[k] for k in range(len(sequence))], sequence.has_labels)

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, position: int) -> Scan:
        return self.scans[position]


class Counts(Listener):
    """Static points, those kept of them, dynamic points, those removed; without and with the drive's own dynamic."""

    def __init__(self) -> None:
        self.true, self.implants = np.zeros(4, np.int64), np.zeros(4, np.int64)

    def labelled(self, labelled: Any, curves: Any) -> None:
        """Count a frame."""
        scan, removed = labelled.scan, labelled.dynamic
        static, dynamic = scan.labels == Label.STATIC, scan.labels == Label.DYNAMIC
        new = np.isin(scan.classes, list(CLASSES.values())) if scan.classes is not None else np.zeros_like(static)
        for counts, moving in ((self.true, dynamic & ~new), (self.implants, dynamic & new)):
            counts += [static.sum(), (static & ~removed).sum(), moving.sum(), (moving & removed).sum()]


def scores(counts: np.ndarray) -> tuple[float, float, float]:
    """SA, DA and AA in percent."""
    static, kept, dynamic, removed = counts.tolist()
    sa, da = 100 * kept / max(static, 1), 100 * removed / max(dynamic, 1)
    return sa, da, math.sqrt(sa * da)


def run(name: str, sequence: Sequence) -> Counts:
    kind, counts = registry.load("methods", name), Counts()
    resolved = params.resolve(kind)
    execute(RunSpec(kind(resolved.params), sequence, resolved.params, online=bool(resolved.online)), [counts])
    return counts


def rank_correlation(a: list[float], b: list[float]) -> float:
    from scipy.stats import spearmanr

    return float(spearmanr(a, b).statistic)


def opened(text: str, frames: int, folder: Path) -> Cached:
    if text.startswith("simulate:"):
        preset = text.partition(":")[2]
        path = folder / f"{preset}-{frames}"
        if not path.exists():
            simulate(preset, path, frames=frames)
        text = str(path)
    sequence = api.open(text, frames=f":{frames}")
    return Cached.of(sequence, sequence.name)


def compare(base: Cached, seeds: int, methods: list[str]) -> Iterator[dict[str, Any]]:
    """One row per method."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # movers that find no place
        options = [ImplantOptions(cars=6, persons=10, seed=seed) for seed in range(seeds)]
        with_labels = [Cached.of(ImplantedSequence.of(base, o), f"seed {o.seed}") for o in options]
        blind, panel = Unlabelled(base), default_panel()
        by_panel = [Cached.of(ImplantedSequence.of(blind, replace(o, panel=panel)), f"seed {o.seed}") for o in options]
    for name in methods:
        true = run(name, base).true
        implants = sum((run(name, sequence).implants for sequence in with_labels), np.zeros(4, np.int64))
        agreed = sum((run(name, sequence).implants for sequence in by_panel), np.zeros(4, np.int64))
        yield {"method": name, "true": scores(true), "implants": scores(implants), "panel": scores(agreed)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", nargs="*", default=list(DEFAULT), metavar="SEQUENCE")
    parser.add_argument("--frames", type=int, default=40, metavar="N")
    parser.add_argument("--seeds", type=int, default=1, metavar="N")
    parser.add_argument("-o", "--out", type=Path, default=Path("build/benchmarks/implants"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    methods = [handle.name for handle in registry.handles("methods")]
    for text in arguments.sequences:
        base, rows = opened(text, arguments.frames, arguments.out), []
        for row in compare(base, arguments.seeds, methods):
            rows.append(row)
            cells = "  ".join(f"{k} " + " / ".join(f"{v:6.2f}" for v in row[k]) for k in ("true", "implants", "panel"))
            print(f"{base.name:24} {row['method']:12} SA / DA / AA: {cells}", flush=True)
        aa = {kind: [row[kind][2] for row in rows] for kind in ("true", "implants", "panel")}
        spearman = {kind: rank_correlation(aa["true"], aa[kind]) for kind in ("implants", "panel")}
        print(f"{base.name}: Spearman with the true AA: " + ", ".join(f"{k} {v:.2f}" for k, v in spearman.items()))
        facts = {"sequence": base.name, "frames": len(base), "rows": rows, "spearman": spearman}
        (arguments.out / f"{base.name}.json").write_text(json.dumps(facts, indent=1))


if __name__ == "__main__":
    main()
