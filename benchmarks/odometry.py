"""Scores with estimated poses on simulated drives, recorded as ROS bags whose points are not deskewed.

    python benchmarks/odometry.py [--method NAME] [--frames N] [--sensor vlp16] [--speed 8] [--refine]
        [--odometries small-gicp kiss-icp]

Writes a drive along a street with motion during the sweep as a bag with the true odometry, then runs a method on it
with the given poses, and with those of each odometry, which sees the points and their times only. Ground truth comes
from the simulator. Prints a table with the errors of the estimated poses and the scores.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import dynaviz as dv
from dynaviz.arrays import F64, I64, U8
from dynaviz.contracts.scan import Scan, Sequence, SequenceView
from dynaviz.sources.odometry.refine import refine
from dynaviz.sources.opening import open_source
from dynaviz.sources.options import SequenceOptions
from dynaviz.spatial import geometry
from dynaviz.synthetic.simulate.lidar import sweep_rays
from dynaviz.synthetic.simulate.presets import PRESETS, Preset
from dynaviz.synthetic.simulate.recording import SceneRecorder, build
from dynaviz.synthetic.simulate.sweep import ray_shares, sensor_pose

SWEEP = 0.1  # seconds
START = 1_700_000_000_000_000_000  # nanoseconds
STEP = 0.01  # seconds between two poses of the odometry


@dataclass(frozen=True)
class WithLabels(SequenceView):
    """The sequence of a bag with the simulator's ground truth."""

    whole: Sequence
    labels: list[U8]

    @property
    def has_labels(self) -> bool:
        """Always."""
        return True

    def __getitem__(self, position: int) -> Scan:
        scan = self.whole[position]
        return replace(scan, labels=self.labels[scan.index])


class BagOfClouds:
    """Writes clouds with times, and odometry."""

    def __init__(self, path: Path) -> None:
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._writer: Any = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._topics: dict[str, Any] = {}

    def __enter__(self) -> BagOfClouds:
        self._writer.open()
        return self

    def __exit__(self, *error: object) -> None:
        self._writer.close()

    def cloud(self, stamp: int, points: F64, offsets: I64) -> None:
        """Write points, (N, 3) metres, and their times after the stamp, (N,) ns."""
        rows = np.zeros(len(points), [*((axis, "<f4") for axis in "xyz"), ("t", "<u4")])
        for axis, column in zip("xyz", points.T, strict=True):
            rows[axis] = column
        rows["t"] = offsets
        types = {"x": 7, "y": 7, "z": 7, "t": 6}
        fields = [
            self._make("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=number, count=1)
            for k, (name, number) in enumerate(types.items())
        ]
        self._write("/points", stamp, "sensor_msgs/msg/PointCloud2", header=self._header(stamp, "lidar"), height=1,
                    width=len(rows), fields=fields, is_bigendian=False, point_step=16, row_step=16 * len(rows),
                    data=rows.view(np.uint8), is_dense=True)  # fmt: skip

    def odometry(self, stamp: int, T: F64) -> None:
        """Write the pose of the lidar."""
        x, y, z, w = (float(value) for value in Rotation.from_matrix(T[:3, :3]).as_quat())
        zero = self._make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        pose = self._make(
            "geometry_msgs/msg/Pose",
            position=self._make("geometry_msgs/msg/Point", **dict(zip("xyz", T[:3, 3].tolist(), strict=True))),
            orientation=self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        )
        twist = self._make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        none = np.zeros(36)
        with_spread = {
            "pose": self._make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=none),
            "twist": self._make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=none),
        }
        header = self._header(stamp, "odom")
        self._write("/odom", stamp, "nav_msgs/msg/Odometry", header=header, child_frame_id="lidar", **with_spread)

    def _make(self, kind: str, **values: Any) -> Any:
        return self._store.types[kind](**values)

    def _header(self, stamp: int, frame: str) -> Any:
        time = self._make("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        return self._make("std_msgs/msg/Header", stamp=time, frame_id=frame)

    def _write(self, topic: str, stamp: int, kind: str, **values: Any) -> None:
        if topic not in self._topics:
            self._topics[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        self._writer.write(self._topics[topic], stamp, self._store.serialize_cdr(self._make(kind, **values), kind))


def write_drive(path: Path, preset: Preset, frames: int, seed: int = 0) -> list[U8]:
    """Write a drive; the labels of each cloud. Stamps are those of the first point of a sweep."""
    recorder = SceneRecorder(build(preset, frames, seed), preset, frames, seed)
    scene, sensor, labels = recorder.scene, recorder.sensor, list[U8]()
    with BagOfClouds(path) as bag:
        for k in range(frames):
            sweep, middle = recorder.sweep(k), k / (sensor.rate or 10.0)
            points = geometry.apply(geometry.inverse(sweep.T_world_sensor), sweep.points.astype(np.float64))
            rays = sweep_rays(sensor, k, np.random.default_rng([seed, 2, k]))
            _, ray = cKDTree(rays.directions).query(points / np.linalg.norm(points, axis=1, keepdims=True))
            offsets = np.round(ray_shares(rays)[ray] * SWEEP * 1e9).astype(np.int64)
            bag.cloud(START + round((middle - SWEEP / 2) * 1e9), points, offsets)
            labels.append(sweep.labels)
        for time in np.arange(-2 * SWEEP, (frames + 2) / (sensor.rate or 10.0), STEP):
            bag.odometry(START + round(time * 1e9), sensor_pose(scene, sensor, float(time)))
    return labels


def errors(found: Sequence, true: Sequence) -> tuple[float, float, float, float]:
    """Root mean square errors after alignment, metres and degrees; largest errors of a step between frames."""
    a, b = (np.array([s[k].T_world_sensor for k in range(len(s))]) for s in (found, true))
    x, y = a[:, :3, 3] - a[:, :3, 3].mean(0), b[:, :3, 3] - b[:, :3, 3].mean(0)
    turn, *_ = Rotation.align_vectors(y, x)
    steps = [geometry.compose(np.array([geometry.inverse(T) for T in T_ab[:-1]]), T_ab[1:]) for T_ab in (a, b)]
    step = np.linalg.norm(steps[0][:, :3, 3] - steps[1][:, :3, 3], axis=1)
    position = float(np.sqrt(((turn.apply(x) - y) ** 2).sum(1).mean()))
    apart = Rotation.from_matrix(a[:, :3, :3] @ np.swapaxes(b[:, :3, :3], 1, 2))
    rotation = float(np.degrees(np.sqrt(((apart.mean().inv() * apart).magnitude() ** 2).mean())))
    twist = Rotation.from_matrix(np.swapaxes(steps[1][:, :3, :3], 1, 2) @ steps[0][:, :3, :3]).magnitude()
    return position, rotation, float(step.max()), float(np.degrees(twist.max()))


def variants(bag: Path, folder: Path, odometries: list[str], refined: bool) -> Iterator[tuple[str, Sequence]]:
    """The bag with each source of poses."""
    yield "given", dv.open(bag)
    for name in odometries:
        estimated = open_source(bag, SequenceOptions(poses=name), folder=folder)
        yield f"`--poses {name}`", estimated
        if refined:
            yield f"`--poses {name} --refine-poses`", refine(estimated)


def main(arguments: Iterable[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--method", default="seethrough")
    parser.add_argument("--frames", type=int, default=80)
    parser.add_argument("--sensor", default="vlp16")
    parser.add_argument("--speed", type=float, default=8.0, help="m/s")
    parser.add_argument("--refine", action="store_true", help="also refine the estimated poses")
    parser.add_argument("--odometries", nargs="*", default=["small-gicp", "kiss-icp"])
    parser.add_argument("--no-scores", action="store_true", help="print the errors of the poses only")
    options = parser.parse_args(None if arguments is None else list(arguments))
    street = PRESETS["street_hdl64" if options.sensor == "hdl64e" else "street_vlp16"]
    effects = replace(street.effects, sweep_s=SWEEP, raw=1)
    preset = replace(street, sensor=options.sensor, speed=options.speed, pose_noise=(0.0, 0.0), effects=effects)
    names = ("poses", "positions", "rotations", "largest step", "largest turn", "SA", "DA", "AA")
    print(f"| {' | '.join(names)} |\n{'|---' * len(names)}|")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        labels = write_drive(folder / "drive", preset, options.frames)
        true = dv.open(folder / "drive")
        for name, sequence in variants(folder / "drive", folder, options.odometries, options.refine):
            position, rotation, step, twist = errors(sequence, true)
            scores = ""
            if not options.no_scores:
                found = dv.run(options.method, WithLabels(sequence, labels), record="none", threads=1).metrics
                scores = " | ".join(f"{found[key] or 0:.2f}" for key in ("SA", "DA", "AA"))
            print(
                f"| {name} | {position:.3f} m | {rotation:.2f}° | {step:.3f} m | {twist:.2f}° | {scores} |", flush=True
            )


if __name__ == "__main__":
    main()
