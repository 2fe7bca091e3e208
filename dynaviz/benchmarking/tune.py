"""Find parameters without labels.

Search on implants, then score on other implants, and on true labels if known.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from dynaviz.benchmarking.bench import bench
from dynaviz.benchmarking.gain import Gain, gain
from dynaviz.benchmarking.leaderboard import BenchRow, Leaderboard
from dynaviz.benchmarking.runner import BenchCallbacks
from dynaviz.benchmarking.search import default_ranges
from dynaviz.contracts import registry
from dynaviz.contracts.options import check_keywords, keywords_of
from dynaviz.contracts.params import read_toml
from dynaviz.errors import UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.progress import Progress, silent
from dynaviz.scores.collect import combined
from dynaviz.scores.result import Result
from dynaviz.sources.drive import Drive
from dynaviz.sources.opening import absolute, open_source
from dynaviz.sources.options import SequenceKeywords, SequenceOptions
from dynaviz.synthetic.implants.implant_options import ImplantOptions, parse
from dynaviz.synthetic.implants.implanted_sequence import ImplantedSequence, planned, write
from dynaviz.synthetic.implants.lidar_model import LidarModel
from dynaviz.synthetic.implants.panel import default_panel, votes
from dynaviz.synthetic.implants.survey import Survey

if TYPE_CHECKING:
    from rich.table import Table

FACTS = "tune.toml"
LABELS = "labels"
"""Name of the sequence with its own labels, in the folder of the search."""


@dataclass(frozen=True)
class Score:
    """One row of the result.

    Attributes:
        parameters: ``default`` or ``tuned``.
        scored_on: what the counts were added over.
        result: its scores.
    """

    parameters: str
    scored_on: str
    result: Result


@dataclass(frozen=True)
class Tuned:
    """The result of a search on implants; printing it with rich shows the scores as a table.

    Attributes:
        preset: the file with the best parameters, for ``--config``: ``best-METHOD.toml`` if their
            gain is proven, or they are the defaults; otherwise ``unproven-METHOD.toml``.
        improved: whether they differ from the default.
        gain: what they gain on other implants; None if they are the defaults, or a run failed.
        scores: default and tuned, on the implants of the search, on other implants, and on true
            labels.
        board: all runs.
    """

    preset: Path
    improved: bool
    gain: Gain | None
    scores: list[Score]
    board: Leaderboard

    @property
    def proven(self) -> bool:
        """Whether the parameters are better than the default on movers that the
        search did not see.
        """
        return self.gain is not None and not self.gain.doubts

    def __rich__(self) -> Table:
        from rich import box
        from rich.table import Table

        table = Table(
            "scored on", "parameters", "SA", "DA", "AA", box=box.SIMPLE_HEAD, pad_edge=False
        )
        for score in self.scores:
            metrics = score.result.metrics
            values = (
                "n/a" if (value := metrics.get(name)) is None else f"{value:.2f}"
                for name in ("SA", "DA", "AA")
            )
            table.add_row(score.scored_on, score.parameters, *values)
        return table


@keywords_of(SequenceOptions)
def tune(
    sequence: str | os.PathLike[str],
    method: str,
    out: str | os.PathLike[str],
    *,
    trials: int = 30,
    seeds: int = 3,
    holdout: int = 2,
    ranges: Mapping[str, str] | None = None,
    workers: int = 1,
    callbacks: BenchCallbacks | None = None,
    progress: Progress = silent,
    **options: Unpack[SequenceKeywords],
) -> Tuned:
    """Find the parameters of a method that suit a sensor and a place, without labels.

    Implants of several seeds are written to ``out/implants``. The search sees some of them; the
    others are scored at the end; parameters whose gain on these is not proven (``Gain.doubts``) are
    not called best. Labels of the sequence are not used, except to score the result. A panel of
    other methods decides which points of the sequence are static. An interrupted search resumes if
    it is started again.

    Args:
        sequence: a path, or ``implant:PATH?cars=6&persons=10`` to choose the movers.
        method: name of the method.
        out: folder for the sequences, the runs, and ``best-METHOD.toml``.
        trials: number of parameter sets to try, in addition to the default.
        seeds, holdout: number of sequences with implants for the search, and for the scores at the
            end.
        ranges: by parameter ``LOW:HIGH`` or ``log:LOW:HIGH``; default: half to twice each positive
            default.
        workers: number of parallel runs.
        callbacks, progress: receive the progress of the runs, and of what comes before.
        options: how to open the sequence: see ``Options``.

    Raises:
        UsageError: for an unknown method, an invalid range, or a folder that contains a search with
            other options.
        DataError: for a sequence that cannot be read.
        MissingDependency: if optuna is not installed.
    """
    check_keywords(tune, options)
    registry.load("methods", method)
    if seeds < 1 or holdout < 1:
        raise UsageError(f"seeds = {seeds}, holdout = {holdout}: give at least 1")
    path = os.fspath(sequence)
    movers = ImplantOptions()
    if path.startswith("implant:"):
        path, movers = parse(path.removeprefix("implant:"))
    path = absolute(path)
    folder = Path(out)
    opening = SequenceOptions.of(**options)
    source = {
        "path": path,
        **{name: value for name, value in asdict(opening).items() if value is not None},
    }
    base = open_source(path, opening, folder=folder, progress=progress)
    names = [f"seed{seed}" for seed in range(1, 1 + seeds + holdout)]
    _write_implants(
        base, replace(movers, panel=default_panel(without=method)), folder, names, source, progress
    )
    held = [*names[seeds:], *([LABELS] if base.has_labels else [])]
    table: dict[str, Any] = {
        "methods": [method],
        "record": "none",
        "workers": workers,
        "sequences": [
            {"path": str((folder / "implants" / name).resolve()), "name": name} for name in names
        ],
        "holdout": held,
        "search": {
            "kind": "bayes",
            "trials": trials,
            "ranges": {method: ranges or default_ranges(method)},
        },
    }
    if base.has_labels:
        table["sequences"].append({**source, "name": LABELS})
    board = bench(table, folder, callbacks=callbacks)
    groups = {
        "implants of the search": names[:seeds],
        "other implants": names[seeds:],
        "true labels": [LABELS],
    }
    found = board.searches[0]
    improved = bool(found.best.variant)
    gained = _gain(board, found.best.variant, names[seeds:]) if improved else None
    tuned = Tuned(found.preset, improved, gained, _scores(board, found.best.variant, groups), board)
    unproven = folder / f"unproven-{method}.toml"
    if improved and not tuned.proven:
        found.preset.replace(unproven)
        return replace(tuned, preset=unproven)
    unproven.unlink(missing_ok=True)
    return tuned


def _gain(board: Leaderboard, best: str, names: Sequence[str]) -> Gain | None:
    """The gain over the default on some sequences; None if a run failed."""
    chosen = [
        [
            row.result
            for name in names
            for row in board.rows
            if _is(row, variant, [name]) and row.result
        ]
        for variant in ("", best)
    ]
    return gain(*chosen) if all(len(results) == len(names) for results in chosen) else None


def _scores(board: Leaderboard, best: str, groups: Mapping[str, list[str]]) -> list[Score]:
    """Default and tuned scores of each group of sequences.

    Groups with a failed run are left out.
    """
    scores = []
    for title, names in groups.items():
        for parameters, variant in {"default": "", "tuned": best}.items():
            rows = [row for row in board.rows if _is(row, variant, names)]
            results = [row.result for row in rows if row.result]
            if len(results) == len(names):
                scores.append(Score(parameters, title, combined(results)))
    return scores


def _is(row: BenchRow, variant: str, names: Sequence[str]) -> bool:
    return row.cell.parameter_set.variant == variant and row.cell.source.name in names


def _write_implants(
    base: Drive,
    movers: ImplantOptions,
    out: Path,
    names: list[str],
    source: Mapping[str, Any],
    progress: Progress,
) -> None:
    """Write the sequences with implants that are not there yet.

    Raises:
        UsageError: if those that are there were written with other options.
    """
    _check_facts(out / FACTS, movers, source)
    missing = [name for name in names if not (out / "implants" / name).exists()]
    if not missing:
        return
    blind = base.blind()
    agreed = votes(blind, movers.panel, progress)
    lidar = LidarModel.measure(blind)
    survey = Survey.of(blind, lambda done, total: progress("survey", done, total), agreed.dynamic)
    for name in missing:
        scene = planned(
            base.name, replace(movers, seed=int(name.removeprefix("seed"))), lidar, survey
        )
        implanted = ImplantedSequence(blind, scene, lidar, name, movers.panel, agreed.static)
        write(implanted, out / "implants" / name, partial(progress, f"write {name}"))


def _check_facts(file: Path, movers: ImplantOptions, source: Mapping[str, Any]) -> None:
    """Compare what is implanted with what an earlier search in the folder implanted,
    or store it.
    """
    import tomli_w

    kept = {
        key: value
        for key, value in asdict(movers).items()
        if key not in ("seed", "frames", "stride", "scene")
    }
    facts = {"sequence": dict(source), "movers": {**kept, "panel": [*movers.panel]}}
    if file.exists():
        if read_toml(file) != facts:
            raise UsageError(
                f"{file}: from a search with another sequence or movers. Give another folder with "
                "-o"
            )
        return
    file.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(file, tomli_w.dumps(facts).encode())
