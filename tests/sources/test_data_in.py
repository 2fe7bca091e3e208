"""What people have, and what programs write: read rightly, or named.

Each situation is written from the same small street, whose truth is known.
"""

from __future__ import annotations

import json
import struct
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from helpers.bags import START, BagWriter, columns
from helpers.pose_files import kitti, quaternions, scans_to, tum
from helpers.street import HEIGHT, Sweep, drive
from scipy.spatial.transform import Rotation

import dynaviz as dv
from dynaviz.diagnosis import quick_check
from dynaviz.errors import DataError
from dynaviz.io.poses import read_poses
from dynaviz.scores.result import Result
from dynaviz.sources.datasets.pose_matching import parse_extrinsic
from dynaviz.sources.sensing import estimate_sensor
from dynaviz.spatial import geometry

UTM = np.array([388_421.0, 5_572_094.0, 120.0])
NEAR = 0.05  # metres of error that a right map may have


def assert_right(sequence: dv.Sequence, sweeps: Sequence[Sweep]) -> None:
    """All points are where they were, up to one motion of the whole world."""
    assert len(sequence) == len(sweeps)
    origin = sequence.origin
    move = sweeps[0].T @ geometry.inverse(sequence[0].T_world_sensor)
    for position, sweep in enumerate(sweeps):
        found = geometry.apply(move, sequence[position].points.astype(np.float64))
        assert np.linalg.norm(found - sweep.world, axis=1).max() < NEAR
    assert np.isfinite(origin).all()


def facts(sequence: dv.Sequence) -> dict[str, str]:
    """What ``info`` shows."""
    return dict(sequence.facts)


@pytest.mark.parametrize(
    "name",
    [
        lambda t: f"{t // 10**9}.{t % 10**9}",
        lambda t: f"{t // 10**9}_{t % 10**9:09d}",
        lambda t: str(t - START + 9_412_345_678),
    ],
    ids=["no zeros", "underscore", "since boot"],
)
def test_names_are_times(tmp_path: Path, name) -> None:  # type: ignore[no-untyped-def]
    sweeps = drive()
    times = [START + 11_149_430 + k * 100_000_000 for k in range(len(sweeps))]
    scans_to(tmp_path / "pcd", [name(t) for t in times], sweeps)
    kitti(tmp_path / "poses.txt", [s.T for s in sweeps])
    sequence = dv.open(tmp_path)
    assert_right(sequence, sweeps)
    assert "10 Hz" in facts(sequence)["names"]


def test_a_folder_of_scans_with_a_pose_file_is_not_the_benchmark(tmp_path: Path) -> None:
    sweeps = drive()
    scans_to(tmp_path / "pcd", [str(k) for k in range(len(sweeps))], sweeps)
    world = np.eye(4)
    world[:3, 3] = UTM
    kitti(tmp_path / "poses.txt", [world @ s.T for s in sweeps])
    sequence = dv.open(tmp_path)
    assert_right(sequence, sweeps)
    assert facts(sequence)["poses"].startswith("poses.txt (KITTI)")
    assert facts(sequence)["origin"].startswith("388000 5572000")


@pytest.mark.parametrize("w_first", [True, False])
def test_poses_without_times_show_the_order_of_their_quaternions(
    tmp_path: Path, w_first: bool
) -> None:
    sweeps = drive()
    scans_to(tmp_path / "pcd", [str(k) for k in range(len(sweeps))], sweeps)
    rows = quaternions([s.T for s in sweeps])
    np.savetxt(tmp_path / "pose.json", rows[:, [0, 1, 2, 6, 3, 4, 5]] if w_first else rows)
    sequence = dv.open(tmp_path)
    assert_right(sequence, sweeps)
    order = "qw qx qy qz" if w_first else "qx qy qz qw"
    assert f"read as x y z {order} (overlap" in facts(sequence)["poses"]


def test_poses_after_loop_closure_come_before_those_of_the_odometry(tmp_path: Path) -> None:
    sweeps = drive()
    scans_to(tmp_path / "Scans", [f"{k:06d}" for k in range(len(sweeps))], sweeps)
    kitti(tmp_path / "optimized_poses.txt", [s.T for s in sweeps])
    kitti(tmp_path / "odom_poses.txt", [s.T for s in sweeps[::-1]])
    np.savetxt(tmp_path / "times.txt", [s.seconds for s in sweeps])
    sequence = dv.open(tmp_path)
    assert_right(sequence, sweeps)
    assert facts(sequence)["poses"].startswith("optimized_poses.txt")


def test_a_file_that_may_be_poses_is_named_rather_than_ignored(tmp_path: Path) -> None:
    sweeps = drive()
    scans_to(tmp_path / "Scans", [f"{k:06d}" for k in range(len(sweeps))], sweeps)
    kitti(tmp_path / "result_of_my_slam.txt", [s.T for s in sweeps])
    with pytest.raises(DataError, match=r"files that may be poses: result_of_my_slam\.txt"):
        dv.open(tmp_path)


def test_a_pose_beside_each_scan(tmp_path: Path) -> None:
    sweeps = drive()
    times = [START + k * 100_000_000 for k in range(len(sweeps))]
    names = [f"{t // 10**9}_{t % 10**9:09d}" for t in times]
    scans_to(tmp_path, names, sweeps)
    for name, sweep in zip(names, sweeps, strict=True):
        np.savetxt(tmp_path / f"{name}.odom", sweep.T)
    assert_right(dv.open(tmp_path), sweeps)


def test_kitti_360_names_and_poses(tmp_path: Path) -> None:
    sweeps = drive()
    folder = scans_to(
        tmp_path / "data", [f"{k:010d}" for k in range(len(sweeps))], sweeps, suffix=".bin"
    )
    rows = [f"{k} " + " ".join(map(str, s.T[:3].ravel())) for k, s in enumerate(sweeps) if k % 5]
    (tmp_path / "poses13.txt").write_text("\n".join(rows) + "\n")
    with pytest.warns(UserWarning, match=r"3 of 14 scans have no pose"):
        sequence = dv.open(folder, poses=str(tmp_path / "poses13.txt"))
    assert_right(sequence, [s for k, s in enumerate(sweeps) if k % 5])
    times = tum(
        tmp_path / "t.tum", [s.T for s in sweeps], [START + k * 10**8 for k in range(len(sweeps))]
    )
    sequence = dv.open(folder, poses=str(times))
    assert_right(sequence, sweeps)
    assert facts(sequence)["poses"].endswith("by order")


@pytest.mark.parametrize(
    ("shift", "words"),
    [
        (18 * 10**9, "leap seconds (18 s)"),
        (-18 * 10**9, "leap seconds (18 s)"),
        (-315_964_782 * 10**9, "GPS time instead of Unix time"),
        (-(START - START % 1000) + 10**9, "both start at the same moment"),
    ],
    ids=["late", "early", "GPS", "relative"],
)
def test_poses_on_another_clock(tmp_path: Path, shift: int, words: str) -> None:
    sweeps = drive()
    times = [START + k * 100_000_000 for k in range(len(sweeps))]
    scans_to(tmp_path / "scans", [str(t) for t in times], sweeps)
    tum(tmp_path / "late.tum", [s.T for s in sweeps], [t + shift for t in times])
    sequence = dv.open(tmp_path)
    assert_right(sequence, sweeps)
    assert words in facts(sequence)["poses"]


def bag(path: Path, sweeps: Sequence[Sweep], deskewed: bool, wrong: int = 0) -> Path:
    """A bag of clouds with times in ns; some of every fourth cloud are impossible."""
    with BagWriter(path) as writer:
        for number, sweep in enumerate(sweeps):
            points = sweep.points
            if deskewed:
                here = geometry.apply(geometry.inverse(sweep.T), sweep.world)
                points = here.astype(np.float32)
            times = np.round(sweep.times * 1e9).astype(np.uint32)
            if wrong and number % 4 == 0:
                times[-wrong:] = 3_604_361_924
            writer.cloud(sweep.seconds, columns(points) | {"t": times})
    return writer.path


@pytest.mark.parametrize("deskewed", [True, False])
def test_clouds_are_deskewed_once(tmp_path: Path, deskewed: bool) -> None:
    sweeps = drive(frames=16, moving=True)
    file = bag(tmp_path / "drive", sweeps, deskewed)
    way = drive(frames=40, rate=20.0, rows=2, columns=4)
    poses = tum(
        tmp_path / "way.tum", [s.T for s in way], [START + round(s.seconds * 1e9) for s in way]
    )
    sequence = dv.open(file, poses=str(poses))
    assert_right(sequence, sweeps)
    said = facts(sequence)["deskewed"]
    assert said.startswith("no, points are deskewed already" if deskewed else "with the field t")
    assert "cm away with it" in said


def test_impossible_times_are_counted_and_replaced(tmp_path: Path) -> None:
    sweeps = drive(frames=16, moving=True)
    file = bag(tmp_path / "drive", sweeps, False, wrong=150)
    way = drive(frames=40, rate=20.0, rows=2, columns=4)
    poses = tum(
        tmp_path / "way.tum", [s.T for s in way], [START + round(s.seconds * 1e9) for s in way]
    )
    sequence = dv.open(file, poses=str(poses))
    with pytest.warns(
        UserWarning, match=r"150 of [\d,]+ points of cloud 0 have an impossible time"
    ):
        assert_right(sequence, sweeps)
    assert facts(sequence)["impossible times"] == "600 points in 4 clouds"


@pytest.mark.filterwarnings("ignore:the sensor is unknown")
def test_what_was_assumed_is_stated_everywhere(
    tmp_path: Path, run_command: Callable[..., tuple[int, str, str]]
) -> None:
    """In ``info``, in the summary and in the result."""
    sweeps = drive()
    times = [START + k * 100_000_000 for k in range(len(sweeps))]
    scans_to(tmp_path / "drive/scans", [str(t) for t in times], sweeps, suffix=".bin")
    mount = np.eye(4)
    mount[:3, 3] = 1.0, 0.0, 0.5
    tum(tmp_path / "drive/a.tum", [s.T @ geometry.inverse(mount) for s in sweeps], times)
    options = {"extrinsic": "1,0,0.5,0,0,0"}
    cleaned = dv.clean(tmp_path / "drive", tmp_path / "clean.pcd", record="none", **options)
    stated = {
        "poses": "a.tum (TUM), by stamp",
        "times": "ns since 1970, 10 Hz",
        "points in": "sensor frame",
        "deskewed": "no, scans are taken as they are",
        "columns": "x y z intensity",
        "units": "metres",
        "mount": "1,0,0.5,0,0,0",
        "coordinates": "float32",
    }
    reading = Result.load(tmp_path / "clean_run/result.json").reading
    assert reading is not None
    code, out, _ = run_command(
        "info", str(tmp_path / "drive"), "--json", "-", "--extrinsic", options["extrinsic"]
    )
    assert code == 0
    shown = json.loads(out)
    page = (tmp_path / "clean_run/summary.md").read_text(encoding="utf-8")
    assert page == cleaned.markdown()
    csv = read_poses(tmp_path / "clean_run/trajectory.csv")
    written = read_poses(tmp_path / "clean_run/trajectory.tum")
    assert csv.stamps is not None
    assert written.stamps is not None
    assert (written.stamps == csv.stamps).all()
    assert np.allclose(written.poses, csv.poses, atol=1e-9)
    for name, value in stated.items():
        assert dict(reading.rows())[name].startswith(value)
        assert shown[name].startswith(value)
        assert f"| {name} | {value}" in page


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_a_drive_split_into_several_bags(tmp_path: Path, kind: str) -> None:
    """Only the first part has the static transform of the lidar."""
    sweeps = drive()
    lidar = np.eye(4)
    lidar[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    lidar[:3, 3] = 1.5, 0.0, 0.2
    half = len(sweeps) // 2
    for part, own in enumerate((sweeps[:half], sweeps[half:])):
        with BagWriter(tmp_path / f"part_{part}", kind) as bag:
            if not part:
                bag.transform(0.0, "base_link", "lidar", lidar, static=True)
            for sweep in own:
                base = sweep.T @ geometry.inverse(lidar)
                bag.transform(sweep.seconds, "odom", "base_link", base)
                bag.cloud(sweep.seconds, columns(sweep.points))
    folder = tmp_path / "drive"
    folder.mkdir()
    for part in range(2):
        if kind == "ros1":
            (tmp_path / f"part_{part}.bag").rename(folder / f"drive_{part}.bag")
        else:
            (file,) = (tmp_path / f"part_{part}").glob("*.mcap")
            file.rename(folder / f"drive_{part}.mcap")
    assert_right(dv.open(folder), sweeps)


@pytest.mark.parametrize(
    ("encoding", "advice"), [("ros1", "rosbags-convert"), ("protobuf", "PointCloud2 in CDR")]
)
def test_an_mcap_file_of_other_messages_is_not_called_corrupt(
    tmp_path: Path, encoding: str, advice: str
) -> None:
    def text(words: str) -> bytes:
        return struct.pack("<I", len(words)) + words.encode()

    def record(kind: int, content: bytes) -> bytes:
        return bytes([kind]) + struct.pack("<Q", len(content)) + content

    schema = struct.pack("<H", 1) + text("foxglove.PointCloud") + text(encoding) + text("")
    channel = struct.pack("<HH", 0, 1) + text("/points") + text(encoding) + struct.pack("<I", 0)
    start = b"\x89MCAP0\r\n" + record(0x01, text("") + text("library"))
    end = record(0x02, struct.pack("<QQI", len(start), 0, 0)) + b"\x89MCAP0\r\n"
    path = tmp_path / "drive.mcap"
    path.write_bytes(start + record(0x03, schema) + record(0x04, channel) + end)
    with pytest.raises(DataError, match=f"intact MCAP file with messages in {encoding}") as raised:
        dv.open(path)
    assert advice in str(raised.value)


@pytest.mark.parametrize("mount", ["0,0,0,180,0,0", "0,0,0,0,20,90", "0,0,0,0,-30,0", "spinning"])
def test_the_height_of_a_sensor_that_is_turned(mount: str) -> None:
    """Upside down, tilted, or turning about a tilted axis."""
    scans = []
    for k, sweep in enumerate(drive()):
        angle = 0.7 * k if mount == "spinning" else 0.0
        text = f"0,0,0,0,25,{np.degrees(angle)}" if mount == "spinning" else mount
        turn = parse_extrinsic(text)
        assert turn is not None
        own = geometry.apply(geometry.inverse(turn), sweep.points.astype(float))
        scans.append((own.astype(np.float32), sweep.T @ turn))
    found = estimate_sensor(dv.open(scans)).height
    assert found == pytest.approx(HEIGHT, abs=0.1)


def test_frames_that_were_not_chosen_are_not_outside_the_trajectory(tmp_path: Path) -> None:
    sweeps = drive()
    with BagWriter(tmp_path / "drive") as bag:
        for sweep in sweeps:
            bag.odometry(sweep.seconds, sweep.T)
            bag.cloud(sweep.seconds, columns(sweep.points))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        account = dv.clean(bag.path, tmp_path / "clean.pcd", frames="2:8", record="none").account
    assert account.points == sum(len(sweep.points) for sweep in sweeps[2:8])
    assert account.unposed_kept == 0


def test_coordinates_in_float32_far_from_zero_are_named(tmp_path: Path) -> None:
    """At 5,572,094 m, float32 has steps of half a metre."""
    sweeps = drive()
    (tmp_path / "scans").mkdir()
    for k, sweep in enumerate(sweeps):
        np.save(tmp_path / f"scans/{k:06d}.npy", (sweep.world + UTM).astype(np.float32))
    world = np.eye(4)
    world[:3, 3] = UTM
    kitti(tmp_path / "poses.txt", [world @ sweep.T for sweep in sweeps])
    (finding,) = quick_check(dv.open(tmp_path, points_in="world"))
    assert finding.name == "coarse coordinates"
    assert "steps of 0.5 m in y" in finding.problem
    assert "subtract an offset" in finding.fix


@pytest.mark.parametrize("shuffled", [False, True], ids=["in order", "shuffled"])
def test_five_columns_under_the_name_of_nuscenes(tmp_path: Path, shuffled: bool) -> None:
    sweeps = drive()
    (tmp_path / "scans").mkdir()
    for k, sweep in enumerate(sweeps):
        rows = np.zeros((len(sweep.points), 5), "<f4")
        rows[:, :3] = sweep.points
        rows[:, 3] = np.random.default_rng(k).integers(0, 256, len(rows))
        elevation = np.arcsin(sweep.points[:, 2] / np.linalg.norm(sweep.points, axis=1))
        rows[:, 4] = np.round((np.degrees(elevation) + 22) / 34 * 15)
        order = np.random.default_rng(k).permutation(len(rows)) if shuffled else slice(None)
        rows[order].tofile(tmp_path / f"scans/scan_{k:06d}.pcd.bin")
    kitti(tmp_path / "poses.txt", [sweep.T for sweep in sweeps])
    sequence = dv.open(tmp_path)
    assert facts(sequence)["columns"] == "x y z intensity ring"
    for position, sweep in enumerate(sweeps):
        found = sequence[position].points.astype(np.float64)
        assert np.abs(np.sort(found, axis=0) - np.sort(sweep.world, axis=0)).max() < 1e-3


def test_poses_of_boreas(tmp_path: Path) -> None:
    """Its angles turn the world to the lidar, about x, then y, then z."""
    sweeps = drive()
    times = [START // 1000 + k * 100_000 for k in range(len(sweeps))]
    scans_to(tmp_path / "lidar", [str(t) for t in times], sweeps, suffix=".bin")
    lines = ["GPSTime,easting,northing,altitude,roll,pitch,heading"]
    for t, sweep in zip(times, sweeps, strict=True):
        angles = Rotation.from_matrix(sweep.T[:3, :3].T).as_euler("xyz")
        lines.append(f"{t}," + ",".join(f"{x:.9f}" for x in (*sweep.T[:3, 3], *angles)))
    (tmp_path / "applanix").mkdir()
    poses = tmp_path / "applanix/lidar_poses.csv"
    poses.write_text("\n".join(lines) + "\n")
    assert_right(dv.open(tmp_path / "lidar", poses=str(poses)), sweeps)
