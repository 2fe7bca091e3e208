"""Comparison: what differs between runs, as plain values; saved whole or not at all, shown as tables or Markdown."""

from __future__ import annotations

import io
import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynaviz.comparison.counts import LEVEL, RESAMPLES, SCORES, SEED, TRUTHS, WRONG, block_length
from dynaviz.errors import UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.results.result import Result

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult

SCHEMA = 1
MOST = 8  # reasons in a table
TOLD = 2  # settings in the name of a run


@dataclass(frozen=True)
class TableSection:
    """A table with a title, and what to know of it."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


@dataclass(frozen=True)
class Comparison:
    """Runs on the same points, and what differs between the first and each other.

    Attributes:
        sequence: name, digest, frames and points.
        runs: for each run its letter, name, file, settings, scores and runtime.
        pairs: for each run but the first what differs from the first: ``scores`` (``first``, ``second``, ``delta`` =
            second - first, ``interval``), who is ``right``, the same ``by_range`` and ``by_reason``, the ``frames`` and
            ``places`` that change most, settings that ``differ``, ``runtime``.
    """

    sequence: dict[str, Any]
    runs: list[dict[str, Any]]
    pairs: list[dict[str, Any]]

    @property
    def title(self) -> str:
        """What is compared on what."""
        return f"{' | '.join(label(run) for run in self.runs)} on {self.sequence['name']}"

    def to_dict(self) -> dict[str, Any]:
        """The content of ``--json``."""
        interval = {
            "method": "paired circular block bootstrap over frames",
            "level": LEVEL,
            "resamples": RESAMPLES,
            "block": block_length(self.sequence["frames"]),
            "seed": SEED,
        }
        return {
            "schema": SCHEMA,
            "kind": "comparison",
            "sequence": self.sequence,
            "interval": interval,
            "verdicts": self.verdicts(),
            "runs": self.runs,
            "pairs": self.pairs,
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write everything as JSON, whole or not at all."""
        write_atomic(path, json.dumps(self.to_dict(), indent=1, allow_nan=False).encode())

    def fallen(self, below: float) -> list[str]:
        """Which run's AA lies more below the first's than allowed, a sentence each.

        Args:
            below: percentage points; AA minus the first's AA must not be less.

        Raises:
            UsageError: where AA is undefined, so that nothing can fall.
        """
        said = []
        for run, pair in zip(self.runs[1:], self.pairs, strict=True):
            aa = pair["scores"]["AA"]
            if aa["delta"] is None:
                raise UsageError(
                    "AA is undefined without static and dynamic points, so it cannot fall. Compare SA or DA"
                )
            if aa["delta"] < below:
                change = f"AA fell from {aa['first']:.2f} to {aa['second']:.2f}"
                said.append(f"{label(run)}: {change}, by {aa['delta']:+.2f}, below {below:+g}")
        return said

    def verdicts(self) -> list[str]:
        """Who is better, a sentence for each run but the first."""
        return [_verdict(self.runs[0], run, pair) for run, pair in zip(self.runs[1:], self.pairs, strict=True)]

    def sections(self) -> Iterator[TableSection]:
        """All that is printed; details where there are two runs."""
        yield _scores(self) if len(self.pairs) == 1 else _table(self)
        if len(self.pairs) == 1:
            first, second, pair = *self.runs, self.pairs[0]
            yield _right(first, second, pair)
            yield _reasons(pair)
            yield _frames(pair)
            yield _places(pair)
        for run, pair in zip(self.runs[1:], self.pairs, strict=True):
            yield _settings(self.runs[0], run, pair)

    def markdown(self, legend: str = "") -> str:
        """The report of the comparison's recording; ``legend`` says what its colours mean."""
        parts = [f"## {self.title}", *(f"**{line}**" for line in self.verdicts()), *([legend] if legend else [])]
        for section in self.sections():
            lines = [section.head, ("---",) + ("---:",) * (len(section.head) - 1), *section.rows]
            table = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in lines)
            parts += [
                f"### {section.title}",
                *([table] if section.rows else []),
                *([section.note] if section.note else []),
            ]
        return "\n\n".join(parts)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        from rich import box
        from rich.markup import escape
        from rich.table import Table

        yield f"[bold]{escape(self.title)}[/]\n"
        for line in self.verdicts():
            yield escape(line)
        for section in self.sections():
            table = Table(
                title=section.title, title_justify="left", caption=section.note or None, caption_justify="left"
            )
            table.box, table.padding, table.pad_edge, table.min_width = box.SIMPLE_HEAD, (0, 1, 0, 0), False, 60
            for i, name in enumerate(section.head):
                table.add_column(name, justify="right" if i else "left", no_wrap=True)
            for row in section.rows:
                table.add_row(*map(escape, row))
            yield "" if section.rows else f"\n[italic]{section.title}[/]: {escape(section.note)}"
            if section.rows:
                yield table

    def __str__(self) -> str:
        from rich.console import Console

        console = Console(file=io.StringIO(), record=True, width=100)
        console.print(self)
        return console.export_text()


def names(results: Sequence[Result], paths: Sequence[Path]) -> list[str]:
    """Short names of runs: the method, and what tells it from another run of the same method."""
    found = []
    for result, path in zip(results, paths, strict=True):
        same = [other for other in results if other.method == result.method]
        told = [k for k, v in _settings_of(result).items() if any(_settings_of(o).get(k) != v for o in same)]
        words = [f"{k}={_value(_settings_of(result)[k])}" for k in told[:TOLD]]
        if not told and len(same) > 1:
            words = [path.parent.name if path.stem == "run" else path.stem]
        found.append(" ".join([result.method, *filter(None, words)]))
    return found


def differences(first: Result, second: Result) -> list[dict[str, Any]]:
    """Settings that differ, ``first`` or ``second`` None where a run has no such setting."""
    a, b = _settings_of(first), _settings_of(second)
    return [
        {"name": name, "first": a.get(name), "second": b.get(name)}
        for name in dict.fromkeys([*a, *b])
        if a.get(name) != b.get(name)
    ]


def _settings_of(result: Result) -> dict[str, Any]:
    chosen = {"method": result.method, "scoring": result.scoring, "preset": _preset(result.command)}
    return {**chosen, "online": result.online, "seed": result.seed, **result.parameters}


def _preset(command: str) -> str | None:
    """A preset is only remembered in what was typed."""
    typed = re.search(r"--preset[ =](\S+)", command)
    return typed[1] if typed else None


def runtimes(first: Result, second: Result) -> dict[str, Any]:
    """Seconds a frame of the second over those of the first, None where they do not compare, and why."""
    means = [result.runtime.get("mean_s") for result in (first, second)]
    notes = []
    for result in (first, second):
        if "source" in result.sections:
            notes.append(f"no ratio of runtimes: what {result.method} answered was read from a file")
    if not notes and None in means:
        notes.append("no ratio of runtimes: one was not measured")
    if not notes and first.instrumented != second.instrumented:
        watched = (first if first.instrumented else second).method
        notes.append(f"no ratio of runtimes: only {watched}'s states were recorded while it ran")
    ratio = None if notes or not means[0] else means[1] / means[0]
    if ratio is not None and first.instrumented:
        notes.append("both while their states were recorded")
    for name, of in _MACHINE.items():
        a, b = of(first), of(second)
        if a != b:
            notes.append(f"{name} differ: {a}, {b}")
    return {"ratio": ratio, "first_s": means[0], "second_s": means[1], "notes": notes}


_MACHINE: dict[str, Callable[[Result], Any]] = {
    "threads": lambda result: result.runtime.get("threads"),
    "machines": lambda result: " ".join(str(v) for v in result.environment.get("machine", {}).values()),
}


def label(run: dict[str, Any]) -> str:
    """A run as it is called everywhere."""
    return f"{run['letter']} {run['name']}"


def _verdict(first: dict[str, Any], second: dict[str, Any], pair: dict[str, Any]) -> str:
    """The headline, and what it is made of."""
    name = next((name for name in ("AA", "SA", "DA") if pair["scores"][name]["delta"] is not None), None)
    if name is None:
        return "No score is defined."
    score = pair["scores"][name]
    low, high = score["interval"] or (-float("inf"), float("inf"))
    (better, high_aa), (worse, low_aa) = (second, score["second"]), (first, score["first"])
    if score["delta"] < 0:
        (better, high_aa), (worse, low_aa) = (worse, low_aa), (better, high_aa)
    how = f"{name} {high_aa:.2f} against {low_aa:.2f}"
    if score["delta"] == 0:
        said = f"{label(first)} and {label(second)} are even: {name} {high_aa:.2f}."
    elif low <= 0 <= high:
        said = f"No clear winner: {label(better)} has {how}, but resampled frames favour now the one, now the other."
    else:
        said = f"{label(better)} is better than {label(worse)}: {how}."
    for what, key in (("keeps more of what stands", "SA"), ("removes more of what moves", "DA")):
        if delta := pair["scores"][key]["delta"]:
            said += f" {label(second if delta > 0 else first)} {what} ({key} {abs(delta):+.2f})."
    return said


def _scores(comparison: Comparison) -> TableSection:
    first, second = comparison.runs
    rows = [
        (name, *(_number(score[side], name) for side in ("first", "second")), _signed(score["delta"], name),
         _interval(score["interval"], name))
        for name, score in comparison.pairs[0]["scores"].items()
    ]  # fmt: skip
    return TableSection("Scores", ("", label(first), label(second), "B - A", "95 % interval"), tuple(rows), _HOW)


_HOW = (
    "SA, DA: static points kept, dynamic points removed, in %; FP: static points removed, "
    "FN: dynamic points kept. Intervals: the same frames resampled for both, in blocks"
)


def _table(comparison: Comparison) -> TableSection:
    head = ("run", *SCORES, *WRONG, "AA - A's", "95 % interval")
    rows = []
    for i, run in enumerate(comparison.runs):
        numbers = [_number(run["scores"][name], name) for name in (*SCORES, *WRONG)]
        aa = comparison.pairs[i - 1]["scores"]["AA"] if i else None
        change = (_signed(aa["delta"], "AA"), _interval(aa["interval"], "AA")) if aa else ("", "")
        rows.append((label(run), *numbers, *change))
    return TableSection("Scores", head, tuple(rows), _HOW)


def _right(first: dict[str, Any], second: dict[str, Any], pair: dict[str, Any]) -> TableSection:
    head = ("points", f"only {label(first)}", f"only {label(second)}", "neither", "both")
    places = [("all", pair["right"]), *((band["band"], band) for band in pair["by_range"])]
    rows = [
        (f"{truth}, {name}", *(f"{counts[truth][who]:,}" for who in ("only_first", "only_second", "neither", "both")))
        for truth in TRUTHS
        for name, counts in places
    ]
    return TableSection("Who is right, by range from the sensor", head, tuple(rows))


def _reasons(pair: dict[str, Any]) -> TableSection:
    rows = [
        (
            {"only_first": "only A", "only_second": "only B", "neither": "neither"}[row["right"]],
            row["truth"],
            row["first_reason"] or "right",
            row["second_reason"] or "right",
            f"{row['points']:,}",
        )
        for row in pair["by_reason"][:MOST]
    ]
    return TableSection(
        "Why whoever is wrong is wrong", ("right", "point", "A's reason", "B's reason", "points"), tuple(rows)
    )


def _frames(pair: dict[str, Any]) -> TableSection:
    rows = [(f"{row['frame']}", *_change(row)) for row in pair["frames"]]
    note = "B's gain: what B loses less than A, in percentage points of SA and of DA; all frames sum up to B - A"
    return TableSection("Frames that change most", ("frame", *_CHANGES), tuple(rows), note)


def _places(pair: dict[str, Any]) -> TableSection:
    title = "Places that change most"
    if pair["places"] is None:
        return TableSection(title, ("place",), (), pair["places_note"])
    rows = []
    for number, row in enumerate(pair["places"], 1):
        x, y = row["low"]
        rows.append((f"{number}", f"{x:g}, {y:g}", f"{row['frame']}", *_change(row)))
    head = ("#", "x, y [m]", "frame", *_CHANGES)
    return TableSection(title, head, tuple(rows), pair["places_note"])


_CHANGES = ("better", "SA gain", "DA gain", "FP A", "FP B", "FN A", "FN B")


def _change(row: dict[str, Any]) -> tuple[str, ...]:
    counts = (f"{row[side][name]:,}" for name in WRONG for side in ("first", "second"))
    return ("B" if row["gain"] > 0 else "A", f"{row['gain_SA']:+.2f}", f"{row['gain_DA']:+.2f}", *counts)


def _settings(first: dict[str, Any], second: dict[str, Any], pair: dict[str, Any]) -> TableSection:
    a, b = first["letter"], second["letter"]
    rows = [(row["name"], _value(row["first"]), _value(row["second"])) for row in pair["differ"]]
    ratio = pair["runtime"]["ratio"]
    notes = list(pair["runtime"]["notes"])
    if ratio is not None:
        notes.insert(0, f"{b} takes {ratio:.2f} times as long per frame as {a}")
    return TableSection(f"Settings that differ: {a}, {b}", ("setting", a, b), tuple(rows), ". ".join(notes))


def _value(value: Any) -> str:
    return "-" if value is None else value if isinstance(value, str) else json.dumps(value)


def _number(value: float | None, name: str) -> str:
    return "n/a" if value is None else f"{value:,.0f}" if name in WRONG else f"{value:.2f}"


def _signed(value: float | None, name: str) -> str:
    return "n/a" if value is None else f"{value:+,.0f}" if name in WRONG else f"{value:+.2f}"


def _interval(interval: tuple[float, float] | None, name: str) -> str:
    return "n/a" if interval is None else " to ".join(_signed(end, name) for end in interval)
