"""Run a method, or score what another program wrote.

With its files, its recording and, if wanted, on tiles.
"""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast, get_args

import msgspec

from dynaviz.contracts import registry
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Labelled, Metric
from dynaviz.contracts.options import Record, RecordMode
from dynaviz.contracts.probe import SILENT, Probe
from dynaviz.engine.external import External
from dynaviz.engine.loop import Listener, RunSpec, execute, of_one_scan
from dynaviz.engine.needs import suited
from dynaviz.engine.outputs import FILES, LabelsFile, MapFiles, RemoveStaleOutputs, write_summary
from dynaviz.engine.source_check import SourceCheck, source_check
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
    budget = budget_of(options)
    if (size := options.tile_size) is not None:
        tiles = TileOptions(size, options.workers, options.scheduler, budget)
        result = _run_tiles(spec, tiles, options.maps, progress, review)
    elif options.workers != 1 or options.scheduler:
        raise UsageError("workers and scheduler run tiles: give tiles=METRES, too")
    else:
        late = None if survey or refine_poses else partial(Surveyed.of, given, progress)
        result = run_spec(
            spec, progress, view=options.view, maps=options.maps, budget=budget, survey=late,
            review=review,
        )  # fmt: skip
    _warn_of_size(recording, result, budget)
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
    return run_spec(spec, progress, check=source_check(external), review=decided)


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


def run_spec(
    spec: RunSpec,
    progress: Progress = silent,
    *,
    view: bool = False,
    maps: bool = True,
    budget: int | None = None,
    check: SourceCheck | None = None,
    survey: Callable[[], Surveyed] | None = None,
    review: ReviewOfRun | None = None,
) -> Result:
    """Run and write all files; each appears only when it is complete, ``result.json`` last.

    Args:
        spec: what to run; its folder is locked meanwhile.
        progress: called with a phase, the number of frames done and their total.
        view: show the recording in a viewer while it is written.
        maps: whether to write maps.
        budget: bytes of the recording; None for any size.
        check: of another program's output.
        survey: surveys the sequence, which the run would do itself otherwise.
        review: counts the decisions of a person.
    """
    with _locked(spec):
        if survey is not None:
            found = survey()
            spec = replace(spec, summary=found.summary, pose_findings=found.findings)
        parts = [each for each in (check, review) if each is not None]
        return _run(spec, progress, view, maps, budget, parts, _sections_of(parts))


def _sections_of(parts: Iterable[SourceCheck | ReviewOfRun]) -> Callable[[], Mapping[str, Any]]:
    """What gives the sections of some listeners at the end of a run."""
    return lambda: {name: found for part in parts for name, found in part.sections().items()}


def _locked(spec: RunSpec) -> contextlib.AbstractContextManager[Any]:
    return locked(spec.folder, spec.command) if spec.folder else contextlib.nullcontext()


def _run(
    spec: RunSpec,
    progress: Progress,
    view: bool,
    maps: bool,
    budget: int | None,
    others: Iterable[Listener],
    more: Callable[[], Mapping[str, Any]],
) -> Result:
    """Run in a locked folder; the other listeners are notified first."""
    folder = spec.folder
    recorder = None
    probe: Probe = SILENT
    with contextlib.ExitStack() as files:
        listeners: list[Listener] = [*others]
        if folder is not None:
            listeners.append(RemoveStaleOutputs(folder, spec.recording, maps))
            listeners.append(files.enter_context(LabelsFile(folder)))
            if maps:
                listeners.append(files.enter_context(MapFiles(folder, spec.drive.origin)))
        if spec.recording is not None:
            from dynaviz.views.record.recorder import Recorder

            mode = spec.record or "errors"
            recorder = files.enter_context(Recorder(spec.recording, mode, live=view, budget=budget))
            listeners.append(recorder)
            # it shows no states, so the runtime stays honest
            probe = SILENT if mode == "scores" else recorder
        listeners.append(_Forgetting())
        result = execute(spec, listeners, probe, progress, more)
    if recorder is not None:
        result = result.recorded_as(recorder.sha256())
    if folder is not None:
        write_summary(folder, spec, result)
    return result


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


def _run_tiles(
    spec: RunSpec,
    options: TileOptions,
    maps: bool,
    progress: Progress,
    review: ReviewOfRun | None,
) -> Result:
    """Run every tile, then score and record the labels of all as those of one run."""
    folder = spec.folder
    if folder is None:
        raise UsageError("tiles need out=FOLDER, which keeps the answers of finished tiles")
    drawn = spec.record not in (None, "scores")
    # of the recordings of tiles, and of that of the whole run
    share = options.budget and options.budget // 2
    with _locked(spec):
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
        whole = replace(spec, labeller=labeller, summary=labeller.summary)
        counts = TileCounts(options.size)
        others: list[Listener] = [counts, *([review] if review else [])]
        if drawn:
            from dynaviz.views.record.overview import Overview

            others.append(Overview(folder / "overview.rrd", counts))
        budget = share if drawn else options.budget

        def tiling() -> Mapping[str, Any]:
            found = review.sections() if review else {}
            return {**found, "tiling": msgspec.structs.replace(labeller.tiling, tile=counts.rows())}

        return _run(whole, progress, False, maps, budget, others, tiling)


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
