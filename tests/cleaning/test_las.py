"""LAS and LAZ maps keep coordinate system, records, scales and times, and can be cleaned again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from helpers.bags import START, BagWriter
from helpers.scan_folders import write_tum_poses

import dynaviz as dv
from dynaviz.errors import DataError
from dynaviz.io.fields import read_fields
from dynaviz.io.las import adjusted_gps_time, leap_offset
from dynaviz.io.poses import read_poses
from dynaviz.spatial import geometry
from dynaviz.testing.world import crossing

UTM = np.array([512_000.0, 5_403_000.0, 380.0])
SCANS = crossing(9)
WKT = b'PROJCS["WGS 84 / UTM zone 32N",AUTHORITY["EPSG","32632"]]\0'
KEYS = np.array([[1, 1, 0, 1], [3072, 0, 1, 32632]], "<u2")
pytestmark = pytest.mark.filterwarnings("ignore:the sensor is unknown")
OPTIONS: dict[str, Any] = {"record": "none", "threads": 1}


def times(seconds: float) -> np.ndarray:
    """Times of the points of a sweep that begins then: 0.1 s in the order of the points."""
    return seconds + np.linspace(0, 0.0999, len(SCANS[0]))


def survey(path: Path, version: str, point_format: int, after: float = 0.0) -> tuple[Path, Path]:
    """A survey in UTM, with both kinds of coordinate systems and a record of another program, and
    its trajectory.
    """
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = [0.001, 0.001, 0.0005], UTM.round(-2)
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.global_encoding.wkt = point_format >= 6
    header.system_identifier = "a survey"
    header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "GeoTIFF keys", KEYS.tobytes()))
    header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "WKT", WKT))
    header.vlrs.append(laspy.VLR("somebody", 7, "notes", b"flown at noon"))
    header.add_extra_dims(
        [laspy.ExtraBytesParams("amplitude", "u2", "in 0.01 dB", scales=[0.01], offsets=[0.0]),
         laspy.ExtraBytesParams("normal", "3f4", "of the surface")]
    )  # fmt: skip
    las = laspy.LasData(header)
    xyz = np.concatenate([scan.points for scan in SCANS]) + UTM
    las.x, las.y, las.z = xyz.T
    seconds = np.concatenate([times(START / 1e9 + 0.1 * k) for k in range(len(SCANS))])
    las.gps_time = seconds - 1e9 - leap_offset(START / 1e9)
    numbers = np.arange(len(xyz))
    las.intensity, las.classification, las.return_number = (
        numbers % 65536,
        numbers % 20,
        1 + numbers % 3,
    )
    las.amplitude = (numbers % 5000) / 100
    las.normal = np.column_stack([numbers, numbers + 1, numbers + 2]).astype("f4")
    if version == "1.4":
        las.evlrs = laspy.vlrs.vlrlist.VLRList(
            [laspy.VLR("somebody", 8, "more notes", b"x" * 70_000)]
        )
    las.write(str(path))
    T = np.array([scan.T_world_sensor for scan in SCANS])
    T[:, :3, 3] += UTM
    stamps = [START + k * 100_000_000 for k in range(len(SCANS) + 1)]
    return path, write_tum_poses(path.with_suffix(".tum"), stamps, np.concatenate([T, T[-1:]]))


def records(path: Path) -> list[tuple[str, int, str, bytes]]:
    """The variable-length records, without those that describe the points of the file."""
    with laspy.open(path) as file:
        vlrs = [*file.header.vlrs, *(file.header.evlrs or [])]
    return sorted(
        (v.user_id, v.record_id, v.description, v.record_data_bytes())
        for v in vlrs
        if v.user_id not in ("LASF_Spec", "laszip encoded")
    )


@pytest.mark.parametrize(
    ("version", "point_format", "suffix"),
    [
        pytest.param("1.2", 1, ".laz", marks=pytest.mark.slow),
        pytest.param("1.4", 6, ".las", marks=pytest.mark.slow),
        ("1.4", 7, ".laz"),
    ],
)
def test_a_survey_is_cleaned_twice(
    tmp_path: Path, version: str, point_format: int, suffix: str
) -> None:
    path, poses = survey(tmp_path / "survey.laz", version, point_format)
    first = dv.clean(path, tmp_path / f"once{suffix}", poses=poses, **OPTIONS)
    assert first.trajectory is not None
    again = dv.clean(
        tmp_path / f"once{suffix}", tmp_path / "twice.laz", poses=first.trajectory, **OPTIONS
    )
    assert first.account.removed > 0.005 * first.account.points
    assert again.account.points == first.account.kept + first.account.unposed_kept
    assert again.account.removed <= 0.001 * again.account.points
    source = laspy.read(path)
    whole = {int(n): row for row, n in enumerate(source.normal[:, 0])}
    for file in (tmp_path / f"once{suffix}", tmp_path / "twice.laz"):
        found = laspy.read(file)
        assert records(file) == records(path)
        for name in ("scales", "offsets", "version", "system_identifier"):
            assert np.array_equal(getattr(found.header, name), getattr(source.header, name))
        assert found.header.global_encoding.value == source.header.global_encoding.value
        assert found.header.point_format == source.header.point_format
        rows = np.array([whole[int(n)] for n in found.normal[:, 0]])
        for name in source.point_format.dimension_names:
            assert np.asarray(found[name]).tobytes() == np.asarray(source[name])[rows].tobytes(), (
                name
            )


@pytest.mark.filterwarnings("ignore:.*no TF from")
def test_a_map_of_a_bag_has_gps_time_and_can_be_cleaned_again(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        for k, scan in enumerate(SCANS):
            T = scan.T_world_sensor
            xyz = geometry.transform(geometry.inverse(T), scan.points)
            columns = {axis: xyz[:, n] for n, axis in enumerate("xyz")}
            bag.cloud(k / 10, {**columns, "ring": np.arange(len(xyz)).astype("u2")})
            bag.odometry(k / 10, T)
    first = dv.clean(bag.path, tmp_path / "map.laz", **OPTIONS)
    found = laspy.read(tmp_path / "map.laz")
    assert found.header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    unix = (
        np.round((np.asarray(found.gps_time) + 1e9 + leap_offset(START / 1e9) - START / 1e9) * 10)
        / 10
    )
    assert set(unix.tolist()) == {k / 10 for k in range(len(SCANS))}
    again = dv.clean(
        tmp_path / "map.laz", tmp_path / "again.laz", poses=first.trajectory, **OPTIONS
    )
    assert again.account.unposed_kept == again.account.unposed_left_out == 0
    assert again.account.removed <= 0.001 * again.account.points
    kept = read_fields(tmp_path / "again.laz")
    assert kept["gps_time"].dtype == np.float64
    assert "ring" in kept


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*no TF from")
def test_a_map_of_two_lidars_can_be_cleaned_again(tmp_path: Path) -> None:
    """Rays start at the lidar that measured them, in the second pass as well."""
    mounts = {"/low": 0.0, "/high": 1.0}  # metres above the vehicle
    with BagWriter(tmp_path / "drive") as bag:
        for k, scan in enumerate(SCANS):
            T = scan.T_world_sensor
            for topic, height in mounts.items():
                xyz = geometry.transform(geometry.inverse(T), scan.points) - np.array(
                    [0, 0, height]
                )
                bag.cloud(
                    k / 10,
                    {axis: xyz[:, n].astype("f4") for n, axis in enumerate("xyz")},
                    topic=topic,
                )
            bag.odometry(k / 10, T)
    extrinsic = ";".join(f"{topic}=0,0,{height},0,0,0" for topic, height in mounts.items())
    first = dv.clean(f"{bag.path}#/low,/high", tmp_path / "map.laz", extrinsic=extrinsic, **OPTIONS)
    assert first.trajectory is not None
    given = read_poses(first.trajectory)
    for number, height in enumerate(mounts.values()):
        expected = [scan.T_world_sensor[:3, 3] + [0, 0, height] for scan in SCANS]
        np.testing.assert_allclose(given.poses[given.lidars[number], :3, 3], expected, atol=1e-6)
    assert set(np.unique(read_fields(tmp_path / "map.laz")["lidar"])) == {0, 1}
    again = dv.open(tmp_path / "map.laz", poses=first.trajectory)
    for scan, once in zip(again, SCANS, strict=True):
        assert set(np.round(scan.origins[:, 2] - once.T_world_sensor[2, 3], 5)) == set(
            mounts.values()
        )
    for name in ("again", "and_again"):
        cleaned = dv.clean(
            tmp_path / "map.laz", tmp_path / f"{name}.laz", poses=first.trajectory, **OPTIONS
        )
        assert cleaned.account.unposed_kept == cleaned.account.unposed_left_out == 0
        first = cleaned
    with pytest.raises(DataError, match="has the poses of 2 lidars"):
        dv.open(f"{bag.path}#/low", poses=first.trajectory)


def test_gps_time_counts_leap_seconds() -> None:
    """2012-06-30 23:59:59 and 2012-07-01 00:00:00 UTC, between which a leap second was inserted
    (Bulletin C 43).
    """
    before, after = (adjusted_gps_time(np.array([t * 10**9])) for t in (1341100799, 1341100800))
    assert after[0] - before[0] == 2
    # The GPS epoch plus 1e9 s is 2011-09-14 01:46:40 GPS, 15 s before which UTC shows the same.
    assert adjusted_gps_time(np.array([1315964785 * 10**9 + 500_000_000])).tolist() == [0.5]
