"""Comparison: what differs between runs, as typed values.

Saved as JSON, shown as tables or Markdown.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import msgspec

from dynaviz.errors import UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.rendered import html_of, text_of
from dynaviz.scores.comparison import tables
from dynaviz.scores.comparison.counts import LEVEL, RESAMPLES, SEED, block_length
from dynaviz.scores.comparison.pair import (
    ComparedRun,
    PairComparison,
    RemovalComparison,
    ScoreChange,
)
from dynaviz.scores.sections import SequenceInfo

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult

SCHEMA = 1
_WIDTH = 100  # of a printed comparison, in characters


@dataclass(frozen=True)
class Comparison:
    """Runs on the same points, and what differs between the first and each other run.

    Attributes:
        sequence: the sequence of all runs.
        runs: all runs, in the order given.
        pairs: the first run against each other run.
        unscored_frames: positions of frames that a run has no labels for; no run is scored on them.
    """

    sequence: SequenceInfo
    runs: tuple[ComparedRun, ...]
    pairs: tuple[PairComparison, ...]
    unscored_frames: tuple[int, ...] = ()

    @property
    def title(self) -> str:
        """The runs and the sequence."""
        return f"{' | '.join(run.label for run in self.runs)} on {self.sequence.name}"

    def against_first(self) -> Iterator[tuple[ComparedRun, PairComparison]]:
        """Each run except the first, with its comparison to the first."""
        return zip(self.runs[1:], self.pairs, strict=True)

    def to_dict(self) -> dict[str, Any]:
        """The content of ``--json``."""
        interval = {
            "method": "paired circular block bootstrap over frames",
            "level": LEVEL,
            "resamples": RESAMPLES,
            "block": block_length(self.sequence.frames),
            "seed": SEED,
        }
        return {
            "schema": SCHEMA,
            "kind": "comparison",
            "sequence": msgspec.to_builtins(self.sequence),
            "interval": interval,
            **({"unscored_frames": list(self.unscored_frames)} if self.unscored_frames else {}),
            "verdicts": self.verdicts(),
            "runs": msgspec.to_builtins(self.runs),
            "pairs": msgspec.to_builtins(self.pairs),
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write ``to_dict`` as JSON; the file appears complete or not at all."""
        write_atomic(path, json.dumps(self.to_dict(), indent=1, allow_nan=False).encode())

    def drops_below(self, limit: float) -> list[str]:
        """One sentence for each run whose AA minus the first run's AA is below a limit.

        Args:
            limit: percentage points.

        Raises:
            UsageError: if AA is undefined.
        """
        sentences = []
        for run, pair in self.against_first():
            aa = pair.scores.AA
            if aa.first is None or aa.second is None or aa.delta is None:
                raise UsageError(
                    "AA is undefined without both static and dynamic points, so it cannot be "
                    "checked. Compare SA or DA"
                )
            if aa.delta < limit:
                change = f"AA changed from {aa.first:.2f} to {aa.second:.2f}"
                sentences.append(
                    f"{run.label}: {change}, by {aa.delta:+.2f}, which is below {limit:+g}"
                )
        return sentences

    def verdicts(self) -> list[str]:
        """Which run is better, one line for each run except the first."""
        return [_verdict(self.runs[0], run, pair) for run, pair in self.against_first()]

    def _notes(self) -> Iterator[str]:
        """What a reader should know about the points that were compared."""
        if n := len(self.unscored_frames):
            yield (
                f"{n:,} of {self.sequence.frames:,} frames are left out, because a run has no "
                "labels for them."
            )

    def markdown(self, legend: str = "") -> str:
        """The report in the comparison's recording; ``legend`` explains its colours."""
        parts = [
            f"## {self.title}",
            *(f"**{line}**" for line in self.verdicts()),
            *self._notes(),
            legend,
        ]
        parts += [tables.markdown(section) for section in tables.sections(self.runs, self.pairs)]
        return "\n\n".join(part for part in parts if part)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        from rich.markup import escape

        yield f"[bold]{escape(self.title)}[/]\n"
        yield from map(escape, [*self.verdicts(), *self._notes()])
        for section in tables.sections(self.runs, self.pairs):
            yield ""
            yield tables.renderable(section)

    def __str__(self) -> str:
        return text_of(self, _WIDTH)

    def __repr__(self) -> str:
        return f"<Comparison of {self.title}>"

    def _repr_html_(self) -> str:
        return html_of(self, _WIDTH)


def _verdict(first: ComparedRun, second: ComparedRun, pair: PairComparison) -> str:
    """The headline score, followed by the two scores it combines."""
    by_name = {"AA": pair.scores.AA, "SA": pair.scores.SA, "DA": pair.scores.DA}
    defined = [(name, score) for name, score in by_name.items() if score.delta is not None]
    if not defined:
        return _removed(first, second, pair.removed) if pair.removed else "No score is defined."
    name, score = defined[0]
    sentences = [_headline(first, second, name, score, pair.over_movers.get(name))]
    for what, name in (("keeps more static points", "SA"), ("removes more dynamic points", "DA")):
        delta = by_name[name].delta
        if delta and _is_clear(by_name[name]):
            sentences.append(
                f"{(second if delta > 0 else first).label} {what} ({name} {abs(delta):+.2f})."
            )
    return " ".join(sentences)


def _headline(
    first: ComparedRun,
    second: ComparedRun,
    name: str,
    score: ScoreChange,
    over_movers: tuple[float, float] | None,
) -> str:
    delta = score.delta or 0.0
    better, worse = (first, second) if delta < 0 else (second, first)
    best, least = (score.first, score.second) if delta < 0 else (score.second, score.first)
    if delta == 0:
        return f"{first.label} and {second.label} are even: {name} {best:.2f}."
    numbers = f"{name} {best:.2f} against {least:.2f}"
    doubt = ""
    if over_movers and over_movers[0] <= 0 <= over_movers[1]:
        doubt = " Other movers may reverse it: the interval over movers includes zero."
    if not _is_clear(score):
        why = "the 95 % interval includes zero" if score.interval else "there is no 95 % interval"
        return f"No clear winner: {better.label} has {numbers}, but {why}."
    return f"{better.label} is better than {worse.label}: {numbers}.{doubt}"


def _is_clear(score: ScoreChange) -> bool:
    """Whether the interval of the change excludes zero."""
    low, high = score.interval or (0.0, 0.0)
    return not low <= 0 <= high


def _removed(first: ComparedRun, second: ComparedRun, removed: RemovalComparison) -> str:
    """Without ground truth: how much each run removes, and how much only one of them removes."""
    points = removed.points
    total = points.neither + points.only_first + points.only_second + points.both
    if not total:
        return "No score is defined, because there are no points."
    shares = points.shares
    only = (100 * n / total for n in (points.only_first, points.only_second))
    runs = [
        f"{run.label} removes {share:.2f} % of the points, {alone:.2f} % that the other keeps"
        for run, share, alone in zip((first, second), shares, only, strict=True)
    ]
    return f"There is no ground truth, so neither run is known to be better. {'; '.join(runs)}."
