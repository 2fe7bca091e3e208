"""The 3D part of a recording: the points of each frame by outcome, and the map of the whole run."""

from __future__ import annotations

import numpy as np
import rerun as rr

from dynaviz import colours
from dynaviz.arrays import F32, F64, I64, U8, Bool
from dynaviz.contracts.extent import CELL, Extent
from dynaviz.contracts.metric import FrameBoxes, Labelled
from dynaviz.contracts.scan import Outcome, Scan
from dynaviz.views import classes, paths
from dynaviz.views.layout import CIRCLES
from dynaviz.views.record.downsampling import (
    DYNAMIC,
    FINE,
    VOXEL,
    DownsampledMap,
    by_outcome,
    to_draw,
)
from dynaviz.views.record.sink import RecordingFile

MAPS = {  # entities of the points of the whole run, by outcome
    paths.MAP: (Outcome.STATIC_KEPT, Outcome.UNLABELLED_KEPT),
    paths.MAP_WRONG: (Outcome.FALSE_NEGATIVE,),
    paths.REMOVED: (Outcome.DYNAMIC_REMOVED, Outcome.UNLABELLED_REMOVED),
    paths.REMOVED_WRONG: (Outcome.FALSE_POSITIVE,),
}
# points in the map of the whole run: at most about 550 000, which a software renderer can draw
CAPS = {
    Outcome.STATIC_KEPT: 300_000,
    Outcome.UNLABELLED_KEPT: 100_000,
    Outcome.FALSE_NEGATIVE: 40_000,
    Outcome.DYNAMIC_REMOVED: 40_000,
    Outcome.UNLABELLED_REMOVED: 30_000,
    Outcome.FALSE_POSITIVE: 40_000,
}
LABELS = 3  # cases of a frame with a label, the costliest ones: more would hide each other
APART = 9.0  # metres between these; about the width of a label, seen from the camera of the frame
RADII = np.array([1.2, 1.6, 3.0, 3.0, 1.2, 1.6], np.float32)
"""By outcome, in points on the screen; wrong points are larger so that few of them remain visible
from afar."""
SMALLEST = 1.2
# points; larger classes are drawn smaller, or many scattered errors would hide a few large ones
FEW = 500
NUMBERED = 5  # cases with a number in the map; more would hide each other
EDGE = 1.2  # points on the screen: thickness of the edges of boxes
EDGES = rr.Radius.ui_points(EDGE)
ABOVE = 1.6  # metres: height of a label above its box, so that it hides nothing
HAIRLINE = 0.4  # the same for the boxes of a frame without a label
WIRES = rr.components.FillMode.MajorWireframe  # the content of a box must stay visible
# of labels: their own entities, because those of boxes would have their colour
NAME_STYLE = rr.Points3D.from_fields(
    colors=colours.LABEL, radii=rr.Radius.ui_points(0.0), show_labels=True
)


class MapDrawing:
    """Draws the 3D part of a recording.

    Args:
        sink: where to draw.
        extent: of the sequence.
        named: number of reasons in the method's legend.
        full: draw every point of every frame; otherwise only dynamic and removed points, the latter
            downsampled.
    """

    def __init__(self, sink: RecordingFile, extent: Extent, named: int, full: bool) -> None:
        self._sink = sink
        self._named = named
        self._full = full
        # Voxels are counted from the middle of the map, which may be far from the origin.
        self._middle: F32 = np.round(
            np.median(extent.cells, axis=0) * CELL if len(extent.cells) else np.zeros(3)
        ).astype(np.float32)
        self._maps = {
            o: DownsampledMap(FINE if o in DYNAMIC else VOXEL, CAPS[o], self._middle)
            for o in Outcome
        }
        self._trajectory: list[F64] = []
        sink.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        sink.log(paths.SENSOR, rr.TransformAxes3D(2.0), static=True)
        sink.log(
            paths.RINGS,
            rr.LineStrips3D(CIRCLES, colors=[90, 90, 100], radii=rr.Radius.ui_points(0.6)),
            static=True,
        )

    def pose(self, scan: Scan) -> None:
        """Draw the pose of the sensor."""
        T = scan.T_world_sensor
        self._sink.log(paths.SENSOR, rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))

    def frame(self, labelled: Labelled, drawn: bool = True) -> None:
        """Draw a frame's points by outcome if ``drawn``, and add them to the map."""
        self._trajectory.append(labelled.scan.position)
        rows = by_outcome(labelled, self._middle)
        for outcome, downsampled in self._maps.items():
            if len(rows[outcome]):
                downsampled.add(labelled.scan.points, labelled.reasons, rows[outcome])
        if not drawn:
            self._sink.log(paths.SCAN, rr.Clear(recursive=False))
        elif self._full:
            self._draw(labelled, np.arange(len(labelled.scan)), None)
        else:
            self._draw(labelled, *to_draw(labelled, self._middle, rows))

    def finish(self) -> None:
        """Draw the map of the whole run and the trajectory of the sensor."""
        for path, kinds in MAPS.items():
            points, reasons = zip(*[self._maps[o].thinned() for o in kinds], strict=True)
            outcome = np.repeat(np.array(kinds, np.uint8), [len(p) for p in points])
            cloud = self._cloud(np.concatenate(points), outcome, np.concatenate(reasons))
            self._sink.log(path, cloud, static=True)
        line = rr.LineStrips3D(
            [self._trajectory], colors=[240, 240, 240], radii=rr.Radius.ui_points(0.8)
        )
        self._sink.log(
            paths.TRAJECTORY, line if self._trajectory else rr.LineStrips3D([]), static=True
        )

    def boxes(self, name: str, cases: FrameBoxes, count: int) -> None:
        """Draw the boxes of the first ``count`` cases.

        By frame, with few labels, and over all frames.
        """
        few = slice(count)
        shades = np.array([colours.BRIGHT[Outcome(o)] for o in cases.outcomes[few]], np.uint8)
        labels = np.array(cases.labels[few], object)
        path = paths.boxes(name)
        numbers = [
            str(number) if number <= NUMBERED else "" for number in range(1, len(labels) + 1)
        ]
        low = cases.low[few]
        size = (cases.high - cases.low)[few]
        whole = rr.Boxes3D(
            mins=low,
            sizes=size,
            colors=shades,
            labels=numbers,
            radii=EDGES,
            fill_mode=WIRES,
            show_labels=False,
        )
        self._sink.log(f"{path}/cases", whole, static=True)
        shown = slice(min(NUMBERED, len(labels)))
        at = rr.Points3D.from_fields(positions=(low + size / 2)[shown], labels=numbers[shown])
        self._sink.log(paths.names(f"{path}/cases"), NAME_STYLE, at, static=True)
        self._sink.log(
            path, rr.Boxes3D.from_fields(fill_mode=WIRES, show_labels=False), static=True
        )
        self._sink.log(paths.names(path), NAME_STYLE, static=True)
        order = np.argsort(cases.frames, kind="stable")
        order = order[cases.case[order] < len(labels)]
        case = cases.case[order]
        low = cases.box_low[order]
        high = cases.box_high[order]
        middle: F32 = ((low + high) / 2).astype(np.float32)
        labelled = with_labels(cases.frames[order], case, middle)
        columns = rr.Boxes3D.columns(
            centers=middle, half_sizes=(high - low) / 2, colors=shades[case],
            labels=np.where(labelled, labels[case], "").tolist(),
            radii=-np.where(labelled, EDGE, HAIRLINE),  # negative: in screen units
        )  # fmt: skip
        frames = cases.frames[order]
        lengths = np.bincount(frames, minlength=len(self._trajectory))
        number = {"number": case + 1}
        of_cases = rr.DynamicArchetype.columns(paths.CASE_NUMBERS, components=number)
        for part in (columns, of_cases):
            self._sink.columns(path, range(len(lengths)), [None], part.partition(lengths))
        above = np.concatenate([middle[:, :2], high[:, 2:] + ABOVE], 1)[labelled]
        names = rr.Points3D.columns(positions=above, labels=labels[case[labelled]].tolist())
        lengths = np.bincount(frames[labelled], minlength=len(lengths))
        self._sink.columns(paths.names(path), range(len(lengths)), [None], names.partition(lengths))

    def _draw(self, labelled: Labelled, chosen: np.ndarray, stands_for: np.ndarray | None) -> None:
        reasons = labelled.reasons[chosen]
        cloud = self._cloud(labelled.scan.points[chosen], labelled.outcome[chosen], reasons)
        self._sink.log(paths.SCAN, cloud)
        if len(chosen) and stands_for is not None:
            rows = {
                "point": chosen.astype(np.uint32),
                "stands_for": stands_for.astype(np.uint32),
            }
            self._sink.log(paths.SCAN_ROWS, rr.DynamicArchetype("dynaviz.Scan", components=rows))

    def _cloud(self, xyz: F32, outcome: U8, reasons: U8) -> rr.Points3D:
        """Points with their class; views switch off its label at each point."""
        ids = classes.encode(outcome, reasons, self._named)
        return rr.Points3D(xyz, class_ids=ids, radii=_radii(outcome))


def with_labels(frames: I64, cases: I64, middle: F32) -> Bool:
    """(N,) whether a box gets a label: the costliest of its frame that are apart from each other.

    Args:
        frames: (N,) int64, ascending.
        cases: (N,) int64, the case of each box, 0 for the costliest.
        middle: (N, 3) metres.
    """
    labelled = np.zeros(len(frames), np.bool_)
    for rows in np.split(np.arange(len(frames)), np.flatnonzero(np.diff(frames)) + 1):
        mine: list[int] = []
        for row in rows[np.argsort(cases[rows], kind="stable")].tolist():
            if (
                len(mine) < LABELS
                and (np.linalg.norm(middle[mine] - middle[row], axis=1) >= APART).all()
            ):
                mine.append(row)
        labelled[mine] = True
    return labelled


def _radii(outcome: U8) -> F32:
    """(N,) radii, smaller for larger outcomes; negative, which means screen units to the viewer."""
    counts = np.bincount(outcome, minlength=len(RADII))
    shrunk = RADII * (np.maximum(counts, FEW) / FEW) ** -0.25
    sizes: F32 = -np.maximum(shrunk, SMALLEST).astype(np.float32)
    return sizes[outcome]
