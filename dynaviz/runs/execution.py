"""Run a method, or score what another program wrote.

With its files, its recording and, if wanted, on tiles.
"""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast, get_args

from dynaviz.contracts import registry
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Labelled, Metric
from dynaviz.contracts.options import Record, RecordMode
from dynaviz.contracts.probe import SILENT, Probe
from dynaviz.engine.external import External
from dynaviz.engine.loop import Listener, RunSpec, execute, of_one_scan
from dynaviz.engine.needs import suited
from dynaviz.engine.outputs import FILES, LabelsFile, MapFiles, RemoveStaleOutputs, write_summary
from dynaviz.engine.source_check import source_check
from dynaviz.errors import UsageError
from dynaviz.io.lock import locked
from dynaviz.progress import Progress, silent
from dynaviz.reviews.decisions import Decisions
from dynaviz.runs.options import RunOptions
from dynaviz.runs.reviewed import ReviewOfRun
from dynaviz.runs.tiles.grid import TileCounts
from dynaviz.runs.tiles.label_tiles import TileOptions, label_tiles
from dynaviz.scores.result import Result
from dynaviz.sources.drive import Drive
from dynaviz.sources.odometry.refine import refine
from dynaviz.sources.origin import PoseFinding
from dynaviz.sources.pose_noise import PoseNoiseMeter
from dynaviz.sources.summary import SequenceSummary, summarize
from dynaviz.views.record.quota import parse_bytes

if TYPE_CHECKING:
    from dynaviz.views.record.recorder import Recorder


@dataclass(frozen=True)
class Surveyed:
    """What is found before a run and depends on the sequence only.

    Its summary, and what is likely wrong with it.
    """

    summary: SequenceSummary
    findings: tuple[PoseFinding, ...]

    @classmethod
    def of(cls, sequence: Drive, progress: Progress = silent) -> Surveyed:
        """Read a sequence, and check its poses on another thread; its findings are warned of."""
        total = len(sequence)
        shared = sequence.for_threads()
        with ThreadPoolExecutor(1, "poses") as pool:
            findings = pool.submit(_pose_findings, shared)
            summary = summarize(
                shared, lambda done: progress("survey", done, total), PoseNoiseMeter(total)
            )
        return cls(summary, _warned(sequence, findings.result(), 6))


def run_method(
    method: str,
    sequence: Drive,
    options: RunOptions,
    *,
    out: Path | None = None,
    refine_poses: bool = False,
    survey: Surveyed | None = None,
    command: str = "",
    progress: Progress = silent,
) -> Result:
    """Run a method on a sequence, score it, and write its files.

    ``dynaviz.run`` describes what it raises.

    Args:
        method: its name.
        sequence: what to run it on.
        options: how to run it.
        out: folder for the files of the run; None writes none.
        refine_poses: refine the poses first, and keep them in the folder.
        survey: of the sequence, if it is known and the poses are not refined.
        command: what the user typed, for the record.
        progress: called with a phase, the number of frames or tiles done and their total.
    """
    kind, resolved = options.resolved(method)
    # before frames are read to check poses
    given = sequence
    sequence = suited(kind, resolved.params, sequence)
    known: tuple[PoseFinding, ...] = survey.findings if survey else ()
    if survey is None and (
        refine_poses or options.tile_size is not None
    ):  # the frames of the run are surveyed later
        known = _warned(given, _pose_findings(given), 4)
    if refine_poses:
        sequence = refine(sequence, out, progress)
    recording, mode = recording_of(options.record, out)
    if options.view and recording is None:
        raise UsageError(
            "view needs a recording: give out=FOLDER or record=FILE.rrd, and not record=none"
        )
    review = review_of(options.review, sequence)
    spec = RunSpec(
        labeller=kind(resolved.params),
        sequence=sequence,
        params=resolved.params,
        metrics=metrics_of(kind.info),
        online=bool(options.online if options.online is not None else resolved.online),
        seed=options.seed if options.seed is not None else resolved.seed or 0,
        variant=options.variant,
        preset=options.preset,
        parameter_origins=resolved.source,
        threads=options.threads,
        command=command,
        pose_findings=known,
        record=mode,
        folder=out,
        recording=recording,
        summary=survey.summary if survey else None,
        review=review.applied if review else None,
    )
    tiles = None
    if options.tile_size is not None:
        tiles = TileOptions(options.tile_size, options.workers, options.scheduler)
    elif options.workers != 1 or options.scheduler:
        raise UsageError("workers and scheduler run tiles: give tiles=METRES, too")
    early = survey is not None or refine_poses or tiles is not None
    plan = RunPlan(
        spec,
        view=options.view and tiles is None,
        maps=options.maps,
        budget=budget_of(options),
        tiles=tiles,
        survey=None if early else partial(Surveyed.of, given, progress),
        listeners=() if review is None else (review,),
    )
    result = run(plan, progress)
    _warn_of_size(recording, result, plan.budget)
    return result


def score_external(
    external: External,
    sequence: Drive,
    *,
    out: Path | None = None,
    record: Record | str | os.PathLike[str] = "errors",
    threads: int | None = None,
    review: str | os.PathLike[str] | None = None,
    command: str = "",
    progress: Progress = silent,
) -> Result:
    """Score what another program wrote; ``dynaviz.score`` describes the arguments and errors."""
    recording, mode = recording_of(record, out)
    if out is not None and out.resolve() in _overwritten(external.path):
        raise UsageError(
            f"the files of the run would overwrite {external.path}: give another folder than {out}"
        )
    decided = review_of(review, sequence, makes_truth=not sequence.has_labels)
    spec = RunSpec(
        labeller=external,
        sequence=sequence,
        params=external.params,
        metrics=metrics_of(external.info),
        threads=threads,
        command=command,
        scoring=external.scoring,
        record=mode,
        folder=out,
        recording=recording,
        review=decided.applied if decided else None,
    )
    listeners = (source_check(external), decided)
    plan = RunPlan(spec, listeners=tuple(each for each in listeners if each is not None))
    return run(plan, progress)


def review_of(
    review: str | os.PathLike[str] | None, sequence: Drive, makes_truth: bool = False
) -> ReviewOfRun | None:
    """What counts the decisions of a file on a sequence; None without a file."""
    if review is None:
        return None
    return ReviewOfRun(Decisions.existing(review), sequence, makes_truth)


def metrics_of(info: MethodInfo) -> tuple[Metric, ...]:
    """All installed metrics, for the answers of a method."""
    return tuple(metric(info) for metric in registry.loadable("metrics").values())


def budget_of(options: RunOptions) -> int | None:
    """The budget of the recording, bytes; None for any size."""
    budget = options.record_budget
    return parse_bytes(budget) if isinstance(budget, str) else budget


def recording_of(
    record: str | os.PathLike[str], folder: Path | None
) -> tuple[Path | None, RecordMode | None]:
    """Path and mode of the recording; None for no recording.

    Raises:
        UsageError: for an unknown mode.
    """
    if Path(record).suffix == ".rrd":
        return Path(record), "errors"
    if record not in get_args(Record):
        raise UsageError(
            f"record = {record}: give {', '.join(get_args(Record))}, or the path of an .rrd file"
        )
    return (
        (None, None)
        if folder is None or record == "none"
        else (folder / "run.rrd", cast(RecordMode, record))
    )


@dataclass(frozen=True)
class RunPlan:
    """A run, and what it writes.

    Attributes:
        spec: what to run; its folder is locked meanwhile.
        view: show the recording in a viewer while it is written.
        maps: whether to write maps.
        budget: bytes of all recordings; None for any size.
        tiles: how to run it tile by tile; None as a whole.
        survey: surveys the sequence, which the loop would do itself otherwise.
        listeners: notified before those that write files.
    """

    spec: RunSpec
    view: bool = False
    maps: bool = True
    budget: int | None = None
    tiles: TileOptions | None = None
    survey: Callable[[], Surveyed] | None = None
    listeners: tuple[Listener, ...] = ()


def run(plan: RunPlan, progress: Progress = silent) -> Result:
    """Run a plan and write all files; each appears only when it is complete, ``result.json`` last.

    Args:
        plan: what to run and to write.
        progress: called with a phase, the number of frames or tiles done and their total.
    """
    folder = plan.spec.folder
    with locked(folder, plan.spec.command) if folder else contextlib.nullcontext():
        if plan.survey is not None:
            found = plan.survey()
            spec = replace(plan.spec, summary=found.summary, pose_findings=found.findings)
            plan = replace(plan, spec=spec)
        if plan.tiles is not None:
            plan = _tiled(plan, plan.tiles, progress)
        spec = plan.spec
        recorder = None
        probe: Probe = SILENT
        with contextlib.ExitStack() as files:
            listeners = [*plan.listeners, *_writers(plan, files)]
            if spec.recording is not None:
                recorder = files.enter_context(_recorder(plan, spec.recording))
                listeners.append(recorder)
                # one of scores shows no states, so the runtime stays honest
                probe = SILENT if spec.record == "scores" else recorder
            result = execute(spec, [*listeners, _Forgetting()], probe, progress)
        if recorder is not None:
            result = result.recorded_as(recorder.sha256())
        if folder is not None:
            write_summary(folder, spec, result)
    return result


def _writers(plan: RunPlan, files: contextlib.ExitStack) -> list[Listener]:
    """What writes labels and maps into the folder of a run."""
    folder = plan.spec.folder
    if folder is None:
        return []
    writers: list[Listener] = [RemoveStaleOutputs(folder, plan.spec.recording, plan.maps)]
    writers.append(files.enter_context(LabelsFile(folder)))
    if plan.maps:
        writers.append(files.enter_context(MapFiles(folder, plan.spec.drive.origin)))
    return writers


def _recorder(plan: RunPlan, file: Path) -> Recorder:
    from dynaviz.views.record.recorder import Recorder

    return Recorder(file, plan.spec.record or "errors", live=plan.view, budget=plan.budget)


class _Forgetting(Listener):
    """Lets the method forget the sequence after the last label.

    Its memory is free for the metrics and the files.
    """

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        self._run = run
        self._last = summary.frames - 1

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        if labelled.frame == self._last and self._run.method:
            self._run.method.begin(of_one_scan(self._run)[1])


def _tiled(plan: RunPlan, options: TileOptions, progress: Progress) -> RunPlan:
    """Run every tile; the rest of the plan scores and records the labels of all as those of one
    run.
    """
    spec = plan.spec
    folder = spec.folder
    if folder is None:
        raise UsageError("tiles need out=FOLDER, which keeps the answers of finished tiles")
    drawn = spec.record not in (None, "scores")
    # of the recordings of tiles, and of that of the whole run
    share = plan.budget and plan.budget // 2
    labeller = label_tiles(
        folder,
        type(spec.labeller),
        spec.params,
        spec.drive,
        replace(options, budget=share if drawn else None),
        online=spec.online,
        seed=spec.seed,
        record=spec.record if drawn else None,
        progress=progress,
    )
    counts = TileCounts(labeller.tiling)
    listeners: list[Listener] = [counts, *plan.listeners]
    if drawn:
        from dynaviz.views.record.overview import Overview

        listeners.append(Overview(folder / "overview.rrd", counts))
    return replace(
        plan,
        spec=replace(spec, labeller=labeller, summary=labeller.summary),
        budget=share if drawn else plan.budget,
        tiles=None,
        listeners=tuple(listeners),
    )


def _overwritten(path: Path) -> list[Path]:
    """Folders in which the files of a run would overwrite, or mix with, this file or folder."""
    return (
        [path.resolve()] if path.is_dir() else [path.resolve().parent] if path.name in FILES else []
    )


def _pose_findings(sequence: Drive) -> tuple[PoseFinding, ...]:
    """What is likely wrong with poses or points.

    The frames and units of data sets with ground truth are taken to be right; their poses may
    drift.
    """
    from dynaviz.diagnosis import OF_POSES, quick_check

    return tuple(
        each for each in quick_check(sequence) if each.name in OF_POSES or not sequence.has_labels
    )


def _warned(
    sequence: Drive, findings: tuple[PoseFinding, ...], level: int
) -> tuple[PoseFinding, ...]:
    """The findings, with a warning each at a level of the stack."""
    for each in findings:
        warnings.warn(
            f"{sequence.name}: {each}. 'dynaviz doctor' examines all frames", stacklevel=level
        )
    return findings


def _warn_of_size(recording: Path | None, result: Result, budget: int | None) -> None:
    """Warn if the recordings are larger than their budget."""
    if recording is None or budget is None:
        return
    paths = [recording]
    if tiling := result.sections.tiling:
        folders = [f"tiles/{tile.column}_{tile.row}" for tile in tiling.tile]
        paths += [
            recording.parent / name
            for name in ("overview.rrd", *(f"{folder}/run.rrd" for folder in folders))
        ]
    sizes = [path.stat().st_size for path in paths if path.is_file()]
    if sum(sizes) > budget:
        files = "the recording has" if len(sizes) == 1 else f"{len(sizes)} recordings have"
        problem = (
            f"{files} {sum(sizes) / 1e6:.1f} MB, more than the budget of {budget / 1e6:.1f} MB"
        )
        warnings.warn(f"{problem}: labels, maps and cases are always recorded", stacklevel=4)
