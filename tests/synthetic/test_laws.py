"""What must be true of every sequence with implants."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import open3d as o3d
import pytest

from dynaviz.arrays import F64
from dynaviz.contracts.scan import Label, Scan
from dynaviz.spatial import geometry
from dynaviz.spatial.scan_ground import ScanGround
from dynaviz.synthetic.implants.cast import grounded, implant
from dynaviz.synthetic.implants.implant_options import ImplantOptions
from dynaviz.synthetic.implants.implant_scene import CLASSES, Implant
from dynaviz.synthetic.implants.implanted_sequence import ImplantedSequence
from dynaviz.synthetic.simulate.shapes import Mesh
from dynaviz.testing import InMemory

Pairs = list[tuple[Scan, Scan]]


def own(scan: Scan) -> np.ndarray:
    """Points that are not implanted."""
    assert scan.classes is not None
    return ~np.isin(scan.classes, list(CLASSES.values()))


def surfaces(mesh: Mesh) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(mesh.vertices.astype(np.float32)),
        o3d.core.Tensor(mesh.triangles.astype(np.uint32)),
    )
    return scene


def first_hit(mesh: Mesh, scan: Scan, points: F64) -> F64:
    """Metres along the rays to points, until the mesh."""
    rays = np.broadcast_to(scan.origins, points.shape)
    towards = points - rays
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    packed = np.concatenate([rays, towards], axis=1).astype(np.float32)
    return surfaces(mesh).cast_rays(o3d.core.Tensor(packed))["t_hit"].numpy().astype(np.float64)


def movers(implanted: ImplantedSequence, before: Scan) -> Iterator[tuple[Implant, Mesh]]:
    """The movers that are put into a scan."""
    ground = ScanGround.of(before.points, before.position)
    for mover in implanted.scene.movers:
        mesh = grounded(mover, implanted.scene.time(before), ground, before.position)
        if mesh is not None:
            yield mover, mesh


def test_every_implanted_point_lies_on_its_mover_within_the_noise(
    implanted: ImplantedSequence, pairs: Pairs
) -> None:
    seen = {}
    for before, scan in pairs:
        present = {mover.instance: (mover, mesh) for mover, mesh in movers(implanted, before)}
        for instance in np.unique(scan.instances[~own(scan)]):
            mover, mesh = present[instance]
            rows = scan.instances == instance
            assert (scan.classes[rows] == CLASSES[mover.kind]).all()
            off = surfaces(mesh).compute_distance(o3d.core.Tensor(scan.points[rows])).numpy()
            assert off.max() < 6 * implanted.scene.range_noise
            seen.setdefault(mover.kind, []).extend(off)
    assert set(seen) == {"car", "cyclist", "person"}
    assert (
        np.mean(np.concatenate(list(seen.values()))) > 0.2 * implanted.scene.range_noise
    )  # there is noise


def test_points_with_times_lie_on_their_mover_at_their_own_time(
    implanted: ImplantedSequence, pairs: Pairs
) -> None:
    fast = next(mover for mover in implanted.scene.movers if mover.kind == "car")
    off, apart = [], []
    for scan, _ in pairs:
        times = np.random.default_rng(scan.index).uniform(-0.05, 0.05, len(scan)).astype(np.float32)
        timed = implant(dataclasses.replace(scan, times=times), implanted.scene, implanted.lidar)
        assert timed.times is not None
        rows = np.flatnonzero(timed.instances == fast.instance)[::40]
        for row in rows:
            mesh = fast.mesh(implanted.scene.time(scan) + float(timed.times[row]))
            if mesh is None:  # before the start or after the end of its path
                continue
            off.append(
                surfaces(mesh).compute_distance(o3d.core.Tensor(timed.points[row : row + 1])).item()
            )
        mesh = fast.mesh(implanted.scene.time(scan))
        if len(rows) and mesh is not None:
            apart.extend(
                surfaces(mesh).compute_distance(o3d.core.Tensor(timed.points[rows])).numpy()
            )
    assert len(off) > 20
    assert max(off) < 6 * implanted.scene.range_noise
    assert max(apart) > 0.1  # with the mover at rest during the sweep they would not


def test_no_mover_hides_a_point_that_was_kept(implanted: ImplantedSequence, pairs: Pairs) -> None:
    for before, scan in pairs:
        points = scan.points[own(scan)].astype(np.float64)
        away = np.linalg.norm(points - scan.origins, axis=1)
        for _, mesh in movers(implanted, before):
            assert (first_hit(mesh, scan, points) > away - 1e-3).all()


def test_points_before_or_aside_of_movers_keep_their_bits_and_their_order(
    implanted: ImplantedSequence, pairs: Pairs
) -> None:
    hidden_somewhere = 0
    for before, after in pairs:
        points = before.points.astype(np.float64)
        away = np.linalg.norm(points - before.origins, axis=1)
        hidden = np.zeros(len(before), bool)
        for _, mesh in movers(implanted, before):
            hit = first_hit(mesh, before, points)
            hidden |= hit < away
            assert (np.abs(hit - away) > 1e-4).all()
        untouched = own(after)
        for name in ("points", "labels", "classes", "instances"):
            np.testing.assert_array_equal(
                getattr(after, name)[untouched], getattr(before, name)[~hidden]
            )
        assert (after.T_world_sensor.tobytes(), after.index) == (
            before.T_world_sensor.tobytes(),
            before.index,
        )
        hidden_somewhere += hidden.sum()
    assert hidden_somewhere > 500


def test_movers_never_touch_a_static_point_above_the_ground(
    implanted: ImplantedSequence, pairs: Pairs
) -> None:
    static = np.concatenate([before.points[before.labels == Label.STATIC] for before, _ in pairs])
    checked = 0
    for before, _ in pairs:
        time = implanted.scene.time(before)
        for mover, mesh in movers(implanted, before):
            to_mover = geometry.inverse(mover.pose(mover.distance(time)))
            low, high = Mesh(geometry.apply(to_mover, mesh.vertices), mesh.triangles).bounds
            points = geometry.apply(to_mover, static)
            inside = ((points > (low[0], low[1], 0.35)) & (points < high)).all(1)
            assert not inside.any(), (mover.kind, before.index)
            checked += 1
    assert checked > 40


def test_movers_do_not_appear_or_disappear_in_sight(
    implanted: ImplantedSequence, pairs: Pairs
) -> None:
    """They have few points in their first and last scan, unless the recording begins
    or ends there.
    """
    times = [implanted.scene.time(before) for before, _ in pairs]
    for mover in implanted.scene.movers:
        start, end = mover.schedule[0, 0], mover.schedule[-1, 0]
        present = [k for k, time in enumerate(times) if start <= time <= end]
        for k, edge in ((present[0], 0), (present[-1], len(pairs) - 1)):
            scan = pairs[k][1]
            away = np.linalg.norm(mover.pose(mover.distance(times[k]))[:2, 3] - scan.position[:2])
            assert k == edge or away > 40 or (scan.instances == mover.instance).sum() < 20, (
                mover.note,
                away,
            )


def test_movers_stand_on_the_ground(implanted: ImplantedSequence, pairs: Pairs) -> None:
    """Static points around their feet or wheels are at their height."""
    static = np.concatenate([before.points[before.labels == Label.STATIC] for before, _ in pairs])
    off = []
    for mover in implanted.scene.movers:
        for x, y, z in mover.path[::4]:
            near = static[np.hypot(static[:, 0] - x, static[:, 1] - y) < 0.4]
            near = near[np.abs(near[:, 2] - z) < 0.5]
            if len(near) >= 5:
                off.append(np.median(near[:, 2]) - z)
    assert len(off) > 20
    assert np.abs(np.median(off)) < 0.03
    assert np.quantile(np.abs(off), 0.9) < 0.15


def test_movers_stand_on_the_ground_of_a_scan_whose_pose_is_too_high(
    implanted: ImplantedSequence, pairs: Pairs
) -> None:
    lift = np.float32([0, 0, 0.5])
    for before, after in pairs[::4]:
        T_world_sensor = before.T_world_sensor.copy()
        T_world_sensor[:3, 3] += lift
        origins = before.origins + lift
        high = dataclasses.replace(
            before, points=before.points + lift, T_world_sensor=T_world_sensor, origins=origins
        )
        found = implant(high, implanted.scene, implanted.lidar)
        assert abs(len(found) - len(after)) < 20
        assert found.points[~own(found), 2].mean() == pytest.approx(
            after.points[~own(after), 2].mean() + 0.5, abs=0.02
        )


def test_movers_keep_clear_of_the_sensor_and_of_each_other(
    implanted: ImplantedSequence, pairs: Pairs
) -> None:
    for before, _ in pairs:
        present = list(movers(implanted, before))
        for number, (_, mesh) in enumerate(present):
            assert np.linalg.norm(mesh.vertices - before.position, axis=1).min() > 0.9
            for _, other in present[:number]:
                apart = np.linalg.norm(
                    mesh.vertices[:, None, :2] - other.vertices[None, :, :2], axis=2
                )
                assert apart.min() > 0.15


def test_implanted_points_are_dynamic_and_have_names_and_instances_of_their_own(
    pairs: Pairs,
) -> None:
    taken = {int(number) for before, _ in pairs for number in np.unique(before.instances)}
    for _, scan in pairs:
        new = ~own(scan)
        assert (scan.labels[new] == Label.DYNAMIC).all()
        assert taken.isdisjoint(scan.instances[new].tolist())
        assert {scan.class_names[number] for number in np.unique(scan.classes[new])} <= {
            "implanted car",
            "implanted cyclist",
            "implanted person",
        }
        assert scan.class_names[10] == "car"


def test_reading_again_gives_the_same_bits(
    street: InMemory, implanted: ImplantedSequence, pairs: Pairs
) -> None:
    for k in (7, 2, 7):
        again = implanted[k]
        for name in ("points", "labels", "classes", "instances", "origins"):
            assert getattr(again, name).tobytes() == getattr(pairs[k][1], name).tobytes()
    assert implanted.sensor == street.sensor
    assert len(implanted) == len(street)


def test_without_labels_only_implants_are_labelled(unlabelled: InMemory) -> None:
    options = ImplantOptions(cars=0, trucks=0, cyclists=1, persons=3, parks=0, seed=3)
    scan = ImplantedSequence.of(unlabelled, options)[3]
    assert scan.labels is not None
    new = ~own(scan)
    assert new.any()
    assert (scan.labels[new] == Label.DYNAMIC).all()
    assert (scan.labels[~new] == Label.UNLABELLED).all()
