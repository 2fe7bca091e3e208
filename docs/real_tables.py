"""The tables of real drives: those that had a part in development, and sealed ones that had none.

``benchmarks/real.py`` counts the development drives (``real.json``). The sealed drives are counted
elsewhere, since nobody who develops methods has them (``sealed.json``, in the same form).
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz.contracts import registry
from dynaviz.scores.movers import FEWEST, drawn, interval

DOCS = Path(__file__).resolve().parent
POSES = {"given": "given poses", "small-gicp": "`small-gicp`"}
"""In words, the poses with which methods ran."""
OURS = "seethrough"
FIVE = ("erasor", "octomap_gf", "dufomap", "dynablox", OURS)
"""The methods of short tables."""
TITLES = {"dor_wheel": "DOR fusion"}
"""Of methods in ``examples/``."""
PARTS = {
    "kitti_tracking_0011": "rules and constants",
    "kitti_tracking_0012": "rules and constants",
    "nuscenes_scene-0916": "rules and constants",
    "semantickitti_08": "its scores were looked at",
    "argoverse2_7fab2350": "its scores were looked at",
}
"""What each development drive had a part in choosing; sealed drives had none."""
OPENS = {
    "nuscenes_scene-0523": "`nuscenes/scene-0523` (full data set)",
    "kitti_raw_2011_09_26_drive_0001": "`kitti_raw/2011_09_26/2011_09_26_drive_0001_sync`",
    "pandaset_002": "`pandaset/002`",
    "kitti_tracking_0011_200_299": ("`kitti_tracking/training/velodyne/0011 --frames 200:300`"),
    "kitti_tracking_0000": "`kitti_tracking/training/velodyne/0000 --poses small-gicp`",
    "scooters_ruby128": "not public",
}
"""What follows ``dynaviz run METHOD`` for each sealed drive."""


def table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A Markdown table."""
    lines = [list(head), *([str(cell).replace("|", "\\|") for cell in row] for row in rows)]
    first, *rest = ("| " + " | ".join(cells) + " |" for cells in lines)
    return "\n".join([first, "|---" * len(lines[0]) + "|", *rest])


@cache
def methods() -> dict[str, Any]:
    """The methods that come with dynaviz, by name."""
    handles = (
        handle for handle in registry.handles("methods") if handle.package == "dynaviz_methods"
    )
    return {handle.name: handle.load() for handle in handles}


def method_title(name: str) -> str:
    """The title of a method, also of one from a package that is not installed here."""
    return str(methods()[name].info.title) if name in methods() else TITLES[name]


@cache
def stored(name: str) -> dict[str, Any]:
    """The counts in a file, ``real`` or ``sealed``."""
    known: dict[str, Any] = json.loads((DOCS / f"{name}.json").read_text(encoding="utf-8"))
    return known


@dataclasses.dataclass(frozen=True)
class RealScore:
    """A method on a real drive.

    Attributes:
        SA, DA, AA: percent.
        low, high: ends of the interval of AA over drawn movers; None if movers have no numbers.
        found: movers of which at least half of the points are removed.
        movers: all.
    """

    SA: float
    DA: float
    AA: float
    low: float | None
    high: float | None
    found: int
    movers: int

    @classmethod
    def of(cls, cell: Mapping[str, Any], drive: Mapping[str, Any]) -> RealScore:
        """From the counts of a cell, and the facts of its drive."""
        points = np.array([number for _, number in drive["movers"]], np.int64)
        removed = np.array(cell["removed"], np.int64)
        kept, lost = cell["static"]
        taken, left = cell.get("dynamic", (removed.sum(), (points - removed).sum()))
        SA = kept / (kept + lost)
        DA = taken / (taken + left)
        low = high = None
        if len(points) >= FEWEST:
            sums = drawn(np.stack([removed, points], 1))
            low, high = interval(100 * np.sqrt(SA * sums[:, 0] / sums[:, 1]))
        found = int((2 * removed >= points).sum())
        AA = 100 * float(np.sqrt(SA * DA))
        return cls(100 * SA, 100 * DA, AA, low, high, found, len(points))

    @property
    def rates(self) -> str:
        """SA, DA and AA."""
        return f"{self.SA:.1f}/{self.DA:.1f}/**{self.AA:.1f}**"

    @property
    def within(self) -> str:
        """SA, DA and AA, with the interval of AA."""
        return self.rates if self.low is None else f"{self.rates} ({self.low:.0f}-{self.high:.0f})"

    def __str__(self) -> str:
        return self.within if self.low is None else f"{self.within} {self.found}"


def scores_on(file: str, drive: str, poses: str, tuned: bool = False) -> dict[str, RealScore]:
    """The scores of each method on a drive of a file, best AA first."""
    facts = next(each for each in stored(file)["drives"] if each["name"] == drive)
    scores = {
        cell["method"]: RealScore.of(cell, facts)
        for cell in stored(file)["cells"]
        if (cell["drive"], cell["poses"], bool(cell["set"])) == (drive, poses, tuned)
    }
    return dict(sorted(scores.items(), key=lambda each: -each[1].AA))


def real_scores(drive: str, poses: str, tuned: bool = False) -> dict[str, RealScore]:
    """The scores of each method on a development drive, best AA first."""
    return scores_on("real", drive, poses, tuned)


def sealed_scores() -> dict[str, dict[str, RealScore]]:
    """By sealed drive, the scores of each method, best AA first."""
    names = [each["name"] for each in stored("sealed")["drives"]]
    return {name: scores_on("sealed", name, "given") for name in names}


def title(drive: str) -> str:
    """A drive, as every table and page names it: the name that ``dynaviz info`` prints."""
    return f"`{drive}`"


def sealed_drives() -> str:
    """Facts of the sealed drives, and how to run each."""
    rows = (
        (
            title(each["name"]),
            each["where"],
            each["sensor"],
            each["frames"],
            each["labelled"],
            len(each["movers"]) or "not numbered",
            OPENS[each["name"]],
        )
        for each in stored("sealed")["drives"]
    )
    return table(
        ("drive", "recorded in", "sensor", "frames", "labelled", "movers", "path and options"),
        rows,
    )


def sealed_table() -> str:
    """Each method on each sealed drive, by mean rank."""
    scores = sealed_scores()
    ranks = {name: [1 + list(known).index(name) for known in scores.values()] for name in methods()}
    order = sorted(methods(), key=lambda name: (np.mean(ranks[name]), name))
    head = ("method", *(title(drive) for drive in scores), "mean rank", "lowest AA")
    rows = (
        (
            f"`{name}`",
            *(str(known[name]) for known in scores.values()),
            f"{np.mean(ranks[name]):.1f}",
            f"{min(known[name].AA for known in scores.values()):.1f}",
        )
        for name in order
    )
    return table(head, rows)


def sealed_five() -> str:
    """Five methods, and the best other one, on the sealed drives."""
    scores = sealed_scores()
    rows = [
        (method_title(name), *(known[name].within for known in scores.values())) for name in FIVE
    ]
    others = (next(name for name in known if name != OURS) for known in scores.values())
    best = (
        f"{method_title(name)} {known[name].AA:.1f}"
        for name, known in zip(others, scores.values(), strict=True)
    )
    rows.append(("best other, AA", *best))
    return table(("SA / DA / AA", *(title(drive) for drive in scores)), rows)


def sealed_first() -> str:
    """On how many sealed drives SeeThrough is first, and which method is where it is not."""
    scores = sealed_scores()
    behind = [
        f"{title(drive)} ({method_title(best)} {known[best].AA:.1f}, "
        f"SeeThrough {known[OURS].AA:.1f})"
        for drive, known in scores.items()
        if (best := next(iter(known))) != OURS
    ]
    mean = np.mean([known[OURS].AA for known in scores.values()])
    lowest = min(known[OURS].AA for known in scores.values())
    first = (
        f"SeeThrough has the highest AA on {len(scores) - len(behind)} of {len(scores)} sealed "
        f"drives, {mean:.1f} in the mean and {lowest:.1f} at the lowest."
    )
    return f"{first} It is not first on {'; '.join(behind)}." if behind else first


def seethrough_drives() -> str:
    """What each drive had a part in choosing, and SeeThrough's place on it."""
    rows = []
    drives = [
        (kind, each["name"]) for kind in ("sealed", "real") for each in stored(kind)["drives"]
    ]
    for file, drive in drives:
        for poses, words in POSES.items():
            scores = scores_on(file, drive, poses)
            if not scores:
                continue
            place = 1 + list(scores).index(OURS)
            other = next(name for name in scores if name != OURS)
            row = (
                title(drive),
                PARTS.get(drive, "none: sealed"),
                words,
                scores[OURS].within,
                f"{place} of {len(scores)}" if place == 1 else f"**{place} of {len(scores)}**",
                f"{method_title(other)} {scores[other].AA:.1f}",
            )
            rows.append(row)
    return table(
        ("drive", "part in choosing", "poses", "SA/DA/AA", "place by AA", "best other, AA"), rows
    )


def real_drives() -> str:
    """Facts of the drives of benchmarks/real.py."""
    rows = (
        (
            title(drive["name"]),
            drive["where"],
            drive["sensor"],
            drive["frames"],
            drive["labelled"],
            len(drive["movers"]),
            drive["licence"],
        )
        for drive in stored("real")["drives"]
    )
    return table(
        ("drive", "recorded in", "sensor", "frames", "labelled", "movers", "licence"), rows
    )


def real_table() -> str:
    """All cells of benchmarks/real.py.

    Drives and methods by poses, and by parameters if they were searched.

    Methods with the same scores share a row, and only the first row of a drive names it.
    """
    rows = []
    searched = {(each["drive"], each["method"]) for each in stored("real")["searches"]}
    head = (
        "drive",
        "method",
        *(f"{words}{tuned}" for tuned in ("", ", tuned") for words in POSES.values()),
    )
    for drive in (each["name"] for each in stored("real")["drives"]):
        known = [real_scores(drive, poses, tuned) for tuned in (False, True) for poses in POSES]
        names: dict[tuple[str, ...], list[str]] = {}
        for name in real_scores(drive, "small-gicp") | real_scores(drive, "given"):
            instead = "unproven" if (drive, name) in searched else ""
            cells = tuple(str(each.get(name, instead)) for each in known)
            names.setdefault(cells, []).append(f"`{name}`")
        firsts = [title(drive), *[""] * (len(names) - 1)]
        rows += [
            (first, ", ".join(each), *cells)
            for first, (cells, each) in zip(firsts, names.items(), strict=True)
        ]
    return table(head, rows)


def real_first() -> str:
    """On which drives SeeThrough is first, and which method is where it is not.

    Also among tuned methods.
    """
    sentences = []
    tunable = {each["drive"] for each in stored("real")["searches"]}
    for tuned, words in (
        (False, "at default parameters"),
        (True, "each method at its tuned parameters if a search has proven their gain"),
    ):
        drives = [
            each["name"]
            for each in stored("real")["drives"]
            if not tuned or each["name"] in tunable
        ]
        pairs = [(drive, poses) for drive in drives for poses in POSES]
        others = []
        for drive, poses in pairs:
            scores = real_scores(drive, poses) | (
                real_scores(drive, poses, tuned=True) if tuned else {}
            )
            best = max(scores, key=lambda name: scores[name].AA)
            if best != OURS:
                behind = (
                    f"{method_title(best)} {scores[best].AA:.1f}, SeeThrough {scores[OURS].AA:.1f}"
                )
                others.append(f"{title(drive)} with {POSES[poses]} ({behind})")
        first = (
            f"Of {len(pairs)} combinations of a drive and its poses, SeeThrough has the highest AA "
            "on"
        )
        rest = f" It is not first on {'; '.join(others)}." if others else ""
        sentences += [f"{first} {len(pairs) - len(others)}, {words}.{rest}"] if pairs else []
    return " ".join([*sentences, *real_losses()])


def real_losses() -> list[str]:
    """Which methods have a lower AA on true movers with parameters whose gain on implants is
    proven.
    """
    facts = {each["name"]: each for each in stored("real")["drives"]}
    tuned = [cell for cell in stored("real")["cells"] if cell["set"]]
    worse = []
    for cell in tuned:
        before = real_scores(cell["drive"], cell["poses"])[cell["method"]].AA
        after = RealScore.of(cell, facts[cell["drive"]]).AA
        if after < before:
            place = f"on {title(cell['drive'])} with {POSES[cell['poses']]}"
            worse.append(f"{method_title(cell['method'])} {place} ({before:.1f} to {after:.1f})")
    return (
        [
            f"Of {len(tuned)} tuned cells, AA on true movers is lower in {len(worse)}: "
            f"{'; '.join(worse)}."
        ]
        if worse
        else []
    )


def real_five() -> str:
    """Five methods on the drives with more than a few scans, with estimated poses."""
    names = [
        each["name"]
        for each in stored("real")["drives"]
        if each["labelled"].startswith("boxes") and each["frames"] > 2
    ]
    scores = {name: real_scores(name, "small-gicp") for name in names}
    rows = ((method_title(name), *(scores[drive][name].within for drive in names)) for name in FIVE)
    return table(("SA / DA / AA", *map(title, names)), rows)


TABLES: tuple[Callable[[], str], ...] = (
    sealed_drives,
    sealed_first,
    sealed_five,
    sealed_table,
    seethrough_drives,
    real_drives,
    real_first,
    real_five,
    real_table,
)
