"""What objects and places did during the drive, from the data alone.

Half of the diagnosis of a failure case.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F32, I32, I64, Bool, Intp
from dynaviz.contracts.looks import CountedLooks, Look
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Label, Scan
from dynaviz.kernels.keys import REACH as KEY_REACH
from dynaviz.kernels.keys import X_SHIFT
from dynaviz.scores.behaviour import Behaviour
from dynaviz.scores.looks import ObjectCeiling
from dynaviz.scores.spans import Spans, spans_of
from dynaviz.spatial.grid import in_key_range, unpack
from dynaviz_eval.cases import EDGE, GAP, Cases, FramePoints, pooled
from dynaviz_eval.ground import GROUND_HEIGHT, scan_squared_ranges
from dynaviz_eval.samples import POINT, smallest
from dynaviz_eval.sorted_runs import SortedRuns

# frames: motion is measured over a second of most sensors, long enough to exceed the noise of boxes
WINDOW = 10
STILL = 0.5  # metres in a window: slower than anyone walks
LATE = 0.75  # of the drive: less than a quarter of it is left to show that the place is free again
END = 10  # frames: seen in these last frames of the drive only
REACH = 3.0  # metres above the ground: what is higher, such as a bridge, touches no road user
# metres: a car has a few dozen points there, and rays pass between the rings of a spinning sensor
FAR = 30.0
BRIEF = 5  # frames: too few hits to decide by
TRACKS = 1000  # objects that are remembered
LOOKED_AT = 200  # of these, objects at whose points looks are taken
SAMPLED = 24  # of their points
CELL = 1.0  # metres: edge of a cell of a place
PLACES = 100_000  # cells in memory; more are stored on disk
_RECORD = np.dtype([("key", np.int64), ("visits", np.int32, 3)])


class Objects:
    """Follows the dynamic objects of a run, also where the method was right.

    Objects are separated by class and number if the data have them; otherwise points whose cells
    touch belong to one object, as for failure cases.
    """

    def __init__(self) -> None:
        self._cases = Cases(1, np.inf, keep=TRACKS, sampled=SAMPLED)
        self._sample = np.empty(0, POINT)
        self._frame = 0

    def add(self, labelled: Labelled, heights: F32 | None) -> None:
        """Add a scan with ground truth.

        Heights (N,) above the ground, metres, or None if unknown.
        """
        scan = labelled.scan
        self._frame = labelled.frame
        dynamic = scan.labels == Label.DYNAMIC
        near = np.zeros(len(scan), np.bool_)
        if heights is not None:
            standing = (
                (scan.labels == Label.STATIC) & (heights >= GROUND_HEIGHT) & (heights < REACH)
            )
            near = kernels.touching.columns(scan.points, dynamic, standing, EDGE)
        chosen = np.flatnonzero(dynamic)
        chosen = chosen[in_key_range(scan.points[chosen], EDGE)]
        groups = groups_of(scan, chosen, True)
        none = np.zeros(len(chosen), np.uint8)
        ranges = np.sqrt(scan_squared_ranges(scan)[chosen])
        self._cases.add(
            FramePoints(
                labelled.frame, scan.points[chosen], groups, none, ranges, near[chosen], rows=chosen
            )
        )

    def finish(self) -> None:
        """Complete the tracks; call it after the last scan."""
        self._cases.settle(self._frame + GAP + 1)

    def sample(self) -> NDArray[np.void]:
        """Points of the largest objects; ``group`` is the object. After ``finish``."""
        rows = self._numbered()
        objects, of = np.unique(rows["case"], return_inverse=True)
        points = np.bincount(of, rows["points"], len(objects))
        largest = objects[np.argsort(-points, kind="stable")[:LOOKED_AT]]
        sample = self._cases.sample.copy()
        sample["group"] = self._number_of[sample["group"]]
        sample = sample[np.isin(sample["group"], largest)]
        self._sample = smallest(sample, SAMPLED)
        return self._sample

    def _numbered(self) -> NDArray[np.void]:
        """The rows, of which those of one class and number belong to one object."""
        rows: NDArray[np.void] = self._cases.rows.copy()
        count = int(rows["case"].max(initial=-1)) + 1
        self._number_of = np.arange(count)
        first: dict[int, int] = {}
        for row in rows[np.unique(rows["case"], return_index=True)[1]]:
            if row["group"] & 0xFFFFFFFF:
                case = int(row["case"])
                self._number_of[case] = first.setdefault(int(row["group"]), case)
        rows["case"] = self._number_of[rows["case"]]
        return rows

    def ceilings(self, seen: CountedLooks, names: Mapping[int, str]) -> list[ObjectCeiling]:
        """What the drive showed of the largest objects, those with most points first.

        Args:
            seen: the looks at ``sample``.
            names: of classes.
        """
        rows = self._numbered()
        evident = seen.through > 0
        found = []
        for number in np.unique(self._sample["group"]).tolist():
            own = rows[rows["case"] == number]
            group = int(own["group"][0])
            class_ = (group >> 32) - 1
            mine = self._sample["group"] == number
            found.append(
                ObjectCeiling(
                    class_=class_ if class_ >= 0 else None,
                    instance=(group & 0xFFFFFFFF) or None,
                    what=names.get(class_) or "moving object",
                    points=int(own["points"].sum()),
                    sampled=int(mine.sum()),
                    seen_through=round(100.0 * float(evident[mine].mean()), 1),
                    first_frame=int(own["frame"].min()),
                    last_frame=int(own["frame"].max()),
                )
            )
        found.sort(key=lambda each: (-each.points, each.first_frame, each.instance or 0))
        return found

    def behaviour(self, rows: NDArray[np.void]) -> Behaviour | None:
        """What the object did in the frames of a case, given the rows of its wrong points.

        None if unknown.
        """
        track = self._track(rows)
        if not len(track):
            return None
        frames = int(rows["frame"].min()), int(rows["frame"].max())
        return behaviour_of_object(track, self._frame, frames)

    def spans(self, rows: NDArray[np.void]) -> Spans:
        """When the object was moving, standing, and kept: mostly, partly or not.

        Given the rows of its kept points.
        """
        track = self._track(rows)
        if not len(track):
            return {"kept": spans_of(rows["frame"].tolist())}
        frames = track["frame"]
        stood = standing(track)
        wrong = np.bincount(rows["frame"], rows["points"], self._frame + 1)
        kept = 2 * wrong[frames] > track["points"]
        none = wrong[frames] == 0
        parts = {
            "moving": ~stood & (len(track) > 1),
            "standing": stood,
            "kept": kept,
            "partly": ~kept & ~none,
            "removed": none,
        }
        return {
            state: spans_of(frames[rows].tolist()) for state, rows in parts.items() if rows.any()
        }

    def _track(self, rows: NDArray[np.void]) -> NDArray[np.void]:
        """The object in all frames, one row each."""
        row = rows[np.argmax(rows["points"])]
        known: NDArray[np.void] = self._cases.rows[self._cases.rows["group"] == row["group"]]
        if (
            not row["group"] & 0xFFFFFFFF
        ):  # no number: the smallest object whose box contains that of the case
            here = known[known["frame"] == row["frame"]]
            here = here[(here["low"] <= row["low"]).all(1) & (here["high"] >= row["high"]).all(1)]
            if not len(here):
                return known[:0]
            known = known[
                known["case"] == here["case"][np.argmin((here["high"] - here["low"]).prod(1))]
            ]
        track, _ = pooled(known, ("frame",))
        return track


def groups_of(scan: Scan, chosen: NDArray[np.intp], objects: bool) -> I64:
    """(K,) int64: class and, for objects, number of the chosen points, packed into one number.

    0 if unknown.
    """
    groups = np.zeros(len(chosen), np.int64)
    if scan.classes is not None:
        groups += (scan.classes[chosen].astype(np.int64) + 1) << 32
    if scan.instances is not None and objects:
        groups += scan.instances[chosen]
    return groups


def behaviour_of_object(
    track: NDArray[np.void], end: int, frames: tuple[int, int] | None = None
) -> Behaviour | None:
    """What a dynamic object did in some frames; the first of the rules below that applies.

    None if none does and it was seen in one frame only: whether it moved is unknown.

    Args:
        track: (R,) rows of the object, as in ``Cases.rows``, one per frame, in the order of frames.
        end: the last frame of the drive.
        frames: the first and the last one to describe, with the object in at least one; None for
            all in which it was seen.
    """
    first = int(track["frame"][0])
    last = int(track["frame"][-1])
    begin, over = (first, last) if frames is None else frames
    here = slice(*np.searchsorted(track["frame"], [begin, over + 1]))
    part = track[here]
    every = standing(track)
    stood = every[here]
    if stood[-1] and every[here.stop :].all():
        return Behaviour.STOOD if 2 * stood.sum() >= len(stood) else Behaviour.CAME_TO_STOP
    if stood[0] and every[: here.start].all():
        return Behaviour.WAITED_FIRST
    if stood.any():
        return Behaviour.STOPPED
    if first > max(end - END, LATE * end):
        return Behaviour.END_OF_DRIVE
    if first > LATE * end and last > end - END:
        return Behaviour.ARRIVED_LATE
    if part["ranges"].sum() > FAR * part["points"].sum():
        return Behaviour.FAR_AWAY
    if 2 * part["touching"].sum() > part["points"].sum():
        return Behaviour.TOUCHED
    return Behaviour.PASSED_BY if len(track) > 1 else None


def standing(track: NDArray[np.void]) -> Bool:
    """(R,) bool: whether the object stands still in each row, for at least ``WINDOW`` frames.

    A sensor that drives past sees another side of an object, which moves one end of the box of its
    points. The object itself has moved only if both ends did, so the shorter way of both counts.
    """
    frames = track["frame"]
    stood = np.zeros(len(track), np.bool_)
    ends = np.searchsorted(frames, frames + WINDOW)
    for i in np.flatnonzero(ends < len(track)):
        stood[i : ends[i] + 1] |= shift(track[i], track[ends[i]]) < STILL
    return stood


def shift(row: np.void, other: np.void) -> float:
    """How far a box moved between two rows, seen from above, metres.

    0 if it only grew or shrank.
    """
    low, high = (other[name][:2].astype(np.float64) - row[name][:2] for name in ("low", "high"))
    return float(np.hypot(*np.where(low * high > 0, np.minimum(np.abs(low), np.abs(high)), 0.0)))


class VisitedPlaces:
    """Remembers when each cell of the map was hit.

    The cells of large maps are stored on disk during the run.

    Args:
        held: cells in memory.
    """

    def __init__(self, held: int = PLACES) -> None:
        self._keys = np.full(1 << 16, -1, np.int64)
        self._visits = np.empty((1 << 16, 3), np.int32)
        self._used = 0
        self._frame = 0
        self._held = held
        self._stored = SortedRuns(_RECORD)

    def add(self, frame: int, points: F32) -> None:
        """Add the points of a scan, (N, 3) float32, metres, world frame.

        A scan's own, read-only array.
        """
        self._frame = frame
        begin = 0
        visits = kernels.visits
        while begin < len(points):
            begin, self._used = visits.visit(
                points, begin, frame, CELL, self._keys, self._visits, self._used
            )
            if begin < len(points):
                self._keys, self._visits = visits.grow(
                    self._keys, self._visits, 2 * len(self._keys)
                )
        if self._used > self._held:  # between frames, so that no frame counts twice
            self._store()

    def visits(self, low: F32, high: F32) -> I32:
        """(K, 3) int32: first frame, last frame and number of frames of the cells within a box.

        After the last scan.
        """
        if self._used:
            self._store()
        first, last = (
            np.clip(np.floor(corner / CELL), -KEY_REACH, KEY_REACH - 1).astype(np.int64)
            for corner in (low, high)
        )
        columns = [(int(x) + KEY_REACH) << X_SHIFT for x in (first[0], last[0] + 1)]
        records = self._stored.between(*columns)
        cells = unpack(records["key"])
        records = records[((cells >= first) & (cells <= last)).all(1)]
        cell, of = np.unique(records["key"], return_inverse=True)
        found = np.zeros((len(cell), 3), np.int32)
        found[:, 0] = self._frame
        np.minimum.at(found[:, 0], of, records["visits"][:, 0])
        np.maximum.at(found[:, 1], of, records["visits"][:, 1])
        np.add.at(found[:, 2], of, records["visits"][:, 2])
        return found

    def _store(self) -> None:
        """Move all cells to the disk."""
        used = self._keys >= 0
        records = np.empty(self._used, _RECORD)
        records["key"] = self._keys[used]
        records["visits"] = self._visits[used]
        self._stored.append(records)
        self._keys.fill(-1)
        self._used = 0


def hits_of(seen: CountedLooks, rows: Intp) -> I32:
    """(K, 3) int32: the first and the last frame, and the number of frames, that hit places.

    Args:
        seen: what was seen.
        rows: (K,) of the places.
    """
    frames = seen.counts[rows, Look.HIT] + 1  # their own
    found: I32 = np.stack([seen.first_hit[rows], seen.last_hit[rows], frames], axis=1)
    return found


def behaviour_of_place(case: np.void, hits: I32, end: int) -> Behaviour | None:
    """How well a static place was seen; the first of the rules below that applies.

    None if unknown.

    Args:
        case: the case, a row of ``summed``; ``touching`` counts points next to dynamic ones.
        hits: (K, 3) first frame, last frame and number of frames that hit each of its points.
        end: the last frame of the drive.
    """
    if 2 * case["touching"] > case["points"]:
        return Behaviour.NEXT_TO_MOVER
    if case["ranges"] > FAR * case["points"]:
        return Behaviour.FAR_AWAY
    if not len(hits):
        return None
    first, last, frames = np.median(hits, axis=0)
    if frames <= BRIEF:
        return Behaviour.SEEN_BRIEFLY
    if first > LATE * end:
        return Behaviour.SEEN_LATE
    return Behaviour.ON_AND_OFF if 2 * frames < last - first + 1 else Behaviour.IN_VIEW
