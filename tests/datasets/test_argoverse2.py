"""Argoverse 2: tables written with pyarrow, both lidars, and the real log with its own labels of moving points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynaviz.datasets import open_sequence
from dynaviz.datasets.argoverse2 import CLASS_NAMES, Argoverse2Sequence
from dynaviz.errors import DataError

START = 315_966_265_259_836_000  # nanoseconds, as the data set counts
UP, DOWN = (1.35, 0.0, 1.64), (1.35, 0.0, 1.53)  # metres, where the lidars are on the car
CITY = np.array([5000.0, 2000.0, 60.0])
STEP = 100_000_000  # nanoseconds from one sweep to the next
SPEED = 10.0  # metres a second, along the city's y axis

Rows = dict[str, Any]


def table(path: Path, columns: Rows) -> None:
    import pyarrow as pa
    from pyarrow import feather

    path.parent.mkdir(parents=True, exist_ok=True)
    feather.write_feather(pa.table(columns), path, compression="lz4")


def pose(places: Any, quaternion: Any) -> Rows:
    """Columns of transforms: positions (N, 3) and one quaternion w x y z for all."""
    places = np.asarray(places, float).reshape(-1, 3)
    turn = {name: np.full(len(places), value) for name, value in zip(("qw", "qx", "qy", "qz"), quaternion, strict=True)}
    return turn | {name: places[:, axis] for axis, name in enumerate(("tx_m", "ty_m", "tz_m"))}


def sweep(log: Path, stamp: int, points: Any, lasers: Any, offsets: Any) -> None:
    xyz = np.asarray(points, np.float16).reshape(-1, 3)
    columns = {axis: xyz[:, k] for k, axis in enumerate("xyz")} | {"intensity": np.zeros(len(xyz), np.uint8)}
    columns |= {"laser_number": np.array(lasers, np.uint8), "offset_ns": np.array(offsets, np.int32)}
    table(log / f"sensors/lidar/{stamp}.feather", columns)


def boxes(log: Path, rows: list[tuple[int, str, str, Any]]) -> None:
    """Boxes of 4 x 2 x 1.5 m with their middle at a place in the car's frame."""
    stamps, tracks, kinds, places = zip(*rows, strict=True)
    size = {name: np.full(len(rows), value) for name, value in (("length_m", 4.0), ("width_m", 2.0), ("height_m", 1.5))}
    columns = {"timestamp_ns": np.array(stamps), "track_uuid": list(tracks), "category": list(kinds)}
    table(
        log / "annotations.feather", columns | size | pose(places, (1, 0, 0, 0)) | {"num_interior_pts": [1] * len(rows)}
    )


POINTS = [
    (10, 0, 1.0),  # in the car that drives ahead
    (10, 0, 0.3),  # at its feet
    (10, 1.125, 1.0),  # just beside it
    (20, 5, 1.0),  # in the parked car
    (-10, 5, 1.0),  # in no box
]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Three sweeps of a car that drives along the city's y axis and looks there; the last has no boxes."""
    log = tmp_path / "sensor/val/0a1b2c3d-log"
    stamps = START + np.arange(-5, 45) * 10_000_000
    along = (stamps - START) * 1e-9 * SPEED
    quarter = (np.sqrt(0.5), 0, 0, np.sqrt(0.5))
    table(
        log / "city_SE3_egovehicle.feather", {"timestamp_ns": stamps} | pose(CITY + np.outer(along, (0, 1, 0)), quarter)
    )
    sensors = {"sensor_name": ["ring_front_center", "up_lidar", "down_lidar"]}
    table(log / "calibration/egovehicle_SE3_sensor.feather", sensors | pose([(9, 9, 9), UP, DOWN], (1, 0, 0, 0)))
    for k in range(3):
        sweep(log, START + k * STEP, POINTS, [0, 31, 32, 63, 0], [0, 99_000_000, 0, 99_000_000, 5_000_000])
    drawn = []
    for k in range(2):
        stamp, parked = START + k * STEP, (20 - k * 0.1 * SPEED, 5, 1.0)
        drawn += [(stamp, "track-a", "REGULAR_VEHICLE", (10, 0, 1.0)), (stamp, "track-b", "BUS", parked)]
    boxes(log, drawn)
    return log


def test_boxes_become_labels(log: Path) -> None:
    scan = open_sequence(str(log))[0]
    assert scan.labels is not None
    assert scan.labels.tolist() == [1, 255, 255, 0, 0]
    assert scan.instances is not None
    assert scan.instances.tolist() == [1, 0, 0, 2, 0]
    assert [CLASS_NAMES[kind] for kind in scan.classes] == ["regular vehicle", "none", "none", "bus", "none"]  # type: ignore[union-attr]


def test_a_sweep_without_boxes_is_unlabelled(log: Path) -> None:
    sequence = open_sequence(str(log))
    assert sequence.has_labels
    assert (sequence[2].labels == 255).all()
    (log / "annotations.feather").unlink()
    bare = open_sequence(str(log))
    assert not bare.has_labels
    assert bare[0].labels is None


def test_the_world_begins_at_the_sensor_with_the_axes_of_the_city(log: Path) -> None:
    sequence = open_sequence(str(log))
    assert (len(sequence), sequence.name, sequence.sensor.name) == (3, "argoverse2_0a1b2c3d", "vlp32c_pair")
    assert [(sequence[k].index, sequence[k].stamp_ns) for k in range(3)] == [(k, START + k * STEP) for k in range(3)]
    np.testing.assert_allclose(sequence[0].position, 0, atol=1e-6)
    np.testing.assert_allclose(sequence[1].position, [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(sequence[0].points[0], [0, 10 - UP[0], 1.0 - UP[2]], atol=1e-3)
    np.testing.assert_allclose(sequence[2].points[0], [0, 12 - UP[0], 1.0 - UP[2]], atol=1e-3)


def test_each_ray_starts_where_its_lidar_was_when_it_fired(log: Path) -> None:
    origins = open_sequence(str(log))[1].origins
    start, low = SPEED * 0.1, DOWN[2] - UP[2]
    expected = [[0, start, 0], [0, start + 0.99, 0], [0, start, low], [0, start + 0.99, low], [0, start + 0.05, 0]]
    np.testing.assert_allclose(origins, expected, atol=0.051)  # rays of 10 ms start together: half of them is 5 cm here
    np.testing.assert_allclose(origins[:, 2], [row[2] for row in expected], atol=1e-6)
    assert len(np.unique(origins, axis=0)) == 4  # the first and the last ray share theirs


@pytest.mark.parametrize("inner", ["", "sensors/lidar", "..", "../../.."])
def test_a_log_is_found_from_many_places(log: Path, inner: str) -> None:
    assert isinstance(open_sequence(str(log / inner)), Argoverse2Sequence)


def test_one_of_several_logs_must_be_chosen(log: Path) -> None:
    sweep(log.parent / "other-log", START, POINTS, [0] * 5, [0] * 5)
    with pytest.raises(DataError, match="several logs: 0a1b2c3d-log, other-log"):
        open_sequence(str(log.parent))
    assert len(open_sequence(f"argoverse2:{log}")) == 3


def test_an_empty_sweep(log: Path) -> None:
    sweep(log, START, np.empty((0, 3)), [], [])
    scan = open_sequence(str(log))[0]
    assert (len(scan), scan.origins.shape) == (0, (0, 3))


@pytest.mark.parametrize("name", ["annotations", "city_SE3_egovehicle", "calibration/egovehicle_SE3_sensor"])
def test_tables_that_are_cut_are_told_when_opened(log: Path, name: str) -> None:
    path = log / f"{name}.feather"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(DataError, match=rf"{path.name}: is no whole Feather file"):
        open_sequence(str(log))


def test_a_cut_sweep_is_told_when_read(log: Path) -> None:
    path = log / f"sensors/lidar/{START}.feather"
    path.write_bytes(path.read_bytes()[:-40])
    sequence = open_sequence(str(log))
    with pytest.raises(DataError, match=rf"{START}\.feather: is no whole Feather file"):
        sequence[0]
    assert len(sequence[1]) == len(POINTS)


def test_missing_files_columns_and_poses_are_told(log: Path) -> None:
    table(log / f"sensors/lidar/{START}.feather", {"x": [1.0]})
    with pytest.raises(DataError, match=rf"{START}\.feather: has no column y, only: x"):
        open_sequence(str(log))[0]
    sweep(log, START + 10**9, POINTS, [0] * 5, [0] * 5)
    with pytest.raises(DataError, match=r"city_SE3_egovehicle\.feather: has no pose near .* is 0\.560 s away"):
        open_sequence(str(log))[3]
    sensors = {"sensor_name": ["up_lidar"]} | pose([UP], (1, 0, 0, 0))
    table(log / "calibration/egovehicle_SE3_sensor.feather", sensors)
    with pytest.raises(DataError, match=r"egovehicle_SE3_sensor\.feather: has no down_lidar"):
        open_sequence(str(log))
    table(
        log / "calibration/egovehicle_SE3_sensor.feather",
        {"sensor_name": ["up_lidar", "down_lidar"]} | pose([UP, DOWN], (0, 0, 0, 0)),
    )
    with pytest.raises(DataError, match=r"egovehicle_SE3_sensor\.feather, row 0: has no rotation"):
        open_sequence(str(log))
    (log / "city_SE3_egovehicle.feather").unlink()
    (log / "calibration/egovehicle_SE3_sensor.feather").unlink()
    with pytest.raises(DataError, match=r"egovehicle_SE3_sensor\.feather: cannot be read"):
        open_sequence(str(log))


def test_gaps_and_lists_in_columns_are_told(log: Path) -> None:
    for values, problem in (([1.0, None], "has gaps in its column x"), ([[1.0], [2.0]], "has list")):
        table(log / f"sensors/lidar/{START}.feather", {"x": values})
        with pytest.raises(DataError, match=problem):
            open_sequence(str(log))[0]


@pytest.fixture(scope="module")
def real(shared: Path) -> Path:
    return shared / "data/argoverse2_fixture"  # a log in its own layout


def test_the_real_log_agrees_with_its_own_labels_of_moving_points(real: Path) -> None:
    from pyarrow import feather

    sequence = open_sequence(str(real))
    assert len(sequence) == 2
    scan = sequence[0]
    flow = feather.read_table(real / "flow_labels.feather")
    moves, ground, kinds = (flow[name].to_numpy() for name in ("dynamic", "is_ground_0", "classes"))
    assert scan.labels is not None
    assert moves.sum() == 2037
    assert (scan.labels[moves] == 1).mean() > 0.95
    assert (scan.labels[moves] == 0).sum() < 20  # slow walkers
    assert ground[moves & (scan.labels == 255)].mean() > 0.8
    others = (scan.labels == 1) & ~moves  # one car that stands now, and drives later
    assert np.bincount(scan.instances[others]).max() > 0.95 * others.sum()  # type: ignore[index]
    boxed = scan.classes > 0  # type: ignore[operator]
    assert (scan.classes[boxed] == kinds[boxed]).mean() > 0.99  # type: ignore[index]


def test_rings_of_the_real_log_are_cones_around_the_origins(real: Path) -> None:
    from pyarrow import feather

    sequence = open_sequence(str(real))
    scan = sequence[1]
    sweep = feather.read_table(next(iter(sorted((real / "sensors/lidar").iterdir(), reverse=True))))
    laser = sweep["laser_number"].to_numpy()
    calib = feather.read_table(real / "calibration/egovehicle_SE3_sensor.feather").to_pylist()
    mounts = {row["sensor_name"]: row for row in calib}

    def spread(origins: Any) -> float:
        rays = (scan.points - origins) @ scan.T_world_sensor[:3, :3]
        spreads = []
        for lidar, first in (("up_lidar", 0), ("down_lidar", 32)):
            row = mounts[lidar]
            turn = Rotation.from_quat([row[f"q{axis}"] for axis in "xyzw"]).as_matrix()
            for k in range(first, first + 32):
                mine = rays[laser == k] @ turn
                distance = np.sqrt((mine**2).sum(1))
                elevation = np.degrees(np.arcsin(mine[:, 2] / distance))[(distance > 3) & (distance < 15)]
                if len(elevation) > 200:
                    spreads.append(np.subtract(*np.percentile(elevation, [90, 10])) / 2)
        assert len(spreads) > 20
        return float(np.mean(spreads))

    assert spread(scan.origins) < 0.035
    assert spread(scan.origins) < 0.8 * spread(scan.position)  # as if all rays started at the upper lidar
