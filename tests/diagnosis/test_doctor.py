"""The doctor finds each fault inserted into a good sequence, and nothing else.

Good sequences have no findings.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator
from functools import partial
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.worlds import thinned
from scipy.spatial.transform import Rotation

import dynaviz as dv
from dynaviz.arrays import F32, F64
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.diagnosis import Confidence, Diagnosis, doctor, quick_check
from dynaviz.errors import DataError
from dynaviz.io.pcd import read_pcd, write_pcd
from dynaviz.sources.drive import Drive
from dynaviz.synthetic.simulate import simulate
from dynaviz.testing import InMemory
from dynaviz.testing.world import SENSOR, crossing

SCANS = thinned(crossing())
FEW = SCANS[:6]  # for faults that show in single scans


def diagnose(scans: list[Scan], sensor: Sensor = SENSOR) -> Diagnosis:
    return doctor(InMemory(scans, "crossing", sensor))


def names(found: Diagnosis) -> list[str]:
    return [finding.name for finding in found.findings]


def changed(scan: Scan, **fields: Any) -> Scan:
    """The scan with other fields; the ray origin follows the pose."""
    return dataclasses.replace(scan, **{"origins": None, **fields})


def in_sensor_frame(scan: Scan) -> F64:
    T = scan.T_world_sensor
    return (scan.points - T[:3, 3]) @ T[:3, :3]


def placed(points: F64, T: F64) -> F32:
    return (points @ T[:3, :3].T + T[:3, 3]).astype(np.float32)


def test_a_good_sequence_has_no_findings() -> None:
    found = diagnose(SCANS)
    assert found.ok, found
    assert (found.frames, found.examined) == (12, 12)
    assert "no problems found" in str(found)


# Pose faults: in one test the points are placed by the wrong pose, in another only the pose is
# wrong.
OPTICAL = np.array(
    [[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]
)  # camera axes in a lidar's frame


def shuffled(T: F64, order: list[int]) -> F64:
    """The pose with the components of its quaternion (x, y, z, w) in another order."""
    wrong = T.copy()
    wrong[:3, :3] = Rotation.from_quat(Rotation.from_matrix(T[:3, :3]).as_quat()[order]).as_matrix()
    return wrong


POSES: dict[str, tuple[str, Callable[[F64], F64]]] = {
    "inverse": ("poses inverted", np.linalg.inv),
    "camera": ("poses of a camera", lambda T: np.linalg.inv(OPTICAL) @ T @ OPTICAL),
    "camera's axes": ("poses of a camera", lambda T: T @ OPTICAL),
    "xyzw as wxyz": (
        "quaternion order",
        lambda T: shuffled(T, [1, 2, 3, 0]),
    ),  # w <- x, x <- y, y <- z, z <- w
    "wxyz as xyzw": ("quaternion order", lambda T: shuffled(T, [3, 0, 1, 2])),
    "zero": ("poses missing", lambda T: np.eye(4)),
}


ORDERS = [list(order) for order in permutations(range(4)) if order != (0, 1, 2, 3)]
UNITS = {"millimetres": 1000.0, "centimetres": 100.0}


def faulty() -> Iterator[tuple[str, str, list[Scan]]]:
    """Name, expected finding and scans of faults.

    Orders of quaternions, inversion, axes, units, frames.
    """
    # Some, for time; swapping x and y hardly tilts a sensor that turns about z.
    chosen = [order for order in ORDERS[::7] if order != [1, 0, 2, 3]]
    orders = {
        f"quaternion {order}": ("quaternion order", partial(shuffled, order=order))
        for order in chosen
    }
    scaled = {unit: (unit, partial(far_apart, factor=factor)) for unit, factor in UNITS.items()}
    for kind, (name, wrong) in {**POSES, **orders, **scaled}.items():
        poses = [wrong(scan.T_world_sensor) for scan in SCANS]
        placed_there = [
            placed(in_sensor_frame(scan), T) for scan, T in zip(SCANS, poses, strict=True)
        ]
        yield f"{kind}, points placed", name, renewed(poses, placed_there)
        if kind not in orders:
            yield f"{kind}, poses only", name, renewed(poses, [scan.points for scan in SCANS])
    own = [scan.T_world_sensor for scan in SCANS]
    yield (
        "sensor frame",
        "points in sensor frame",
        renewed(own, [in_sensor_frame(scan) for scan in SCANS]),
    )
    twice = [placed(scan.points.astype(np.float64), scan.T_world_sensor) for scan in SCANS]
    yield "twice transformed", "points in world frame", renewed(own, twice)
    for unit, factor in UNITS.items():
        yield (
            f"points in {unit}",
            unit,
            renewed(own, [placed(in_sensor_frame(s) * factor, s.T_world_sensor) for s in SCANS]),
        )


def far_apart(T: F64, factor: float) -> F64:
    return np.block([[T[:3, :3], factor * T[:3, 3:]], [T[3:]]])


def renewed(poses: list[F64], points: list[Any]) -> list[Scan]:
    return [
        changed(scan, points=np.asarray(xyz, np.float32), T_world_sensor=T, labels=None)
        for scan, T, xyz in zip(SCANS, poses, points, strict=True)
    ]


FAULTY = {name: (finding, scans) for name, finding, scans in faulty()}
OFTEN = {  # in each run of the tests: each finding, with certainty and without
    "inverse, points placed", "inverse, poses only", "camera, points placed", "camera's axes, "
    "poses only",
    "xyzw as wxyz, points "
    "placed", "xyzw as wxyz, poses only", "zero, points placed", "millimetres, points placed",
    "sensor frame", "twice transformed", "points in centimetres",
}  # fmt: skip


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[] if kind in OFTEN else pytest.mark.slow) for kind in FAULTY]
)
def test_doctor_and_quick_check_name_wrong_poses_units_and_frames(kind: str) -> None:
    expected, scans = FAULTY[kind]
    diagnosis = diagnose(
        [changed(scan, labels=truth.labels) for scan, truth in zip(scans, SCANS, strict=True)]
    )
    assert names(diagnosis) == [expected], diagnosis
    finding = diagnosis.findings[0]
    if kind in ("sensor frame", "twice transformed"):
        assert f"--points-in {'sensor' if kind == 'sensor frame' else 'world'}" in finding.fix
    elif expected not in UNITS:
        usual = not kind.startswith("quaternion")
        alone = not re.search("the same with|fits alike", finding.problem)
        certain = kind.endswith("points placed") and (usual or alone)
        assert finding.confidence is (Confidence.CERTAIN if certain else Confidence.LIKELY)
    assert [each.name for each in quick_check(Drive.of(InMemory(scans, "crossing", SENSOR)))] == [
        expected
    ]


def test_a_stationary_sensor_has_no_findings() -> None:
    points = in_sensor_frame(SCANS[0])
    noise = np.random.default_rng(1)
    scans = [
        Scan(k, points + noise.normal(0, 0.01, points.shape), np.eye(4), None, SCANS[0].labels)
        for k in range(6)
    ]
    assert diagnose(scans).ok


def test_a_jump_is_found_where_it_is() -> None:
    scans = list(SCANS)
    T = np.eye(4)
    T[:2, 3] = 4.0, 3.0
    for k in range(6, len(scans)):
        scans[k] = changed(
            scans[k],
            points=placed(scans[k].points.astype(np.float64), T),
            T_world_sensor=T @ scans[k].T_world_sensor,
        )
    found = diagnose(scans)
    assert names(found) == ["poses jump"], found
    assert found.findings[0].frames == (6,)
    assert "jumps by 5." in found.findings[0].problem or "jumps by 4." in found.findings[0].problem


def spinning(columns: int, order: tuple[int, ...] = (0, 1, 2, 3)) -> F32:
    """A room of 12 x 8 m as 16 rows of a spinning lidar, with intensity and further columns."""
    azimuth, elevation = (
        np.tile(np.linspace(0, 2 * np.pi, 300), 16),
        np.radians(np.repeat(np.arange(-15, 17, 2), 300)),
    )
    rays = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        1,
    )
    ranges = (np.array([6.0, 4.0, 2.0]) / np.maximum(np.abs(rays), 1e-6)).min(1)
    rows = np.zeros((len(rays), columns), np.float32)
    rows[:, :3], rows[:, 3] = (
        rays * ranges[:, None],
        np.random.default_rng(0).uniform(0, 1, len(rays)),
    )
    rows[:, 4:] = np.repeat(np.arange(16), 300)[:, None]
    rows[:, :4] = rows[:, order]
    return rows


@pytest.mark.parametrize(
    ("rows", "confidence", "problem"),
    [
        (
            spinning(5),
            Confidence.CERTAIN,
            "5 columns (x y z intensity ring), but this layout reads 4",
        ),
        (spinning(4, (3, 0, 1, 2)), Confidence.LIKELY, "column 4 has negative values at"),
    ],
)
def test_wrong_columns(tmp_path: Path, rows: F32, confidence: Confidence, problem: str) -> None:
    """In the layout of KITTI odometry, whose files have four columns."""
    folder = tmp_path / "sequences/00/velodyne"
    folder.mkdir(parents=True)
    for frame in range(3):
        rows.tofile(folder / f"{frame:06d}.bin")
    np.savetxt(tmp_path / "sequences/00/poses.txt", np.tile(np.eye(4)[:3].ravel(), (3, 1)))
    (tmp_path / "sequences/00/calib.txt").write_text("Tr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n")
    found = doctor(dv.open(f"kitti_odometry:{tmp_path / 'sequences/00'}"))
    assert names(found) == ["columns"], found
    assert found.findings[0].confidence is confidence
    assert problem in found.findings[0].problem
    right = spinning(4)
    for frame in range(3):
        right.tofile(folder / f"{frame:06d}.bin")
    assert "columns" not in names(doctor(dv.open(f"kitti_odometry:{tmp_path / 'sequences/00'}")))


def test_an_origin_outside_its_cloud() -> None:
    far = np.eye(4)
    far[0, 3] = 500.0
    found = diagnose([changed(scan, T_world_sensor=far @ scan.T_world_sensor) for scan in SCANS])
    assert len(found.findings) == 1, found
    assert names(found)[0] in ("origin outside", "origin elsewhere")


def with_points(scan: Scan, rows: slice, points: Any) -> Scan:
    changed_points = scan.points.copy()
    changed_points[rows] = points
    return changed(scan, points=changed_points)


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("not finite", lambda s: with_points(s, slice(0, 40), np.nan)),
        ("not finite", lambda s: with_points(s, slice(7, 8), np.inf)),
        ("far points", lambda s: with_points(s, slice(0, 1), 2e5)),
        ("no return", lambda s: with_points(s, slice(0, 500), s.position)),
        ("no return", lambda s: with_points(s, slice(0, 500), 0.0)),
        ("duplicate points", lambda s: with_points(s, slice(0, 200), s.points[200:400])),
        ("empty frame", lambda s: changed(s, points=s.points[:0], labels=s.labels[:0])),
        ("empty frame", lambda s: with_points(s, slice(None), np.nan)),
    ],
)  # fmt: skip
def test_bad_points_in_one_scan(name: str, fault: Callable[[Scan], Scan]) -> None:
    scans = list(FEW)
    scans[4] = fault(scans[4])
    found = diagnose(scans)
    wanted = {name} | ({"not finite"} if name == "empty frame" and len(scans[4]) else set())
    assert set(names(found)) == wanted, found
    assert all(
        (f.frames, f.count, f.confidence) == ((4,), 1, Confidence.CERTAIN) for f in found.findings
    )


@pytest.mark.parametrize(("columns", "ok"), [(2, True), (40, False)])
def test_ego_points_are_reported_if_they_block_many_rays(columns: int, ok: bool) -> None:
    """Points 0.4 m from the sensor, in some of 400 directions."""
    scans = []
    for scan in FEW:
        rays = in_sensor_frame(scan)[:columns]
        rays *= 0.4 / np.linalg.norm(rays, axis=1, keepdims=True)
        scans.append(with_points(scan, slice(0, columns), placed(rays, scan.T_world_sensor)))
    found = diagnose(scans)
    assert names(found) == ([] if ok else ["ego points"]), found
    if not ok:
        assert "--set min_range=0.6" in found.findings[0].fix
        assert "dufomap" in found.findings[0].fix
        assert found.findings[0].count == len(scans)


def test_duplicate_frames_missing_numbers_and_bad_stamps() -> None:
    twice = [*SCANS[:4], changed(SCANS[3], index=4, stamp_ns=SCANS[4].stamp_ns), *SCANS[5:7]]
    found = diagnose(twice)
    assert names(found) == ["duplicate frame"], found
    assert found.findings[0].frames == (4,)
    found = diagnose([*SCANS[:3], *SCANS[5:8]])
    assert names(found) == ["gap in numbers"], found
    assert "2 numbers" in found.findings[0].problem
    for stamp in (FEW[2].stamp_ns, 0):
        found = diagnose([*FEW[:3], changed(FEW[3], stamp_ns=stamp), *FEW[4:]])
        assert names(found)[0] == "time goes back", found
        assert found.findings[0].frames == (3,)
    late = [
        changed(scan, stamp_ns=scan.stamp_ns + 10**9 * (k > 3))
        for k, scan in enumerate(FEW)
        if scan.stamp_ns is not None
    ]
    assert names(diagnose(late)) == ["gap in time"]


def test_ground_height_differs_from_the_sensor_file() -> None:
    found = diagnose(SCANS, dataclasses.replace(SENSOR, height=0.4))
    assert names(found) == ["ground height"], found
    # The ground falls from 1.68 to 1.96 m below the sensor; the later scans of pairs count.
    assert "1.9 m below" in found.findings[0].problem


def test_labels() -> None:
    assert names(diagnose([changed(s, labels=np.zeros(len(s), np.uint8)) for s in FEW])) == [
        "no dynamic label"
    ]
    assert names(diagnose([changed(s, labels=np.full(len(s), 255, np.uint8)) for s in FEW])) == [
        "all unlabelled"
    ]
    assert diagnose([changed(s, labels=None) for s in FEW]).ok


def test_labels_of_another_length_are_reported_with_their_file(tmp_path: Path) -> None:
    for scan in FEW:
        (tmp_path / "labels").mkdir(exist_ok=True)
        np.save(tmp_path / f"{scan.index:06d}.npy", in_sensor_frame(scan).astype(np.float32))
        assert scan.labels is not None
        np.save(tmp_path / f"labels/{scan.index:06d}.npy", scan.labels)
    np.savetxt(tmp_path / "poses.txt", [scan.T_world_sensor[:3].ravel() for scan in FEW])
    assert doctor(dv.open(tmp_path)).ok
    np.save(tmp_path / "labels/000004.npy", np.zeros(3, np.uint8))
    found = doctor(dv.open(tmp_path))
    assert names(found) == ["labels do not fit"], found
    assert str(found.findings[0].file).endswith("000004.npy")


def test_points_missing_from_the_labelled_cloud(tmp_path: Path) -> None:
    folder = simulate("demo", tmp_path / "demo", frames=3)
    scan = read_pcd(folder / "pcd/000001.pcd")
    lifted = scan.xyz[:-90] + np.float32([0, 0, 0.5])
    write_pcd(scan.path, dict(zip("xyz", lifted.T, strict=True)), scan.T_world_sensor)
    found = doctor(folder)
    assert names(found) == ["labels do not fit"], found
    assert found.findings[0].frames == (1,)
    assert str(found.findings[0].file).endswith("000001.pcd")


def test_a_tilted_world_is_perhaps_wrong() -> None:
    side = np.eye(4)
    side[:3, :3] = Rotation.from_euler("x", 50, degrees=True).as_matrix()
    scans = [
        changed(
            s,
            points=placed(s.points.astype(np.float64), side),
            T_world_sensor=side @ s.T_world_sensor,
        )
        for s in SCANS
    ]
    found = diagnose(scans)
    assert [(f.name, f.confidence) for f in found.findings] == [("tilted", Confidence.PERHAPS)], (
        found
    )


def test_no_readable_frame_is_an_error() -> None:
    class Broken(InMemory):
        def __getitem__(self, position: int) -> Scan:
            raise DataError(f"{position}.bin", "is cut off", hint="Copy it again")

    with pytest.raises(DataError, match="cut off"):
        doctor(Broken(SCANS))


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_the_shortest_sequences(frames: int) -> None:
    if frames:
        assert diagnose(SCANS[:frames]).ok
    else:
        with pytest.raises(DataError, match="no frame"):
            diagnose([])


def test_long_sequences_are_sampled_and_reported_so() -> None:
    class Long(InMemory):
        def __len__(self) -> int:
            return 3000

        def __getitem__(self, position: int) -> Scan:
            read.append(position)
            T = np.eye(4)
            T[0, 3] = 0.1 * position
            return Scan(position, np.random.default_rng(position).normal(size=(9, 3)) + T[:3, 3], T)

    read: list[int] = []
    found = doctor(Long([]))
    assert found.ok, found
    assert found.examined == 400
    assert 400 <= len(set(read)) <= 452  # and those that are compared
    assert max(read) - min(read) == 2999
    assert "400 of 3,000 frames" in str(found)


@pytest.mark.parametrize(
    ("preset", "frames"),
    [("demo", 10), pytest.param("hall_mid360", 10, marks=pytest.mark.slow), ("square_vlp32c", 3)],
)
def test_simulated_sequences_have_no_findings(preset: str, frames: int, tmp_path: Path) -> None:
    found = doctor(simulate(preset, tmp_path / preset, frames=frames))
    assert found.ok, found


@pytest.mark.parametrize(
    "part",
    [
        pytest.param("kitti_tracking/training/velodyne/0012", marks=pytest.mark.slow),
        pytest.param("semantickitti/sequences/08", marks=pytest.mark.slow),
        "argoverse2",
    ],
)
def test_real_sequences_have_no_findings(part: str, real_data: Path) -> None:
    """One stationary sensor and two moving ones."""
    found = doctor(dv.open(real_data / part, frames="0:20"))
    assert found.ok, found
