"""The recording of a comparison.

Each run below its own letter, on one time cursor, and what differs between them.
"""

from __future__ import annotations

import contextlib
import json
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from dynaviz.arrays import F64
from dynaviz.colours import NEUTRAL, Colour
from dynaviz.contracts.scan import ERRORS
from dynaviz.io.atomic import atomic_file
from dynaviz.progress import Progress, silent
from dynaviz.scores.comparison.counts import (
    FIRST,
    SECOND,
    AgreementCounts,
    SpatialGains,
    frame_gains,
)
from dynaviz.scores.comparison.pair import FrameChange, PairComparison
from dynaviz.scores.comparison.summary import Comparison
from dynaviz.scores.spans import shared_objects
from dynaviz.views import object_lanes, paths, reading_order
from dynaviz.views.compare import compare_layout, compared_cases
from dynaviz.views.compare.agreement import AgreementLegend, agreed_points
from dynaviz.views.compare.compare_layout import (
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
from dynaviz.views.pipe import open_writer
from dynaviz.views.read.reader import COMPARISON, RunRecording
from dynaviz.views.record.case_timeline import circles

KEPT = (  # entities copied from each run
    paths.ROOT, paths.WORLD, paths.SCAN, f"{paths.MAP}/**", f"{paths.REMOVED}/**", paths.TRAJECTORY,
    f"{paths.SENSOR}/**", f"{paths.SCORES}/**", f"{paths.ERROR_DISTANCE}/**", paths.REPORT,
)  # fmt: skip
BY_FRAME = [SCAN, *(f"{side}/{path}" for side in SIDES for path in (paths.SCAN, paths.SENSOR))]
LEGEND = (
    "Colours in each run's own views: blue dynamic, removed; orange dynamic, kept; yellow static, "
    "removed; "
    "grey static, kept."
)
DARK: Colour = (62, 64, 72)
RUNS = [colour for _, colour in COLOURS]
SIZES = np.array([1.6, 2.2, 2.2, 1.2], np.float32)  # of points on the screen, by agreement
DYNAMIC_SCALE = 1.5  # dynamic points are drawn this much larger: they are few, and each counts more
BUBBLE = (
    1.2  # metres: radius of the marks on the cells that change most; the area of a mark is the gain
)
RAISED = 1.5  # metres above the wrong points, so that they do not hide the marks
SEEN = 0.95  # share of all change that is in the picture when the recording opens
LARGEST = 0.98  # quantile of the gains that gets the largest mark; beyond it, marks do not grow


@dataclass(frozen=True, slots=True)
class Side:
    """One run in the merged recording.

    The root of its entities, its name in legends, and its colour.
    """

    root: str
    name: str
    colour: Colour
    recording: RunRecording


def write(
    out: Path,
    recordings: Sequence[RunRecording],
    comparison: Comparison,
    counts: Sequence[AgreementCounts],
    fine: Sequence[SpatialGains],
    progress: Progress = silent,
) -> None:
    """Write the recording of a comparison; the file appears complete or not at all.

    Args:
        out: the file.
        recordings: the compared runs, in the order of letters.
        comparison: what differs.
        counts: agreement of the first run with each other.
        fine: gains by small cells of each pair; empty if a recording has no coordinates.
        progress: called with a phase, the number of recordings done, and their total number.

    Raises:
        DataError: if the file cannot be written.
    """
    sides = [
        Side(root, run.label, colour, recording)
        for root, run, colour, recording in zip(
            SIDES, comparison.runs, RUNS, recordings, strict=False
        )
    ]
    pair = len(sides) == 2
    drawn = bool(fine)
    found: list[compared_cases.Difference] = []
    if pair and drawn and all(recording.properties["has_labels"] for recording in recordings):
        found = compared_cases.find((recordings[0], recordings[1]))
    with _stream(out, comparison.title, _layout(sides, fine, found)) as stream:
        if (
            pair and drawn
        ):  # first: the viewer reports a problem for views whose entities do not exist yet
            legend = _legend(sides)
            stream.log(COMPARE, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            _write_ground(stream, sides[0])
            _write_gains_by_cell(stream, fine[0])
            _write_places(stream, comparison.pairs[0])
        for done, side in enumerate(sides, 1):
            _copy_run(stream, side)
            progress("writing", done, len(sides))
        _write_properties(stream, comparison)
        _write_report(stream, comparison, drawn)
        _write_distances(stream, sides)
        _write_objects(stream, sides)
        if pair:
            _write_gains_by_frame(stream, sides, counts[0], comparison.pairs[0].frames)
        if pair and drawn:
            _write_agreement(stream, sides[0], sides[1], legend, found)
        if found:
            compared_cases.write(stream, SIDES[:2], (recordings[0], recordings[1]), found)


def _layout(
    sides: Sequence[Side], fine: Sequence[SpatialGains], found: Sequence[compared_cases.Difference]
) -> Any:
    names = [side.name for side in sides]
    places = np.concatenate([_bulk(gains) for gains in fine]) if fine else None
    if len(sides) > 2:
        return compare_layout.many(names, places)
    first = circles(found[0].low[None], found[0].high[None]) if found else None
    return compare_layout.two(names, places, first)


def _bulk(gains: SpatialGains) -> F64:
    """(N, 3): the places that make up most of the change."""
    order = gains.order()
    size = np.abs(gains.gain.sum(1))[order]
    seen: F64 = gains.low[order[np.cumsum(size) <= SEEN * size.sum()]]
    return seen


@contextlib.contextmanager
def _stream(out: Path, title: str, layout: Any) -> Iterator[rr.RecordingStream]:
    with atomic_file(out) as unfinished:
        with contextlib.closing(open_writer(unfinished)) as writer:
            stream = rr.RecordingStream(
                "dynaviz compare", recording_id=str(uuid.uuid4()), send_properties=False
            )
            try:
                stream.save(writer.inlet, default_blueprint=layout)
                stream.set_log_time_enabled(False)
                stream.send_recording_name(title)
                yield stream
            finally:
                stream.disconnect()
        reading_order.rewrite(unfinished, layout, BY_FRAME)


def _copy_run(stream: rr.RecordingStream, side: Side) -> None:
    """Copy the entities that the layout shows to ``/SIDE``.

    Curves get the run's name and colour.
    """
    recording = side.recording
    chunks = recording.store.stream().filter(
        content=["/" + path.removeprefix("/") for path in KEPT]
    )
    chunks = chunks.drop(has_timeline=paths.CASE)
    with recording.decoding():
        rr.send_chunks(
            chunks.map(
                lambda chunk: chunk.with_entity_path(f"/{side.root}{chunk.entity_path}".rstrip("/"))
            ),
            recording=stream,
        )
    for path in recording.entities():
        words = path.split("/")
        if words[0] == paths.SCORES and path != paths.WORST:
            what = " ".join(word.replace("_", " ") for word in words[2:] if word != "so_far")
            style = rr.SeriesLines(
                names=f"{side.name} {what}".strip(), colors=side.colour, widths=2.0
            )
            stream.log(f"{side.root}/{path}", style, static=True)
    stream.send_property(
        side.root, rr.AnyValues(**{k: v for k, v in recording.properties.items() if v != ""})
    )


def _write_properties(stream: rr.RecordingStream, comparison: Comparison) -> None:
    sequence = comparison.sequence
    properties: dict[str, Any] = {
        "schema": paths.SCHEMA,
        "kind": COMPARISON,
        "title": comparison.title,
        "sequence": sequence.name,
        "digest": sequence.digest,
        "frames": sequence.frames,
        "points": sequence.points,
        "comparison_json": json.dumps(comparison.to_dict()),
    }
    stream.send_property(COMPARISON, rr.AnyValues(**properties))


def _write_report(stream: rr.RecordingStream, comparison: Comparison, drawn: bool) -> None:
    text = comparison.markdown(LEGEND if drawn else "")
    stream.log(REPORT, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def _legend(sides: Sequence[Side]) -> AgreementLegend:
    first, second = sides
    return AgreementLegend(
        (first.name, second.name),
        (first.colour, second.colour),
        (first.recording.reasons, second.recording.reasons),
    )


def _write_gains_by_frame(
    stream: rr.RecordingStream,
    sides: Sequence[Side],
    counts: AgreementCounts,
    listed: Sequence[FrameChange],
) -> None:
    """A curve for each run, nonzero in frames where it is better.

    And marks on the frames in the report.
    """
    gain = frame_gains(counts).sum(1)
    frames = rr.TimeColumn(paths.FRAME, sequence=np.arange(len(gain)))
    for side, sign in zip(sides, (-1, 1), strict=True):
        path = f"{GAIN}/{side.root}"
        style = rr.SeriesLines(names=f"{side.name} better", colors=side.colour, widths=2.0)
        stream.log(path, style, static=True)
        values = np.where(gain * sign > 0, gain, 0.0)
        stream.send_columns(path, indexes=[frames], columns=rr.Scalars.columns(scalars=values))
    marked = sorted(change.frame for change in listed)
    marks = rr.SeriesPoints(
        colors=NEUTRAL, markers="diamond", marker_sizes=4, names="listed in the report"
    )
    stream.log(CHANGED, marks, static=True)
    if marked:
        frames = rr.TimeColumn(paths.FRAME, sequence=marked)
        stream.send_columns(
            CHANGED, indexes=[frames], columns=rr.Scalars.columns(scalars=gain[marked])
        )


def _write_distances(stream: rr.RecordingStream, sides: Sequence[Side]) -> None:
    """The histograms of all runs, with their bars next to each other."""
    for kind in ERRORS:
        for i, side in enumerate(sides):
            if (bars := _bars(side.recording, f"{paths.ERROR_DISTANCE}/{kind}/run")) is not None:
                counts, middles, widths = bars
                narrow = widths / len(sides)
                shifted = middles - widths / 2 + (i + 0.5) * narrow
                chart = rr.BarChart(counts, abscissa=shifted, widths=narrow, color=side.colour)
                stream.log(f"{DISTANCE}/{kind}/{side.root}", chart, static=True)


def _write_objects(stream: rr.RecordingStream, sides: Sequence[Side]) -> None:
    """The objects that cost most over time: what each did, and what each run decided."""
    results = {side.root.upper(): side.recording.result for side in sides}
    objects = shared_objects(
        {letter: result.failures for letter, result in results.items() if result}
    )
    shown = objects[: object_lanes.MOST]
    names = object_lanes.names([title for title, _ in shown])
    for name, (_, parts) in zip(names, shown, strict=True):
        for path, style, frames, states in object_lanes.lanes(name, True, parts):
            stream.log(path, style, static=True)
            stream.send_columns(
                path, indexes=[rr.TimeColumn(paths.FRAME, sequence=frames)], columns=states
            )


def _bars(recording: RunRecording, path: str) -> tuple[F64, F64, F64] | None:
    """Heights, middles and widths of a static bar chart; None if absent."""
    for chunk in recording.store.stream().filter(content=f"/{path}", is_static=True):
        row = {name: values[-1] for name, values in chunk.to_record_batch().to_pydict().items()}
        heights, middles = (
            np.array(row[f"BarChart:{part}"][0]["buffer"], float) for part in ("values", "abscissa")
        )
        return heights, middles, np.array(row["BarChart:widths"], float)
    return None


def _write_agreement(
    stream: rr.RecordingStream,
    first: Side,
    second: Side,
    legend: AgreementLegend,
    found: Sequence[compared_cases.Difference],
) -> None:
    """The drawn points of each frame by agreement, and the legend of all their class ids.

    At the index of a difference, the points of its worst frame.
    """
    for drawn in agreed_points(first.recording, second.recording, legend):
        stream.reset_time()
        stream.set_time(paths.FRAME, sequence=drawn.frame)
        sizes = -SIZES[drawn.right] * np.where(
            drawn.dynamic, np.float32(DYNAMIC_SCALE), np.float32(1)
        )
        points = rr.Points3D(drawn.xyz, class_ids=drawn.ids, radii=sizes)
        stream.log(SCAN, points)
        for number, difference in enumerate(found, 1):
            if difference.case.worst_frame == drawn.frame:
                stream.reset_time()
                stream.set_time(paths.CASE, sequence=number)
                stream.log(SCAN, points)
    stream.log(COMPARE, rr.AnnotationContext(legend.entries()), static=True)


def _write_ground(stream: rr.RecordingStream, first: Side) -> None:
    """A darker copy of the first run's map, so that marks stand out."""
    xyz = first.recording.static(paths.MAP)["Points3D:positions"]
    stream.log(GROUND, rr.Points3D(xyz, colors=DARK, radii=rr.Radius.ui_points(1.2)), static=True)


def _write_gains_by_cell(stream: rr.RecordingStream, fine: SpatialGains) -> None:
    """Marks on the cells that change over the whole run."""
    gain = fine.gain.sum(1)
    changed = gain != 0
    centres = fine.low[changed] + np.array([fine.size / 2, fine.size / 2, RAISED])
    size = np.abs(gain[changed])
    most = np.quantile(size, LARGEST) if len(size) else 1.0
    radii = BUBBLE * np.sqrt(np.minimum(size / most, 1.0))
    better = np.where(gain[changed] > 0, SECOND, FIRST).astype(np.uint16)
    stream.log(WHERE, rr.Points3D(centres, class_ids=better, radii=radii), static=True)


def _write_places(stream: rr.RecordingStream, pair: PairComparison) -> None:
    """The surfaces in the report, or the places if none is known, as numbered boxes."""
    if pair.surfaces:
        boxes = [(each.low, each.high, each.gain_SA) for each in pair.surfaces]
    else:
        boxes = [
            ((*each.low, each.height - 0.5), (*each.high, each.height + 2.5), each.gain)
            for each in pair.places or ()
        ]
    stream.log(
        PLACES,
        rr.Boxes3D(
            mins=[low for low, _, _ in boxes],
            sizes=[np.subtract(high, low) for low, high, _ in boxes],
            labels=[str(number) for number in range(1, len(boxes) + 1)],
            class_ids=[SECOND if gain > 0 else FIRST for *_, gain in boxes],
            radii=rr.Radius.ui_points(0.8),
            show_labels=True,
        ),
        static=True,
    )
