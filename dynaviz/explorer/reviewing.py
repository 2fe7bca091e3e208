"""The review of a run: what its page asks, decides and writes."""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz.arrays import F64
from dynaviz.cleaning.map_settings import MapSettings
from dynaviz.cleaning.reviewing import Review
from dynaviz.errors import DynavizError, UsageError
from dynaviz.explorer.run import ExploredRun
from dynaviz.reviews.applying import NONE
from dynaviz.reviews.candidates import Candidate
from dynaviz.reviews.decisions import VERDICTS, ReviewDecision
from dynaviz.reviews.regions import BoxRegion, Region, Span, clock_of, time_of
from dynaviz.reviews.survey import ReviewSurvey

SHOWN_BESIDE = np.array([3.0, 3.0, 1.5])  # metres around a candidate that a view shows at least
BESIDE = np.array([10.0, 10.0, 6.0])  # metres around it whose points are drawn, if they fit
WIDEST = 40.0  # metres, of a view
SHOWN = 150_000  # points around a candidate; of more, some are left out
WORTH = 0.8  # share of all expected changes that the first candidates make, those worth a look
LOOKED_AT = 400  # cells of a candidate whose looks are drawn
FALLBACK = "reviewed.pcd"  # the map of a run that wrote none

Query = Mapping[str, str]


class ReviewPage:
    """The review of a run, in the background of its page.

    Args:
        run: with a folder and labels.
    """

    def __init__(self, run: ExploredRun) -> None:
        self._run = run
        self._lock = threading.Lock()
        self._review: Review | None = None
        self._survey: ReviewSurvey | None = None
        self._state: dict[str, Any] = {"phase": "opening the sequence", "done": 0, "total": 0}
        self._written: dict[str, Any] = {}
        self._closed = threading.Event()
        threading.Thread(target=self._look, name="review", daemon=True).start()

    def close(self) -> None:
        """Stop work in the background."""
        self._closed.set()

    @property
    def overview(self) -> dict[str, Any]:
        """The candidates with what was decided; or the ``phase`` of the search, or ``error``."""
        if self._survey is None or self._review is None:
            return self._state
        found = self._survey.candidates
        return {
            "title": self._run.title,
            "sequence": self._run.result.sequence.name,
            "frames": self._survey.frames,
            "step": self._survey.step,
            "file": str(self._review.file),
            "out": str(self._out()),
            "worth": _worth(found),
            "candidates": [_plain(each) for each in found],
            **self.decided,
        }

    @property
    def decided(self) -> dict[str, Any]:
        """The decisions that hold, by candidate, and what they change."""
        survey, review = self._ready()
        held = review.decisions
        by_hand = survey.by_hand(held)
        return {
            "decisions": [
                {
                    "id": each.id, "key": each.key, "verdict": each.verdict, "what": each.sentence,
                    "points": effect.points, "kept": effect.kept, "removed": effect.removed,
                }
                for each, effect in zip(held, by_hand.effects, strict=True)
            ],
            "kept": by_hand.kept * survey.step,
            "removed": by_hand.removed * survey.step,
        }  # fmt: skip

    def place(self, query: Query) -> dict[str, Any]:
        """What is shown of a candidate: its box, and over the frames what scans saw of it."""
        survey, review = self._ready()
        chosen = self._chosen(query)
        origin = review.sequence.origin
        low = np.array(chosen.low) - origin
        high = np.array(chosen.high) - origin
        seen = survey.around(low, high, chosen.region, ())
        count = np.bincount(seen.frame[seen.chosen], minlength=survey.frames)
        removed = np.bincount(seen.frame[seen.chosen & seen.removed], minlength=survey.frames)
        here = np.bincount(seen.frame, minlength=survey.frames)
        xyz = seen.xyz[seen.chosen]
        cells = np.unique(xyz[:: max(1, len(xyz) // LOOKED_AT)].astype(np.float64), axis=0)
        through = survey.looks.through(cells) if len(cells) else np.zeros(survey.frames)
        best = int(count.argmax())
        window = _window(low, high, SHOWN_BESIDE)
        around = _window(low, high, BESIDE)
        return {
            "number": chosen.number,
            "low": [round(float(value), 3) for value in low],
            "high": [round(float(value), 3) for value in high],
            "window": [[float(value) for value in corner] for corner in window],
            "around": [[float(value) for value in corner] for corner in around],
            "best": best,
            "points": count.tolist(),
            "removed": removed.tolist(),
            "here": here.tolist(),
            "through": [round(float(share), 2) for share in through],
        }

    def points(self, query: Query) -> bytes:
        """The points around a candidate: x, y, z, frame and flags, float32 each.

        Flags: 1 for a removed point, 2 for one of the candidate, and 4 times one more than the
        verdict of a decision.
        """
        survey, review = self._ready()
        chosen = self._chosen(query)
        origin = review.sequence.origin
        low, high = _window(np.array(chosen.low) - origin, np.array(chosen.high) - origin, BESIDE)
        seen = survey.around(low, high, chosen.region, review.decisions)
        flags = seen.removed + 2 * seen.chosen
        flags = flags + np.where(seen.verdicts == NONE, 0, 4 * (seen.verdicts + np.uint8(1)))
        rows = np.flatnonzero(seen.chosen | (seen.verdicts != NONE))
        others = np.flatnonzero(~seen.chosen & (seen.verdicts == NONE))
        others = others[:: max(1, -(-len(others) // SHOWN))]
        rows = np.concatenate([others, rows])
        columns = np.column_stack([seen.xyz[rows], seen.frame[rows], flags[rows]])
        return columns.astype("<f4").tobytes()

    def decide(self, query: Query) -> dict[str, Any]:
        """Decide what a candidate is, or a box.

        The box is ``low`` and ``high``, three numbers each, in the world of the sequence; with
        ``first``, from this frame on.
        """
        _, review = self._ready()
        verdict = query.get("verdict", "")
        if verdict not in VERDICTS:
            raise UsageError(f"verdict {verdict}: choose from {', '.join(VERDICTS)}")
        about: Candidate | Region = self._chosen(query)
        span = None
        what = ""
        if "low" in query:
            about = self._box(query, review.sequence.origin)
            what = f"box of {_size(about)} m"
            span = self._span(query)
        review.decide(
            about, verdict, span=span, what=what,
            reviewer=query.get("reviewer", ""), reason=query.get("reason", ""),
        )  # fmt: skip
        return self.decided

    def undo(self, query: Query) -> dict[str, Any]:
        """Take back the last decision, or one by its ``id``; ``undone`` is its key."""
        _, review = self._ready()
        undone: ReviewDecision = review.undo(query.get("id"), reviewer=query.get("reviewer", ""))
        return {**self.decided, "undone": undone.key}

    def write(self, query: Query) -> dict[str, Any]:
        """Write the map with the decisions."""
        self._ready()
        with self._lock:
            if "phase" in self._written:
                raise UsageError("a map is being written")
            self._written = {"phase": "starting", "done": 0, "total": 0}
        out = Path(os.path.expanduser(query.get("out", "") or self._out()))
        threading.Thread(target=self._write, args=(out,), name="map", daemon=True).start()
        return self._written

    @property
    def written(self) -> dict[str, Any]:
        """``text`` about the map that was written, its ``phase``, or ``error``."""
        return self._written

    def _look(self) -> None:
        try:
            review = Review(self._run.path.parent)
            self._review = review
            self._survey = review.survey(self._progress)
        except DynavizError as error:
            self._state = {"error": str(error)}

    def _write(self, out: Path) -> None:
        def progress(phase: str, done: int, total: int) -> None:
            self._written = {"phase": phase, "done": done, "total": total}

        try:
            assert self._review is not None
            cleaned = self._review.write(out, progress=progress)
            paths = ", ".join(str(each.path) for each in cleaned.maps)
            self._written = {"text": f"Written to {paths}. Points: {cleaned.account}"}
        except DynavizError as error:
            self._written = {"error": str(error)}

    def _progress(self, phase: str, done: int, total: int) -> None:
        if self._closed.is_set():
            raise UsageError("the explorer was closed")
        self._state = {"phase": phase, "done": done, "total": total}

    def _ready(self) -> tuple[ReviewSurvey, Review]:
        if self._survey is None or self._review is None:
            raise UsageError(self._state.get("error", "the places are being looked for"))
        return self._survey, self._review

    def _out(self) -> Path:
        """The map that is proposed to be written: next to the first one."""
        folder = self._run.path.parent
        earlier = MapSettings.load(folder)
        if earlier is None:
            return folder / FALLBACK
        out = Path(earlier.out)
        return out.with_name(f"{out.stem}_reviewed{out.suffix}")

    def _chosen(self, query: Query) -> Candidate:
        survey, _ = self._ready()
        total = len(survey.candidates)
        try:
            number = int(query["candidate"])
        except (KeyError, ValueError):
            raise UsageError("candidate: give a whole number") from None
        if not 1 <= number <= total:
            raise UsageError(f"candidate {number}: the run has the candidates 1 to {total}")
        return survey.candidates[number - 1]

    def _span(self, query: Query) -> Span | None:
        """From a frame on; None for all times."""
        survey, _ = self._ready()
        if "first" not in query:
            return None
        try:
            scan = survey.time(int(query["first"]))
        except (ValueError, IndexError):
            raise UsageError(f"first: give a frame from 0 to {survey.frames - 1}") from None
        clock = clock_of(scan)
        return Span(clock, time_of(scan, clock))

    @staticmethod
    def _box(query: Query, origin: F64) -> BoxRegion:
        corners = []
        for name in ("low", "high"):
            try:
                corner = np.array([float(value) for value in query.get(name, "").split(",")])
            except ValueError:
                corner = np.empty(0)
            if corner.shape != (3,) or not np.isfinite(corner).all():
                raise UsageError(f"{name}: give three numbers x,y,z")
            corners.append(tuple((corner + origin).tolist()))
        return BoxRegion(corners[0], corners[1])


def _size(box: BoxRegion) -> str:
    return " x ".join(f"{b - a:.1f}" for a, b in zip(box.low, box.high, strict=True))


def _window(low: F64, high: F64, beside: F64) -> tuple[F64, F64]:
    """A box and what is beside it: of a large one, the part around its middle."""
    middle = (low + high) / 2
    half = np.minimum((high - low) / 2, WIDEST / 2) + beside
    return middle - half, middle + half


def _worth(candidates: tuple[Candidate, ...]) -> int:
    """How many of the first candidates make ``WORTH`` of all expected changes."""
    expected = np.cumsum([each.expected for each in candidates])
    if not len(expected):
        return 0
    return int(np.searchsorted(expected, WORTH * expected[-1])) + 1


def _plain(candidate: Candidate) -> dict[str, Any]:
    return {
        "number": candidate.number,
        "answered": candidate.answered,
        "points": candidate.points,
        "wrong": round(candidate.wrong, 3),
        "expected": round(candidate.expected, 1),
        "first": candidate.first_frame,
        "last": candidate.last_frame,
        "title": candidate.title,
        "key": candidate.key,
    }
