from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import tomllib

import numpy as np
import pytest

from dynaviz.contracts.sensors import load_sensor
from dynaviz.errors import DataError, DynavizError, UsageError
from dynaviz.spatial import geometry
from dynaviz.synthetic.simulate import PRESETS, parallel, record_sweeps, simulate
from dynaviz.synthetic.simulate.classes import CLASS_NAMES, ObjectClass
from dynaviz.synthetic.simulate.recording import build
from dynaviz.synthetic.simulate.sweep import HEIGHT, sensor_pose

FRAMES = 12


@pytest.fixture(scope="module")
def street():
    """The demo without pose errors: scene and sweeps."""
    preset = dataclasses.replace(PRESETS["demo"], pose_noise=(0.0, 0.0))
    scene = build(preset, FRAMES)
    return scene, list(record_sweeps(scene, preset, FRAMES))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return simulate("demo", tmp_path_factory.mktemp("made") / "demo", frames=3)


def in_body(scene, mover, sweep):
    """Points in the frame of a mover, and its (2, 3) bounds there.

    None while it is not in the scene.
    """
    T = mover.motion.pose(sweep.time, scene.height)
    if T is None:
        return None
    points = geometry.apply(geometry.inverse(T) @ sweep.T_scene_world, sweep.points)
    return points, mover.body(mover.motion.schedule(sweep.time)).bounds


def test_dynamic_points_lie_on_their_mover_and_no_static_point_in_one(street):
    scene, sweeps = street
    seen = set()
    for sweep in sweeps:
        for mover in scene.movers:
            found, own = in_body(scene, mover, sweep), sweep.instances == mover.instance
            if found is None:
                assert not own.any()
                continue
            points, (low, high) = found
            assert (
                (points[own] > low - 0.12) & (points[own] < high + 0.12)
            ).all()  # six times the range noise
            within = ((points > np.add(low, (0.1, 0.1, 0.2))) & (points < high - 0.1)).all(1)
            assert (sweep.labels[within] == 1).all()
            assert (sweep.kinds[own] == mover.kind).all()
            if own.any():
                seen.add(mover.kind)
        np.testing.assert_array_equal(sweep.labels == 1, sweep.instances > 0)
    assert seen == {
        ObjectClass.MOVING_CAR,
        ObjectClass.MOVING_TRUCK,
        ObjectClass.MOVING_BICYCLIST,
        ObjectClass.MOVING_PERSON,
    }


def standing(mover, times):
    """At which of the times a mover stands."""
    way = np.array([mover.motion.schedule(t) for t in [*times, times[-1] + 0.1]])
    return np.diff(way) < 1e-9


@pytest.mark.parametrize(
    ("kind", "when"),
    [
        (ObjectClass.MOVING_PERSON, "first"),
        (ObjectClass.MOVING_CAR, "first"),
        (ObjectClass.MOVING_CAR, "last"),
    ],
)
def test_a_mover_that_stands_for_a_while_is_always_dynamic(street, kind, when):
    scene, sweeps = street
    times = [sweep.time for sweep in sweeps]
    half = slice(0, 5) if when == "first" else slice(-5, None)
    stays = [standing(m, times) for m in scene.movers]
    chosen = [
        m
        for m, still in zip(scene.movers, stays, strict=True)
        if m.kind == kind and still[half].all()
    ]
    chosen = [m for m in chosen if not standing(m, times).all()]
    assert len(chosen) == 1
    counts = [(sweep.instances == chosen[0].instance).sum() for sweep in sweeps]
    assert min(counts) > 0
    for sweep in sweeps:
        assert (sweep.labels[sweep.instances == chosen[0].instance] == 1).all()


def test_multipath_returns_lie_below_the_ground_and_are_static(street):
    scene, sweeps = street
    echoes = 0
    for sweep in sweeps:
        odd = sweep.kinds == ObjectClass.OUTLIER
        x, y, z = geometry.apply(sweep.T_scene_world, sweep.points[odd]).T
        assert (z < scene.height(x, y)).all()
        assert not sweep.labels[odd].any()
        echoes += int(odd.sum())
    assert echoes > 0


def test_the_world_is_the_first_sensor_frame_above_the_ground(street):
    _, sweeps = street
    np.testing.assert_allclose(sweeps[0].T_world_sensor, np.eye(4), atol=1e-12)
    road = sweeps[0].points[
        (sweeps[0].kinds == ObjectClass.ROAD) & (np.linalg.norm(sweeps[0].points, axis=1) < 6)
    ]
    assert np.median(road[:, 2]) == pytest.approx(-load_sensor("vlp16").height, abs=0.1)


def test_a_sensor_without_a_height_is_not_on_the_ground(street):
    unknown, known = (
        dataclasses.replace(load_sensor("vlp16"), height=height) for height in (None, HEIGHT)
    )
    np.testing.assert_array_equal(
        sensor_pose(street[0], unknown, 0.0), sensor_pose(street[0], known, 0.0)
    )


def test_pose_errors_have_the_given_size():
    preset = dataclasses.replace(PRESETS["hall_vlp16"], pose_noise=(0.02, 0.1))
    exact = dataclasses.replace(preset, pose_noise=(0.0, 0.0))
    scene = build(preset, 40)
    errors = [
        geometry.inverse(a.T_world_sensor) @ b.T_world_sensor
        for a, b in zip(
            record_sweeps(scene, exact, 40), record_sweeps(scene, preset, 40), strict=True
        )
    ]
    assert 0.01 < np.std([e[:3, 3] for e in errors]) < 0.03
    assert 0.05 < np.degrees(np.std([e[np.tril_indices(3, -1)] for e in errors])) < 0.15


@pytest.mark.parametrize(
    "name", [name for name in PRESETS if not name.endswith("_real")] + ["square_vlp32c_real"]
)
def test_every_preset_renders(name):
    preset = PRESETS[name]
    first, second = record_sweeps(build(preset, 2), preset, 2)
    for sweep in (first, second):
        ranges = np.linalg.norm(sweep.points - sweep.T_world_sensor[:3, 3], axis=1)
        sensor = load_sensor(preset.sensor)
        assert np.isfinite(sweep.points).all()
        assert sensor.min_range - 0.5 < ranges.min()
        assert ranges.max() < sensor.max_range + 0.5
        assert (
            0.001 < sweep.labels.mean() < 0.5
        )  # in so short a time all traffic meets the sensor at once
        assert set(np.unique(sweep.kinds).tolist()) <= set(CLASS_NAMES)
    assert not np.array_equal(first.points[:100], second.points[:100])


def test_open3d_reads_the_files(folder):
    import open3d as o3d

    cloud = o3d.t.io.read_point_cloud(str(folder / "gt_cloud.pcd"))
    scans = [o3d.t.io.read_point_cloud(str(path)) for path in sorted((folder / "pcd").iterdir())]
    assert [path.name for path in sorted((folder / "pcd").iterdir())] == [
        "000000.pcd",
        "000001.pcd",
        "000002.pcd",
    ]
    np.testing.assert_array_equal(
        cloud.point.positions.numpy(),
        np.concatenate([scan.point.positions.numpy() for scan in scans]),
    )
    dynamic = cloud.point["class"].numpy() >= 252
    np.testing.assert_array_equal(cloud.point["intensity"].numpy(), dynamic.astype(np.float32))
    np.testing.assert_array_equal(cloud.point["instance"].numpy() > 0, dynamic)
    assert 0 < dynamic.mean() < 0.5


def test_the_viewpoint_is_the_sensor_position(folder):
    header = (folder / "pcd" / "000002.pcd").read_bytes().split(b"DATA")[0].decode()
    fields = {words[0]: words[1:] for line in header.splitlines() if (words := line.split())}
    position = np.array(fields["VIEWPOINT"][:3], float)
    assert fields["FIELDS"] == ["x", "y", "z", "intensity"]
    assert np.linalg.norm(position - (0.6, 0, 0)) < 0.15  # 3 m/s for 0.2 s


def test_merged_lidars_are_numbered_per_point(tmp_path):
    from dynaviz.io.pcd import read_pcd

    scan = read_pcd(simulate("square_vlp32c", tmp_path / "pair", frames=1) / "pcd" / "000000.pcd")
    np.testing.assert_array_equal(np.unique(scan["lidar"]), [0, 1])
    assert scan["lidar"].dtype == np.uint8


def test_sequence_toml_describes_the_sequence(folder):
    facts = tomllib.loads((folder / "sequence.toml").read_text())
    assert facts["preset"] == facts["name"] == "demo"
    assert (facts["sensor"], facts["seed"], facts["frames"], facts["rate"]) == ("vlp16", 0, 3, 10.0)
    assert facts["classes"]["10"] == "car"
    assert facts["classes"]["252"] == "moving car"


def test_the_same_seed_gives_the_same_bytes_on_any_number_of_threads(tmp_path, folder):
    real = simulate("hall_vlp16_real", tmp_path / "hall", frames=2)
    code = "import sys; from dynaviz.synthetic.simulate import simulate; "
    code += "simulate('demo', sys.argv[1] + '/demo', frames=3); "
    code += "simulate('hall_vlp16_real', sys.argv[1] + '/hall', frames=2)"
    limit = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    pin = (
        "import os; hasattr(os, 'sched_setaffinity') and os.sched_setaffinity(0, "
        "{min(os.sched_getaffinity(0))}); "
    )
    subprocess.run(
        [sys.executable, "-c", pin + code, str(tmp_path / "again")],
        env=os.environ | limit,
        check=True,
    )
    for made in (folder, real):
        for path in (p for p in made.rglob("*") if p.is_file()):
            again = tmp_path / "again" / made.name / path.relative_to(made)
            assert again.read_bytes() == path.read_bytes(), path.name


@pytest.mark.slow
def test_several_processes_give_the_same_bytes(tmp_path, folder, monkeypatch):
    started = []
    monkeypatch.setattr(parallel, "WORTH", 1)
    monkeypatch.setattr(parallel.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(
        parallel,
        "_received",
        lambda child, own=parallel._received: started.append(child) or own(child),
    )
    again = simulate("demo", tmp_path / "demo", frames=3)
    assert len(started) == 1
    for path in (p for p in folder.rglob("*") if p.is_file()):
        assert (again / path.relative_to(folder)).read_bytes() == path.read_bytes(), path.name


def test_a_process_that_dies_is_reported_and_leaves_no_files(tmp_path, monkeypatch):
    monkeypatch.setattr(parallel, "WORTH", 1)
    monkeypatch.setattr(parallel.os, "cpu_count", lambda: 2)
    monkeypatch.setenv("PYTHONHOME", str(tmp_path / "nowhere"))  # so that Python does not start
    with pytest.raises(
        DynavizError, match=r"a process of the simulation ended with exit code 1\. .*fewer frames"
    ):
        simulate("demo", tmp_path / "a", frames=2)
    assert list(tmp_path.iterdir()) == []


def test_another_seed_is_another_scene():
    ways = [[m.reflectance for m in build(PRESETS["demo"], 5, seed).movers] for seed in (0, 1)]
    assert ways[0] != ways[1]


def test_errors_suggest_a_fix_and_leave_no_files(tmp_path, folder):
    with pytest.raises(UsageError, match=r"unknown scene 'nowhere'.*street_hdl64"):
        simulate("nowhere", tmp_path / "a")
    with pytest.raises(UsageError, match="at least one frame"):
        simulate("demo", tmp_path / "a", frames=0)
    with pytest.raises(UsageError, match="fewer frames"):
        simulate("square_mid360", tmp_path / "a", frames=100_000)
    with pytest.raises(DataError, match="already exists"):
        simulate("demo", folder)

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate("hall_mid360", tmp_path / "a", frames=2, progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_progress_counts_the_sweeps(tmp_path):
    calls = []
    simulate(
        "hall_mid360",
        tmp_path / "hall",
        frames=2,
        progress=lambda done, total: calls.append((done, total)),
    )
    assert calls == [(1, 2), (2, 2)]


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, dynaviz.synthetic.simulate; "
    code += "print([m for m in ('open3d', 'scipy', 'numba', 'rerun') if m in sys.modules])"
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.strip()
        == "[]"
    )
