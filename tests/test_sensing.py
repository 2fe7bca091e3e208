"""Facts of unknown sensors, estimated from scans of known ones."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from helpers.worlds import room
from scipy.spatial.transform import Rotation

import dynaviz as dv
from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan, Sequence
from dynaviz.contracts.sensors import Sensor, load_sensor, sensor_names
from dynaviz.engine.needs import suited
from dynaviz.errors import DataError, UsageError
from dynaviz.sources.drive import Drive
from dynaviz.sources.sensing import estimate_sensor, sentence
from dynaviz.testing.world import InMemory
from dynaviz_methods.octomap.method import OctoMap, OctoMapParams
from dynaviz_methods.seethrough import SeeThrough, SeeThroughParams


def unknown(text: str) -> Sequence:
    return dv.open(text).with_sensor(Sensor())


@pytest.mark.parametrize("scene", ["demo", "hall_vlp16"])
def test_simulated_sensors_are_found(scene: str) -> None:
    sequence = dv.open(f"simulate:{scene}?frames=2")
    known, found = sequence.sensor, estimate_sensor(Drive.of(sequence))
    assert found.rings == known.rings
    assert known.elevation is not None
    assert found.elevation == pytest.approx(known.elevation, abs=1.0)
    assert found.height == pytest.approx(known.height, abs=0.05)
    assert found.rate == pytest.approx(10.0)
    assert found.azimuth == (-180.0, 180.0)


def test_rows_are_counted_in_the_order_of_the_points_where_elevations_overlap() -> None:
    azimuth = np.tile(np.linspace(0, 2 * np.pi, 400, endpoint=False), 12)
    ring = np.repeat(np.arange(12), 400)
    elevation = np.radians(-10 + 0.3 * ring + np.random.default_rng(0).normal(0, 0.4, len(ring)))
    flat = 10 * np.cos(elevation)
    points = np.column_stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), 10 * np.sin(elevation)]
    )
    assert estimate_sensor(dv.open([(points, np.eye(4))])).rings == 12
    shuffled = np.random.default_rng(1).permutation(points)
    assert estimate_sensor(dv.open([(shuffled, np.eye(4))])).rings is None


def test_near_points_of_lasers_mounted_higher_do_not_widen_the_field_of_view() -> None:
    """Lasers 0.2 m above the middle of the sensor, as in a HDL-64E.

    At 3 m, they see 4 degrees higher.
    """
    random, azimuth = (
        np.random.default_rng(0),
        np.tile(np.linspace(0, 2 * np.pi, 400, endpoint=False), 30),
    )
    elevation = np.radians(np.repeat(np.linspace(-9.6, 2.0, 30), 400))
    ranges = random.uniform(3.0, 40.0, len(azimuth))
    flat = ranges * np.cos(elevation)
    points = np.column_stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), ranges * np.sin(elevation) + 0.2]
    )
    found = estimate_sensor(dv.open([(points, np.eye(4))]))
    assert found.rings == 30
    assert found.elevation is not None
    assert found.elevation[1] == pytest.approx(2.0, abs=1.0)


def turned(seconds: F64) -> F64:
    """(N, 4, 4) poses of a vehicle that drives and pitches by 2 degrees within ten sweeps."""
    T = np.tile(np.eye(4), (len(seconds), 1, 1))
    T[:, 0, 3] = 8 * seconds
    pitch = np.radians(2.0) * np.sin(2 * np.pi * seconds)
    T[:, :3, :3] = Rotation.from_rotvec(pitch[:, None] * [0.0, 1.0, 0.0]).as_matrix()
    return T


def test_rows_are_counted_although_the_vehicle_pitches_within_a_sweep() -> None:
    """Rays of a sweep start from many poses.

    With the times of points, each is seen from its own.
    """
    shares, ring = np.tile(np.arange(400) / 400, 12), np.repeat(np.arange(12), 400)
    shuffle = np.random.default_rng(0).permutation(
        len(ring)
    )  # so that the order of points shows no rows
    azimuth, elevation = 2 * np.pi * shares[shuffle], np.radians(-10 + 0.8 * ring[shuffle])
    flat = 10 * np.cos(elevation)
    points = np.column_stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), 10 * np.sin(elevation)]
    )
    scans = []
    for k in range(7):
        T, here = turned(0.1 * (k + shares[shuffle])), turned(np.array([0.1 * k]))[0]
        world = np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3]
        times = (0.1 * shares[shuffle]).astype(np.float32)
        scans.append(
            Scan(k, world.astype(np.float32), here, k * 10**8, origins=T[:, :3, 3], times=times)
        )
    found = estimate_sensor(Drive.of(InMemory(scans, "bumps", Sensor())))
    assert found.rings == 12
    assert found.elevation == pytest.approx((-10.0, -1.2), abs=0.05)
    blurred = [dataclasses.replace(scan, times=None) for scan in scans]
    assert estimate_sensor(Drive.of(InMemory(blurred, "bumps", Sensor()))).rings is None


def test_rows_of_two_lidars_in_one_scan_are_not_added() -> None:
    """Their rows are at other elevations, and their rays start from other places."""
    azimuth, ring = (
        np.tile(np.linspace(0, 2 * np.pi, 300, endpoint=False), 20),
        np.repeat(np.arange(20), 300),
    )
    elevation = np.radians(np.where(ring < 10, -8 + 1.1 * ring, 8.3 - 1.1 * (ring - 10)))
    starts = np.where(ring[:, None] < 10, [0.0, 0.0, 0.0], [0.0, 0.1, -0.2])
    flat = 12 * np.cos(elevation)
    ends = np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), 12 * np.sin(elevation)])
    shuffle = np.random.default_rng(0).permutation(len(ring))
    points = (starts + ends)[shuffle].astype(np.float32)
    both = Scan(0, points, np.eye(4), origins=starts[shuffle])
    assert estimate_sensor(Drive.of(InMemory([both], "pair", Sensor()))).rings == 10
    one = Scan(0, points, np.eye(4))
    assert estimate_sensor(Drive.of(InMemory([one], "pair", Sensor()))).rings != 10


def test_a_method_gets_the_estimates_that_it_needs() -> None:
    with pytest.warns(
        UserWarning,
        match=r"sensor is unknown; estimated from the scans: 0\.\d+ m above the ground, 16",
    ):
        estimated = dv.run("erasor", unknown("simulate:demo?frames=3"), threads=1)
    assert (estimated.counts["static_kept"], estimated.counts["dynamic_removed"]) > (0, 0)


def test_a_method_gets_the_estimates_that_it_uses() -> None:
    sequence = unknown("simulate:demo?frames=3")
    with pytest.warns(UserWarning, match="sensor is unknown"):
        found = suited(SeeThrough, SeeThroughParams(), sequence)
    assert found.sensor.elevation == pytest.approx((-15, 15), abs=1.0)
    assert suited(OctoMap, OctoMapParams(), sequence) is sequence, "it uses no facts of the sensor"


@pytest.mark.filterwarnings("ignore:the sensor is unknown")
@pytest.mark.parametrize("method", ["seethrough", "freedom"])
def test_a_label_is_explained_with_the_estimates_of_its_run(method: str, tmp_path: Path) -> None:
    sequence = unknown("simulate:demo?frames=3")
    dv.run(method, sequence, out=tmp_path, record="none", threads=1)
    dv.why(tmp_path, frame=2, point=0, sequence=sequence)


def test_what_cannot_be_estimated_is_reported_before_the_sequence_is_read() -> None:
    class ReadOnce:
        name, sensor, has_labels = "little", Sensor(), False
        positions: tuple[int, ...] = ()

        def __len__(self) -> int:
            return 50

        # loaded on access
        def __getitem__(self, position: int) -> dv.scan.Scan:  # type: ignore[name-defined]
            self.positions += (position,)
            scan = room(frames=1).scans[0]
            return dataclasses.replace(scan, points=scan.points[:20], labels=None, instances=None)

    sequence = ReadOnce()
    with pytest.raises(UsageError, match="erasor needs the height of the sensor"):
        dv.run("erasor", sequence, threads=1)
    assert len(sequence.positions) < 20


def test_estimates_in_one_line() -> None:
    sensor = Sensor(
        rings=32,
        elevation=(-25.0, 15.0),
        height=1.8,
        azimuth=(-60.0, 60.0),
        max_range=98.4,
        rate=10.0,
    )
    expected = (
        "1.80 m above the ground, 32 rows, from -25.0 to 15.0 degrees, azimuth -60 to 60, up to 98 "
        "m, 10.0 Hz"
    )
    assert sentence(sensor) == expected


def test_a_sensor_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('title = "Mine"\nrings = 20\nelevation = [-20.0, 20.0]\nheight = 1\n')
    assert load_sensor(str(file)) == Sensor("mine", "Mine", 20, (-20.0, 20.0), height=1)
    for text, message in [
        ("ringz = 3", "a sensor has no 'ringz'"),
        ("rings = 2.5", "is not a sensor: Expected `int"),
        ("elevation = [20.0, -20.0]", "invalid elevation"),
        ("height = -1", "is not a sensor: Expected `float` >= 0"),
        ("rings = ", "not valid TOML"),
    ]:
        (tmp_path / f"{len(message)}.toml").write_text(text)
        with pytest.raises(DataError, match=message):
            load_sensor(str(tmp_path / f"{len(message)}.toml"))


def test_every_sensor_is_complete() -> None:
    assert len(sensor_names()) >= 12
    for sensor in map(load_sensor, sensor_names()):
        assert sensor.elevation is not None
        assert sensor.elevation[0] < sensor.elevation[1]
        assert (sensor.rings is None) == (sensor.points_per_sweep is not None)
        assert not sensor.elevations or len(sensor.elevations) == sensor.rings
        assert np.all(np.diff(sensor.elevations) > 0)
