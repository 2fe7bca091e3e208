"""Failure cases: wrong points that belong together, and their causes in the paper's terms."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F32, F64, Bool, Intp
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Figure, Labelled
from dynaviz.contracts.scan import Label, Outcome, Scan
from dynaviz.scores.scores import percentage_points_lost
from dynaviz.scores.spans import Spans, spans_of
from dynaviz.spatial.grid import in_key_range
from dynaviz.spatial.surface import angles, surface_normals
from dynaviz_eval.attribution import causes_of, grazed_share, sentence, shape
from dynaviz_eval.behaviour import Objects, VisitedPlaces, groups_of
from dynaviz_eval.cases import EDGE, GAP, KEEP, Cases, FramePoints, boxes, facts, gathered, summed
from dynaviz_eval.ground import on_ground, scan_heights, scan_squared_ranges

# Metres: maximum size of a false-positive case; larger holes are split, and patches of ground
# within are one. Trails of movers may be longer.
SPAN = 20.0
ONE_PATCH = (
    0.9  # of the points of a case: with fewer in its largest patch, it is described as patches
)
_UNLABELLED = 1 << 32  # the group of class 0
_KINDS = {"false_negative": Outcome.FALSE_NEGATIVE, "false_positive": Outcome.FALSE_POSITIVE}


class FailuresMetric:
    """Section ``failures``: where, when and why points are wrong, costliest case first.

    ``cases``: at most 100, each with ``kind``, ``points``, ``cost`` (percentage points of DA or
    SA), ``first_frame``, ``last_frame``, ``worst_frame``, number of ``frames``, ``low`` and
    ``high`` corner (metres, world frame), ``range`` from the sensor (metres), distance ``moved``
    (metres), ``reasons`` with their counts, ``cause``, ``class``, ``instance``, ``what`` it is, its
    ``behaviour``, the share of its points on the ``ground``, that of its surface met at small
    angles (``grazed``), ``spans`` of frames by state, and a ``sentence``. ``causes``: numbers of
    cases and points by kind and cause, of all cases. ``others``: cases and points that are not
    listed.
    """

    def __init__(self, info: MethodInfo) -> None:
        self._reasons = info.reasons
        spans = {"false_negative": np.inf, "false_positive": SPAN}
        self._cases = {
            kind: Cases(len(info.reasons) + 1, span, partial(self._count, kind))
            for kind, span in spans.items()
        }
        self._causes: dict[str, dict[str, dict[str, int]]] = {
            kind: defaultdict(lambda: {"cases": 0, "points": 0}) for kind in spans
        }
        self._objects = Objects()
        self._places = VisitedPlaces()
        self._grounded = True
        self._names: dict[int, str] = {}
        self._totals = dict.fromkeys(_KINDS, 0)
        self._frame = 0
        self._listed: list[tuple[dict[str, Any], NDArray[np.void]]] = []

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Join the wrong points of a scan into cases."""
        scan = labelled.scan
        if scan.labels is not None:
            self._places.add(labelled.frame, scan.points)
            static, dynamic = (
                int(np.count_nonzero(scan.labels == label))
                for label in (Label.STATIC, Label.DYNAMIC)
            )
            self.add(labelled, static, dynamic, scan_heights(scan))
        return {}

    def add(
        self, labelled: Labelled, static: int, dynamic: int, heights: F32 | None = None
    ) -> None:
        """As ``update``, for a scan reduced to its wrong and its dynamic points.

        Args:
            labelled: the scan; correctly labelled static points may be missing.
            static, dynamic: numbers of points in the whole scan, of which costs are shares.
            heights: (N,) float32, metres above the ground; None if unknown.
        """
        scan = labelled.scan
        self._frame = labelled.frame
        # 0 means unlabelled
        self._names |= {number: name for number, name in scan.class_names.items() if number}
        self._totals["false_negative"] += dynamic
        self._totals["false_positive"] += static
        self._grounded &= heights is not None
        self._objects.add(labelled, heights)
        for kind, cases in self._cases.items():
            removed = kind == "false_positive"
            wrong = np.flatnonzero(labelled.outcome == _KINDS[kind])
            # drop non-finite and very distant points
            wrong = wrong[in_key_range(scan.points[wrong], EDGE)]
            points = scan.points[wrong]
            groups = groups_of(scan, wrong, not removed)
            ranges = np.sqrt(scan_squared_ranges(scan)[wrong])
            near = np.zeros(len(points), np.bool_)
            if removed and dynamic:
                near = self._next_to_movers(labelled)[wrong]
            ground = None if heights is None else on_ground(heights[wrong])
            if (
                removed and ground is not None
            ):  # where the class is unknown, ground is a group of its own
                groups[groups <= _UNLABELLED] |= ground[groups <= _UNLABELLED]
            measured = partial(_angles, scan, wrong) if removed else None
            reasons = labelled.reasons[wrong]
            cases.add(
                FramePoints(labelled.frame, points, groups, reasons, ranges, near, ground, measured)
            )

    @staticmethod
    def _next_to_movers(labelled: Labelled) -> Bool:
        """(N,) bool: wrongly removed points with dynamic points in their cell, or in a cell that
        touches it.
        """
        removed = labelled.outcome == Outcome.FALSE_POSITIVE
        dynamic = labelled.scan.labels == Label.DYNAMIC
        found: Bool = kernels.touching.cells(labelled.scan.points, removed, dynamic, EDGE)
        return found

    def finish(self) -> Mapping[str, Any]:
        """The section."""
        self._objects.finish()
        listed: list[tuple[dict[str, Any], NDArray[np.void]]] = []
        for kind, cases in self._cases.items():
            cases.settle(self._frame + GAP + 1)  # all cases are over by then
            rows, largest = (
                gathered(cases.rows, SPAN) if kind == "false_positive" else (cases.rows, {})
            )
            listed += self._described(kind, rows, largest)
            self._count(kind, summed(rows))
        listed.sort(
            key=lambda pair: (
                -pair[0]["cost"],
                pair[0]["kind"],
                pair[0]["first_frame"],
                pair[0]["low"],
            )
        )
        self._listed = listed[:KEEP]
        counts = [count for by in self._causes.values() for count in by.values()]
        others = {
            "cases": sum(count["cases"] for count in counts) - len(self._listed),
            "points": sum(count["points"] for count in counts)
            - sum(case["points"] for case, _ in self._listed),
        }
        ordered = {
            kind: dict(sorted(by.items(), key=lambda i: -i[1]["points"]))
            for kind, by in self._causes.items()
        }
        return {
            "failures": {
                "cases": [case for case, _ in self._listed],
                "causes": ordered,
                "others": others,
            }
        }

    def figures(self) -> Mapping[str, Figure]:
        """A box around each case, overall and in each of its frames."""
        if not self._listed:
            return {}
        return {"failures": boxes(self._listed, [_KINDS[case["kind"]] for case, _ in self._listed])}

    def _count(self, kind: str, over: NDArray[np.void]) -> None:
        """Add cases that are over to the counts of their causes."""
        for (cause, _), points in zip(
            causes_of(kind, over, self._reasons), over["points"].tolist(), strict=True
        ):
            count = self._causes[kind][str(cause or "unknown")]
            count["cases"] += 1
            count["points"] += points

    def _described(
        self, kind: str, rows: NDArray[np.void], largest: Mapping[int, float]
    ) -> Iterator[tuple[dict[str, Any], NDArray[np.void]]]:
        """Each case as plain JSON values, with its rows.

        Given the share of the largest patch of those in patches.
        """
        names = [*(reason.name for reason in self._reasons), "unknown code"]
        meanings = [
            *(reason.meaning for reason in self._reasons),
            "the method gives no known reason",
        ]
        total = summed(rows)
        for case, (cause, code) in zip(total, causes_of(kind, total, self._reasons), strict=True):
            group = int(case["group"])
            own = rows[rows["case"] == case["case"]]
            number = (group >> 32) - 1  # of its class
            behaviour = (
                self._places.behaviour(case)
                if kind == "false_positive"
                else self._objects.behaviour(own)
            )
            if kind == "false_positive":
                spans: Spans = {"removed": spans_of(np.unique(own["frame"]).tolist())}
            else:  # an object with a number may have several cases
                spans = self._objects.spans(
                    rows[rows["group"] == group] if group & 0xFFFFFFFF else own
                )
            found = facts(case, names, self._grounded)
            plain = {
                "kind": kind,
                **found,
                "cost": float(percentage_points_lost(found["points"], self._totals[kind])),
                "cause": None if cause is None else str(cause),
                "reason": names[code],
                "grazed": None if (grazed := grazed_share(case)) is None else round(grazed, 3),
                "class": number if number >= 0 else None,
                "instance": (group & 0xFFFFFFFF) or None if kind == "false_negative" else None,
                "what": self._names.get(number) or shape(kind, case),
                "behaviour": None if behaviour is None else str(behaviour),
                "spans": {state: [list(span) for span in found] for state, found in spans.items()},
            }
            patches = largest.get(int(case["case"]), 1.0) < ONE_PATCH
            yield {**plain, "sentence": sentence(plain, meanings[code], patches)}, own


def _angles(scan: Scan, wrong: Intp, chosen: Intp) -> F64:
    """(K,) degrees: at which the rays of chosen ones among the wrong points meet the surfaces.

    NaN without any.
    """
    measured = scan.chosen(wrong[chosen])
    normals = surface_normals(scan.points, measured.points, measured.origins)
    return angles(measured.points - measured.origins, normals)
