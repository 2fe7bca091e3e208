"""Does the ranking of the methods by implants agree with the ranking by true labels? ``python
benchmarks/implants.py``.

    python benchmarks/implants.py [--frames N] [--stride N] [--seeds A,B] [--methods A,B | --grid]
        [-o OUT] [SEQUENCE]

SEQUENCE is a path with ground truth, or ``simulate:PRESET[:SEED]``. Every registered method, or
with ``--grid`` DUFOMap and OctoMap with several parameters each, runs on the sequence, and on the
sequence with implants for each seed. The implants are planned without the sequence's labels. Three
scores are compared, by Spearman's rank correlation of SA, DA and AA (``benchmarks/agreement.py``
describes all figures):

true      the sequence's own labels
implants  DA of the implants alone, SA of the points labelled static; counts of all seeds are added
panel     as above, but SA of the points that most methods of the default panel keep: needs no
labels

DA is averaged in three ways, on both sides:

points    each point counts once, as in the protocol: one large mover near the sensor decides
movers    each mover counts once in each band of range (``BANDS``), with its share of removed points
matched   as ``movers``, but the implants are weighted: for each true mover and band, those of its
kind in this band

Finished runs are kept in OUT; delete the folder after changes of methods or implants.
"""

from __future__ import annotations

import argparse
import itertools
import json
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from agreement import AVERAGES, Scores, agreement, compared, rank_correlation

from dynaviz import api
from dynaviz.contracts import params, registry
from dynaviz.contracts.scan import Label, Scan, Sequence
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.sources.drive import Drive
from dynaviz.synthetic.implants.implant_options import ImplantOptions
from dynaviz.synthetic.implants.implant_scene import CLASSES
from dynaviz.synthetic.implants.implanted_sequence import ImplantedSequence, planned
from dynaviz.synthetic.implants.lidar_model import LidarModel
from dynaviz.synthetic.implants.panel import default_panel, votes
from dynaviz.synthetic.implants.survey import Survey
from dynaviz.synthetic.simulate import simulate

DEFAULT = ("simulate:demo", "simulate:street_hdl64")
KINDS = ("true", "implants", "panel")
BANDS = (5.0, 10.0, 15.0, 20.0, 30.0, 45.0)  # metres from the sensor
MOVERS = ImplantOptions(cars=4, cyclists=4, persons=4)  # as many of each kind, so that none decides
GRID = {
    "dufomap": {"resolution": (0.1, 0.2, 0.3), "unknown_margin": (0, 1)},
    "octomap": {"resolution": (0.1, 0.2, 0.3), "prob_miss": (0.3, 0.4)},
}
Entry = tuple[str, dict[str, Any]]


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
        return Cached(
            name, sequence.sensor, [sequence[k] for k in range(len(sequence))], sequence.has_labels
        )

    def blind(self) -> Cached:
        """The sequence without its ground truth."""
        return Cached(self.name, self.sensor, [scan.without_truth() for scan in self.scans], False)

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, position: int) -> Scan:
        return self.scans[position]


class Count(Listener):
    """Counts a run, for each kind of score by the labels of one sequence.

    ``static`` has static points and those kept, ``movers`` for each instance its kind, and for each
    band of range its points and those removed.
    """

    def __init__(self, truth: Mapping[str, Sequence]) -> None:
        self.truth = truth
        self.found: dict[str, dict[str, Any]] = {
            kind: {"static": np.zeros(2, np.int64), "movers": {}} for kind in truth
        }

    def labelled(self, labelled: Any, curves: Any) -> None:
        """Count a frame."""
        removed = labelled.dynamic
        for kind, sequence in self.truth.items():
            scan = sequence[labelled.frame]
            found = self.found[kind]
            static = scan.labels == Label.STATIC
            found["static"] += static.sum(), (static & ~removed).sum()
            implanted = np.isin(scan.classes, list(CLASSES.values()))
            moving = (scan.labels == Label.DYNAMIC) & (implanted if kind != "true" else ~implanted)
            band = np.digitize(np.sqrt(scan.squared_ranges()), BANDS)
            for mover in np.unique(scan.instances[moving]).tolist():
                own = moving & (scan.instances == mover)
                name = scan.class_names.get(int(scan.classes[own][0]), "")
                counts = found["movers"].setdefault(
                    str(mover), (group(name), np.zeros((2, len(BANDS) + 1), np.int64))
                )
                counts[1][:] += [
                    np.bincount(band[chosen], minlength=len(BANDS) + 1)
                    for chosen in (own, own & removed)
                ]


def group(name: str) -> str:
    """Vehicle, cyclist or person, from the name of a class."""
    if re.search("person|pedestrian|animal", name.lower()):
        return "person"
    return "cyclist" if "cycl" in name.lower() else "vehicle"


def opened(text: str, frames: int, stride: int, folder: Path) -> Cached:
    if text.startswith("simulate:"):
        preset, _, seed = text.removeprefix("simulate:").partition(":")
        path = folder / "-".join(filter(None, [preset, str(frames), seed]))
        if not path.exists():
            simulate(preset, path, frames=frames, seed=int(seed or 0))
        text = str(path)
    sequence = api.open(text, frames=f":{frames}", stride=stride)
    return Cached.of(sequence, f"{sequence.name}-stride{stride}" if stride > 1 else sequence.name)


class Implanter:
    """Puts movers into a sequence, by seed."""

    def __init__(self, base: Cached) -> None:
        self.base = base
        self.blind = base.blind()
        self.agreed = votes(Drive.of(self.blind), default_panel())
        self.lidar = LidarModel.measure(base)
        self.survey = Survey.of(self.blind, moving=self.agreed.dynamic)

    def sequences(self, seed: int) -> dict[str, Cached]:
        """The same implants in the sequence, with the labels of the sequence, and with those of the
        panel.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # movers that find no place
            scene = planned("", replace(MOVERS, seed=seed), self.lidar, self.survey)
        kinds = [mover.kind for mover in scene.movers]
        print(
            f"{self.base.name} seed {seed}:",
            {kind: kinds.count(kind) for kind in kinds},
            flush=True,
        )
        panel = ImplantedSequence(self.blind, scene, self.lidar, "", ("panel",), self.agreed.static)
        return {
            "implants": Cached.of(
                ImplantedSequence(self.base, scene, self.lidar, ""), self.base.name
            ),
            "panel": Cached.of(panel, self.base.name),
        }


def measured(
    base: Cached, seeds: list[int], entries: list[Entry], folder: Path
) -> list[list[dict[str, Any]]]:
    """For each entry the counts on the sequence itself, and on that with each seed's implants."""
    folder.mkdir(parents=True, exist_ok=True)
    implanter: Implanter | None = None
    results: list[list[dict[str, Any]]] = [[] for _ in entries]
    for seed in (None, *seeds):
        truth: dict[str, Cached] = {}
        for entry, found in zip(entries, results, strict=True):
            what = "itself" if seed is None else f"seed{seed}"
            stored = folder / f"{what}-{title(entry).replace(' ', '-')}.json"
            if not stored.exists():
                if not truth and seed is None:
                    truth = {"true": base}
                elif not truth:
                    implanter = implanter or Implanter(base)
                    truth = implanter.sequences(int(seed or 0))
                stored.write_text(
                    json.dumps(run(entry, truth), default=lambda array: array.tolist())
                )
                print(f"{base.name}: {stored.stem}", flush=True)
            found.append(json.loads(stored.read_text()))
    return results


def run(entry: Entry, truth: Mapping[str, Cached]) -> dict[str, Any]:
    kind = registry.load("methods", entry[0])
    resolved = params.resolve(kind, settings=[f"{key}={value}" for key, value in entry[1].items()])
    count = Count(truth)
    sequence = next(iter(truth.values()))
    execute(
        RunSpec(kind(resolved.params), sequence, resolved.params, online=bool(resolved.online)),
        [count],
    )
    return count.found


def scores(results: list[list[dict[str, Any]]], kind: str) -> Scores:
    """The counts of one kind of score."""
    chosen = [[run[kind] for run in runs if kind in run] for runs in results]
    static = np.array([np.sum([run["static"] for run in runs], axis=0) for runs in chosen])
    cells: list[tuple[int, int, str, int]] = []
    counts: list[np.ndarray] = []
    movers = 0
    for seed, runs in enumerate(zip(*chosen, strict=True)):
        for instance, (name, own) in runs[0]["movers"].items():
            removed = np.array([run["movers"][instance][1][1] for run in runs])
            present = np.flatnonzero(own[0])
            cells += [(movers, seed, name, int(band)) for band in present]
            counts += [np.append(own[0][band], removed[:, band]) for band in present]
            movers += 1
    mover, seeds, kinds, bands = (np.array(column) for column in zip(*cells, strict=True))
    table = np.array(counts).T
    return Scores(
        100 * static[:, 1] / static[:, 0], mover, seeds, kinds, bands, table[0], table[1:]
    )


def title(entry: Entry) -> str:
    return " ".join([entry[0], *(f"{key}={value}" for key, value in entry[1].items())])


def grid() -> list[Entry]:
    found: list[Entry] = []
    for method, axes in GRID.items():
        found += [
            (method, dict(zip(axes, values, strict=True)))
            for values in itertools.product(*axes.values())
        ]
    return found


def report(name: str, entries: list[Entry], results: list[list[dict[str, Any]]]) -> dict[str, Any]:
    """Print the scores and how the rankings agree."""
    by_kind = {kind: scores(results, kind) for kind in KINDS}
    true = by_kind["true"]
    names = [title(entry) for entry in entries]
    facts: dict[str, Any] = {
        "movers": {kind: len(found) for kind, found in by_kind.items()},
        "rows": {},
    }
    print(f"{name}: movers {facts['movers']}")
    for average in AVERAGES:
        das = {
            kind: compared(average, true, by_kind[kind], true.once(), by_kind[kind].once())
            for kind in KINDS[1:]
        }
        columns = {"true": (true.sa, das["implants"][0])}
        columns |= {kind: (by_kind[kind].sa, das[kind][1]) for kind in KINDS[1:]}
        aa = {kind: np.sqrt(sa * da) for kind, (sa, da) in columns.items()}
        facts["rows"][average] = rows = {}
        for k in np.argsort(-aa["true"]):
            rows[names[k]] = {
                kind: [float(sa[k]), float(da[k]), float(aa[kind][k])]
                for kind, (sa, da) in columns.items()
            }
            cells = "  ".join(
                f"{kind} " + " / ".join(f"{v:6.2f}" for v in row)
                for kind, row in rows[names[k]].items()
            )
            print(f"{name:20} {average:7} {names[k]:40} SA / DA / AA: {cells}", flush=True)
        for kind in KINDS[1:]:
            found = agreement(average, true, by_kind[kind])
            found["wrong"] = [" - ".join(names[k] for k in pair) for pair in found["wrong"]]
            facts.setdefault(kind, {})[average] = found
            print(f"{name}, average over {average}, {kind}: {json.dumps(found)}", flush=True)
    return facts


def together(facts: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Rank correlation of the AA averaged over several sequences.

    Do implants choose what is best on all of them?
    """
    found: dict[str, dict[str, float]] = {kind: {} for kind in KINDS[1:]}
    for average in AVERAGES:
        rows = [one["rows"][average] for one in facts]
        aa = {
            kind: [np.mean([row[name][kind][2] for row in rows]) for name in rows[0]]
            for kind in KINDS
        }
        for kind in KINDS[1:]:
            found[kind][average] = rank_correlation(aa["true"], aa[kind])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sequences", nargs="*", default=list(DEFAULT), metavar="SEQUENCE")
    parser.add_argument("--frames", type=int, default=60, metavar="N")
    parser.add_argument(
        "--stride", type=int, default=3, metavar="N", help="use every N-th of these frames"
    )
    parser.add_argument("--seeds", default="0,1", metavar="A,B")
    parser.add_argument("--methods", metavar="A,B", help="methods to compare; default: all")
    parser.add_argument("--grid", action="store_true", help="compare parameters instead of methods")
    parser.add_argument("-o", "--out", type=Path, default=Path("build/benchmarks/implants"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    names = (
        arguments.methods.split(",")
        if arguments.methods
        else [known.name for known in registry.handles("methods")]
    )
    seeds = [int(seed) for seed in arguments.seeds.split(",")]
    all_facts: list[dict[str, Any]] = []
    for text in arguments.sequences:
        base = opened(text, arguments.frames, arguments.stride, arguments.out)
        entries = grid() if arguments.grid else [(name, {}) for name in names]
        results = measured(base, seeds, entries, arguments.out / "runs" / base.name)
        groups = dict.fromkeys(method for method, _ in entries) if arguments.grid else (None,)
        for group_name in groups:
            rows = [k for k, (method, _) in enumerate(entries) if group_name in (None, method)]
            facts = report(base.name, [entries[k] for k in rows], [results[k] for k in rows])
            all_facts.append(facts)
            file = (
                "-".join(filter(None, [base.name, group_name, "seeds", arguments.seeds])) + ".json"
            )
            (arguments.out / file).write_text(json.dumps(facts, indent=1))
    if len(arguments.sequences) > 1 and not arguments.grid:
        print(f"mean AA of all sequences: {json.dumps(together(all_facts))}")


if __name__ == "__main__":
    main()
