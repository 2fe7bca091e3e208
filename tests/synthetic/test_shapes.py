from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynaviz.synthetic.simulate import objects
from dynaviz.synthetic.simulate.shapes import (
    Mesh,
    boxes,
    ellipsoid,
    grid,
    join,
    layers,
    leaves,
    quads,
    tube,
)

metres = st.floats(0.1, 10)


def is_closed(mesh: Mesh) -> bool:
    """Every edge is used once in each direction."""
    edges = np.concatenate([mesh.triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    there = {(int(a), int(b)) for a, b in edges}
    return len(there) == len(edges) and all((b, a) in there for a, b in there)


def volume(mesh: Mesh) -> float:
    """Volume by the divergence theorem; positive if triangles face outward."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6)


@given(st.lists(st.tuples(metres, metres, metres), min_size=1, max_size=4))
def test_boxes_have_the_volume_of_their_sizes(sizes):
    mesh = boxes([(20.0 * k, 0, 0) for k in range(len(sizes))], sizes)
    assert is_closed(mesh)
    assert volume(mesh) == pytest.approx(sum(x * y * z for x, y, z in sizes))


@given(metres, metres, st.floats(-3, 3), st.floats(-3, 3))
def test_a_slanted_tube_is_a_prism(radius, height, x, y):
    mesh = tube([(0, 0, 0), (x, y, height)], radius, 24)
    disc = 12 * radius**2 * np.sin(2 * np.pi / 24)
    assert is_closed(mesh)
    assert volume(mesh) == pytest.approx(disc * np.sqrt(x * x + y * y + height * height))


@given(metres, metres, metres)
def test_an_ellipsoid_reaches_its_half_axes(x, y, z):
    mesh = ellipsoid(x, y, z, at=(1, 2, 3), sides=12)
    assert is_closed(mesh)
    np.testing.assert_allclose(
        mesh.bounds, [[1 - x, 2 - y, 3 - z], [1 + x, 2 + y, 3 + z]], atol=0.01 * max(x, y, z)
    )
    assert 0.7 < volume(mesh) / (4 / 3 * np.pi * x * y * z) < 1


def test_layers_are_closed_and_mirrored():
    mesh = layers([(0.2, -2, 2, 0.8), (0.9, -2, 2, 0.8), (1.4, -1, 1, 0.6)])
    assert is_closed(mesh)
    assert volume(mesh) > 0
    np.testing.assert_allclose(mesh.bounds, [[-2, -0.8, 0.2], [2, 0.8, 1.4]])


def test_a_grid_faces_up():
    x, y = np.meshgrid(np.arange(4.0), np.arange(3.0), indexing="ij")
    mesh = grid(np.stack([x, y, x + y], -1))
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    assert len(mesh.triangles) == 12
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_quads_and_leaves_are_flat_pieces():
    assert len(quads([[(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]]).triangles) == 2
    crown = leaves(np.zeros((50, 3)), 0.2, np.random.default_rng(0))
    assert crown.triangles.shape == (50, 3)
    assert np.abs(crown.vertices).max() < 0.6


@given(st.floats(-np.pi, np.pi), metres, metres)
def test_moving_keeps_the_volume(yaw, x, y):
    mesh = join([boxes([(0, 0, 0)], (1, 2, 3)), boxes([(9, 0, 0)], (1, 1, 1))]).moved(
        x, y, 1, yaw=yaw
    )
    assert volume(mesh) == pytest.approx(7)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    ("build", "low", "high"),
    [
        (objects.car, (3.6, 1.6, 1.3), (5.0, 1.9, 1.8)),
        (objects.truck, (6.4, 2.3, 3.5), (9.1, 2.7, 4.1)),
        (objects.forklift, (2.5, 0.9, 2.0), (3.3, 1.3, 2.4)),
    ],
)
def test_vehicles_are_closed_and_have_realistic_sizes(build, low, high, seed):
    mesh = build(np.random.default_rng(seed))
    size = np.ptp(mesh.bounds, axis=0)
    assert is_closed(mesh)
    assert (size >= low).all()
    assert (size <= high).all()
    assert abs(mesh.bounds[0, 2]) < 0.02  # stands on the ground


@given(st.floats(0, 1000))
def test_a_person_stands_on_the_ground_at_any_step(distance):
    low, high = objects.person(distance, 1.8).bounds
    assert -0.03 < low[2] < 0.15
    assert 1.7 < high[2] < 1.85
    assert np.ptp([low[0], high[0]]) < 1.3


def test_a_person_swings_the_legs():
    stride = [
        np.ptp(objects.person(distance).bounds[:, 0]) for distance in (0.0, objects.STRIDE / 4)
    ]
    assert stride[0] < 0.4 < 0.7 < stride[1]


def test_windows_are_openings_in_the_wall():
    import open3d as o3d

    walls, panes = objects.house(np.random.default_rng(0), 12.0, 10.0, 3)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(walls.vertices.astype(np.float32)),
        o3d.core.Tensor(walls.triangles.astype(np.uint32)),
    )
    low, high = panes.bounds
    x, z = np.meshgrid(np.linspace(low[0] + 0.3, high[0], 40), np.linspace(low[2], high[2], 40))
    rays = np.stack([x, np.full_like(x, 5), z, 0 * x, 0 * x - 1, 0 * x], -1).astype(np.float32)
    depth = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    through = depth > 8
    assert 0.1 < through.mean() < 0.6
    assert np.isfinite(depth).all()  # the room behind stops every ray
