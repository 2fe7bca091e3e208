"""From raw data to a clean map.

Open anything, estimate poses if there are none, run a method, write the map.

Private: other packages do not import it.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Unpack

from dynaviz.cleaning.changes import Pair, find_changes
from dynaviz.cleaning.cleaned import Cleaned
from dynaviz.cleaning.doubt import doubt_in
from dynaviz.cleaning.followed import Reviewed
from dynaviz.cleaning.map_settings import MapSettings
from dynaviz.cleaning.reviewing import Review, run_of
from dynaviz.cleaning.trajectory import UsedPoses
from dynaviz.contracts.options import check_keywords, keywords_of
from dynaviz.contracts.registry import BEST
from dynaviz.contracts.sensors import Sensor
from dynaviz.engine.cleaned_map import Judgement, region_is_empty, write_maps
from dynaviz.errors import UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.progress import Progress, silent
from dynaviz.runs.execution import run_method
from dynaviz.runs.options import RunOptions, SequenceRunKeywords, split
from dynaviz.scores.labels import reasons_by_frame
from dynaviz.sources.drive import Drive
from dynaviz.sources.opening import Source, open_source
from dynaviz.sources.options import SequenceOptions
from dynaviz.sources.sensing import estimate_sensor, sentence

__all__ = ["Cleaned", "Review", "clean"]

AUTOWARE = "autoware"  # a layout of divided maps


@keywords_of(SequenceOptions, RunOptions)
def clean(
    sequence: Source,
    out: str | os.PathLike[str],
    *,
    method: str = BEST,
    region: str | None = None,
    voxel_size: float | None = None,
    keep_dynamic: str | os.PathLike[str] | None = None,
    mark: bool = False,
    drop_unposed: bool = False,
    changed: bool = False,
    command: str = "",
    progress: Progress = silent,
    **options: Unpack[SequenceRunKeywords],
) -> Cleaned:
    """Clean a map.

    Args:
        sequence: an open sequence, a path, or a list of ``(points, pose)``; or the folder of a run,
            whose map is written again from its labels and the decisions about it, in the same way
            as its first map unless options say otherwise.
        out: the map: PCD, PLY, LAS, LAZ or NPZ, by its suffix; a folder for Autoware's divided map.
            The other files of the run are written to a folder next to it, ``clean_run`` for
            ``clean.laz``.
        method: its name.
        region: ``X0,Y0,X1,Y1`` or ``X0,Y0,Z0,X1,Y1,Z1`` in the coordinates of the map, or a file
            with the corners of a polygon: the map contains only the points inside. The method sees
            all points.
        voxel_size: metres: the map contains one point per voxel, the first one.
        keep_dynamic: file for the removed points, in any of the formats.
        mark: delete no points. The map has all of them, with the attributes ``dynamic`` (0 static,
            1 dynamic, 2 not judged) and ``reason`` (code of the method; ``Cleaned.to_dict`` has the
            legend).
        drop_unposed: leave out points that no pose covers, such as those of a merged map outside
            the trajectory. They are kept otherwise, without judgement, if their place in the world
            is known.
        changed: also find what is in one of two drives and not in the other (``Cleaned.changes``).
            The folder ``clean_changed`` receives maps of it like the clean map, and a recording.
        command, progress: as for ``dynaviz.run``.
        options: as for ``dynaviz.run``. Without ``poses``, they are estimated with small-gicp if
            the sequence has none. With ``tiles``, if ``out`` has a suffix, a folder without it
            receives a file for each square, and ``tiles.json``; otherwise ``out`` is Autoware's
            divided map, PCD files of 20 m x 20 m with metadata. ``tiles="autoware"`` writes the
            latter from a run without tiles. No other maps are written.

    Returns:
        What was done; printing it shows a summary. ``Cleaned.result`` is the result of the run.

    Raises:
        UsageError, DataError, MissingDependency: as ``open`` and ``run``.
    """
    check_keywords(clean, options)
    if (run := run_of(sequence)) is not None:
        if changed or method != BEST or set(options) - {"review"}:
            raise UsageError(
                f"{run}: is a run, whose map is written without running a method. Give its "
                "sequence to run one"
            )
        return Review(run, options.get("review"), progress=progress).write(
            out,
            region=region,
            voxel_size=voxel_size,
            keep_dynamic=keep_dynamic,
            mark=mark,
            drop_unposed=drop_unposed,
            command=command,
            progress=progress,
        )
    opening, running = split(options)
    divided = running.tiles is not None
    if running.tiles == AUTOWARE:
        running = dataclasses.replace(running, tiles=None)
    settings = MapSettings(
        os.fspath(out),
        region,
        voxel_size,
        None if keep_dynamic is None else os.fspath(keep_dynamic),
        mark,
        drop_unposed,
        divided,
        running.tile_size,
    )
    files = settings.files(running.review is not None)
    folder = run_folder(Path(out))
    opened = open_source(
        sequence, opening.without_refinement, folder=folder, estimate_missing=True,
        progress=progress
    )  # fmt: skip
    if (limit := files[0].region) is not None and region_is_empty(opened, limit):
        hint = "Give it in the coordinates of the map: 'dynaviz info' shows their extent"
        raise UsageError(f"--region {region}: contains no point of {opened.name}. {hint}")
    pair = Pair.of(opened) if changed else None
    agreement = pair and pair.compared()
    result = run_method(
        method,
        opened,
        dataclasses.replace(running, maps=False),
        out=folder,
        refine_poses=opening.refine_poses,
        command=command,
        progress=progress,
    )
    used: Drive = result.answers.sequence  # with refined poses, if they were
    review = None if running.review is None else Reviewed.of(used, running.review)
    judgement = Judgement(
        result.labels,
        reasons_by_frame(folder / "labels.npz", result.labels) if mark else None,
        review.applied if review else None,
    )
    followed = UsedPoses(used)
    maps, account = write_maps(used, judgement, files, progress, drop_unposed, followed.add)
    trajectory = folder / "trajectory.csv"
    written = followed.write(trajectory)
    changes = None
    if pair and agreement:
        beside = Path(out).with_name(f"{Path(out).stem}_changed")
        changes = find_changes(
            pair, agreement, result, running, files[0], beside, command, progress
        )
    sensor = sentence(estimate_sensor(opened)) if opened.sensor.name == Sensor().name else ""
    facts = opened.facts
    doubt = doubt_in(result, account, opened, command, Path(out), opened.estimated is None)
    cleaned = Cleaned(
        result=result,
        account=account,
        maps=tuple(maps),
        folder=folder,
        poses=opened.estimated,
        facts=facts,
        sensor=sensor,
        doubt=doubt,
        trajectory=trajectory if written else None,
        marked=mark,
        changes=changes,
        review=review,
    )
    settings.save(folder)
    write_atomic(folder / "summary.md", cleaned.markdown().encode())
    return cleaned


def run_folder(out: Path) -> Path:
    """The folder for the files of the run that writes a map."""
    return out.with_name(f"{out.stem}_run")
