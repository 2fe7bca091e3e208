"""Refine poses: register each scan to a local map of the scans around it (open3d, point to plane).

Every scan is registered to the scans that are 1, 2, 4 and 7 frames before and after it, with the
poses refined so far; once forwards and once backwards through the sequence. Errors that change from
frame to frame vanish; slow ones stay, because neighbours share them. A robust kernel gives points
on moving objects little weight.
"""

from __future__ import annotations

import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from dynaviz.arrays import F32, F64
from dynaviz.contracts.scan import Scan, stream
from dynaviz.errors import DataError
from dynaviz.io.atomic import write_atomic
from dynaviz.io.poses import read_poses
from dynaviz.progress import Progress, silent
from dynaviz.sources.drive import Drive
from dynaviz.sources.odometry.estimate import reach_of
from dynaviz.sources.odometry.pose_table import without_points, write_pose_table
from dynaviz.sources.origin import PoseRefinement
from dynaviz.sources.pose_noise import PoseNoiseMeter, pose_noise
from dynaviz.sources.summary import ScanDigest
from dynaviz.spatial import geometry, open3d

FORMAT = 1  # of the cache; a change makes earlier caches invalid
NEIGHBOURS = (1, 2, 4, 7)  # frames before and after a scan
# metres from the sensor
NEAREST = 2.0
FARTHEST = 50.0
# metres; edge of the voxels that thin out scans
FINEST = 0.2
COARSEST = 0.5
FEWEST = 200  # voxels of a scan that is registered
PAIRED = 0.3  # metres; largest distance of a point from the local map
KERNEL = 0.05  # metres; Geman-McClure
ITERATIONS = 15
# metres and degrees; a larger correction is a failed registration
LARGEST_STEP = 0.5
LARGEST_TURN = 3.0


def refine(sequence: Drive, folder: Path | None = None, progress: Progress = silent) -> Drive:
    """Refine the poses of a sequence, or find those that an earlier call wrote into the same folder
    for the same data.

    Args:
        sequence: with poses whose errors are below ``PAIRED`` between neighbouring frames.
        folder: where to write ``poses_refined.csv`` and ``poses_refined.toml``; None writes
            nothing.
        progress: called after each frame of each phase.

    Raises:
        MissingDependency: if open3d cannot be loaded.
        DataError: for data that cannot be read, or files that cannot be written.
    """
    register = Registration(_edge(sequence))
    start = time.process_time()
    meter = PoseNoiseMeter(len(sequence))
    digest = ScanDigest()
    clouds = list[F32]()
    frames = list[Scan]()
    for position, scan in enumerate(stream(sequence)):
        digest.add(scan)
        meter.add(position, scan)
        clouds.append(register.thinned(scan))
        frames.append(without_points(scan))
        progress("read for refinement", position + 1, len(sequence))
    key = f"{FORMAT} open3d {metadata.version(register.package)} {digest.hexdigest()}"
    if folder is not None and (earlier := _cached(folder, key, sequence, frames)) is not None:
        return earlier
    given = np.array([frame.T_world_sensor for frame in frames])
    refined, registered = register.all(clouds, given, progress)
    moved = _moved(given, refined, registered, meter)
    if folder is not None:
        refined = _saved(folder, refined, sequence.origin, frames)
    after = pose_noise(sequence.with_poses(refined))
    moved = msgspec.structs.replace(
        moved, after=after, seconds=round(time.process_time() - start, 1)
    )
    if folder is not None:
        _save_note(folder, key, moved)
    return sequence.with_refined(refined, moved)


class Registration:
    """Registers scans with open3d, in one thread: sums in several threads differ from run to run.

    Args:
        edge: metres; edge of the voxels that thin out scans.

    Raises:
        MissingDependency: if open3d cannot be loaded.
    """

    def __init__(self, edge: float) -> None:
        self._o3d = open3d.load("--refine-poses")
        self._edge = edge

    @property
    def package(self) -> str:
        """The distribution that is installed: ``open3d`` or ``open3d-cpu``."""
        found = metadata.packages_distributions().get("open3d", ["open3d"])
        return found[0]

    def thinned(self, scan: Scan) -> F32:
        """(K, 3) float32, metres, sensor frame: the mean point of each voxel at usable ranges."""
        with np.errstate(invalid="ignore"):
            squares = scan.squared_ranges()
            rows = (squares > NEAREST**2) & (squares < FARTHEST**2)  # false for non-finite points
        own = geometry.apply(geometry.inverse(scan.T_world_sensor), scan.points[rows])
        means = np.asarray(self._cloud(own).voxel_down_sample(self._edge).points)
        return means.astype(np.float32)

    def all(self, clouds: list[F32], given: F64, progress: Progress) -> tuple[F64, int]:
        """Refined poses, (frames, 4, 4), and how many frames were registered in the last pass.

        Args:
            clouds: of each frame, (K, 3) metres, sensor frame.
            given: (frames, 4, 4) float64, metres.
            progress: called after each frame.
        """
        poses = given.copy()
        frames = range(len(clouds))
        done = 0
        with self._one_thread():
            for order in (frames, reversed(frames)):
                registered = 0
                for k in order:
                    around = [
                        k + side * gap
                        for gap in NEIGHBOURS
                        for side in (-1, 1)
                        if k + side * gap in frames
                    ]
                    step = (
                        self._step(clouds, poses, k, around) if len(clouds[k]) >= FEWEST else None
                    )
                    if step is not None:
                        poses[k] = geometry.compose(poses[k], step)
                        registered = registered + 1
                    done += 1
                    progress("refine poses", done, 2 * len(clouds))
        return poses, registered

    @contextmanager
    def _one_thread(self) -> Iterator[None]:
        utility = self._o3d.utility
        if not hasattr(
            utility, "set_max_threads"
        ):  # before open3d 0.20, which depends on a package with threadpoolctl
            from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

            with threadpool_limits(1, "openmp"):
                yield
            return
        before = utility.get_max_threads()
        utility.set_max_threads(1)
        try:
            yield
        finally:
            utility.set_max_threads(before)

    def _step(self, clouds: list[F32], poses: F64, k: int, around: list[int]) -> F64 | None:
        """The correction of a pose in the sensor frame; None if the registration fails."""
        registration = self._o3d.pipelines.registration
        to_sensor = geometry.inverse(poses[k])
        near = [
            geometry.apply(geometry.compose(to_sensor, poses[j]), clouds[j])
            for j in around
            if len(clouds[j])
        ]
        if not near:
            return None
        target = self._cloud(np.concatenate(near)).voxel_down_sample(0.8 * self._edge)
        target.estimate_normals(
            self._o3d.geometry.KDTreeSearchParamHybrid(radius=2.4 * self._edge, max_nn=12)
        )
        found = registration.registration_icp(
            self._cloud(clouds[k]),
            target,
            PAIRED,
            np.eye(4),
            registration.TransformationEstimationPointToPlane(registration.GMLoss(k=KERNEL)),
            registration.ICPConvergenceCriteria(max_iteration=ITERATIONS),
        )
        step: F64 = np.array(found.transformation)
        shift, turn = _size(step[None])
        failed = (
            len(found.correspondence_set) < FEWEST
            or shift[0] > LARGEST_STEP
            or turn[0] > LARGEST_TURN
        )
        return None if failed else step

    def _cloud(self, points: Any) -> Any:
        return self._o3d.geometry.PointCloud(
            self._o3d.utility.Vector3dVector(points.astype(np.float64))
        )


def _edge(sequence: Drive) -> float:
    """Edge of the voxels, metres: fine in rooms, coarse in streets."""
    sample = [sequence[k] for k in sorted({0, len(sequence) // 2, len(sequence) - 1})]
    return float(np.clip(reach_of(sample) / 80, FINEST, COARSEST))


def _size(T: F64) -> tuple[F64, F64]:
    """Lengths in metres and angles in degrees, (N,) each, of (N, 4, 4) transforms."""
    from scipy.spatial.transform import Rotation

    return np.linalg.norm(T[:, :3, 3], axis=1), np.degrees(
        Rotation.from_matrix(T[:, :3, :3]).magnitude()
    )


def _moved(given: F64, refined: F64, registered: int, meter: PoseNoiseMeter) -> PoseRefinement:
    shift, turn = _size(geometry.compose(np.array([geometry.inverse(T) for T in given]), refined))
    return PoseRefinement(
        median_m=round(float(np.median(shift)), 5),
        max_m=round(float(shift.max()), 5),
        median_deg=round(float(np.median(turn)), 5),
        max_deg=round(float(turn.max()), 5),
        frames=registered,
        before=meter.result(),
    )


def _saved(folder: Path, poses: F64, origin: F64, frames: list[Scan]) -> F64:
    """Write poses in the coordinates of the source; return them as the next call reads them."""
    whole = poses.copy()
    whole[:, :3, 3] += origin
    write_pose_table(folder / "poses_refined.csv", frames, whole)
    return _read(folder, origin, frames)


def _read(folder: Path, origin: F64, frames: list[Scan]) -> F64:
    """(frames, 4, 4) float64, metres: the poses of the file in the order of the frames."""
    found = read_poses(folder / "poses_refined.csv")
    poses = found.poses.copy()
    poses[:, :3, 3] -= origin
    if found.stamps is not None:
        poses = poses[
            np.searchsorted(found.stamps, np.array([frame.stamp_ns for frame in frames], np.int64))
        ]
    return poses


def _save_note(folder: Path, key: str, moved: PoseRefinement) -> None:
    import tomli_w

    facts = {name: value for name, value in msgspec.to_builtins(moved).items() if value is not None}
    write_atomic(folder / "poses_refined.toml", tomli_w.dumps({"key": key, **facts}).encode())


def refined_before(sequence: Drive, folder: Path) -> Drive | None:
    """The sequence with the refined poses of a run's folder, for this sequence.

    None if they are not there.
    """
    frames = [without_points(scan) for scan in stream(sequence)]
    return _cached(folder, None, sequence, frames)


def _cached(folder: Path, key: str | None, sequence: Drive, frames: list[Scan]) -> Drive | None:
    """The sequence with the poses of an earlier call with the same key, or any key.

    None if there are none.
    """
    try:
        facts = tomllib.loads((folder / "poses_refined.toml").read_text(encoding="utf-8"))
        moved = msgspec.convert(facts, PoseRefinement)
        if key is not None and facts.get("key") != key:
            return None
        poses = _read(folder, sequence.origin, frames)
    except (OSError, ValueError, IndexError, DataError):
        return None
    refined = msgspec.structs.replace(moved, reused=True)
    return sequence.with_refined(poses, refined) if len(poses) == len(frames) else None
