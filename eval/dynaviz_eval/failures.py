"""Failure cases: wrong points that belong together, and their causes in the paper's terms."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F32, I64, Bool, Intp
from dynaviz.kernels.keys import X_SHIFT, Y_SHIFT
from dynaviz.method import MethodInfo
from dynaviz.metric import Figure, FrameBoxes, Labelled
from dynaviz.results.scores import percentage_points_lost
from dynaviz.scan import Label, Outcome, Scan
from dynaviz.spatial.grid import in_key_range, pack
from dynaviz_eval.attribution import causes_of, sentence, shape
from dynaviz_eval.cases import EDGE, GAP, KEEP, Cases, summed

SPAN = 20.0  # metres: maximum size of a false-positive case; larger holes are split. Trails of movers may be longer
_KINDS = {"false_negative": Outcome.FALSE_NEGATIVE, "false_positive": Outcome.FALSE_POSITIVE}


class Failures:
    """Section ``failures``: where, when and why points are wrong, costliest case first.

    ``cases``: at most 100, each with ``kind``, ``points``, ``cost`` (percentage points of DA or SA), ``first_frame``,
    ``last_frame``, ``worst_frame``, number of ``frames``, ``low`` and ``high`` corner (metres, world frame), ``range``
    from the sensor (metres), distance ``moved`` (metres), ``reasons`` with their counts, ``cause``, ``class``,
    ``instance``, ``what`` it is, and a ``sentence``. ``causes``: numbers of cases and points by kind and cause, of all
    cases. ``others``: cases and points that are not listed.
    """

    def __init__(self, info: MethodInfo) -> None:
        self._reasons = info.reasons
        spans = {"false_negative": np.inf, "false_positive": SPAN}
        self._cases = {
            kind: Cases(len(info.reasons) + 1, span, partial(self._count, kind)) for kind, span in spans.items()
        }
        self._causes: dict[str, dict[str, dict[str, int]]] = {
            kind: defaultdict(lambda: {"cases": 0, "points": 0}) for kind in spans
        }
        self._names: dict[int, str] = {}
        self._totals = dict.fromkeys(_KINDS, 0)
        self._frame = 0
        self._listed: list[tuple[dict[str, Any], NDArray[np.void]]] = []

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Join the wrong points of a scan into cases."""
        labels = labelled.scan.labels
        if labels is not None:
            self.add(labelled, int((labels == Label.STATIC).sum()), int((labels == Label.DYNAMIC).sum()))
        return {}

    def add(self, labelled: Labelled, static: int, dynamic: int) -> None:
        """As ``update``, for a scan reduced to its wrong and its dynamic points.

        Args:
            labelled: the scan; correctly labelled static points may be missing.
            static, dynamic: numbers of points in the whole scan, of which costs are shares.
        """
        scan, self._frame = labelled.scan, labelled.frame
        self._names |= {number: name for number, name in scan.class_names.items() if number}  # 0 means unlabelled
        self._totals["false_negative"] += dynamic
        self._totals["false_positive"] += static
        for kind, cases in self._cases.items():
            wrong = np.flatnonzero(labelled.outcome == _KINDS[kind])
            wrong = wrong[in_key_range(scan.points[wrong], EDGE)]  # drop non-finite and very distant points
            points, groups = scan.points[wrong], _groups(scan, wrong, kind)
            ranges = np.sqrt(scan.squared_ranges(wrong))
            near = _near_dynamic(points, scan) if kind == "false_positive" else np.zeros(len(points), np.bool_)
            cases.add(labelled.frame, points, groups, labelled.reasons[wrong], ranges, near)

    def finish(self) -> Mapping[str, Any]:
        """The section."""
        listed: list[tuple[dict[str, Any], NDArray[np.void]]] = []
        for kind, cases in self._cases.items():
            cases.settle(self._frame + GAP + 1)  # all cases are over by then
            listed += self._described(kind, cases.rows)
            self._count(kind, summed(cases.rows))
        listed.sort(key=lambda pair: (-pair[0]["cost"], pair[0]["kind"], pair[0]["first_frame"], pair[0]["low"]))
        self._listed = listed[:KEEP]
        counts = [count for by in self._causes.values() for count in by.values()]
        others = {
            "cases": sum(count["cases"] for count in counts) - len(self._listed),
            "points": sum(count["points"] for count in counts) - sum(case["points"] for case, _ in self._listed),
        }
        ordered = {kind: dict(sorted(by.items(), key=lambda i: -i[1]["points"])) for kind, by in self._causes.items()}
        return {"failures": {"cases": [case for case, _ in self._listed], "causes": ordered, "others": others}}

    def figures(self) -> Mapping[str, Figure]:
        """A box around each case, overall and in each of its frames."""
        if not self._listed:
            return {}
        cases = [case for case, _ in self._listed]
        rows = np.concatenate([rows for _, rows in self._listed])
        number = np.repeat(np.arange(len(cases)), [len(rows) for _, rows in self._listed])
        low, high = (np.array([case[name] for case in cases], np.float32) for name in ("low", "high"))
        return {
            "failures": FrameBoxes(
                tuple(f"{number} {case['what']}" for number, case in enumerate(cases, 1)),
                np.array([_KINDS[case["kind"]] for case in cases], np.uint8),
                low,
                high,
                rows["frame"],
                number,
                rows["low"],
                rows["high"],
            )
        }

    def _count(self, kind: str, over: NDArray[np.void]) -> None:
        """Add cases that are over to the counts of their causes."""
        for cause, points in zip(causes_of(kind, over, self._reasons), over["points"].tolist(), strict=True):
            count = self._causes[kind][str(cause or "unknown")]
            count["cases"] += 1
            count["points"] += points

    def _described(self, kind: str, rows: NDArray[np.void]) -> Iterator[tuple[dict[str, Any], NDArray[np.void]]]:
        """Each case as plain JSON values, with its rows."""
        total = summed(rows)
        for case, cause in zip(total, causes_of(kind, total, self._reasons), strict=True):
            group, points = int(case["group"]), int(case["points"])
            number = (group >> 32) - 1  # of its class
            plain = {
                "kind": kind,
                "points": points,
                "cost": float(percentage_points_lost(points, self._totals[kind])),
                "first_frame": int(case["first"]),
                "last_frame": int(case["last"]),
                "worst_frame": int(case["frame"]),
                "frames": int(case["frames"]),
                "low": _rounded(case["low"], 2),
                "high": _rounded(case["high"], 2),
                "range": {
                    "min": round(float(case["near"]), 1),
                    "mean": round(float(case["ranges"]) / points, 1),
                    "max": round(float(case["far"]), 1),
                },
                "moved": round(float(case["moved"]), 1),
                "reasons": self._by_name(case["reasons"]),
                "cause": None if cause is None else str(cause),
                "class": number if number >= 0 else None,
                "instance": (group & 0xFFFFFFFF) or None,
                "what": self._names.get(number) or shape(kind, case["high"] - case["low"]),
            }
            yield {**plain, "sentence": sentence(plain)}, rows[rows["case"] == case["case"]]

    def _by_name(self, counts: I64) -> dict[str, int]:
        names = [*(reason.name for reason in self._reasons), "unknown code"]
        return {names[code]: int(counts[code]) for code in np.argsort(-counts, kind="stable") if counts[code]}


def _groups(scan: Scan, chosen: Intp, kind: str) -> I64:
    """Class, and for dynamic points the object, packed into one number; 0 if unknown."""
    groups = np.zeros(len(chosen), np.int64)
    if scan.classes is not None:
        groups += (scan.classes[chosen].astype(np.int64) + 1) << 32
    if scan.instances is not None and kind == "false_negative":
        groups += scan.instances[chosen]
    return groups


def _near_dynamic(points: F32, scan: Scan) -> Bool:
    """(N,) bool: whether the scan has dynamic points in a point's cell, or in a cell that touches it."""
    dynamic = scan.points[scan.labels == Label.DYNAMIC]
    dynamic = dynamic[in_key_range(dynamic, EDGE)]
    if not len(dynamic) or not len(points):
        return np.zeros(len(points), np.bool_)
    steps = np.arange(-1, 2)
    around = ((steps[:, None, None] << X_SHIFT) + (steps[:, None] << Y_SHIFT) + steps).ravel()
    near = np.unique(np.unique(pack(dynamic, EDGE))[:, None] + around)
    return np.isin(pack(points, EDGE), near)


def _rounded(values: F32, digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]
