"""A comparison as a card: Markdown for a pull request, with strips of pictures beside it."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote

import numpy as np

from dynaviz import colours
from dynaviz.arrays import F32, F64, I64, U8
from dynaviz.contracts.scan import ERRORS, Outcome
from dynaviz.errors import UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.progress import Progress, silent
from dynaviz.scores.comparison.objects import ObjectChange, ObjectFate
from dynaviz.scores.comparison.pair import ComparedRun, PairComparison
from dynaviz.scores.comparison.settings import text
from dynaviz.scores.comparison.summary import Comparison
from dynaviz.scores.comparison.surfaces import SurfaceChange, SurfaceFate
from dynaviz.views import paths
from dynaviz.views.read.reader import DrawnPoints, RunRecording
from dynaviz.views.read.still import Still, spread, with_map

LISTED = 10  # changes of a pair, at most
SHOWN = ("SA", "DA", "AA")
FRAMES = 6  # of a strip
TILE = (260, 170)  # pixels
CLOSEST = 6.0  # metres: distance of the eye from a small object
GAP = 3
HEAD = 20  # pixels: height of the frame numbers above a strip
SIDE = 22  # pixels: width of the letters beside a strip
INK = (235, 235, 235)
LEGEND = (
    Outcome.FALSE_NEGATIVE,
    Outcome.FALSE_POSITIVE,
    Outcome.DYNAMIC_REMOVED,
    Outcome.STATIC_KEPT,
)
MEANING = {
    Outcome.FALSE_NEGATIVE: "dynamic, kept",
    Outcome.FALSE_POSITIVE: "static, removed",
    Outcome.DYNAMIC_REMOVED: "dynamic, removed",
    Outcome.STATIC_KEPT: "static, kept",
}
SIGNS = str.maketrans("-", "−")

Change = ObjectChange | SurfaceChange


@dataclass(frozen=True, slots=True, eq=False)
class PlacedChange:
    """An object or a surface that changed, and the case that shows it.

    Attributes:
        change: what changed.
        worse: which run did worse on it, 0 or 1.
        number: of its case in that run; None if that is not listed.
    """

    change: Change
    worse: int
    number: int | None

    @property
    def gain(self) -> float:
        """Percentage points of the metric, positive where the second run is better."""
        change = self.change
        return change.gain_DA if isinstance(change, ObjectChange) else change.gain_SA

    @property
    def metric(self) -> str:
        """The metric that it changes."""
        return "DA" if isinstance(self.change, ObjectChange) else "SA"

    @property
    def fate(self) -> ObjectFate | SurfaceFate:
        """What the run that did worse did to it."""
        return (self.change.first, self.change.second)[self.worse]

    @property
    def outcome(self) -> Outcome:
        """Of the points that the case is of."""
        object_ = isinstance(self.change, ObjectChange)
        return ERRORS["false_negative" if object_ else "false_positive"]

    @property
    def line(self) -> str:
        """What changed, by how much, and when, in a line."""
        change = self.change
        if isinstance(change, ObjectChange):
            did = f"removed {change.first.removed:.0f} % → {change.second.removed:.0f} %"
        else:
            did = f"lost {change.first.lost:.2f} → {change.second.lost:.2f} % of SA"
        one = change.first_frame == change.last_frame
        frames = f"frames {change.first_frame}-{change.last_frame}"
        frames = f"frame {change.first_frame}" if one else frames
        gain = f"{self.gain:+.2f} {self.metric}".translate(SIGNS)
        return f"{change.what}: {did}, {gain}, {frames}"


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """Where the pictures of a change look.

    Attributes:
        frames: positions in the run.
        low, high: (3,) float64, metres, world frame: the box in each frame.
    """

    frames: list[int]
    low: list[F64] = field(default_factory=list)
    high: list[F64] = field(default_factory=list)


def placed(pair: PairComparison) -> list[PlacedChange]:
    """The objects and surfaces that changed, those that changed their metric most first."""
    changes: list[Change] = [*pair.objects, *pair.surfaces]
    found = []
    for change in changes:
        gain = change.gain_DA if isinstance(change, ObjectChange) else change.gain_SA
        worse = 0 if gain > 0 else 1
        found.append(PlacedChange(change, worse, (change.first, change.second)[worse].case))
    found.sort(key=lambda each: -abs(each.gain))
    return found


def write_card(
    path: str | os.PathLike[str],
    comparison: Comparison,
    recordings: Sequence[RunRecording],
    progress: Progress = silent,
) -> list[Path]:
    """Write a comparison as Markdown, and the strips of its changes as PNG files next to it.

    Args:
        path: of the Markdown file, which ends in ``.md``.
        comparison: the runs and what differs between them.
        recordings: of these runs.
        progress: called with ``card``, the number of finished pairs of runs, and their number.

    Returns:
        The files, the Markdown file first.

    Raises:
        UsageError: if the name does not end in ``.md``.
        DataError: if a recording cannot be read, or a file cannot be written.
    """
    path = checked(path)
    runs = comparison.runs
    parts = [f"# {comparison.title}\n"]
    parts += [f"**{verdict}**\n" for verdict in comparison.verdicts()]
    files: list[Path] = []
    for done, pair in enumerate(comparison.pairs, 1):
        card = PairCard(
            path, (runs[0], runs[done]), (recordings[0], recordings[done]), pair, len(runs) > 2
        )
        parts += card.lines()
        for name, pixels in card.pictures():
            files.append(path.with_name(name))
            write_atomic(files[-1], _png(pixels))
        progress("card", done, len(comparison.pairs))
    parts.append(f"{_legend()}\n" if files else "")
    write_atomic(path, "\n".join(part for part in parts if part).encode())
    return [path, *files]


def checked(path: str | os.PathLike[str]) -> Path:
    """The path of a card.

    Raises:
        UsageError: if its name does not end in ``.md``.
    """
    path = Path(path)
    if path.suffix.lower() != ".md":
        raise UsageError(f"--card {path}: is Markdown. Give a name that ends in .md")
    return path


class PairCard:
    """What differs between the first and another run.

    Args:
        path: of the card, to which links are relative.
        runs: the two.
        recordings: of them.
        pair: what differs.
        several: whether the card is of more runs than two.
    """

    def __init__(
        self,
        path: Path,
        runs: tuple[ComparedRun, ComparedRun],
        recordings: tuple[RunRecording, RunRecording],
        pair: PairComparison,
        several: bool,
    ) -> None:
        self._path = path
        self._runs = runs
        self._recordings = recordings
        self._pair = pair
        self._several = several
        changes = placed(pair)
        self._changes = changes[:LISTED]
        self._more = len(changes) - len(self._changes)
        self._strips: dict[int, Strip] = {}
        self._drawn: tuple[dict[int, DrawnPoints], ...] = ({}, {})
        self._maps: tuple[F32, ...] = ()
        if self._changes and all(run.mode != "scores" for run in self._runs):
            self._read()

    def lines(self) -> Iterator[str]:
        """The Markdown of the pair."""
        first, second = self._runs
        if self._several:
            yield f"## {first.label} → {second.label}\n"
        yield _scores(self._pair)
        yield f"What differs: {_settings(self._pair)}\n"
        if not self._changes:
            yield f"{self._nothing()}\n"
        for number, each in enumerate(self._changes, 1):
            yield f"### {number} {each.line}\n"
            yield from self._change(number, each)
        if self._more:
            yield f"Smaller changes that are left out: {self._more}.\n"

    def pictures(self) -> Iterator[tuple[str, U8]]:
        """Name and pixels of each strip."""
        for number, strip in self._strips.items():
            front = self._changes[number - 1].outcome
            yield self._name(number), self._picture(strip, front)

    def _change(self, number: int, each: PlacedChange) -> Iterator[str]:
        run = self._runs[each.worse]
        if each.number is None:
            yield f"{run.letter} is worse; the case is not among those that its recording lists.\n"
            return
        cause = each.fate.cause or "unknown cause"
        yield f"{run.letter}, case {each.number}: {cause}\n"
        if number in self._strips:
            frames = self._strips[number].frames
            alt = f"frames {', '.join(map(str, frames))}: A above, {self._runs[1].letter} below"
            yield f"![{alt}]({quote(self._name(number))})\n"
        recording = os.path.relpath(run.path, self._path.parent)
        command = f"dynaviz view {shlex.quote(run.path)} --case {each.number} -o case.png"
        yield f"[Recording]({quote(recording)}) · `{command}`\n"

    def _nothing(self) -> str:
        if self._pair.removed:
            return "Without ground truth no object or surface is known to have changed."
        return "No object and no listed surface changed."

    def _name(self, number: int) -> str:
        letter = f"_{self._runs[1].letter}" if self._several else ""
        return f"{self._path.stem}{letter}_{number}.png"

    def _read(self) -> None:
        """Choose the frames of each strip, and read what is drawn in them."""
        recordings = self._recordings
        every = [{each.frame: each for each in recording.drawn()} for recording in recordings]
        for worse, recording in enumerate(recordings):
            failures = recording.result.failures if recording.result else ()
            wrong = _wrong(recording, every[worse].values())
            for number, each in enumerate(self._changes, 1):
                if each.worse == worse and each.number in wrong:
                    worst = failures[each.number - 1].worst_frame
                    self._strips[number] = _strip(each, worst, *wrong[each.number])
        self._strips = dict(sorted(self._strips.items()))
        self._drawn = tuple(every)
        self._maps = tuple(
            recording.static(paths.MAP).get("Points3D:positions", np.zeros((0, 3), np.float32))
            for recording in recordings
        )

    def _picture(self, strip: Strip, front: Outcome) -> U8:
        """Frames from left to right, the first run above the second."""
        width, height = TILE
        tall = HEAD + 2 * (height + GAP)
        wide = SIDE + len(strip.frames) * (width + GAP)
        pixels = np.full((tall, wide, 3), colours.BACKGROUND, np.uint8)
        for k, frame in enumerate(strip.frames):
            left = SIDE + k * (width + GAP)
            _write(pixels, f"frame {frame}", left + 4, HEAD - 6)
            for i in (0, 1):
                top = HEAD + i * (height + GAP)
                xyz, outcome = with_map(self._maps[i], self._drawn[i].get(frame))
                still = Still(strip.low[k], strip.high[k], TILE, CLOSEST)
                still.draw(xyz, outcome, front)
                still.outline()
                pixels[top : top + height, left : left + width] = still.pixels
        for i, run in enumerate(self._runs):
            _write(pixels, run.letter, 5, HEAD + i * (height + GAP) + height // 2)
        return pixels


def _wrong(recording: RunRecording, drawn: Iterable[DrawnPoints]) -> dict[int, tuple[I64, F32]]:
    """By number of the cases of a run, the frames and positions of their drawn points."""
    failures = recording.result.failures if recording.result else ()
    parts = list(drawn)
    found = {}
    for kind in dict.fromkeys(case.kind for case in failures):
        rows = [(each.frame, each.xyz[each.outcome == ERRORS[kind]]) for each in parts]
        frames = np.concatenate([np.full(len(xyz), frame, np.int64) for frame, xyz in rows])
        xyz = np.concatenate([part for _, part in rows])
        owners = recording.case_points.owners(kind, frames, xyz)
        for number in np.unique(owners[owners > 0]).tolist():
            found[number] = frames[owners == number], xyz[owners == number]
    return found


def _strip(each: PlacedChange, worst: int, frames: I64, xyz: F32) -> Strip:
    """Frames spread over those of a case; the eye follows an object and rests on a surface.

    Args:
        each: the change.
        worst: the worst frame of its case.
        frames, xyz: of the points of the case.
    """
    strip = Strip(spread(frames.tolist(), worst, FRAMES))
    rests = isinstance(each.change, SurfaceChange) and worst in frames
    for frame in strip.frames:
        here = xyz[frames == (worst if rests else frame)].astype(np.float64)
        strip.low.append(here.min(0))
        strip.high.append(here.max(0))
    return strip


def _scores(pair: PairComparison) -> str:
    """The scores as a small table."""
    rows = [
        (name, *(f"{value:.2f}" for value in (score.first, score.second)),
         f"{score.delta:+.2f}".translate(SIGNS), _interval(score.interval))
        for name, score in pair.scores.items()
        if name in SHOWN
        and score.first is not None
        and score.second is not None
        and score.delta is not None
    ]  # fmt: skip
    if not rows:
        return ""
    head = f"| [%] | {pair.first} | {pair.second} | change | 95 % interval |"
    lines = [head, "|---|---:|---:|---:|---:|"]
    lines += [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join(lines) + "\n"


def _interval(interval: tuple[float, float] | None) -> str:
    if interval is None:
        return ""
    low, high = (f"{end:+.2f}".translate(SIGNS) for end in interval)
    return f"{low} to {high}"


def _settings(pair: PairComparison) -> str:
    """The settings that differ, in a line."""
    found = [f"{each.name} {text(each.first)} → {text(each.second)}" for each in pair.differ]
    return "; ".join(found) or "nothing in their parameters, code or version"


def _legend() -> str:
    """The colours of the strips."""
    words = [f"{colours.WORDS[each]}: {MEANING[each]}" for each in LEGEND]
    return f"Colours of points: {', '.join(words)}."


def _write(pixels: U8, words: str, x: int, y: int) -> None:
    """Write into a picture; x, y: left end of the base line, pixels."""
    import cv2

    cv2.putText(pixels, words, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.42, INK, 1, cv2.LINE_AA)


def _png(pixels: U8) -> bytes:
    import cv2

    return cv2.imencode(".png", pixels[:, :, ::-1])[1].tobytes()
