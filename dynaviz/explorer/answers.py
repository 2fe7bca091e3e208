"""What the page of the explorer can ask, answered from the recordings."""

from __future__ import annotations

import dataclasses
import json
import shlex
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal, cast

import msgspec
import numpy as np

from dynaviz.contracts.scan import Outcome
from dynaviz.errors import UsageError
from dynaviz.explain.case_evidence import evidence_text
from dynaviz.explain.deciding import decided_by
from dynaviz.explain.document import Why
from dynaviz.explain.judging import numbers_of, of_ledgers, parameters_of
from dynaviz.explain.point_ledger import PointLedger
from dynaviz.explain.rays import TouchingRays, rays_of, spans_of_rays
from dynaviz.explain.strip import strip
from dynaviz.explorer import cards
from dynaviz.explorer.ledgers import Ledgers
from dynaviz.explorer.reruns import Rerun
from dynaviz.explorer.reviewing import ReviewPage
from dynaviz.explorer.run import ExploredRun
from dynaviz.reviews.decisions import CORRECTED, LABELS, ReviewDecision, case_key
from dynaviz.reviews.regions import ObjectRegion, Piece
from dynaviz.runs.reviewed import decisions_of, reviewed_scores
from dynaviz.runs.stored_evidence import Stored
from dynaviz.views.read.focus import CASE, LAYOUTS, MAP
from dynaviz.views.read.shot import LARGEST, shot

PNG = "image/png"
MP4 = "video/mp4"
RRD = "application/octet-stream"
SIZE = (1600, 900)  # of copied pictures, pixels
CLIP_SIZE = (960, 640)
THUMBNAIL = {"width": "168", "height": "108"}  # pixels
LETTERS = "abcdefghi"
CASE_RAYS = 120  # drawn of a case

Query = Mapping[str, str]


class Explored:
    """One run, or several runs on the same points.

    Args:
        run, others: at most nine.

    Attributes:
        runs: by letter.
        cards: the cases of each run, by its letter.
        answers: by name, a function from a query to plain JSON types.
        changes: by name, a function from a query to plain JSON types, which writes a file.
        contents: by name, a function from a query to the content of a file, and its media type.
        compare: serves the comparison of two runs, and returns its address; set by the server.

    Raises:
        DataError: as ``ExploredRun``.
        UsageError: if the runs are of different sequences, or more than nine.
    """

    def __init__(self, run: ExploredRun, *others: ExploredRun):
        if len(others) >= len(LETTERS):
            raise UsageError(f"{1 + len(others)} runs: give at most {len(LETTERS)}")
        for other in others:
            if other.result.sequence.digest != run.result.sequence.digest:
                raise UsageError(
                    f"{other.path} is from a different sequence than {run.path}. Compare runs of "
                    "the same frames"
                )
        self.runs = dict(zip(LETTERS, [run, *others], strict=False))
        self.cards = {letter: cards.cards(each) for letter, each in self.runs.items()}
        self._reruns: list[Rerun] = []
        self._reviews: dict[str, ReviewPage] = {}
        self.compare: Callable[[ExploredRun, ExploredRun], str] = _unserved
        self._ledgers = Ledgers(self.runs)
        self._lock = threading.Lock()
        self._drawing = cache(
            lambda letter, *of: cards.picture(self.runs[letter], self._card(*of[:2]), of[2:])
        )
        self.answers: dict[str, Callable[[Query], Any]] = {
            "runs": self._overview,
            "click": self._click,
            "point": self._point,
            "why": self._why,
            "evidence": self._evidence,
            "judge": self._judge,
            "dial": self._turn,
            "run": self._rerun_state,
            "rescored": self._rescored,
            "review": lambda query: self._review(query).overview,
            "review_place": lambda query: self._review(query).place(query),
            "written": lambda query: self._review(query).written,
        }
        self.changes: dict[str, Callable[[Query], Any]] = {
            "correct": self._correct,
            "run": self._rerun,
            "decide": lambda query: self._review(query).decide(query),
            "undo": lambda query: self._review(query).undo(query),
            "write": lambda query: self._review(query).write(query),
        }
        self.contents: dict[str, tuple[Callable[[Query], bytes], str]] = {
            "loading": (lambda query: self.runs[self._letter(query)].focus.loading(), RRD),
            "layout": (self._layout, RRD),
            "marks": (self._marks, RRD),
            "drawing": (self._draw, PNG),
            "picture": (lambda query: self._shot(query, "case.png", SIZE), PNG),
            "clip": (lambda query: self._shot(query, "case.mp4", CLIP_SIZE), MP4),
            "review_points": (lambda query: self._review(query).points(query), RRD),
        }

    def close(self) -> None:
        """Stop work in the background."""
        self._ledgers.close()
        for rerun in self._reruns:
            rerun.close()
        for review in self._reviews.values():
            review.close()

    def _overview(self, query: Query) -> dict[str, Any]:
        """Facts of the runs, and their cases."""
        return {letter: self._facts(letter) for letter in self.runs}

    def _facts(self, letter: str) -> dict[str, Any]:
        run = self.runs[letter]
        others = {key: other for key, other in self.runs.items() if key != letter}
        shared = {key: run.wrong_too(other) for key, other in others.items()}
        same = {key: cards.pairs(run, self.cards[letter], self.cards[key]) for key in others}
        ceiling = run.result.sections.ceiling
        return {
            "title": run.title,
            "method": run.result.method,
            "variant": run.result.variant,
            "sequence": run.result.sequence.name,
            "frames": run.frames,
            "scores": {name: run.result.metrics.get(name) for name in ("SA", "DA", "AA")},
            "possible": ceiling.allowed if ceiling and ceiling.possible else None,
            "truth": run.result.has_truth,
            "compares": run.compares,
            "path": shlex.quote(str(run.path)),
            "corrections": self._corrections(run),
            "cases": [cards.plain(run, card, shared, same) for card in self.cards[letter]],
        }

    def _click(self, query: Query) -> dict[str, Any]:
        """The point that was clicked, as ``_point``."""
        run = self.runs[self._letter(query)]
        instance = _number(query, "instance") if "instance" in query else None
        position = np.array([_decimal(query, axis) for axis in "xyz"])
        frame, point = run.clicked(
            query.get("entity", "").strip("/"), instance, _number(query, "frame"), position
        )
        return self._at(frame, point)

    def _point(self, query: Query) -> dict[str, Any]:
        """Truth, answer and reason of a point in each run."""
        return self._at(_number(query, "frame"), _number(query, "point"))

    def _at(self, frame: int, point: int) -> dict[str, Any]:
        found = {
            letter: run.point(frame, point, self._corrections(run))
            for letter, run in self.runs.items()
        }
        commands = {
            letter: f"dynaviz why {shlex.quote(str(run.path))} --frame {frame} --point {point}"
            for letter, run in self.runs.items()
        }
        return {"frame": frame, "point": point, "runs": found, "commands": commands}

    def _why(self, query: Query) -> dict[str, Any]:
        """The ledger of a point, from the recording or a replay, or the progress of the replay.

        With ``exact``, a stored ledger of a point near it is not enough.
        """
        letter = self._letter(query)
        frame = _number(query, "frame")
        point = _number(query, "point")
        run = self.runs[letter]
        stored = run.stored(frame, point)
        if stored is not None and ("exact" not in query or not stored[1]):
            ledger, metres = stored
            document = Stored(run.run).document(ledger)
            return {"why": self._shown(letter, document), "metres": metres}
        if stored is None and "exact" not in query:
            run.point(frame, point)  # or the replay would find out after a while
            return {"seconds": run.replay_s}
        answer = self._ledgers.ask(letter, frame, point)
        return (
            {"why": self._shown(letter, answer), "metres": 0.0}
            if isinstance(answer, Why)
            else answer
        )

    def _shown(self, letter: str, why: Why) -> dict[str, Any]:
        """A ledger as the page draws it."""
        rule = decided_by(why.ledger)
        return {
            **why.to_dict(),
            "decided": None if rule is None else rule.name,
            "strip": strip([why.ledger]),
            "what_if": self._what_if(letter, [why.ledger]),
        }

    def _evidence(self, query: Query) -> dict[str, Any]:
        """What points of a case have in common.

        Empty if the recording stores no evidence on them.
        """
        letter = self._letter(query)
        run = self.runs[letter]
        card = self._card(letter, _number(query, "case"))
        ledgers = self._chosen(letter, query)
        if not ledgers:
            return {}
        return {
            "text": evidence_text(ledgers, None if "points" in query else card.failure),
            "strip": strip(ledgers),
            "spans": spans_of_rays(ledgers),
            "what_if": self._what_if(letter, ledgers),
            "map": cards.surroundings(run, card, ledgers),
        }

    def _what_if(self, letter: str, ledgers: Sequence[PointLedger]) -> dict[str, Any] | None:
        """Sliders for points, at least one; None if no parameter enters their evidence."""
        run = self.runs[letter]
        given = numbers_of(run.result.parameters)
        judged = of_ledgers(ledgers, given)
        known = {each.name: each for each in run.sliders}
        found = [
            known.get(each.name, each) for each in parameters_of(judged.names, judged.sums, given)
        ]
        if not found:
            return None
        return {
            "parameters": [msgspec.structs.asdict(each) for each in found],
            "points": len(ledgers),
            "removed": int(judged.removed.sum()),
        }

    def _judge(self, query: Query) -> dict[str, int]:
        """How many points with stored evidence would be removed with other parameters."""
        letter = self._letter(query)
        if "case" in query:
            ledgers = self._chosen(letter, query)
        else:
            ledgers = self._known(letter, _number(query, "frame"), _number(query, "point"))
        if not ledgers:
            raise UsageError("no evidence is stored on these points")
        given = numbers_of(self.runs[letter].result.parameters)
        removed = of_ledgers(ledgers, given).judge(_settings(query, given), given)
        return {"removed": int(removed.sum())}

    def _turn(self, query: Query) -> dict[str, Any]:
        """A run with other parameters, as far as its recording tells; empty without a sample."""
        run = self.runs[self._letter(query)]
        dial = run.dial
        if dial is None:
            return {}
        turned = dial.turn(_settings(query, dial.sample.given))
        return {
            "parameters": [msgspec.structs.asdict(each) for each in dial.sample.parameters],
            "scores": {name: dataclasses.asdict(each) for name, each in turned.scores.items()},
            "cases": {case.number: case.cost for case in turned.cases},
            "text": turned.text,
        }

    def _chosen(self, letter: str, query: Query) -> list[PointLedger]:
        """The stored ledgers of a case.

        With ``points``, rows in the scan of its worst frame, those alone.
        """
        ledgers = self.runs[letter].ledgers(_number(query, "case"))
        if "points" not in query:
            return list(ledgers)
        rows = {_number({"points": row}, "points") for row in query["points"].split(",")}
        return [ledger for ledger in ledgers if ledger.point in rows]

    def _rerun(self, query: Query) -> dict[str, Any]:
        """Start a run with other parameters, unless one is running."""
        running = self._reruns[-1].state.keys() if self._reruns else {"url"}
        if "phase" in running:
            raise UsageError("a run is in progress. Wait until it has finished")
        settings = _object(query)
        run = self.runs[self._letter(query)]
        self._reruns.append(Rerun(run, settings, lambda other: self.compare(run, other)))
        return self._reruns[-1].state

    def _rerun_state(self, query: Query) -> dict[str, Any]:
        """How far the run with other parameters is."""
        return self._reruns[-1].state if self._reruns else {"error": "no run was started"}

    def _corrections(self, run: ExploredRun) -> dict[int, str]:
        """The corrected truth by number of the case."""
        keys = self._keys(run)
        return {
            keys[each.key]: each.verdict
            for each in decisions_of(run.run).standing
            if each.key in keys and each.verdict in LABELS
        }

    def _keys(self, run: ExploredRun) -> dict[str, int]:
        """Numbers of the cases of a run by the keys of the questions about their truth."""
        digest = run.result.sequence.digest
        return {
            case_key(digest, number): number
            for number in range(1, len(run.result.failures) + 1)
        }  # fmt: skip

    def _correct(self, query: Query) -> dict[int, str]:
        """Correct the ground truth of a case, or, without ``truth``, withdraw that.

        All corrections are returned.
        """
        letter = self._letter(query)
        truth = query.get("truth")
        run = self.runs[letter]
        card = self._card(letter, _number(query, "case"))
        if not run.result.has_truth:
            raise UsageError(f"{run.path} has no ground truth to correct")
        if truth is not None and truth not in LABELS:
            raise UsageError(f"truth {truth}: choose from {', '.join(LABELS)}")
        decisions = decisions_of(run.run)
        key = case_key(run.result.sequence.digest, card.number)
        for each in decisions.standing:
            if each.key == key:
                decisions.undo(each.id)
        if truth is not None:
            decisions.add(self._correction(run, card, cast(Any, truth), key))
        return self._corrections(run)

    def _correction(
        self, run: ExploredRun, card: cards.Card, truth: Literal["static", "dynamic"], key: str
    ) -> ReviewDecision:
        """A decision on the boxes of a case.

        The recording lacks the offset of the world, so its coordinates do, too.
        """
        pieces = [
            Piece(run.index_of(frame), low, high) for frame, low, high in cards.boxes(run, card)
        ]
        pieces.sort(key=lambda piece: piece.time)
        region = ObjectRegion("frame", tuple(pieces), margin=CORRECTED)
        by = f"{run.result.method} on {run.result.sequence.name}"
        return ReviewDecision(
            truth, region, what=card.title, by=by, key=key, local=True,
            answered="kept" if card.outcome == Outcome.FALSE_NEGATIVE else "removed",
        )  # fmt: skip

    def _rescored(self, query: Query) -> dict[str, str]:
        """The scores against the ground truth with the decisions, in a line."""
        return {"text": str(reviewed_scores(self.runs[self._letter(query)].path))}

    def _review(self, query: Query) -> ReviewPage:
        """The review of a run, which starts when it is asked for first."""
        letter = self._letter(query)
        with self._lock:
            if letter not in self._reviews:
                self._reviews[letter] = ReviewPage(self.runs[letter])
            return self._reviews[letter]

    def _layout(self, query: Query) -> bytes:
        """The layout of a case, a frame or the map, as a recording."""
        letter = self._letter(query)
        kind = query.get("layout", CASE)
        if kind not in LAYOUTS:
            raise UsageError(f"layout {kind}: choose from {', '.join(LAYOUTS)}")
        run = self.runs[letter]
        focus = self.runs[letter].focus
        # The case may be one of the other run: both viewers then show the same place.
        owner = query.get("owner", letter)
        if owner not in self.runs:
            raise UsageError(f"run {owner}: choose from {', '.join(self.runs)}")
        if not self.cards[owner]:
            low, high = _extent(run)
            with self._lock:
                return focus.layout(MAP if kind == CASE else kind, "map", 0, low, high, None)
        card = self._card(owner, _number(query, "case"))
        eye = None if "x" not in query else np.array([_decimal(query, axis) for axis in "xyz"])
        low, high = (
            (np.array(card.case.low), np.array(card.case.high))
            if kind == MAP
            else (card.low, card.high)
        )
        title = f"case {card.number}: {card.title}, frame {card.case.worst_frame}"
        with self._lock:
            return focus.layout(
                kind, title, card.case.worst_frame, low, high, card.outcome, eye, "first" in query
            )

    def _marks(self, query: Query) -> bytes:
        """A mark at a point, and the rays of its ledger if that is known."""
        letter = self._letter(query)
        focus = self.runs[letter].focus
        lit = _number(query, "lit") if "lit" in query else None
        if "case" in query:
            return focus.marks(None, rays_of(self._chosen(letter, query), CASE_RAYS), lit)
        if "point" not in query:
            return focus.marks(None, rays_of([]), None)
        frame = _number(query, "frame")
        point = _number(query, "point")
        at = self.runs[letter].point(frame, point)["position"]
        return focus.marks(
            None if at is None else np.array(at), self._rays(letter, frame, point), lit
        )

    def _rays(self, letter: str, frame: int, point: int) -> TouchingRays:
        """The rays of the ledger of a point, if that is known."""
        return rays_of(self._known(letter, frame, point))

    def _known(self, letter: str, frame: int, point: int) -> list[PointLedger]:
        """The ledger of a point, or of one near it, if that is known."""
        computed = self._ledgers.known(letter, frame, point)
        stored = self.runs[letter].stored(frame, point)
        return [computed.ledger] if computed else [stored[0]] if stored else []

    def _draw(self, query: Query) -> bytes:
        """The case in its worst frame, drawn at once, before the viewer has loaded."""
        width, height = (
            min(max(_number({**THUMBNAIL, **query}, edge), 1), LARGEST) for edge in THUMBNAIL
        )
        letter = self._letter(query)
        drawing: bytes = self._drawing(
            letter, query.get("owner", letter), _number(query, "case"), width, height
        )
        return drawing

    def _shot(self, query: Query, name: str, size: tuple[int, int]) -> bytes:
        """A picture or a clip of a case that the recording lists."""
        run = self.runs[self._letter(query)]
        with tempfile.TemporaryDirectory() as folder:
            file = shot(run.path, Path(folder) / name, case=_number(query, "case"), size=size)[0]
            return file.read_bytes()

    def _letter(self, query: Query) -> str:
        letter = query.get("run", LETTERS[0])
        if letter not in self.runs:
            raise UsageError(f"run {letter}: choose from {', '.join(self.runs)}")
        return letter

    def _card(self, letter: str, number: int) -> cards.Card:
        found = self.cards.get(letter, ())
        if not 1 <= number <= len(found):
            raise UsageError(f"case {number}: the run has the cases 1 to {len(found)}")
        return found[number - 1]


def _unserved(run: ExploredRun, other: ExploredRun) -> str:
    raise UsageError("no server compares the runs")


def _extent(run: ExploredRun) -> tuple[Any, Any]:
    """The box around the drawn points of the first frame, for a run without cases."""
    drawn = run.drawn(0)
    if drawn is None or not len(drawn.xyz):
        return np.full(3, -10.0), np.full(3, 10.0)
    low, high = np.nanquantile(drawn.xyz.astype(np.float64), [0.05, 0.95], axis=0)
    return low, high


def _object(query: Query) -> dict[str, Any]:
    """The settings in a query."""
    try:
        found = json.loads(query["settings"])
    except (KeyError, ValueError):
        found = None
    if not isinstance(found, dict):
        raise UsageError("settings: give a JSON object")
    return found


def _settings(query: Query, given: Mapping[str, float]) -> dict[str, float]:
    """Other values of parameters that are numbers."""
    found = _object(query)
    for name, value in found.items():
        if name not in given or not isinstance(value, int | float):
            raise UsageError(f"settings: {name}: give a number for one of {', '.join(given)}")
    return found


def _number(query: Query, name: str) -> int:
    try:
        return int(query[name])
    except (KeyError, ValueError):
        raise UsageError(f"{name}: give a whole number") from None


def _decimal(query: Query, name: str) -> float:
    try:
        return float(query[name])
    except (KeyError, ValueError):
        raise UsageError(f"{name}: give a number") from None
