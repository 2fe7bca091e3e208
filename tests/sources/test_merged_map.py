"""A merged map is split by its times and a trajectory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.bags import START, at
from helpers.scan_folders import write_tum_poses

import dynaviz as dv
from dynaviz.errors import DataError
from dynaviz.io.maps import open_map

N = 3000
UTM = np.array([512_000.5, 5_403_000.25, 380.0])
SECONDS = np.random.default_rng(0).permutation(np.linspace(0.0005, 0.9995, N))
XYZ = np.random.default_rng(1).uniform(-20, 20, (N, 3)) + UTM


def write(tmp_path: Path, times: np.ndarray | None, suffix: str = ".laz") -> tuple[Path, Path]:
    """A map, and a trajectory of 2 m/s along x over one second."""
    fields = {"intensity": np.arange(N).astype(np.uint16)} | (
        {} if times is None else {"gps_time": times}
    )
    path = tmp_path / f"survey{suffix}"
    with open_map(
        path, {name: array.dtype for name, array in fields.items()}, UTM.round(-3)
    ) as append:
        append(XYZ, fields)
    poses = np.array([at(*(UTM + np.array([0.2 * k, 0, 0])), 0.0) for k in range(11)])
    return path, write_tum_poses(
        tmp_path / "trajectory.tum", [START + k * 100_000_000 for k in range(11)], poses
    )


@pytest.mark.parametrize("offset", [0.0, 1e9])  # GPS seconds, or adjusted as in LAS files
def test_points_return_to_their_scans(tmp_path: Path, offset: float) -> None:
    path, poses = write(tmp_path, START / 1e9 - offset + SECONDS)
    sequence = dv.open(path, poses=poses)
    origin = sequence.origin
    assert origin.tolist() == [512_000 if UTM[0] < 512_500 else 513_000, 5_403_000, 0]
    assert 9 <= len(sequence) <= 11
    seen = []
    for k in range(len(sequence)):
        scan, found = sequence[k], sequence.attributes(k)
        rows = found["intensity"].astype(int)
        seen += rows.tolist()
        np.testing.assert_allclose(scan.points + origin, XYZ[rows], atol=2e-4)
        expected = UTM[0] - origin[0] + 2 * SECONDS[rows]
        np.testing.assert_allclose(scan.origins[:, 0], expected, atol=0.003)
        assert np.ptp(SECONDS[rows]) <= 0.1
    assert sorted(seen) == list(range(N))


def test_the_reason_is_clear_where_it_cannot_be_split(tmp_path: Path) -> None:
    path, poses = write(tmp_path, None, ".pcd")
    with pytest.raises(
        DataError, match=r"merged map without a time per point\. Methods must know from where"
    ):
        dv.open(path, poses=poses)
    path, poses = write(tmp_path, SECONDS)
    with pytest.raises(
        DataError, match=r"its field gps_time can split it by a trajectory\. Give the trajectory"
    ):
        dv.open(path)
    with pytest.raises(DataError, match="points and poses do not overlap in time"):
        dv.open(path, poses=poses)


@pytest.mark.parametrize("name", ["scalar_GpsTime", "scalar_Gps_Time", "GPS_time", "Time"])
def test_times_are_found_under_names_of_other_programs(tmp_path: Path, name: str) -> None:
    _, poses = write(tmp_path, None)
    path = tmp_path / "cloud_compare.ply"
    with open_map(path, {name: np.dtype("f8")}, UTM.round(-3)) as append:
        append(XYZ, {name: START / 1e9 + SECONDS})
    assert sum(len(scan) for scan in dv.open(path, poses=poses)) == N


GPS_EPOCH = 315_964_800  # seconds from 1970 to 1980
LEAPS = 18  # since 2017


def test_seconds_of_the_gps_week(tmp_path: Path) -> None:
    of_week = (START / 1e9 + LEAPS - GPS_EPOCH) % 604_800
    path, poses = write(tmp_path, of_week + SECONDS)
    sequence = dv.open(path, poses=poses)
    assert sum(len(scan) for scan in sequence) == N
    assert "seconds of the GPS week" in sequence.facts["split by"]
    origin = sequence.origin[0]
    for k in range(len(sequence)):
        rows = sequence.attributes(k)["intensity"].astype(int)
        expected = UTM[0] - origin + 2 * SECONDS[rows]
        np.testing.assert_allclose(sequence[k].origins[:, 0], expected, atol=0.003)


def test_times_in_float32_are_named(tmp_path: Path) -> None:
    path, poses = write(tmp_path, (START / 1e9 + SECONDS).astype(np.float32), ".ply")
    with pytest.raises(DataError, match=r"gps_time is float32, .* steps of 128 s\. Write"):
        dv.open(path, poses=poses)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300, -1e18])
def test_a_point_without_a_valid_time_is_left_out(tmp_path: Path, value: float) -> None:
    times = START / 1e9 + SECONDS
    times[5] = value
    path, poses = write(tmp_path, times, ".pcd")
    sequence = dv.open(path, poses=poses)
    rows = np.concatenate([sequence.attributes(k)["intensity"] for k in range(len(sequence))])
    assert sorted(rows.tolist()) == [k for k in range(N) if k != 5]
