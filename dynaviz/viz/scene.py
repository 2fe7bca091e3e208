"""The 3D part of a recording: the points of each frame by outcome, and the map of the whole run."""

from __future__ import annotations

import itertools

import numpy as np
import rerun as rr

from dynaviz import colours
from dynaviz.arrays import F32, F64, I64, U8, Bool, Intp
from dynaviz.metric import FrameBoxes, Labelled
from dynaviz.scan import Outcome, Scan
from dynaviz.spatial.extent import CELL, Extent
from dynaviz.spatial.grid import KeySet, in_key_range, pack, voxel_downsample
from dynaviz.viz import classes, paths
from dynaviz.viz.sink import RecordingFile

VOXEL = 0.2  # metres: edge of the voxels used to downsample the map and the false positives of a frame
FINE = 0.1  # metres: the same for dynamic points, which are few
MOST = 10_000  # points of an outcome in a frame, about; more are downsampled, with larger voxels if need be
MARGIN = 1.1  # factor on these, because surfaces are rough
GROWTH = 1.25  # factor on the voxel's edge while a map has more points than its cap

MAPS = {  # entities of the points of the whole run, by outcome
    paths.MAP: (Outcome.STATIC_KEPT, Outcome.UNLABELLED_KEPT),
    paths.MAP_WRONG: (Outcome.FALSE_NEGATIVE,),
    paths.REMOVED: (Outcome.DYNAMIC_REMOVED, Outcome.UNLABELLED_REMOVED),
    paths.REMOVED_WRONG: (Outcome.FALSE_POSITIVE,),
}
DYNAMIC = (Outcome.DYNAMIC_REMOVED, Outcome.FALSE_NEGATIVE)
DRAWN = {  # outcomes drawn by frame in ``errors`` mode, and the voxel's edge in metres if they are downsampled
    Outcome.DYNAMIC_REMOVED: FINE,
    Outcome.FALSE_NEGATIVE: FINE,
    Outcome.FALSE_POSITIVE: VOXEL,
    Outcome.UNLABELLED_REMOVED: VOXEL,
}
CAPS = {  # points in the map of the whole run: at most about 550 000, which a software renderer can draw
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
"""By outcome, in points on the screen; wrong points are larger so that few of them remain visible from afar."""
SMALLEST = 1.2
FEW = 500  # points; larger classes are drawn smaller, or many scattered errors would hide a few large ones
RINGS = (10.0, 20.0)  # metres; the camera tracks them, and their size sets its distance
NUMBERED = 5  # cases with a number in the map; more would hide each other
EDGES = rr.Radius.ui_points(1.2)  # of boxes
HAIRLINE = rr.Radius.ui_points(0.4)  # of the boxes of a frame without a label
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
        self._points: list[F32] = [np.empty((0, 3), np.float32)]
        self._reasons: list[U8] = [np.empty(0, np.uint8)]

    def add(self, points: F32, reasons: U8) -> None:
        """Add (N, 3) finite points and their (N,) reason codes; the first point of each voxel is kept."""
        first = self._seen.add(pack(points, self.size))
        self._points.append(points[first])
        self._reasons.append(reasons[first])

    def thinned(self) -> tuple[F32, U8]:
        """(M, 3) float32 points and their (M,) reason codes, downsampled further if they exceed the cap.

        They are ordered by reason: equal codes next to each other compress to almost nothing.
        """
        points, reasons, size = np.concatenate(self._points), np.concatenate(self._reasons), self.size
        while len(points) > self.cap:
            size *= GROWTH
            first = voxel_downsample(points, size)[0]
            points, reasons = points[first], reasons[first]
        order = np.argsort(reasons, kind="stable")
        return points[order], reasons[order]


class MapDrawing:
    """Draws the 3D part of a recording.

    Args:
        sink: where to draw.
        extent: of the sequence.
        named: number of reasons in the method's legend.
        full: draw every point of every frame; otherwise only dynamic and removed points, the latter downsampled.
    """

    def __init__(self, sink: RecordingFile, extent: Extent, named: int, full: bool) -> None:
        self._sink, self._named, self._full = sink, named, full
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
        rows = _by_outcome(labelled.outcome, finite)
        for outcome, downsampled in self._maps.items():
            if len(rows[outcome]):
                downsampled.add(local[rows[outcome]], labelled.reasons[rows[outcome]])
        if self._full:
            self._draw(labelled, np.arange(len(local)), None)
        else:
            self._draw(labelled, *_chosen(labelled, local, rows))

    def finish(self) -> None:
        """Draw the map of the whole run and the trajectory of the sensor."""
        for path, kinds in MAPS.items():
            points, reasons = zip(*[self._maps[o].thinned() for o in kinds], strict=True)
            outcome = np.repeat(np.array(kinds, np.uint8), [len(p) for p in points])
            cloud = self._cloud(np.concatenate(points) + self._middle, outcome, np.concatenate(reasons))
            self._sink.log(path, cloud, static=True)
        line = rr.LineStrips3D([self._trajectory], colors=[240, 240, 240], radii=rr.Radius.ui_points(0.8))
        self._sink.log(paths.TRAJECTORY, line if self._trajectory else rr.LineStrips3D([]), static=True)

    def boxes(self, name: str, cases: FrameBoxes, count: int) -> None:
        """Draw the boxes of the first ``count`` cases: by frame, with few labels, and over all frames."""
        few = slice(count)
        shades = np.array([colours.BRIGHT[Outcome(o)] for o in cases.outcomes[few]], np.uint8)
        labels, path = np.array(cases.labels[few], object), paths.boxes(name)
        numbers = [str(number) if number <= NUMBERED else "" for number in range(1, len(labels) + 1)]
        low, size = cases.low[few], (cases.high - cases.low)[few]
        whole = rr.Boxes3D(mins=low, sizes=size, colors=shades, labels=numbers, radii=EDGES, fill_mode=WIRES)
        self._sink.log(f"{path}/cases", whole, static=True)
        self._sink.log(path, rr.Boxes3D.from_fields(fill_mode=WIRES, show_labels=True), static=True)
        order = np.argsort(cases.frames, kind="stable")
        order = order[cases.case[order] < len(labels)]
        case, low, high = cases.case[order], cases.box_low[order], cases.box_high[order]
        middle = (low + high) / 2
        labelled = _labelled(cases.frames[order], case, middle)
        columns = rr.Boxes3D.columns(
            centers=middle, half_sizes=(high - low) / 2, colors=shades[case],
            labels=np.where(labelled, labels[case], "").tolist(),
            radii=[EDGES if firm else HAIRLINE for firm in labelled],
        )  # fmt: skip
        lengths = np.bincount(cases.frames[order], minlength=len(self._trajectory))
        self._sink.columns(path, range(len(lengths)), [None], columns.partition(lengths))

    def _draw(self, labelled: Labelled, chosen: np.ndarray, stands_for: np.ndarray | None) -> None:
        cloud = self._cloud(labelled.scan.points[chosen], labelled.outcome[chosen], labelled.reasons[chosen])
        self._sink.log(paths.SCAN, cloud)
        if len(chosen) and stands_for is not None:
            details = {
                "point": chosen.astype(np.uint32),
                "stands_for": stands_for.astype(np.uint32),
                "reason": labelled.reasons[chosen],
            }
            self._sink.log(paths.SCAN, rr.DynamicArchetype("dynaviz.Scan", components=details))

    def _cloud(self, xyz: F32, outcome: U8, reasons: U8) -> rr.Points3D:
        """Points with their class; without ``show_labels=False`` the viewer would print it at each of a few points."""
        ids = classes.encode(outcome, reasons, self._named)
        return rr.Points3D(xyz, class_ids=ids, radii=_radii(outcome), show_labels=False)


def _labelled(frames: I64, cases: I64, middle: F32) -> Bool:
    """(N,) whether a box gets a label: the costliest of each frame that are apart; cases ascend by their number."""
    labelled = np.zeros(len(frames), np.bool_)
    for rows in np.split(np.arange(len(frames)), np.flatnonzero(np.diff(frames)) + 1):
        mine: list[int] = []
        for row in rows[np.argsort(cases[rows], kind="stable")].tolist():
            if len(mine) < LABELS and (np.linalg.norm(middle[mine] - middle[row], axis=1) >= APART).all():
                mine.append(row)
        labelled[mine] = True
    return labelled


def _radii(outcome: U8) -> F32:
    """(N,) radii, smaller for larger outcomes; negative, which means screen units to the viewer."""
    counts = np.bincount(outcome, minlength=len(RADII))
    shrunk = RADII * (np.maximum(counts, FEW) / FEW) ** -0.25
    sizes: F32 = -np.maximum(shrunk, SMALLEST).astype(np.float32)
    return sizes[outcome]


def _by_outcome(outcome: U8, finite: Bool) -> list[Intp]:
    """The rows of each ``Outcome``, ascending, without those that are not finite."""
    order = np.argsort(outcome, kind="stable")
    order = order[finite[order]]
    bounds = np.searchsorted(outcome[order], np.arange(len(Outcome) + 1, dtype=np.uint8))
    return [order[first:end] for first, end in itertools.pairwise(bounds)]


def _chosen(labelled: Labelled, local: F32, rows: list[Intp]) -> tuple[Intp, Intp]:
    """Rows of points to draw, and how many each stands for: dynamic and removed points, one per voxel if many."""
    parts = []
    for outcome, size in DRAWN.items():
        every = np.flatnonzero(labelled.outcome == outcome)  # those that are not finite, too
        if outcome in DYNAMIC and len(every) <= MOST:
            parts.append((every, np.ones(len(every), np.intp)))
        else:
            parts.append(_thinned(rows[outcome], local, size))
    return np.concatenate([chosen for chosen, _ in parts]), np.concatenate([counts for _, counts in parts])


def _thinned(rows: Intp, local: F32, size: float) -> tuple[Intp, Intp]:
    """One of these rows per voxel of this edge, or of a larger one if these are more than ``MOST``."""
    first, counts = voxel_downsample(local[rows], size)
    if len(first) > MOST:  # the number of voxels of surfaces falls with the square of their edge
        first, counts = voxel_downsample(local[rows], MARGIN * size * float(np.sqrt(len(first) / MOST)))
    return rows[first], counts
