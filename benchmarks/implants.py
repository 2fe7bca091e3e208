"""Does the ranking of the methods by implants agree with the ranking by true labels? ``python benchmarks/implants.py``.

    python benchmarks/implants.py [--frames N] [--stride N] [--seeds N] [--methods A,B | --grid] [-o FOLDER] [SEQUENCE]

SEQUENCE is a path with ground truth, or ``simulate:PRESET[:SEED]``. Every registered method, or with ``--grid``
DUFOMap and OctoMap with several parameters each, runs on the sequence, and on the sequence with implants for each
seed. The implants are planned without the sequence's labels. Three scores are compared, by Spearman's rank correlation
of SA, DA and AA:

true      the sequence's own labels
implants  DA of the implants alone, SA of the points labelled static; counts of all seeds are added
panel     as above, but SA of the points that most methods of the default panel keep: needs no labels

DA is averaged in two ways, on both sides:

points    each point counts once, as in the protocol: one large mover near the sensor decides
movers    each mover counts once in each band of range (``BANDS``), with its share of removed points

Movers are few, so both rankings depend on which movers there are. They are drawn again with replacement: the interval
of each correlation contains 90 % of the draws. ``itself`` is the correlation of the true ranking with that of drawn
movers of the same sequence: other movers cannot be expected to agree better.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz import api, params, registry
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.implants.lidar import LidarModel
from dynaviz.implants.options import ImplantOptions
from dynaviz.implants.panel import Votes, default_panel, votes
from dynaviz.implants.scene import CLASSES
from dynaviz.implants.sequence import ImplantedSequence, planned
from dynaviz.implants.survey import Survey
from dynaviz.scan import Label, Scan, Sequence
from dynaviz.simulate import simulate

DEFAULT = ("simulate:demo", "simulate:street_hdl64")
KINDS = ("true", "implants", "panel")
AVERAGES = ("points", "movers")
BANDS = (5.0, 10.0, 15.0, 20.0, 30.0, 45.0)  # metres from the sensor
FEW = 20  # points of a mover in a band; fewer do not count in the average over movers
DRAWS = 500
MOVERS = ImplantOptions(cars=6, cyclists=6, persons=6)  # as many of each kind, so that none decides
GRID = {
    "dufomap": {"resolution": (0.1, 0.2, 0.3), "unknown_margin": (0, 1)},
    "octomap": {"resolution": (0.1, 0.2, 0.3), "prob_miss": (0.3, 0.4)},
}


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

    def blind(self) -> Cached:
        """The sequence without its ground truth."""
        return Cached(self.name, self.sensor, [scan.without_truth() for scan in self.scans], False)

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, position: int) -> Scan:
        return self.scans[position]


@dataclass
class Score:
    """Static points, and those kept; for each mover and band of range its points, and those removed."""

    static: np.ndarray = field(default_factory=lambda: np.zeros(2, np.int64))
    movers: dict[Any, np.ndarray] = field(default_factory=dict)

    def add(self, scan: Scan, moving: np.ndarray, removed: np.ndarray, seed: int) -> None:
        """Count a frame."""
        static = scan.labels == Label.STATIC
        self.static += static.sum(), (static & ~removed).sum()
        band = np.digitize(np.sqrt(scan.squared_ranges()), BANDS)
        for mover in np.unique(scan.instances[moving]):
            own = moving & (scan.instances == mover)
            counts = self.movers.setdefault((seed, int(mover)), np.zeros((2, len(BANDS) + 1), np.int64))
            counts += [np.bincount(band[chosen], minlength=len(BANDS) + 1) for chosen in (own, own & removed)]

    def percent(self, average: str, drawn: list[Any] | None = None) -> tuple[float, float, float]:
        """SA, DA and AA; with drawn movers only those count, as often as they were drawn."""
        chosen = np.array([self.movers[mover] for mover in (self.movers if drawn is None else drawn)])
        points, removed = chosen.sum(0).sum(1) if average == "points" and len(chosen) else (0, 0)
        da = removed / max(points, 1)
        if average == "movers" and len(chosen):
            points, removed = chosen[:, 0], chosen[:, 1]
            da = float(np.mean(removed[points >= FEW] / points[points >= FEW]))
        sa, da = 100 * self.static[1] / max(self.static[0], 1), 100 * da
        return float(sa), float(da), math.sqrt(sa * da)


class Count(Listener):
    """Counts the frames of a run; ``truth`` has one labelled sequence for each kind of score."""

    def __init__(self, scores: dict[str, Score], truth: Mapping[str, Sequence], seed: int) -> None:
        self.scores, self.truth, self.seed = scores, truth, seed

    def labelled(self, labelled: Any, curves: Any) -> None:
        """Count a frame."""
        for kind, sequence in self.truth.items():
            scan = sequence[labelled.frame]
            implanted = np.isin(scan.classes, list(CLASSES.values()))
            moving = (scan.labels == Label.DYNAMIC) & (implanted if kind != "true" else ~implanted)
            self.scores[kind].add(scan, moving, labelled.dynamic, self.seed)


def run(method: str, settings: Mapping[str, Any], sequence: Sequence, count: Count) -> None:
    kind = registry.load("methods", method)
    resolved = params.resolve(kind, settings=[f"{key}={value}" for key, value in settings.items()])
    execute(RunSpec(kind(resolved.params), sequence, resolved.params, online=bool(resolved.online)), [count])


def opened(text: str, frames: int, folder: Path, stride: int = 1) -> Cached:
    if text.startswith("simulate:"):
        preset, _, seed = text.removeprefix("simulate:").partition(":")
        path = folder / "-".join(filter(None, [preset, str(frames), seed]))
        if not path.exists():
            simulate(preset, path, frames=frames, seed=int(seed or 0))
        text = str(path)
    sequence = api.open(text, frames=f":{frames}", stride=stride)
    return Cached.of(sequence, sequence.name)


def implanted(base: Cached, agreed: Votes, seed: int) -> dict[str, Cached]:
    """The same implants in the sequence, with the labels of the sequence, and with those of the panel."""
    blind, lidar = base.blind(), LidarModel.measure(base)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # movers that find no place
        scene = planned("", replace(MOVERS, seed=seed), lidar, Survey.of(blind, moving=agreed.dynamic))
    return {
        "implants": Cached.of(ImplantedSequence(base, scene, lidar, ""), base.name),
        "panel": Cached.of(ImplantedSequence(blind, scene, lidar, "", ("panel",), agreed.static), base.name),
    }


def compare(base: Cached, seeds: int, entries: list[tuple[str, dict[str, Any]]]) -> list[dict[str, Score]]:
    """The scores of each method with its settings, by kind."""
    agreed = votes(base.blind(), default_panel())
    scores = [{kind: Score() for kind in KINDS} for _ in entries]
    for seed in range(-1, seeds):  # -1: without implants
        truth = {"true": base} if seed < 0 else implanted(base, agreed, seed)
        sequence = next(iter(truth.values()))
        for (method, settings), found in zip(entries, scores, strict=True):
            run(method, settings, sequence, Count(found, truth, seed))
            done = " ".join(f"{kind} {found[kind].percent('points')[2]:.2f}" for kind in truth)
            print(f"{base.name} seed {seed} {method} {settings or ''}: AA {done}", flush=True)
    return scores


def rank_correlation(a: list[float], b: list[float]) -> float:
    from scipy.stats import spearmanr

    return float(spearmanr(a, b).statistic)


def correlations(scores: list[dict[str, Score]], average: str) -> dict[str, Any]:
    """Spearman's correlation of SA, DA and AA with the true ones, and intervals of that of AA over drawn movers."""
    rng = np.random.default_rng(0)
    whole = {kind: np.array([score[kind].percent(average) for score in scores]) for kind in KINDS}
    movers = {kind: list(scores[0][kind].movers) for kind in KINDS}
    draws: dict[str, list[float]] = {"implants": [], "panel": [], "itself": []}
    for _ in range(DRAWS):
        chosen = {kind: [names[k] for k in rng.integers(len(names), size=len(names))] for kind, names in movers.items()}
        aa = {kind: [score[kind].percent(average, chosen[kind])[2] for score in scores] for kind in KINDS}
        for kind in ("implants", "panel"):
            draws[kind].append(rank_correlation(aa["true"], aa[kind]))
        draws["itself"].append(rank_correlation(whole["true"][:, 2], aa["true"]))
    facts: dict[str, Any] = {}
    for kind, values in draws.items():
        low, middle, high = np.nanquantile(values, [0.05, 0.5, 0.95]).round(2).tolist()
        facts[kind] = {"AA": round(middle, 2), "interval": [low, high]}
        if kind != "itself":
            found = [rank_correlation(whole["true"][:, k], whole[kind][:, k]) for k in range(3)]
            facts[kind] |= dict(zip(("SA", "DA", "AA"), np.round(found, 2).tolist(), strict=True))
    return facts


def grid() -> list[tuple[str, dict[str, Any]]]:
    found: list[tuple[str, dict[str, Any]]] = []
    for method, axes in GRID.items():
        found += [(method, dict(zip(axes, values, strict=True))) for values in itertools.product(*axes.values())]
    return found


def report(base: Cached, entries: list[tuple[str, dict[str, Any]]], scores: list[dict[str, Score]]) -> dict[str, Any]:
    """Print the scores and the correlations; with a grid one per method."""
    gridded = any(settings for _, settings in entries)
    facts: dict[str, Any] = {"sequence": base.name, "frames": len(base), "rows": {}, "correlations": {}}
    for average in AVERAGES:
        rows = [
            {
                "name": " ".join([method, *(f"{key}={value}" for key, value in settings.items())]),
                **{kind: score[kind].percent(average) for kind in KINDS},
            }
            for (method, settings), score in zip(entries, scores, strict=True)
        ]
        facts["rows"][average] = rows = sorted(rows, key=lambda row: -row["true"][2])
        for row in rows:
            cells = "  ".join(f"{kind} " + " / ".join(f"{v:6.2f}" for v in row[kind]) for kind in KINDS)
            print(f"{base.name:20} {average:6} {row['name']:40} SA / DA / AA: {cells}", flush=True)
        for group in dict.fromkeys(method for method, _ in entries) if gridded else ("methods",):
            own = [score for (method, _), score in zip(entries, scores, strict=True) if group in (method, "methods")]
            facts["correlations"].setdefault(group, {})[average] = found = correlations(own, average)
            for kind, fact in found.items():
                print(f"{base.name}: {group}, average over {average}: {kind}: Spearman {fact}", flush=True)
    return facts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", nargs="*", default=list(DEFAULT), metavar="SEQUENCE")
    parser.add_argument("--frames", type=int, default=24, metavar="N")
    parser.add_argument("--stride", type=int, default=1, metavar="N", help="use every N-th of these frames")
    parser.add_argument("--seeds", type=int, default=2, metavar="N")
    parser.add_argument("--methods", metavar="A,B", help="methods to compare; default: all")
    parser.add_argument("--grid", action="store_true", help="compare parameters instead of methods")
    parser.add_argument("-o", "--out", type=Path, default=Path("build/benchmarks/implants"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    names = arguments.methods.split(",") if arguments.methods else [known.name for known in registry.handles("methods")]
    entries = grid() if arguments.grid else [(name, {}) for name in names]
    for text in arguments.sequences:
        base = opened(text, arguments.frames, arguments.out, arguments.stride)
        facts = report(base, entries, compare(base, arguments.seeds, entries))
        name = f"{base.name}{'-grid' if arguments.grid else ''}.json"
        (arguments.out / name).write_text(json.dumps(facts, indent=1))


if __name__ == "__main__":
    main()
