"""The report in a recording, as Markdown: scores, worst frames, failure cases, legend, settings."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from dynaviz import colours
from dynaviz.arrays import U8
from dynaviz.method import MethodInfo
from dynaviz.results.result import Result
from dynaviz.results.scores import percentage_points_lost
from dynaviz.results.sections import FailureCase
from dynaviz.scan import Outcome
from dynaviz.viz import paths

WORST = 5  # frames named in the report and marked on the curve
LISTED = 20  # failure cases in the list and in the map, at most ...
WORTH = 0.01  # ... that cost at least this share of the first one


class OutcomeCounts:
    """Counts for the report: points by outcome and reason, and wrong points by frame."""

    def __init__(self) -> None:
        self.points = np.zeros((len(Outcome), 256), np.int64)
        self.frames: list[tuple[int, int, int, int]] = []  # frame, index, false negatives, false positives

    def add(self, frame: int, index: int, outcome: U8, reasons: U8) -> tuple[int, int]:
        """Count a frame; returns its false negatives and false positives."""
        flat = outcome.astype(np.intp) * 256 + reasons
        here = np.bincount(flat, minlength=self.points.size).reshape(self.points.shape)
        self.points += here
        missed, removed = (int(here[o].sum()) for o in (Outcome.FALSE_NEGATIVE, Outcome.FALSE_POSITIVE))
        self.frames.append((frame, index, missed, removed))
        return missed, removed

    def worst(self) -> list[tuple[int, int, int, int]]:
        """The frames with the most wrong points, worst first; frames without wrong points are left out."""
        wrong = [entry for entry in self.frames if entry[2] + entry[3]]
        return sorted(wrong, key=lambda entry: (-entry[2] - entry[3], entry[0]))[:WORST]


def before(info: MethodInfo, sequence: str, params: Mapping[str, Any], mode: str) -> str:
    """The report until the run finishes."""
    return "\n\n".join(
        [_title(info, sequence), "**This run did not finish.**", _parameters(params), _how_to_read(mode)]
    )


def report(info: MethodInfo, result: Result, counts: OutcomeCounts, mode: str) -> str:
    """The report of a finished run.

    Args:
        info: of the method.
        result: of the run.
        counts: of its points.
        mode: of the recording.
    """
    parts = [
        _title(info, result.sequence.name),
        _scores(result),
        _worst(counts),
        _sentences(result),
        _counts(result),
        _reasons(info, counts),
        _how_to_read(mode),
        _states(info) if mode != "scores" else "",
        _run(info, result),
        _parameters(result.parameters),
    ]
    return "\n\n".join(part for part in parts if part)


def listed(result: Result) -> list[FailureCase]:
    """The costliest failure cases."""
    return [case for case in result.failures[:LISTED] if case.cost >= WORTH * result.failures[0].cost]


def failure_list(result: Result) -> str:
    """The cost of each cause, and the costliest cases, numbered like their boxes."""
    cases = listed(result)
    if not cases:
        return "No failure cases: there is no wrong point, or no ground truth."
    rows = [
        (
            f"[{number}](recording://{paths.CASES}[#{number - 1}])",
            case.worst_frame,
            f"{_DID[case.kind]} {case.what}",
            case.cause or "unknown",
            f"{case.cost:.2f}",
        )
        for number, case in enumerate(cases, 1)
    ]
    return f"{_causes(result)}\n\n" + _table([("#", "frame", "what", "cause", "% lost"), *rows])


_DID = {"false_positive": "removed", "false_negative": "kept"}


def _causes(result: Result) -> str:
    """A line per kind of error: its colour, and the cost of each cause, largest first."""
    counts = result.counts
    static, dynamic = (
        counts["static_kept"] + counts["static_removed"],
        counts["dynamic_kept"] + counts["dynamic_removed"],
    )
    lines = []
    for kind, colour, whole, score in (
        ("false_positive", "Yellow", static, "SA"),
        ("false_negative", "Orange", dynamic, "DA"),
    ):
        causes = result.causes.get(kind, {})
        costs = {cause: float(percentage_points_lost(count.points, whole)) for cause, count in causes.items()}
        parts = [f"{cause} {cost:.2f}" for cause, cost in costs.items() if cost >= 0.005]
        if parts:
            lines.append(f"**{colour}**: wrongly {_DID[kind]}. Loss of {score} by cause, in %: {', '.join(parts)}.")
    return "\n\n".join(lines)


def _sentences(result: Result) -> str:
    rows = [
        (number, f"{case.first_frame} to {case.last_frame}", case.sentence, _most(case.reasons))
        for number, case in enumerate(listed(result), 1)
    ]
    if not rows:
        return ""
    others = result.sections.failures.others.cases if result.sections.failures else 0
    rest = len(result.failures) - len(rows) + others
    more = f"\n\n{rest:,} smaller cases are not shown; `dynaviz failures` lists more." if rest else ""
    head = ("#", "frames", "what happened", "reasons given by the method")
    return "### Failure cases\n\n" + _table([head, *rows]) + more


def _most(reasons: Mapping[str, int]) -> str:
    """The two most frequent reasons, with their shares."""
    total = sum(reasons.values())
    return ", ".join(f"{name} {100 * count / total:.0f} %" for name, count in list(reasons.items())[:2])


def _title(info: MethodInfo, sequence: str) -> str:
    return f"## {info.title} on {sequence}"


def _scores(result: Result) -> str:
    return (
        _table([tuple(result.metrics), tuple(_percent(v) for v in result.metrics.values())]) if result.metrics else ""
    )


def _counts(result: Result) -> str:
    rows = [(name.replace("_", " "), f"{count:,}") for name, count in result.counts.items()]
    return _table([("points", "count"), *rows]) if rows else ""


def _percent(value: float | None) -> str:
    return "n/a" if value is None else f"{value:.2f} %"


def _worst(counts: OutcomeCounts) -> str:
    rows = [(f, i, f"{missed:,}", f"{removed:,}") for f, i, missed, removed in counts.worst()]
    if not rows:
        return "No frame has wrong points." if counts.frames else ""
    return "### Worst frames\n\n" + _table([("frame", "scan", "false negatives", "false positives"), *rows])


def _reasons(info: MethodInfo, counts: OutcomeCounts) -> str:
    outcomes = [o for o in Outcome if counts.points[o].any()]
    rows = []
    for code, reason in enumerate(info.reasons):
        if counts.points[:, code].any():
            rows.append((code, reason.name, *(f"{counts.points[o, code]:,}" for o in outcomes), reason.meaning))
    head = ("code", "reason", *(paths.NAMES[o].split(":")[0] for o in outcomes), "meaning")
    return "### Points by reason\n\n" + _table([head, *rows]) if rows else ""


def _how_to_read(mode: str) -> str:
    if mode == "scores":
        return "### How to read this recording\n\nIt contains only numbers (`--record scores`); no points are drawn."
    shown = {
        "errors": "all dynamic points are drawn, one false positive per 0.2 m voxel, and kept static points as one map",
        "full": "every point of every frame is drawn; the map of the whole run is downsampled",
    }[mode]
    rows = [(word, paths.NAMES[outcome]) for outcome, word in colours.WORDS.items()]
    views = (
        "- **map**: the whole run; wrong points of all frames are highlighted.\n"
        "- **frame**: the points of the frame at the time cursor, and the sensor. Drag the cursor to replay.\n"
        "- **wrong points per frame**: diamonds mark the worst frames; right-click on one to go there.\n"
        "- **FN, FP: distance**: from each wrong point to the nearest correct one; a tenth are left of the line."
    )
    legend = _table([("colour", "point"), *rows])
    return f"### How to read this recording\n\n{legend}\n\n{views}\n\nIn this recording, {shown} (`--record {mode}`)."


def _states(info: MethodInfo) -> str:
    rows = [(state.name, state.meaning) for state in info.emits]
    return "### States of the method\n\n" + _table([("state", "meaning"), *rows]) if rows else ""


def _run(info: MethodInfo, result: Result) -> str:
    runtime, mean = result.runtime, result.runtime.mean_s
    rows: list[tuple[Any, Any]] = [
        ("seconds per frame", "n/a" if mean is None else f"{mean:.3f} ± {runtime.std_s or 0:.3f}"),
        ("published in", info.paper),
        ("frames", result.sequence.frames),
        ("points", f"{result.sequence.points:,}"),
        ("mode", "online" if result.online else "two passes"),
        ("scoring", result.scoring),
        ("seed", result.seed),
        ("threads", runtime.threads or "n/a"),
        ("digest of the sequence", f"`{result.sequence.digest[:16]}`"),
        ("digest of the labels", f"`{(result.labels_sha256 or 'n/a')[:16]}`"),
    ]
    return "### The run\n\n" + _table([("property", "value"), *rows])


def _parameters(params: Mapping[str, Any]) -> str:
    rows = [(name, json.dumps(value)) for name, value in params.items()]
    return f"### Parameters ({len(rows)})\n\n" + _table([("name", "value"), *rows]) if rows else ""


def _table(rows: Iterable[Sequence[Any]]) -> str:
    head, *body = rows
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines)
