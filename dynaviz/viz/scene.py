"""The 3D part of a recording: the points of each frame by outcome, and the map of the whole run."""

from __future__ import annotations

import numpy as np
import rerun as rr

from dynaviz import colours
from dynaviz.arrays import F32, F64, U16, Bool
from dynaviz.metric import FrameBoxes, Labelled
from dynaviz.scan import Outcome, Scan
from dynaviz.spatial.extent import CELL, Extent
from dynaviz.spatial.grid import KeySet, in_key_range, pack, voxel_downsample
from dynaviz.viz import paths
from dynaviz.viz.sink import RecordingFile

VOXEL = 0.2  # metres: edge of the voxels used to downsample the map and the false positives of a frame
FINE = 0.1  # metres: the same for dynamic points, which are few
GROWTH = 1.25  # factor on the voxel's edge while a map has more points than its cap

MAPS = {  # entities of the points of the whole run, by outcome
    paths.MAP: (Outcome.STATIC_KEPT, Outcome.UNLABELLED_KEPT),
    paths.MAP_WRONG: (Outcome.FALSE_NEGATIVE,),
    paths.REMOVED: (Outcome.DYNAMIC_REMOVED, Outcome.UNLABELLED_REMOVED),
    paths.REMOVED_WRONG: (Outcome.FALSE_POSITIVE,),
}
DYNAMIC = (Outcome.DYNAMIC_REMOVED, Outcome.FALSE_NEGATIVE)
CAPS = {  # points in the map of the whole run: at most about 550 000, which a software renderer can draw
    Outcome.STATIC_KEPT: 300_000,
    Outcome.UNLABELLED_KEPT: 100_000,
    Outcome.FALSE_NEGATIVE: 40_000,
    Outcome.DYNAMIC_REMOVED: 40_000,
    Outcome.UNLABELLED_REMOVED: 30_000,
    Outcome.FALSE_POSITIVE: 40_000,
}
RADII = np.array([1.2, 1.6, 3.0, 3.0, 1.2, 1.6], np.float32)
"""By outcome, in points on the screen; wrong points are larger so that few of them remain visible from afar."""
SMALLEST = 1.2
FEW = 500  # points; larger classes are drawn smaller, or many scattered errors would hide a few large ones
RINGS = (10.0, 20.0)  # metres; the camera tracks them, and their size sets its distance
EDGES = rr.Radius.ui_points(1.2)  # of boxes
WIRES = rr.components.FillMode.MajorWireframe  # the content of a box must stay visible
TURN = np.linspace(0.0, 2 * np.pi, 73)


class DownsampledMap:
    """Points of a whole run, one per voxel; memory grows with the occupied volume, not with the number of points.

    Args:
        size: the voxel's edge, metres.
        cap: number of points at the end, at most.
    """

    def __init__(self, size: float, cap: int) -> None:
        self.size, self.cap = size, cap
        self._seen = KeySet()
        self._parts: list[F32] = []

    def add(self, points: F32) -> None:
        """Add (N, 3) finite points; the first point of each voxel is kept."""
        self._parts.append(points[self._seen.add(pack(points, self.size))])

    def points(self) -> F32:
        """(M, 3) float32: the points, downsampled with larger voxels if they exceed the cap."""
        left, size = np.concatenate([np.empty((0, 3), np.float32), *self._parts]), self.size
        while len(left) > self.cap:
            size *= GROWTH
            left = left[voxel_downsample(left, size)[0]]
        return left


class MapDrawing:
    """Draws the 3D part of a recording.

    Args:
        sink: where to draw.
        extent: of the sequence.
        full: draw every point of every frame; otherwise only dynamic and removed points, the latter downsampled.
    """

    def __init__(self, sink: RecordingFile, extent: Extent, full: bool) -> None:
        self._sink, self._full = sink, full
        # Voxels are counted from the middle of the map, which may be far from the origin.
        self._middle: F32 = np.round(
            np.median(extent.cells, axis=0) * CELL if len(extent.cells) else np.zeros(3)
        ).astype(np.float32)
        self._maps = {o: DownsampledMap(FINE if o in DYNAMIC else VOXEL, CAPS[o]) for o in Outcome}
        self._trajectory: list[F64] = []
        sink.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        sink.log(paths.SENSOR, rr.TransformAxes3D(2.0), static=True)
        rings = [limit * np.stack([np.cos(TURN), np.sin(TURN), 0 * TURN], 1) for limit in RINGS]
        sink.log(paths.RINGS, rr.LineStrips3D(rings, colors=[90, 90, 100], radii=rr.Radius.ui_points(0.6)), static=True)

    def pose(self, scan: Scan) -> None:
        """Draw the pose of the sensor."""
        T = scan.T_world_sensor
        self._sink.log(paths.SENSOR, rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))

    def frame(self, labelled: Labelled) -> None:
        """Draw a frame's points by outcome, and add them to the map."""
        self._trajectory.append(labelled.scan.position)
        local = labelled.scan.points - self._middle
        finite = in_key_range(local, FINE)
        for outcome, downsampled in self._maps.items():
            downsampled.add(local[finite & (labelled.outcome == outcome)])
        if self._full:
            self._draw(labelled, np.arange(len(local)), None)
        else:
            self._draw(labelled, *_chosen(labelled, local, finite))

    def finish(self) -> None:
        """Draw the map of the whole run and the trajectory of the sensor."""
        for path, kinds in MAPS.items():
            points = [self._maps[o].points() + self._middle for o in kinds]
            classes = np.repeat(np.array(kinds, np.uint16), [len(p) for p in points])
            self._sink.log(
                path, rr.Points3D(np.concatenate(points), class_ids=classes, radii=_radii(classes)), static=True
            )
        line = rr.LineStrips3D([self._trajectory], colors=[240, 240, 240], radii=rr.Radius.ui_points(1.5))
        self._sink.log(paths.TRAJECTORY, line if self._trajectory else rr.LineStrips3D([]), static=True)

    def boxes(self, name: str, cases: FrameBoxes, count: int) -> None:
        """Draw the boxes of the first ``count`` cases: by frame, and over all frames."""
        few = slice(count)
        shades = np.array([colours.BRIGHT[Outcome(o)] for o in cases.outcomes[few]], np.uint8)
        labels, path = np.array(cases.labels[few], object), paths.boxes(name)
        numbers = [str(number) for number in range(1, len(labels) + 1)]
        low, size = cases.low[few], (cases.high - cases.low)[few]
        whole = rr.Boxes3D(mins=low, sizes=size, colors=shades, labels=numbers, radii=EDGES, fill_mode=WIRES)
        self._sink.log(f"{path}/cases", whole, static=True)
        self._sink.log(path, rr.Boxes3D.from_fields(radii=EDGES, fill_mode=WIRES, show_labels=True), static=True)
        order = np.argsort(cases.frames, kind="stable")
        order = order[cases.case[order] < len(labels)]
        case, low, high = cases.case[order], cases.box_low[order], cases.box_high[order]
        columns = rr.Boxes3D.columns(
            centers=(low + high) / 2, half_sizes=(high - low) / 2, colors=shades[case], labels=labels[case].tolist()
        )
        lengths = np.bincount(cases.frames[order], minlength=len(self._trajectory))
        self._sink.columns(path, range(len(lengths)), [None], columns.partition(lengths))

    def _draw(self, labelled: Labelled, chosen: np.ndarray, stands_for: np.ndarray | None) -> None:
        classes = labelled.outcome[chosen].astype(np.uint16)
        xyz = labelled.scan.points[chosen]
        self._sink.log(paths.SCAN, rr.Points3D(xyz, class_ids=classes, radii=_radii(classes)))
        if len(chosen) and stands_for is not None:
            details = {
                "point": chosen.astype(np.uint32),
                "stands_for": stands_for.astype(np.uint32),
                "reason": labelled.reasons[chosen],
            }
            self._sink.log(paths.SCAN, rr.DynamicArchetype("dynaviz.Scan", components=details))


def _radii(classes: U16) -> F32:
    """(N,) radii, smaller for larger classes; negative, which means screen units to the viewer."""
    counts = np.bincount(classes, minlength=len(RADII))
    shrunk = RADII * (np.maximum(counts, FEW) / FEW) ** -0.25
    sizes: F32 = -np.maximum(shrunk, SMALLEST).astype(np.float32)
    return sizes[classes]


def _chosen(labelled: Labelled, local: F32, finite: Bool) -> tuple[np.ndarray, np.ndarray]:
    """Points to draw, and how many each stands for: all dynamic points, and one per voxel of those wrongly removed."""
    dynamic = np.isin(labelled.outcome, DYNAMIC)
    chosen, stands_for = [np.flatnonzero(dynamic)], [np.ones(int(dynamic.sum()), np.intp)]
    for outcome in (Outcome.FALSE_POSITIVE, Outcome.UNLABELLED_REMOVED):
        points = np.flatnonzero(finite & (labelled.outcome == outcome))
        first, counts = voxel_downsample(local[points], VOXEL)
        chosen.append(points[first])
        stands_for.append(counts)
    return np.concatenate(chosen), np.concatenate(stands_for)
