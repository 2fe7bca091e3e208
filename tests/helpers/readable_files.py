"""Everything that reads files: how to make a small valid example, and how to read it completely."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz.api import run
from dynaviz.benchmarking.plan_file import plan_of, read
from dynaviz.contracts.params import resolve
from dynaviz.contracts.registry import load
from dynaviz.contracts.scan import Scan
from dynaviz.engine.external import PrecomputedLabels
from dynaviz.io.benchmark import BenchmarkWriter
from dynaviz.io.fields import read_points
from dynaviz.io.kitti import read_boxes, read_calib
from dynaviz.io.maps import open_map
from dynaviz.io.pcd import ENCODINGS, read_pcd
from dynaviz.io.poses import read_poses
from dynaviz.scores.regression import read_baseline, write_baseline
from dynaviz.scores.result import Result
from dynaviz.sources.datasets import open_sequence
from dynaviz.views.read.reader import RunRecording
from helpers.argoverse2_files import write_log
from helpers.bags import BagWriter, at, columns
from helpers.guessing_method import record, run_into
from helpers.kitti_files import write_odometry, write_raw_drive, write_semantickitti, write_tracking
from helpers.labelled_files import write_moe, write_pandaset, write_sustech
from helpers.mos_files import write_doals, write_helimos
from helpers.nuscenes_files import write_nuscenes
from helpers.pcd_files import write_encoded
from helpers.scan_folders import POSES, STAMPS, write_kitti_poses, write_scans, write_tum_poses
from helpers.worlds import room


@dataclass(frozen=True)
class Subject:
    """A reader and an example of its input.

    Attributes:
        make: writes a valid example into an empty folder.
        read: reads the example completely, given the return value of ``make``.
        target: files to damage, as a glob below the folder.
    """

    make: Callable[[Path], Path]
    read: Callable[[Path], Any]
    target: str = "*"


def every_scan(name: str, step: int = 1, poses: str | None = None) -> Callable[[Path], None]:
    """Open a sequence in a given format, with a file of poses next to it, and read all its scans,
    or every n-th.
    """

    def read(path: Path) -> None:
        options = {} if poses is None else {"poses": str(path.with_name(poses))}
        sequence = open_sequence(f"{name}:{path}", **options)
        assert len(sequence) > 0
        for position in range(0, len(sequence), step):
            scan = sequence[position]
            assert isinstance(scan, Scan)
            R = scan.T_world_sensor[:3, :3]
            assert np.isfinite(scan.T_world_sensor).all(), "a pose is not finite"
            assert np.abs(R @ R.T - np.eye(3)).max() < 0.1, "a pose is not rigid"
            assert scan.stamp_ns is None or abs(scan.stamp_ns) < 1 << 63
        _ = sequence.name, sequence.has_labels, getattr(sequence, "facts", {})

    return read


def clouds(suffix: str, **more: Any) -> Subject:
    """A scan in one file format."""

    def make(folder: Path) -> Path:
        write_scans(folder, suffix)
        for path in sorted(folder.iterdir())[2:]:
            path.unlink()
        return next(iter(sorted(folder.iterdir())))

    return Subject(make, read_points, f"*{suffix}", **more)


def pcd(encoding: str) -> Subject:
    def make(folder: Path) -> Path:
        random = np.random.default_rng(0)
        fields = {axis: random.normal(size=40).astype(np.float32) for axis in "xyz"}
        write_encoded(
            folder / "a.pcd",
            {**fields, "label": np.zeros((40, 2), np.uint8)},
            at(1, 2, 3, 0.5),
            encoding,
        )
        return folder / "a.pcd"

    def read(path: Path) -> None:
        cloud = read_pcd(path)
        assert len(cloud.xyz) == cloud.header.points
        _ = cloud.T_world_sensor

    return Subject(make, read)


def scans_with_poses(suffix: str, poses: str) -> Subject:
    """A folder of scans with a pose file."""

    def make(folder: Path) -> Path:
        names = None if poses == "poses.txt" else [str(stamp) for stamp in STAMPS]
        write_scans(folder, suffix, names)
        if poses == "poses.txt":
            write_kitti_poses(folder / poses)
            (folder / "labels").mkdir()
            np.save(folder / "labels/000001.npy", np.zeros(40, np.uint8))
            np.zeros(40, "<u4").tofile(folder / "labels/000002.label")
        elif poses == "poses.tum":
            write_tum_poses(folder / poses, STAMPS, POSES)
        else:
            rows = [
                f"{t},{k},{x},{y},{z},0,0,0,1"
                for k, (t, (x, y, z)) in enumerate(zip(STAMPS, POSES[:, :3, 3], strict=True))
            ]
            (folder / poses).write_text(
                "\n".join(["timestamp [ns],index,x,y,z,qx,qy,qz,qw", *rows]) + "\n"
            )
        return folder

    return Subject(make, every_scan("files"), "**/*")


def bag(kind: str) -> Subject:
    def make(folder: Path) -> Path:
        xyz = np.random.default_rng(0).uniform(-20, 20, (3, 15, 3))
        with BagWriter(folder / "drive", kind) as writer:
            writer.transform(0, "base", "lidar", at(0, 0, 1), static=True)
            for k in range(3):
                more = {"time": np.linspace(0, 0.1, 15).astype("f4")}
                writer.cloud(k / 10, columns(xyz[k], **more))
                writer.odometry(k / 10, at(k), child="base")
        return writer.path

    return Subject(make, every_scan("rosbag"), "**/*")


def merged_map(suffix: str) -> Subject:
    """A map whose points have times, and a trajectory."""

    def make(folder: Path) -> Path:
        path, xyz = folder / f"survey{suffix}", np.random.default_rng(0).uniform(-20, 20, (90, 3))
        times = STAMPS[0] / 1e9 + np.linspace(0, 0.25, 90)
        fields: dict[str, Any] = {"gps_time": times, "intensity": np.arange(90, dtype=np.uint16)}
        with open_map(
            path, {name: array.dtype for name, array in fields.items()}, np.zeros(3)
        ) as append:
            append(xyz, fields)
        write_tum_poses(
            folder / "trajectory.tum", [STAMPS[0] + k * 100_000_000 for k in range(4)], POSES[:4]
        )
        return path

    return Subject(make, every_scan("merged", poses="trajectory.tum"))


def tiny_benchmark(folder: Path) -> Path:
    """Two scans in the layout of the public benchmark."""
    with BenchmarkWriter(folder / "demo") as writer:
        for scan in room(2, 30).scans:
            assert scan.labels is not None
            points, classes = scan.points.astype(np.float32), scan.labels.astype(np.uint16)
            writer.append(scan.index, points, scan.T_world_sensor)
            writer.append_truth(points, scan.labels, classes, classes.astype(np.int32))
        facts = {"name": "demo", "sensor": "hdl64e", "rate": 10.0}
        writer.describe(facts, {0: "static", 1: "dynamic"})
    return folder / "demo"


def finished(folder: Path) -> Path:
    """The files of a run."""
    run_into(folder / "out", room(3, 300))
    return folder / "out"


def scored(folder: Path) -> Path:
    """The result of a run with all metrics."""
    run("octomap", room(4, 600), out=folder / "out", record="none")
    return folder / "out"


def answers(path: Path) -> None:
    """Read the labels of a run for each scan of its sequence."""
    labels = PrecomputedLabels(path, "labels")
    for scan in room(3, 300).scans:
        answer = labels.label(scan)
        assert len(answer.dynamic) == len(answer.reasons) == len(scan)


def baseline(folder: Path) -> Path:
    out = scored(folder)
    write_baseline(out / "baseline.json", [Result.load(out / "result.json")])
    return out


BENCH = """
methods = ["octomap"]
record = "none"
workers = 2
[[sequences]]
simulate = "demo"
frames = 3
[[sequences]]
path = "somewhere"
name = "there"
frames = "0:9"
[[variants]]
method = "erasor"
name = "fine"
set = { max_range = 60.0 }
[grid]
octomap = { resolution = [0.1, 0.2] }
[search]
kind = "random"
trials = 3
[search.ranges]
octomap = { resolution = [0.05, 0.4] }
"""


def bench(folder: Path) -> Path:
    (folder / "bench.toml").write_text(BENCH)
    return folder / "bench.toml"


def config(folder: Path) -> Path:
    (folder / "config.toml").write_text(
        "[run]\nonline = true\nseed = 3\n[octomap]\nresolution = 0.2\n"
    )
    return folder / "config.toml"


def text(name: str, content: str, read: Callable[[Path], Any]) -> Subject:
    def make(folder: Path) -> Path:
        (folder / name).write_text(content)
        return folder / name

    return Subject(make, read)


def recording(folder: Path) -> Path:
    return record(room(3, 100), folder / "run.rrd", "errors")


def recorded(path: Path) -> None:
    """Read everything that a recording contains."""
    run = RunRecording(path)
    _ = run.result, run.reasons, run.parameters, run.complete, run.facts(), run.entities()
    assert len(list(run.answers())) <= run.frames
    assert len(list(run.drawn())) <= run.frames


def keyframes(folder: Path) -> Path:
    """A nuScenes scene without the files of its camera, which are not read."""
    root = write_nuscenes(folder)
    for channel in root.glob("*/CAM_FRONT"):
        shutil.rmtree(channel)
    return root


DATASETS: dict[str, Callable[[Path], Path]] = {
    "argoverse2": write_log,
    "benchmark": tiny_benchmark,
    "doals": write_doals,
    "files": scans_with_poses(".bin", "poses.txt").make,
    **dict.fromkeys(("helimos", "helimos_test", "helimos_train", "helimos_val"), write_helimos),
    "kitti_odometry": write_odometry,
    "kitti_raw": write_raw_drive,
    "kitti_tracking": write_tracking,
    "moe": write_moe,
    "nuscenes": keyframes,
    "pandaset": write_pandaset,
    "rosbag": bag("ros1").make,
    "semantickitti": write_semantickitti,
    "sustechpoints": write_sustech,
}
"""By name in the registry."""

SUBJECTS: dict[str, Subject] = {
    **{name: Subject(make, every_scan(name), "**/*") for name, make in DATASETS.items()},
    **{f"merged{suffix}": merged_map(suffix) for suffix in (".las", ".ply", ".pcd")},
    **{
        f"files{suffix}": scans_with_poses(suffix, "poses.tum")
        for suffix in (".npz", ".pcd", ".ply")
    },
    "files-csv": scans_with_poses(".bin", "poses.csv"),
    **{f"rosbag-{kind}": bag(kind) for kind in ("sqlite3", "mcap")},
    **{f"pcd-{encoding}": pcd(encoding) for encoding in ENCODINGS},
    **{f"points{suffix}": clouds(suffix) for suffix in (".npy", ".ply", ".las", ".laz")},
    "poses": text("a.txt", "".join(f"{t / 1e9} 1 2 3 0 0 0 1\n" for t in STAMPS), read_poses),
    "calib": text("a.txt", "P2: 1 0 0 0 0 1 0 0 0 0 1 0\nR: 1 0 0 0 1 0 0 0 1\n", read_calib),
    "boxes": text(
        "a.txt",
        "0 0 Car 0 0 0 0 0 9 9 2 2 4 1 1.7 9 0\n0 -1 DontCare -1 -1 -10 " + "-1 " * 11,
        read_boxes,
    ),
    "config.toml": Subject(config, lambda path: resolve(load("methods", "octomap"), config=path)),
    "bench.toml": Subject(bench, lambda path: plan_of(read(path), str(path))),
    "result.json": Subject(
        scored, lambda out: str(Result.load(out / "result.json")), "out/result.json"
    ),
    "baseline.json": Subject(
        baseline, lambda out: read_baseline(out / "baseline.json"), "out/baseline.json"
    ),
    "labels.npz": Subject(finished, lambda out: answers(out / "labels.npz"), "out/labels.npz"),
    "run.rrd": Subject(recording, recorded, "run.rrd"),
}


def parts(folder: Path, target: str) -> Iterator[Path]:
    """The files of an example to damage."""
    yield from sorted(path for path in folder.glob(target) if path.is_file())
