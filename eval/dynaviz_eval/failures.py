"""Failure cases: wrong points that belong together, and what is to blame for them in the paper's terms."""

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
from dynaviz.scan import Label, Outcome, Scan
from dynaviz.spatial.grid import in_key_range, pack
from dynaviz_eval.attribution import causes_of, sentence, shape
from dynaviz_eval.cases import EDGE, GAP, KEEP, Cases, summed

SPAN = 20.0  # metres: a hole in the map is told in parts of at most this size; what moved may leave a longer trail
_KINDS = {"false_negative": Outcome.FALSE_NEGATIVE, "false_positive": Outcome.FALSE_POSITIVE}


class Failures:
    """Section ``failures``: where, when and why points are wrong, the costliest case first.

    ``cases``: at most 100; of each its ``kind``, ``points``, ``cost`` (percentage points of DA or SA), ``first_frame``,
    ``last_frame``, ``worst_frame``, ``low`` and ``high`` corner (metres, world frame), ``range`` from the sensor
    (metres), how far it ``moved`` (metres), ``reasons`` by count, ``cause``, ``class``, ``instance``, ``what`` it is,
    and a ``sentence``. ``causes``: cases and points of each kind by cause, of all cases; ``others``: those not listed.
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
        self._told: list[tuple[dict[str, Any], NDArray[np.void]]] = []

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Join the wrong points of a scan to cases."""
        scan, self._frame = labelled.scan, labelled.frame
        if scan.labels is None:
            return {}
        self._names |= {number: name for number, name in scan.class_names.items() if number}  # 0 is no class
        self._totals["false_negative"] += int((scan.labels == Label.DYNAMIC).sum())
        self._totals["false_positive"] += int((scan.labels == Label.STATIC).sum())
        for kind, cases in self._cases.items():
            wrong = np.flatnonzero(labelled.outcome == _KINDS[kind])
            wrong = wrong[in_key_range(scan.points[wrong], EDGE)]  # not those without a place
            points, groups = scan.points[wrong], _groups(scan, wrong, kind)
            ranges = np.sqrt(((points - _origins(scan, wrong)) ** 2).sum(1))
            beside = _beside(points, scan) if kind == "false_positive" else np.zeros(len(points), np.bool_)
            cases.add(labelled.frame, points, groups, labelled.reasons[wrong], ranges, beside)
        return {}

    def finish(self) -> Mapping[str, Any]:
        """The section."""
        told: list[tuple[dict[str, Any], NDArray[np.void]]] = []
        for kind, cases in self._cases.items():
            cases.settle(self._frame + GAP + 1)  # by then all are over
            told += self._described(kind, cases.rows)
            self._count(kind, summed(cases.rows))
        told.sort(key=lambda pair: (-pair[0]["cost"], pair[0]["kind"], pair[0]["first_frame"], pair[0]["low"]))
        self._told = told[:KEEP]
        counts = [count for by in self._causes.values() for count in by.values()]
        others = {
            "cases": sum(count["cases"] for count in counts) - len(self._told),
            "points": sum(count["points"] for count in counts) - sum(case["points"] for case, _ in self._told),
        }
        ordered = {kind: dict(sorted(by.items(), key=lambda i: -i[1]["points"])) for kind, by in self._causes.items()}
        return {"failures": {"cases": [case for case, _ in self._told], "causes": ordered, "others": others}}

    def figures(self) -> Mapping[str, Figure]:
        """A box around each case in each of its frames."""
        if not self._told:
            return {}
        cases = [case for case, _ in self._told]
        rows = np.concatenate([rows for _, rows in self._told])
        number = np.repeat(np.arange(len(cases)), [len(rows) for _, rows in self._told])
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
        """Add cases that are over to those of their causes."""
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
                "cost": 100.0 * points / self._totals[kind],
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
    """Class, and for what moves the object, as one number; 0 where the data tell neither."""
    groups = np.zeros(len(chosen), np.int64)
    if scan.classes is not None:
        groups += (scan.classes[chosen].astype(np.int64) + 1) << 32
    if scan.instances is not None and kind == "false_negative":
        groups += scan.instances[chosen]
    return groups


def _origins(scan: Scan, chosen: Intp) -> F32:
    origins = scan.origins if len(scan.origins) == 1 else scan.origins[chosen]
    return origins.astype(np.float32)


def _beside(points: F32, scan: Scan) -> Bool:
    """(N,) bool: whether something that moves lies in a point's cell, or in one that touches it, in the same scan."""
    moving = scan.points[scan.labels == Label.DYNAMIC]
    moving = moving[in_key_range(moving, EDGE)]
    if not len(moving) or not len(points):
        return np.zeros(len(points), np.bool_)
    steps = np.arange(-1, 2)
    around = ((steps[:, None, None] << X_SHIFT) + (steps[:, None] << Y_SHIFT) + steps).ravel()
    near = np.unique(np.unique(pack(moving, EDGE))[:, None] + around)
    return np.isin(pack(points, EDGE), near)


def _rounded(values: F32, digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]
