"""Failure cases: wrong points that belong together, and what rays showed of them."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, Bool, Intp
from dynaviz.contracts.looks import AskedPlaces, CountedLooks, Look
from dynaviz.contracts.method import MethodInfo, Reason
from dynaviz.contracts.metric import CaseSample, Figure, Labelled
from dynaviz.contracts.scan import ERRORS, ErrorKind, Label, Outcome, Scan
from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.looks import Ceiling
from dynaviz.scores.scores import percentage_points_lost
from dynaviz.scores.sections import CaseTotals, Failures
from dynaviz.scores.spans import LANES, Spans, spans_of
from dynaviz.spatial.grid import in_key_range
from dynaviz.spatial.surface import angles, surface_normals
from dynaviz_eval.attribution import grazed_share, sentence, shape
from dynaviz_eval.behaviour import Objects, behaviour_of_place, groups_of, hits_of
from dynaviz_eval.cases import EDGE, GAP, KEEP, Cases, FramePoints, boxes, facts, gathered, summed
from dynaviz_eval.causes import cause_of, looks_of, near_cause
from dynaviz_eval.ceiling import Evident, asked_places
from dynaviz_eval.ground import on_ground, scan_heights, scan_squared_ranges
from dynaviz_eval.samples import POINT, smallest

# Metres: maximum size of a false-positive case; larger holes are split, and patches of ground
# within are one. Trails of movers may be longer.
SPAN = 20.0
ONE_PATCH = (
    0.9  # of the points of a case: with fewer in its largest patch, it is described as patches
)
LOOKED_AT = 128  # points of a listed case at which looks are taken, on average at most
MOST_LOOKED_AT = 512  # points of one case
SHOWN = 0.25  # of the looks at a case in a frame: fewer are not shown over time
NOT_LISTED = "not listed, not measured"
NO_REASON = Reason("unknown code", "the method gives no known reason")
_UNLABELLED = 1 << 32  # the group of class 0


class FailuresMetric:
    """Section ``failures``: where, when and why points are wrong, costliest case first.

    ``cases``: at most 100, each with ``kind``, ``points``, ``cost`` (percentage points of DA or
    SA), ``first_frame``, ``last_frame``, ``worst_frame``, number of ``frames``, ``low`` and
    ``high`` corner (metres, world frame), ``range`` from the sensor (metres), distance ``moved``
    (metres), ``reasons`` with their counts, ``cause``, ``class``, ``instance``, ``what`` it is, its
    ``behaviour``, the share of its points on the ``ground``, that of its surface met at small
    angles (``grazed``), the ``looks`` at its points, ``spans`` of frames by state, and a
    ``sentence``. ``causes``: numbers of cases and points by kind and cause; of cases that are not
    listed nothing is measured. ``others``: cases and points that are not listed.

    Section ``ceiling``: what the drive showed of its moving objects.
    """

    def __init__(self, info: MethodInfo) -> None:
        self._reasons = info.reasons
        spans: dict[ErrorKind, float] = {"false_negative": np.inf, "false_positive": SPAN}
        self._cases = {
            kind: Cases(
                len(info.reasons) + 1,
                span,
                partial(self._drop, kind),
                sampled=MOST_LOOKED_AT,
                objects=kind == "false_negative",
            )
            for kind, span in spans.items()
        }
        self._unlisted = dict.fromkeys(spans, CaseTotals())
        self._evident = Evident(info.reasons)
        self._found: list[_Found] = []
        self._asked = False
        self._seen: CountedLooks | None = None
        self._objects = Objects()
        self._grounded = True
        self._names: dict[int, str] = {}
        self._totals = dict.fromkeys(ERRORS, 0)
        self._frame = 0
        self._listed: list[tuple[FailureCase, NDArray[np.void]]] = []

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Join the wrong points of a scan into cases."""
        scan = labelled.scan
        if scan.labels is not None:
            static, dynamic = (
                int(np.count_nonzero(scan.labels == label))
                for label in (Label.STATIC, Label.DYNAMIC)
            )
            self.add(labelled, static, dynamic, scan_heights(scan))
            self._evident.add(labelled)
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
        self._names |= {
            number: class_in_words(name) for number, name in scan.class_names.items() if number
        }
        self._totals["false_negative"] += dynamic
        self._totals["false_positive"] += static
        self._grounded &= heights is not None
        self._objects.add(labelled, heights)
        for kind, cases in self._cases.items():
            removed = kind == "false_positive"
            wrong = np.flatnonzero(labelled.outcome == ERRORS[kind])
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
                FramePoints(
                    labelled.frame, points, groups, reasons, ranges, near, ground, measured, wrong
                )
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

    def places(self) -> AskedPlaces:
        """Points of the listed cases, of the largest objects, and of the whole run."""
        self._settle()
        samples = [found.sample for found in self._found]
        sizes = np.array([len(sample) for sample in samples], np.int64)
        numbers = np.repeat(np.arange(len(samples)), sizes)
        cases = asked_places(np.concatenate([np.empty(0, POINT), *samples]), numbers)
        others = [asked_places(self._objects.sample()), self._evident.places()]
        self._sizes = [len(cases), *map(len, others)]
        return AskedPlaces.of([cases, *others])

    def looked(self, seen: CountedLooks) -> None:
        """Receive the looks at these points."""
        self._seen = seen

    def finish(self) -> Mapping[str, Failures | Ceiling]:
        """The sections."""
        self._settle()
        first = 0
        for number, found in enumerate(self._found):
            rows = np.arange(first, first + len(found.sample))
            first += len(rows)
            self._listed.append((self._described(found, number, rows), found.rows))
        unlisted = self._unlisted.values()
        section = Failures(
            cases=tuple(case for case, _ in self._listed),
            causes=self._by_cause(),
            others=CaseTotals(
                sum(total.cases for total in unlisted), sum(total.points for total in unlisted)
            ),
        )
        return {"failures": section, **self._ceiling()}

    def _ceiling(self) -> dict[str, Ceiling]:
        """The section ``ceiling``; empty without looks or ground truth."""
        if self._seen is None or not any(self._totals.values()):
            return {}
        ends = np.cumsum(self._sizes).tolist()
        none = slice(0, 0)
        objects = self._objects.ceilings(self._seen.part(slice(*ends[:2]), none), self._names)
        return {"ceiling": self._evident.found(self._seen.part(slice(*ends[1:]), none), objects)}

    def _settle(self) -> None:
        """Choose the listed cases, once."""
        if self._asked:
            return
        self._asked = True
        self._objects.finish()
        every = []
        for kind, cases in self._cases.items():
            cases.settle(self._frame + GAP + 1)  # all cases are over by then
            rows = cases.rows
            sample = cases.sample
            largest: Mapping[int, float] = {}
            if kind == "false_positive":
                rows, largest, into = gathered(rows, SPAN)
                sample = sample.copy()
                sample["group"] = [into.get(case, case) for case in sample["group"].tolist()]
                sample = smallest(sample, MOST_LOOKED_AT)
            for case in summed(rows):
                number = int(case["case"])
                cost = float(percentage_points_lost(int(case["points"]), self._totals[kind]))
                every.append(
                    _Found(
                        kind, case, rows[rows["case"] == number],
                        sample[sample["group"] == number], cost, largest.get(number, 1.0),
                    )
                )  # fmt: skip
        every.sort(key=_Found.order)
        self._found = looked_at(every[:KEEP])
        for found in every[KEEP:]:
            self._drop(found.kind, np.atleast_1d(found.case))

    def _by_cause(self) -> dict[str, dict[str, CaseTotals]]:
        """Cases and points by kind and cause, most points first."""
        by: dict[str, dict[str, CaseTotals]] = {kind: {} for kind in self._cases}
        for case, _ in self._listed:
            causes = by[case.kind]
            cause = str(case.cause)
            causes[cause] = causes.get(cause, CaseTotals()).plus(1, case.points)
        ordered = {
            kind: dict(sorted(causes.items(), key=lambda each: -each[1].points))
            for kind, causes in by.items()
        }
        for kind, total in self._unlisted.items():
            if total.cases:
                ordered[kind][NOT_LISTED] = total
        return ordered

    def figures(self) -> Mapping[str, Figure]:
        """A box around each case, overall and in each of its frames."""
        if not self._listed:
            return {}
        outcomes = [ERRORS[case.kind] for case, _ in self._listed]
        samples = [found.sample for found in self._found]
        joined = np.concatenate(samples)
        sample = CaseSample(
            np.repeat(np.arange(len(samples)), [len(each) for each in samples]),
            joined["frame"].astype(np.int64),
            joined["xyz"],
        )
        return {"failures": boxes(self._listed, outcomes, sample)}

    def _drop(self, kind: ErrorKind, over: NDArray[np.void]) -> None:
        """Count cases that are over and not listed."""
        self._unlisted[kind] = self._unlisted[kind].plus(len(over), int(over["points"].sum()))

    def _described(self, found: _Found, number: int, rows: Intp) -> FailureCase:
        """A listed case, given the rows of its points among the looks."""
        kind = found.kind
        case = found.case
        own = found.rows
        group = int(case["group"])
        class_ = (group >> 32) - 1
        removed = kind == "false_positive"
        names = [*(reason.name for reason in self._reasons), "unknown code"]
        code = int(case["reasons"].argmax())
        reason = self._reasons[code] if code < len(self._reasons) else NO_REASON
        looks = None if self._seen is None or not len(rows) else looks_of(self._seen, rows)
        if removed:
            hits = np.empty((0, 3), np.int32)
            if self._seen is not None:
                hits = hits_of(self._seen, rows)
            behaviour = behaviour_of_place(case, hits, self._frame)
            spans: Spans = {"removed": spans_of(np.unique(own["frame"]).tolist())}
        else:
            behaviour = self._objects.behaviour(own)
            spans = self._objects.spans(own)
        if self._seen is not None and number < len(self._seen.by_frame):
            spans = {**spans, **spans_of_looks(self._seen.by_frame[number])}
        cause = cause_of(kind, looks, reason.cause)
        near = None
        if self._seen is not None and 0 < len(rows) < case["points"]:
            near = near_cause(kind, self._seen, rows, cause, reason.cause)
        known = facts(case, names, self._grounded)
        described = FailureCase(
            **msgspec.structs.asdict(known),
            kind=kind,
            cost=found.cost,
            cause=str(cause),
            near_cause=None if near is None else str(near),
            word=None if reason.cause is None else str(reason.cause),
            reason=names[code],
            grazed=None if (grazed := grazed_share(case)) is None else round(grazed, 3),
            class_=class_ if class_ >= 0 else None,
            instance=None if removed else (group & 0xFFFFFFFF) or None,
            what=self._names.get(class_) or shape(kind, case),
            behaviour=None if behaviour is None else str(behaviour),
            looks=looks,
            spans=spans,
        )
        words = sentence(described, reason.meaning, found.largest < ONE_PATCH)
        return msgspec.structs.replace(described, sentence=words)


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """A case, and what is known about it.

    Attributes:
        kind: of its error; case: its row of ``summed``; rows: by frame.
        sample: of its points.
        cost: percentage points of DA or SA.
        largest: share of its points in its largest patch.
    """

    kind: ErrorKind
    case: np.void
    rows: NDArray[np.void]
    sample: NDArray[np.void]
    cost: float
    largest: float

    def order(self) -> tuple[Any, ...]:
        """Costliest first."""
        low = [round(float(value), 2) for value in self.case["low"]]
        return -self.cost, self.kind, int(self.case["first"]), low


def looked_at(listed: list[_Found]) -> list[_Found]:
    """Cases with the points at which looks are taken: as many of each, if it has so many.

    All points of small cases, and more of large ones where few cases are listed.
    """
    sizes = np.array([len(found.sample) for found in listed], np.int64)

    def total(most: int) -> int:
        return int(np.minimum(sizes, most).sum())

    wanted = bisect_right(range(MOST_LOOKED_AT + 1), KEEP * LOOKED_AT, key=total) - 1
    return [replace(found, sample=smallest(found.sample, wanted)) for found in listed]


def class_in_words(name: str) -> str:
    """The name of a class in words: ``rigid bus`` for ``vehicle.bus.rigid``."""
    _, *parts = name.split(".")
    return " ".join(reversed(parts)).replace("_", " ") if parts else name


def spans_of_looks(by_frame: I32) -> Spans:
    """When scans hit the place of a case, saw through it, or saw nothing of it.

    In each frame the most frequent of the three decides, if it is at least ``SHOWN`` of the looks
    at its points: the others are mostly between rays.

    Args:
        by_frame: (frames, 6) number of points by frame and ``Look``.
    """
    through = by_frame[:, Look.THROUGH] + by_frame[:, Look.GRAZING]
    parts = np.stack([by_frame[:, Look.HIT], through, by_frame[:, Look.HIDDEN]], 1)
    least = np.maximum(SHOWN * by_frame.sum(1), 1)
    most = np.where(parts.max(1) >= least, parts.argmax(1), -1)
    return {
        state: found
        for number, state in enumerate(LANES["looks"])
        if (found := spans_of(np.flatnonzero(most == number).tolist()))
    }


def _angles(scan: Scan, wrong: Intp, chosen: Intp) -> F64:
    """(K,) degrees: at which the rays of chosen ones among the wrong points meet the surfaces.

    NaN without any.
    """
    measured = scan.chosen(wrong[chosen])
    normals = surface_normals(scan.points, measured.points, measured.origins)
    return angles(measured.points - measured.origins, normals)
