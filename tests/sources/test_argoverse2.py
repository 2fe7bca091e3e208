"""Argoverse 2: tables written with pyarrow, both lidars, and a real log with its flow labels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.argoverse2_files import (
    DOWN,
    POINTS,
    SPEED,
    START,
    STEP,
    UP,
    transform_columns,
    write_log,
    write_sweep,
    write_table,
)
from scipy.spatial.transform import Rotation

from dynaviz.errors import DataError
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.argoverse2 import CLASS_NAMES, Argoverse2Sequence


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write_log(tmp_path)


def test_boxes_become_labels(log: Path) -> None:
    scan = open_sequence(str(log))[0]
    assert scan.labels is not None
    assert scan.labels.tolist() == [1, 255, 255, 0, 0]
    assert scan.instances is not None
    assert scan.instances.tolist() == [1, 0, 0, 2, 0]
    assert [CLASS_NAMES[kind] for kind in scan.classes] == [
        "regular vehicle",
        "none",
        "none",
        "bus",
        "none",
    ]  # type: ignore[union-attr]


def test_a_sweep_without_boxes_is_unlabelled(log: Path) -> None:
    sequence = open_sequence(str(log))
    assert sequence.has_labels
    assert (sequence[2].labels == 255).all()
    (log / "annotations.feather").unlink()
    bare = open_sequence(str(log))
    assert not bare.has_labels
    assert bare[0].labels is None


def test_the_world_frame_has_the_axes_of_the_city_and_starts_at_the_sensor(log: Path) -> None:
    sequence = open_sequence(str(log))
    assert (len(sequence), sequence.name, sequence.sensor.name) == (
        3,
        "argoverse2_0a1b2c3d",
        "vlp32c_pair",
    )
    assert [(sequence[k].index, sequence[k].stamp_ns) for k in range(3)] == [
        (k, START + k * STEP) for k in range(3)
    ]
    np.testing.assert_allclose(sequence[0].position, 0, atol=1e-6)
    np.testing.assert_allclose(sequence[1].position, [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(sequence[0].points[0], [0, 10 - UP[0], 1.0 - UP[2]], atol=1e-3)
    np.testing.assert_allclose(sequence[2].points[0], [0, 12 - UP[0], 1.0 - UP[2]], atol=1e-3)


def test_each_ray_starts_at_its_lidar_when_it_fired(log: Path) -> None:
    origins = open_sequence(str(log))[1].origins
    start, low = SPEED * 0.1, DOWN[2] - UP[2]
    expected = [
        [0, start, 0],
        [0, start + 0.99, 0],
        [0, start, low],
        [0, start + 0.99, low],
        [0, start + 0.05, 0],
    ]
    np.testing.assert_allclose(
        origins, expected, atol=0.051
    )  # rays within 10 ms share an origin: up to 5 cm here
    np.testing.assert_allclose(origins[:, 2], [row[2] for row in expected], atol=1e-6)
    assert len(np.unique(origins, axis=0)) == 4  # the first and the last ray share an origin


@pytest.mark.parametrize("inner", ["", "sensors/lidar", "..", "../../.."])
def test_a_log_is_found_from_related_folders(log: Path, inner: str) -> None:
    assert isinstance(open_sequence(str(log / inner)).reader, Argoverse2Sequence)


def test_several_logs_are_reported(log: Path) -> None:
    write_sweep(log.parent / "other-log", START, POINTS, [0] * 5, [0] * 5)
    with pytest.raises(DataError, match="several logs: 0a1b2c3d-log, other-log"):
        open_sequence(str(log.parent))
    assert len(open_sequence(f"argoverse2:{log}")) == 3


def test_an_empty_sweep(log: Path) -> None:
    write_sweep(log, START, np.empty((0, 3)), [], [])
    scan = open_sequence(str(log))[0]
    assert (len(scan), scan.origins.shape) == (0, (0, 3))


@pytest.mark.parametrize(
    "name", ["annotations", "city_SE3_egovehicle", "calibration/egovehicle_SE3_sensor"]
)
def test_truncated_tables_are_reported_on_opening(log: Path, name: str) -> None:
    path = log / f"{name}.feather"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(DataError, match=rf"{path.name}: not a valid Feather file"):
        open_sequence(str(log))


def test_a_truncated_sweep_is_reported_on_reading(log: Path) -> None:
    path = log / f"sensors/lidar/{START}.feather"
    path.write_bytes(path.read_bytes()[:-40])
    sequence = open_sequence(str(log))
    with pytest.raises(DataError, match=rf"{START}\.feather: not a valid Feather file"):
        sequence[0]
    assert len(sequence[1]) == len(POINTS)


def test_missing_files_columns_and_poses_are_reported(log: Path) -> None:
    write_table(log / f"sensors/lidar/{START}.feather", {"x": [1.0]})
    with pytest.raises(DataError, match=rf"{START}\.feather: column y is missing \(found: x\)"):
        open_sequence(str(log))[0]
    write_sweep(log, START + 10**9, POINTS, [0] * 5, [0] * 5)
    with pytest.raises(
        DataError, match=r"city_SE3_egovehicle\.feather: no pose near .* is 0\.560 s away"
    ):
        open_sequence(str(log))[3]
    sensors = {"sensor_name": ["up_lidar"]} | transform_columns([UP], (1, 0, 0, 0))
    write_table(log / "calibration/egovehicle_SE3_sensor.feather", sensors)
    with pytest.raises(
        DataError, match=r"egovehicle_SE3_sensor\.feather: sensor down_lidar is missing"
    ):
        open_sequence(str(log))
    write_table(
        log / "calibration/egovehicle_SE3_sensor.feather",
        {"sensor_name": ["up_lidar", "down_lidar"]} | transform_columns([UP, DOWN], (0, 0, 0, 0)),
    )
    with pytest.raises(
        DataError, match=r"egovehicle_SE3_sensor\.feather, row 0: the quaternion is not a rotation"
    ):
        open_sequence(str(log))
    (log / "city_SE3_egovehicle.feather").unlink()
    (log / "calibration/egovehicle_SE3_sensor.feather").unlink()
    with pytest.raises(DataError, match=r"egovehicle_SE3_sensor\.feather: cannot be read"):
        open_sequence(str(log))


def test_missing_values_and_lists_in_columns_are_reported(log: Path) -> None:
    for values, problem in (
        ([1.0, None], "column x has missing values"),
        ([[1.0], [2.0]], "column x contains list"),
    ):
        write_table(log / f"sensors/lidar/{START}.feather", {"x": values})
        with pytest.raises(DataError, match=problem):
            open_sequence(str(log))[0]


@pytest.fixture(scope="module")
def real(shared: Path) -> Path:
    return shared / "data/argoverse2_fixture"  # a log in its native layout


def test_the_real_log_agrees_with_its_flow_labels(real: Path) -> None:
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
    others = (scan.labels == 1) & ~moves  # one car that stands in this sweep and drives later
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
                elevation = np.degrees(np.arcsin(mine[:, 2] / distance))[
                    (distance > 3) & (distance < 15)
                ]
                if len(elevation) > 200:
                    spreads.append(np.subtract(*np.percentile(elevation, [90, 10])) / 2)
        assert len(spreads) > 20
        return float(np.mean(spreads))

    assert spread(scan.origins) < 0.035
    assert spread(scan.origins) < 0.8 * spread(scan.position)  # all rays from the upper lidar
