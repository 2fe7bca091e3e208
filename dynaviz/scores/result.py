"""Result: everything that a run found; saved whole or not at all, and shown as a table."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import json
import math
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from dynaviz import kernels
from dynaviz.arrays import F64
from dynaviz.contracts.plugin_code import Plugin
from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import atomic_file
from dynaviz.io.plain_json import read_json
from dynaviz.rendered import html_of, text_of
from dynaviz.scores.account import PointAccount
from dynaviz.scores.answers import Answers, SavedAnswers
from dynaviz.scores.data_frames import ResultTable, data_frame, rows_of
from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.labels import RunLabels
from dynaviz.scores.sections import (
    CaseTotals,
    Environment,
    Machine,
    Removals,
    RemovedCluster,
    Runtime,
    Sections,
    SequenceInfo,
)
from dynaviz.sources.origin import Origin, PoseFinding, PoseNoise, PoseRefinement, SourceReading

if TYPE_CHECKING:
    import pandas
    from rich.console import RenderableType
    from rich.table import Table

SCHEMA = 1
_NOT_IN_FILE = {"sections", "answers"}  # sections are spread over the top level
_REASONS = 3  # in a row of a table
_WIDTH = 160  # of a printed result, in characters
_HINT = "Give the result.json of a run"


@dataclass(frozen=True)
class Result:
    """The result of one run; the fields are those of ``result.json``.

    Attributes:
        method, sequence: what ran on what.
        parameters: the method's parameters; ``n_parameters`` in the file counts them (paper,
            runtime table).
        sections: what the metrics found.
        runtime: cost of the method alone.
        variant: a short name for the parameter set, if a benchmark runs several.
        preset: name of the preset that was used, or None.
        parameter_origins: for each parameter the layer that set it: ``default``, ``preset NAME``, a
            file, ``--set``.
        scoring: ``mask`` (labels by index) or ``nn`` (nearest neighbour in a cleaned map).
        labels_sha256: digest of all labels in the order of the sequence.
        recording_sha256: digest of the recording's file, or None.
        record: how much that recording contains, or None.
        instrumented: whether the method's states were recorded while it ran, so that its runtime is
            not comparable.
        environment: package versions, machine and threading layer.
        command: what the user typed.
        pose_noise: noise of the sequence's poses; None if too few planes are seen, and in results
            of earlier versions.
        pose_refinement: how the poses were refined; None if they were not.
        pose_findings: what is likely wrong with poses, frames or units; empty in results of earlier
            versions.
        reading: how the numbers of the source were read; None for simulated sequences, and in
            results of earlier versions.
        account: where the points of the source went; None in results of earlier versions.
        origin: where the sequence came from, to open it again; None in results of earlier versions.
        plugin: the code of the method; None for another program, and in results of earlier
            versions.
        answers: where ``labels`` and ``static_map`` come from (``dynaviz.scores.answers``); not in
            the file.
    """

    method: str
    parameters: dict[str, Any]
    sequence: SequenceInfo
    sections: Sections = field(default_factory=Sections)
    runtime: Runtime = field(default_factory=Runtime)
    online: bool = False
    seed: int = 0
    variant: str = ""
    preset: str | None = None
    parameter_origins: Mapping[str, str] = field(default_factory=dict)
    scoring: str = "mask"
    labels_sha256: str | None = None
    recording_sha256: str | None = None
    record: str | None = None
    instrumented: bool = False
    environment: Environment = field(default_factory=Environment)
    command: str = ""
    pose_noise: PoseNoise | None = None
    pose_refinement: PoseRefinement | None = None
    pose_findings: tuple[PoseFinding, ...] = ()
    reading: SourceReading | None = None
    account: PointAccount | None = None
    origin: Origin | None = None
    plugin: Plugin | None = None
    answers: Any = field(default=None, repr=False, compare=False)

    @property
    def metrics(self) -> Mapping[str, float | None]:
        """SA, DA, AA, HA, precision and IoU in percent; None where undefined."""
        return self.sections.metrics

    @property
    def counts(self) -> Mapping[str, int]:
        """static_kept, static_removed, dynamic_removed, dynamic_kept, unlabelled."""
        return self.sections.counts

    @property
    def unanswered(self) -> str:
        """How many frames another program has no labels for, in words; empty if it answers all."""
        n = len(self.sections.source.unanswered_frames) if self.sections.source else 0
        return (
            f"{n:,} of {self.sequence.frames:,} frames have no labels and are not scored"
            if n
            else ""
        )

    @property
    def has_truth(self) -> bool:
        """Whether the sequence has ground truth, so that points are known to be right or wrong."""
        return self.sections.has_truth

    @property
    def failures(self) -> tuple[FailureCase, ...]:
        """The failure cases, costliest first; empty if no metric looked for them."""
        return self.sections.failures.cases if self.sections.failures else ()

    @property
    def causes(self) -> Mapping[str, Mapping[str, CaseTotals]]:
        """Cases and points by kind of error and cause, most points first.

        Empty if no metric looked for them.
        """
        return self.sections.failures.causes if self.sections.failures else {}

    @property
    def clusters(self) -> tuple[RemovedCluster, ...]:
        """Clusters of removed points, most suspicious first; empty for runs with ground truth."""
        return self.sections.removals.clusters if self.sections.removals else ()

    @property
    def labels(self) -> RunLabels:
        """Labels by position of the frame.

        ``labels[i]`` is (N,) bool, True for points that the method removed.

        Raises:
            UsageError: for a result that was loaded without the ``labels.npz`` of its run.
        """
        return self._answers.labels

    def static_map(self) -> F64:
        """(M, 3) float64, metres.

        The points that the method kept, in the coordinates of the source.

        Raises:
            UsageError: for a result that was loaded without the files of its run.
        """
        return self._answers.static_map()

    @property
    def _answers(self) -> Answers:
        if self.answers is None:
            raise UsageError(
                "this result has no labels. Run the method, or load the result.json in the run's "
                "folder"
            )
        found: Answers = self.answers
        return found

    def to_dict(self) -> dict[str, Any]:
        """The content of ``result.json``."""
        fields = {
            f.name: getattr(self, f.name)
            for f in dataclasses.fields(self)
            if f.name not in _NOT_IN_FILE
        }
        plain: dict[str, Any] = msgspec.to_builtins(fields)
        return {
            "schema": SCHEMA,
            "n_parameters": len(self.parameters),
            **plain,
            **self.sections.plain(),
        }

    def recorded_as(self, sha256: str | None) -> Result:
        """The result with the digest of its finished recording, the only fact that the recording
        cannot contain.
        """
        return dataclasses.replace(self, recording_sha256=sha256)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write ``result.json``, whole or not at all."""
        with (
            atomic_file(path) as temporary,
            temporary.open("w", encoding="utf-8", newline="\n") as file,
        ):
            # piece by piece: frames may be many
            json.dump(self.to_dict(), file, indent=1, allow_nan=False)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Result:
        """Read a ``result.json``, also of an earlier version.

        Raises:
            DataError: if the file is not a result, or was written by a newer dynaviz.
        """
        return dataclasses.replace(
            cls.from_dict(read_json(path, _HINT), path), answers=SavedAnswers(Path(path).parent)
        )

    @classmethod
    def from_dict(cls, plain: Any, path: str | os.PathLike[str]) -> Result:
        """The inverse of ``to_dict``; ``path`` names the source in errors.

        Raises:
            DataError: as ``load``.
        """
        if not isinstance(plain, dict) or not plain.keys() >= {"method", "parameters", "sequence"}:
            raise DataError(path, "is not the result of a run", hint=_HINT)
        schema = plain.get("schema", 0)
        if isinstance(schema, int) and schema > SCHEMA:
            raise DataError(path, "was written by a newer dynaviz", hint="Upgrade dynaviz")
        names = {f.name for f in dataclasses.fields(cls)} - _NOT_IN_FILE
        fields = {key: value for key, value in plain.items() if key in names}
        rest = {
            k: v
            for k, v in plain.items()
            if k not in {*names, *_NOT_IN_FILE, "schema", "n_parameters"}
        }
        try:
            result = msgspec.convert(fields, cls)
            return dataclasses.replace(result, sections=Sections.of(rest))
        except msgspec.ValidationError as error:
            raise DataError(
                path, f"is not a valid result: {error}", hint="Run the method again"
            ) from None

    def to_pandas(self, table: ResultTable = "cases") -> pandas.DataFrame:
        """Rows of the result as a data frame; pandas must be installed.

        Args:
            table: ``cases`` (the failure cases; of a run without ground truth the clusters of
                removed points), ``objects``, ``frames``, ``ranges`` or ``heights`` (points and
                scores of each), or ``reasons``.

        Returns:
            One row each, with the fields of ``dynaviz.scores.sections`` and
            ``dynaviz.scores.failure_case`` as columns; empty if no metric found them.

        Raises:
            UsageError: for another table, or without pandas.
        """
        return data_frame(rows_of(self.sections, table))

    def __rich__(self) -> RenderableType:
        return result_table([self])

    def __str__(self) -> str:
        return text_of(self, _WIDTH)

    def __repr__(self) -> str:
        label = run_label(self.method, self.variant, self.online)
        return f"<Result of {label} on {self.sequence.name}: {self._headline}>"

    @property
    def _headline(self) -> str:
        """The scores, or how much was removed without ground truth."""
        if self.has_truth:
            return ", ".join(f"{name} {_percent(self, name)}" for name in ("SA", "DA", "AA"))
        removals = self.sections.removals
        if removals is None or removals.percent is None:
            return "without ground truth"
        return f"{removals.percent:.2f} % removed, without ground truth"

    def _repr_html_(self) -> str:
        return html_of(self, _WIDTH)


def environment() -> Environment:
    """Package versions that may affect labels or speed, this machine, and the threading layer of
    this process.
    """
    versions = {
        name: metadata.version(name) for name in ("dynaviz", "numba", "numpy", "scipy", "rerun-sdk")
    }
    machine = Machine(platform.system(), platform.machine(), os.cpu_count())
    return Environment(
        {"python": platform.python_version(), **versions}, machine, kernels.threading_layer()
    )


def run_label(method: str, variant: str, online: bool) -> str:
    """A method, with what distinguishes this run from its other runs."""
    apart = dict.fromkeys([variant, "online" if online else ""])
    return " ".join([method, *(f"({text})" for text in apart if text)])


def result_table(results: Sequence[Result], title: str | None = None) -> Table:
    """One row per result, in 80 columns; the best AA of each sequence and scoring is bold.

    If no result has ground truth, the table shows what was removed instead of scores. Percentages
    have two decimals as in the papers, ``n/a`` where undefined. Scores of different scorings
    (``mask``, ``nn``) cannot be compared: if there are several, the scoring has its own column.
    """
    from rich.markup import escape

    if any(result.sections.removals for result in results) and not any(
        result.has_truth for result in results
    ):
        return _removal_table(results, title)
    scorings = sorted({result.scoring for result in results})
    table = _plain_table(results, title, _caption(results, scorings))
    for name in ("SA ↑", "DA ↑", "AA ↑", "HA ↑", "FP", "FN", "s/frame"):
        table.add_column(name, justify="right", no_wrap=True)
    if len(scorings) > 1:
        table.add_column("scoring")
    best: dict[tuple[str, str], float] = {}
    for result in results:
        best[_group(result)] = max(best.get(_group(result), -math.inf), _aa(result))
    for result, following in itertools.zip_longest(results, results[1:]):
        aa = _percent(result, "AA")
        champion = len(results) > 1 and _aa(result) == best[_group(result)] >= 0
        table.add_row(
            escape(result.sequence.name),
            escape(run_label(result.method, result.variant, result.online)),
            _percent(result, "SA"),
            _percent(result, "DA"),
            f"[bold]{aa}[/bold]" if champion else aa,
            _percent(result, "HA"),
            _count(result, "static_removed"),
            _count(result, "dynamic_kept"),
            _runtime(result),
            *([result.scoring] if len(scorings) > 1 else []),
            end_section=following is not None and following.sequence.name != result.sequence.name,
        )
    return table


def _plain_table(results: Sequence[Result], title: str | None, caption: str) -> Table:
    """A table with the columns that name a result."""
    from rich import box
    from rich.table import Table

    table = Table(title=title, caption=caption, caption_justify="left")
    table.box = box.SIMPLE_HEAD
    table.padding = (0, 1, 0, 0)
    table.pad_edge = False
    table.add_column("sequence", overflow="fold")
    table.add_column(
        "method", no_wrap=not any(result.variant for result in results), overflow="fold"
    )
    return table


def _removal_table(results: Sequence[Result], title: str | None) -> Table:
    """What runs without ground truth removed, and why."""
    from rich.markup import escape

    slowed = (
        ["* runtime includes recording of states"]
        if any(result.instrumented for result in results)
        else []
    )
    note = "There is no ground truth, so it is unknown which points were removed rightly"
    table = _plain_table(results, title, "\n".join([note, *_at_sensor(results), *slowed]))
    for name in ("removed", "in %"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("main reasons", overflow="fold")
    table.add_column("s/frame", justify="right", no_wrap=True)
    for result in results:
        removals = result.sections.removals or Removals()
        listed = list(removals.reasons.items())[:_REASONS]
        shares = [
            f"{name} {100 * n / removals.removed:.0f}\N{NO-BREAK SPACE}%" for name, n in listed
        ]
        table.add_row(
            escape(result.sequence.name),
            escape(run_label(result.method, result.variant, result.online)),
            f"{removals.removed:,}" if removals.points else "n/a",
            "n/a" if removals.percent is None else f"{removals.percent:.2f}",
            escape("\n".join(shares)) or "n/a",
            _runtime(result),
        )
    return table


def _caption(results: Sequence[Result], scorings: Sequence[str]) -> str:
    lines = [
        "SA, DA: static points kept, dynamic points removed, in %; AA = √(SA · DA),",
        "HA = 2 · SA · DA / (SA + DA)",
        "FP: static points removed, FN: dynamic points kept",
        *([f"scoring: {scorings[0]}"] if len(scorings) == 1 else []),
        *(f"{result.method}: {note}" for result in results if (note := result.unanswered)),
        *_possible(results),
        *_at_sensor(results),
        *(
            ["* runtime includes recording of states"]
            if any(result.instrumented for result in results)
            else []
        ),
    ]
    return "\n".join(lines)


def _possible(results: Sequence[Result]) -> list[str]:
    """A line per sequence: the DA that its evidence allows."""
    lines = {}
    for result in results:
        ceiling = result.sections.ceiling
        if ceiling is not None and ceiling.possible is not None:
            objects = ceiling.possible_by_object
            by_object = "" if objects is None else f", {objects} by object"
            lines[result.sequence.name] = (
                f"{result.sequence.name}: possible DA {ceiling.possible}{by_object}: "
                "rays of other scans went through these places"
            )
    return list(lines.values())


def _at_sensor(results: Sequence[Result]) -> list[str]:
    """A line per sequence with points that no method sees."""
    counts = {result.sequence.name: n for result in results if (n := result.sequence.at_sensor)}
    return [f"{name}: {n:,} points at the sensor were left unjudged" for name, n in counts.items()]


def _group(result: Result) -> tuple[str, str]:
    """Results that can be compared: the same points, scored the same way."""
    return result.sequence.digest, result.scoring


def _aa(result: Result) -> float:
    """AA, or minus infinity if undefined."""
    value = result.metrics.get("AA")
    return -math.inf if value is None else value


def _percent(result: Result, name: str) -> str:
    value = result.metrics.get(name)
    return "n/a" if value is None else f"{value:.2f}"


def _count(result: Result, part: str) -> str:
    return f"{result.counts[part]:,}" if part in result.counts else "n/a"


def _runtime(result: Result) -> str:
    """Seconds per frame, with a mark if recording the method's states slowed it down."""
    mean = result.runtime.mean_s
    std = result.runtime.std_s
    if mean is None:
        return "n/a"
    return (
        f"{mean:.3f}"
        + ("" if std is None else f" ±{std:.3f}")
        + ("*" if result.instrumented else "")
    )


with contextlib.suppress(
    msgspec.ValidationError
):  # describes the type, which is not safe in several threads at once
    msgspec.convert({}, Result)
