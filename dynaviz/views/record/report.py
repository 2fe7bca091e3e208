"""The report in a recording, as Markdown: scores, worst frames, failure cases, legend, settings."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from dynaviz import colours
from dynaviz.arrays import U8
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.scan import ERRORS, Outcome
from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.result import Result
from dynaviz.scores.scores import percentage_points_lost
from dynaviz.scores.sections import RemovedCluster, RemovedInterval
from dynaviz.views import paths
from dynaviz.views.cases import listed, suspicious, title_of

WORST = 5  # frames named in the report and marked on the curve
TRUE = [
    Outcome.STATIC_KEPT,
    Outcome.DYNAMIC_REMOVED,
    Outcome.FALSE_POSITIVE,
    Outcome.FALSE_NEGATIVE,
]
SMALLEST = 0.005  # percentage points: smaller costs would print as 0.00


class OutcomeCounts:
    """Counts for the report: points by outcome and reason, and wrong points by frame."""

    def __init__(self) -> None:
        self.points = np.zeros((len(Outcome), 256), np.int64)
        self.frames: list[
            tuple[int, int, int, int]
        ] = []  # frame, index, false negatives, false positives

    def add(self, frame: int, index: int, outcome: U8, reasons: U8) -> tuple[int, int]:
        """Count a frame; returns its false negatives and false positives."""
        flat = (outcome.astype(np.uint16) << 8) | reasons
        here = np.bincount(flat, minlength=self.points.size).reshape(self.points.shape)
        self.points += here
        kept, removed = (
            int(here[o].sum()) for o in (Outcome.FALSE_NEGATIVE, Outcome.FALSE_POSITIVE)
        )
        self.frames.append((frame, index, kept, removed))
        return kept, removed

    def curves(self, info: MethodInfo) -> tuple[str, ...]:
        """Paths of the curves of reasons that are not zero in all frames."""
        kinds = {**ERRORS, "removed": Outcome.UNLABELLED_REMOVED}
        return tuple(
            f"{paths.REASONS}/{kind}/{reason.name}"
            for kind, outcome in kinds.items()
            for code, reason in enumerate(info.reasons)
            if self.points[outcome, code]
        )

    def worst(self) -> list[tuple[int, int, int, int]]:
        """The frames with the most wrong points, worst first.

        Frames without wrong points are left out.
        """
        wrong = [entry for entry in self.frames if entry[2] + entry[3]]
        return sorted(wrong, key=lambda entry: (-entry[2] - entry[3], entry[0]))[:WORST]


def before(info: MethodInfo, sequence: str, params: Mapping[str, Any], mode: str) -> str:
    """The report until the run finishes."""
    unfinished = "**The recording is still loading, or this run did not finish.**"
    return "\n\n".join(
        [_title(info, sequence), unfinished, _parameters(params), _how_to_read(mode)]
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
        _how_to_read(mode, bool(counts.points[TRUE].any())),
        _states(info) if mode != "scores" else "",
        _run(info, result),
        _parameters(result.parameters),
    ]
    return "\n\n".join(part for part in parts if part)


def failure_list(result: Result) -> str:
    """The costliest cases by cause, holes and ghosts apart, numbered as on their timeline.

    Or suspicious clusters.
    """
    if cases := listed(result):
        # the kind of the costliest case first
        kinds = sorted(KINDS, key=lambda kind: kind != cases[0].kind)
        return "\n\n".join(part for kind in kinds for part in _by_cause(result, kind))
    if rows := [_suspicious(case, number) for number, case in enumerate(suspicious(result), 1)]:
        removed = suspicious(result)[0].did == "removed"
        what = (
            "Removed points that may be static, most suspicious"
            if removed
            else "Points that changed, largest"
        )
        head = f"{what} first. There is no ground truth to check them."
        return f"{head}\n\n" + table([("#", "points", "what and why", "frame"), *rows])
    if result.counts.get("static_kept") or result.counts.get("dynamic_removed"):
        return "No failure case: all labelled points are right."
    return (
        "There is no ground truth, so failures cannot be computed. **removed** sums up what was "
        "removed."
    )


KINDS = {  # kind: heading
    "false_positive": "Holes (yellow)",
    "false_negative": "Ghosts (orange)",
}


def _by_cause(result: Result, kind: str) -> Iterator[str]:
    """A heading with the loss, and a row per cause followed by its cases.

    Nothing if there are no such cases.
    """
    cases = [(number, case) for number, case in enumerate(listed(result), 1) if case.kind == kind]
    costs = _costs(result, kind)
    if not cases and not costs:
        return
    metric = "SA" if kind == "false_positive" else "DA"
    score = result.metrics.get(metric)
    yield f"**{KINDS[kind]}" + (
        f": {100 - score:.2f} % of {metric} lost**" if score is not None else "**"
    )
    ceiling = result.sections.ceiling
    if metric == "DA" and ceiling is not None and (words := ceiling.of_kept()):
        yield f"Of DA: {words} (in %)."
    by: dict[str, list[tuple[int, FailureCase]]] = {cause: [] for cause in costs}
    for number, case in cases:
        by.setdefault(case.cause or "unknown", []).append((number, case))
    rows: list[tuple[Any, ...]] = []
    for cause, members in by.items():
        rows.append(("", f"**{costs.get(cause, 0.0):.2f}**", f"**{cause}**", ""))
        rows += [
            (_link(number, paths.CASES), f"{case.cost:.2f}", _named(case), case.worst_frame)
            for number, case in members
        ]
    yield table([("#", "% lost", "cause, cases", "frame"), *rows])


def _costs(result: Result, kind: str) -> dict[str, float]:
    """The cost of each cause in percentage points, largest first.

    Without those that round to zero.
    """
    counts = result.counts
    first, second = (
        ("static_kept", "static_removed")
        if kind == "false_positive"
        else ("dynamic_kept", "dynamic_removed")
    )
    whole = counts.get(first, 0) + counts.get(second, 0)
    costs = {
        cause: float(percentage_points_lost(n.points, whole))
        for cause, n in result.causes.get(kind, {}).items()
    }
    return {cause: cost for cause, cost in costs.items() if cost >= SMALLEST}


def _named(case: FailureCase) -> str:
    return f"{case.what}: {case.behaviour}" if case.behaviour else case.what


def _link(number: int, boxes: str) -> str:
    return f"[{number}](recording://{boxes}[#{number - 1}])"


def _suspicious(case: RemovedCluster, number: int) -> tuple[Any, ...]:
    why = next((reason for reason in case.why if reason != case.what), "")
    # short, or the panel cuts off the last column
    why = why.replace("points that were kept", "kept points")
    what = case.what if case.did == "removed" else title_of(case)
    named = f"{what}: {why}" if what and why else what or why
    return _link(number, paths.CLUSTER_CASES), f"{case.points:,}", named, case.worst_frame


def removed(info: MethodInfo, result: Result, counts: OutcomeCounts) -> str:
    """What a run without ground truth removed.

    In total, by reason, by range, and the frames with the most.
    """
    points = counts.points[[Outcome.UNLABELLED_REMOVED, Outcome.UNLABELLED_KEPT]].sum(1)
    total = int(points.sum())
    gone = counts.points[Outcome.UNLABELLED_REMOVED]
    share = f"{100 * points[0] / max(total, 1):.2f} %"
    parts = [f"**{share} of the points removed** ({int(points[0]):,} of {total:,})"]
    parts.append("No ground truth: whether this is right is unknown.")
    rows = [
        (info.reasons[c].name, f"{gone[c]:,}")
        for c in np.argsort(-gone)[: len(info.reasons)]
        if c < len(info.reasons)
    ]
    if rows := [row for row in rows if row[1] != "0"]:
        parts.append(table([("reason", "removed"), *rows]))
    if (section := result.sections.removals) and section.range:
        parts.append(table([("range [m]", "removed", "of", "%"), *map(_range_row, section.range)]))
    if section and (most := sorted(section.frame, key=lambda frame: -frame.removed)[:WORST]):
        worst = [
            (frame.frame, f"{frame.removed:,}", f"{100 * frame.removed / max(frame.points, 1):.2f}")
            for frame in most
        ]
        parts.append(table([("frames with the most", "removed", "%"), *worst]))
    return "\n\n".join(parts)


def _range_row(row: RemovedInterval) -> tuple[str, ...]:
    end = "and more" if row.high is None else f"to {row.high:g}"
    return (
        f"{row.low or 0:g} {end}",
        f"{row.removed:,}",
        f"{row.points:,}",
        f"{100 * row.removed / max(row.points, 1):.2f}",
    )


def _sentences(result: Result) -> str:
    rows = [
        (number, f"{case.first_frame} to {case.last_frame}", case.sentence, _most(case.reasons))
        for number, case in enumerate(listed(result), 1)
    ]
    if not rows:
        return ""
    others = result.sections.failures.others.cases if result.sections.failures else 0
    rest = len(result.failures) - len(rows) + others
    more = (
        f"\n\n{rest:,} smaller cases are not shown; `dynaviz info --failures` lists more."
        if rest
        else ""
    )
    head = ("#", "frames", "what happened", "reasons given by the method")
    return "### Failure cases\n\n" + table([head, *rows]) + more


def _most(reasons: Mapping[str, int]) -> str:
    """The two most frequent reasons, with their shares."""
    total = sum(reasons.values())
    return ", ".join(
        f"{name} {100 * count / total:.0f} %" for name, count in list(reasons.items())[:2]
    )


def _title(info: MethodInfo, sequence: str) -> str:
    return f"### {info.title} on {sequence}"


def _scores(result: Result) -> str:
    if all(value is None for value in result.metrics.values()):
        return ""
    return table([tuple(result.metrics), tuple(_percent(v) for v in result.metrics.values())])


def _counts(result: Result) -> str:
    """The counts; without ground truth, those of unlabelled points."""
    shown = {name: n for name, n in result.counts.items() if n or result.has_truth}
    rows = [(name.replace("_", " "), f"{count:,}") for name, count in shown.items()]
    return table([("points", "count"), *rows]) if rows else ""


def _percent(value: float | None) -> str:
    return "n/a" if value is None else f"{value:.2f} %"


def _worst(counts: OutcomeCounts) -> str:
    rows = [(f, i, f"{kept:,}", f"{removed:,}") for f, i, kept, removed in counts.worst()]
    if not rows:
        return "No frame has wrong points." if counts.points[TRUE].any() else ""
    return "### Worst frames\n\n" + table(
        [("frame", "scan", "false negatives", "false positives"), *rows]
    )


def _reasons(info: MethodInfo, counts: OutcomeCounts) -> str:
    outcomes = [o for o in Outcome if counts.points[o].any()]
    rows = []
    for code, reason in enumerate(info.reasons):
        if counts.points[:, code].any():
            rows.append(
                (
                    code,
                    reason.name,
                    *(f"{counts.points[o, code]:,}" for o in outcomes),
                    reason.meaning,
                )
            )
    head = ("code", "reason", *(paths.NAMES[o].split(":")[0] for o in outcomes), "meaning")
    return "### Points by reason\n\n" + table([head, *rows]) if rows else ""


def _how_to_read(mode: str, truth: bool = True) -> str:
    if mode == "scores":
        return (
            "### How to read this recording\n\nIt contains only numbers (`--record scores`); no "
            "points are drawn."
        )
    shown = {
        "errors": "all dynamic points are drawn, one false positive per 0.2 m voxel, and kept "
        "static points as one map",
        "full": "every point of every frame is drawn; the map of the whole run is downsampled",
    }[mode]
    rows = [(word, paths.NAMES[outcome]) for outcome, word in colours.WORDS.items()]
    views = (
        "- **case**: a case in its worst frame, with rays that touched it. The arrow keys step "
        "through the cases.\n"
        "- **map**: the whole run, with a numbered box around each case.\n"
        "- **frame**: the points of the frame, and the sensor. Choose the timeline `frame` to "
        "replay the run."
    )
    if truth:
        views += (
            "\n- **wrong points**: by frame; diamonds mark the worst frames, right-click on one to "
            "go there.\n"
            "- **FN, FP: distance**: from each wrong point to the nearest correct one; a tenth are "
            "left of the line."
        )
    legend = table([("colour", "point"), *rows])
    return (
        f"### How to read this recording\n\n{legend}\n\n{views}\n\nIn this recording, {shown} "
        f"(`--record {mode}`)."
    )


def _states(info: MethodInfo) -> str:
    rows = [(state.name, state.meaning) for state in info.emits]
    return "### States of the method\n\n" + table([("state", "meaning"), *rows]) if rows else ""


def _run(info: MethodInfo, result: Result) -> str:
    runtime = result.runtime
    mean = result.runtime.mean_s
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
    return "### The run\n\n" + table([("property", "value"), *rows])


def _parameters(params: Mapping[str, Any]) -> str:
    rows = [(name, json.dumps(value)) for name, value in params.items()]
    return f"### Parameters ({len(rows)})\n\n" + table([("name", "value"), *rows]) if rows else ""


def table(rows: Iterable[Sequence[Any]]) -> str:
    """A Markdown table; the first row is its head."""
    head, *body = rows
    lines = [head, ["---"] * len(head), *body]
    return "\n".join(
        "| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines
    )
