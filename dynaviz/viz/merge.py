"""One recording of several: each run below a letter of its own, on one time cursor, and what differs between them."""

from __future__ import annotations

import contextlib
import json
import uuid
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr

from dynaviz.arrays import F32, F64, U8, Bool
from dynaviz.comparison.answers import Answers
from dynaviz.comparison.counts import (
    BOTH,
    FIRST,
    NEITHER,
    SECOND,
    AgreementCounts,
    SpatialGains,
    agreement,
    frame_gains,
)
from dynaviz.comparison.summary import Comparison, label
from dynaviz.io.atomic import atomic_file
from dynaviz.progress import Progress, silent
from dynaviz.scan import Label
from dynaviz.viz import compare_layout, paths
from dynaviz.viz.compare_layout import (
    CHANGED,
    COLOURS,
    COMPARE,
    DISTANCE,
    GAIN,
    GROUND,
    PLACES,
    REPORT,
    SCAN,
    SIDES,
    WHERE,
)
from dynaviz.viz.pipe import PipeWriter
from dynaviz.viz.reader import COMPARISON, DrawnPoints, RunRecording

KEPT = (  # of each run
    paths.ROOT, paths.WORLD, paths.SCAN, f"{paths.MAP}/**", f"{paths.REMOVED}/**", paths.TRAJECTORY,
    f"{paths.SENSOR}/**", f"{paths.SCORES}/**", f"{paths.ERROR_DISTANCE}/**", paths.REPORT,
)  # fmt: skip
LEGEND = "Each run's own views: blue removed, orange moved but kept, yellow stood but removed, grey kept."
NOBODY: paths.Colour = (235, 235, 235)
EVERYBODY: paths.Colour = (110, 110, 118)
DARK: paths.Colour = (62, 64, 72)
RUNS = [colour for _, colour in COLOURS]
SIZES = np.array([1.6, 2.2, 2.2, 1.2], np.float32)  # of points on the screen, by who is right
MOVES = 1.5  # times as large is a point that moves: there are few, and each weighs much
BUBBLE = 1.2  # metres: radius of the largest cells' marks; their area is the gain
RAISED = 1.5  # metres above what is wrong, so that marks are not hidden in it
SEEN = 0.95  # of all change: so much is in the picture when it opens
LARGEST = 0.98  # quantile of the gains that is drawn so large; beyond, marks grow no more


def write(
    out: Path,
    recordings: Sequence[RunRecording],
    comparison: Comparison,
    crossed: Sequence[AgreementCounts],
    fine: Sequence[SpatialGains],
    progress: Progress = silent,
) -> None:
    """Write the recording of a comparison, whole or not at all.

    Args:
        out: the file.
        recordings: what was compared, in the order of letters.
        comparison: what differs.
        crossed: the points of the first and each other.
        fine: gains by small cells of each pair; empty where a recording holds no coordinates.
        progress: called with a phase, and how many recordings of how many are done.

    Raises:
        DataError: where the file cannot be written.
    """
    names = [label(run) for run in comparison.runs]
    pair = len(recordings) == 2
    places = np.concatenate([_bulk(gains) for gains in fine]) if fine else None
    layout = (compare_layout.two if pair else compare_layout.many)(names, places)
    with atomic_file(out) as beside, PipeWriter(beside) as tap, contextlib.ExitStack() as stack:
        stream = rr.RecordingStream("dynaviz compare", recording_id=str(uuid.uuid4()), send_properties=False)
        stack.callback(stream.disconnect)
        stream.save(tap.inlet, default_blueprint=layout)
        stream.set_log_time_enabled(False)
        stream.send_recording_name(comparison.title)
        if pair and fine:  # first, for the viewer complains of views whose world it does not know yet
            _legend(stream, names)
            _ground(stream, recordings[0])
            _where(stream, fine[0], comparison)
        for i, recording in enumerate(recordings):
            _copy(recording, SIDES[i], names[i], RUNS[i], stream)
            progress("writing", i + 1, len(recordings))
        _facts(stream, comparison, bool(fine))
        _distances(stream, recordings)
        if pair:
            _gains(stream, names, crossed[0], comparison)
        if pair and fine:
            _frames(stream, *recordings)


def _bulk(gains: SpatialGains) -> F64:
    """(N, 3): the places that make up most of what changes."""
    order = gains.order()
    size = np.abs(gains.gain.sum(1))[order]
    seen: F64 = gains.low[order[np.cumsum(size) <= SEEN * size.sum()]]
    return seen


def _copy(recording: RunRecording, side: str, name: str, colour: paths.Colour, stream: rr.RecordingStream) -> None:
    """Copy what the layout shows below ``/side``, and give curves the run's name and colour."""
    chunks = recording.store.stream().filter(content=["/" + path.removeprefix("/") for path in KEPT])
    rr.send_chunks(
        chunks.map(lambda chunk: chunk.with_entity_path(f"/{side}{chunk.entity_path}".rstrip("/"))), recording=stream
    )
    for path in recording.entities():
        words = path.split("/")
        if words[0] == paths.SCORES and path != paths.WORST:
            what = " ".join(word.replace("_", " ") for word in words[2:] if word != "so_far")
            style = rr.SeriesLines(names=f"{name} {what}".strip(), colors=colour, widths=2.0)
            stream.log(f"{side}/{path}", style, static=True)
    stream.send_property(side, rr.AnyValues(**{k: v for k, v in recording.properties.items() if v != ""}))


def _facts(stream: rr.RecordingStream, comparison: Comparison, drawn: bool) -> None:
    facts = {
        "schema": paths.SCHEMA,
        "kind": COMPARISON,
        "title": comparison.title,
        "sequence": comparison.sequence["name"],
        "digest": comparison.sequence["digest"],
        "frames": comparison.sequence["frames"],
        "points": comparison.sequence["points"],
        "comparison_json": json.dumps(comparison.to_dict()),
    }
    stream.send_property(COMPARISON, rr.AnyValues(**facts))
    words = rr.TextDocument(comparison.markdown(LEGEND if drawn else ""), media_type=rr.MediaType.MARKDOWN)
    stream.log(REPORT, words, static=True)


def _legend(stream: rr.RecordingStream, names: Sequence[str]) -> None:
    legend = [
        (NEITHER, "both wrong", NOBODY),
        (FIRST, f"only {names[0]} right", RUNS[0]),
        (SECOND, f"only {names[1]} right", RUNS[1]),
        (BOTH, "both right", EVERYBODY),
    ]
    stream.log(COMPARE, rr.AnnotationContext(legend), rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)


def _gains(stream: rr.RecordingStream, names: Sequence[str], crossed: AgreementCounts, comparison: Comparison) -> None:
    """A curve for each run, apart from 0 where it is the better one; and marks on the frames told."""
    gain = frame_gains(crossed).sum(1)
    frames = rr.TimeColumn(paths.FRAME, sequence=np.arange(len(gain)))
    for side, name, colour, sign in zip(SIDES, names, RUNS, (-1, 1), strict=False):
        path = f"{GAIN}/{side}"
        stream.log(path, rr.SeriesLines(names=f"{name} better", colors=colour, widths=2.0), static=True)
        values = np.where(gain * sign > 0, gain, 0.0)
        stream.send_columns(path, indexes=[frames], columns=rr.Scalars.columns(scalars=values))
    told = sorted(row["frame"] for row in comparison.pairs[0]["frames"])
    style = rr.SeriesPoints(colors=NOBODY, markers="diamond", marker_sizes=4, names="told in the report")
    stream.log(CHANGED, style, static=True)
    if told:
        marks = rr.TimeColumn(paths.FRAME, sequence=told)
        stream.send_columns(CHANGED, indexes=[marks], columns=rr.Scalars.columns(scalars=gain[told]))


def _distances(stream: rr.RecordingStream, recordings: Sequence[RunRecording]) -> None:
    """The runs' histograms with their bars beside each other."""
    for kind in ("false_negative", "false_positive"):
        for i, recording in enumerate(recordings):
            if (bars := _bars(recording, f"{paths.ERROR_DISTANCE}/{kind}/run")) is not None:
                counts, middles, widths = bars
                narrow = widths / len(recordings)
                shifted = middles - widths / 2 + (i + 0.5) * narrow
                chart = rr.BarChart(counts, abscissa=shifted, widths=narrow, color=RUNS[i])
                stream.log(f"{DISTANCE}/{kind}/{SIDES[i]}", chart, static=True)


def _bars(recording: RunRecording, path: str) -> tuple[F64, F64, F64] | None:
    """Heights, middles and widths of a bar chart that was logged once."""
    for chunk in recording.store.stream().filter(content=f"/{path}", is_static=True):
        row = {name: values[-1] for name, values in chunk.to_record_batch().to_pydict().items()}
        heights, middles = (np.array(row[f"BarChart:{part}"][0]["buffer"], float) for part in ("values", "abscissa"))
        return heights, middles, np.array(row["BarChart:widths"], float)
    return None


def _frames(stream: rr.RecordingStream, first: RunRecording, second: RunRecording) -> None:
    """Each frame's drawn points by who is right."""
    sides = zip(first.answers(), second.answers(), first.drawn(), second.drawn(), strict=True)
    for a, b, drawn_a, drawn_b in sides:
        xyz, who, moves = _who(a, b, drawn_a, drawn_b)
        stream.reset_time()
        stream.set_time(paths.FRAME, sequence=a.frame)
        sizes = -SIZES[who] * np.where(moves, np.float32(MOVES), np.float32(1))
        stream.log(SCAN, rr.Points3D(xyz, class_ids=who.astype(np.uint16), radii=sizes))


def _who(a: Answers, b: Answers, drawn_a: DrawnPoints, drawn_b: DrawnPoints) -> tuple[F32, U8, Bool]:
    """The labelled points that either recording drew: where, who is right, and whether they move."""
    points, at = np.unique(np.concatenate([drawn_a.point, drawn_b.point]), return_index=True)
    truth = a.truth[points]
    labelled = truth != Label.UNLABELLED
    points, at, truth = points[labelled], at[labelled], truth[labelled]
    xyz = np.concatenate([drawn_a.xyz, drawn_b.xyz])[at]
    return xyz, agreement(truth, a.dynamic[points], b.dynamic[points]), truth == Label.DYNAMIC


def _ground(stream: rr.RecordingStream, first: RunRecording) -> None:
    """The map once more, darker, so that marks stand out."""
    xyz = first.static(paths.MAP)["Points3D:positions"]
    stream.log(GROUND, rr.Points3D(xyz, colors=DARK, radii=rr.Radius.ui_points(1.2)), static=True)


def _where(stream: rr.RecordingStream, fine: SpatialGains, comparison: Comparison) -> None:
    """Marks on the cells of the whole run, and the places told as numbered boxes."""
    gain = fine.gain.sum(1)
    changed = gain != 0
    centres = fine.low[changed] + np.array([fine.size / 2, fine.size / 2, RAISED])
    size = np.abs(gain[changed])
    most = np.quantile(size, LARGEST) if len(size) else 1.0
    radii = BUBBLE * np.sqrt(np.minimum(size / most, 1.0))
    better = np.where(gain[changed] > 0, SECOND, FIRST).astype(np.uint16)
    stream.log(WHERE, rr.Points3D(centres, class_ids=better, radii=radii), static=True)
    told = comparison.pairs[0]["places"]
    stream.log(
        PLACES,
        rr.Boxes3D(
            mins=[[*row["low"], row["height"] - 0.5] for row in told],
            sizes=[[*np.subtract(row["high"], row["low"]), 3.0] for row in told],
            labels=[str(number) for number in range(1, len(told) + 1)],
            class_ids=[SECOND if row["gain"] > 0 else FIRST for row in told],
            radii=rr.Radius.ui_points(0.8),
            show_labels=True,
        ),
        static=True,
    )
