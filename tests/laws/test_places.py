"""Laws of geometry: transforms, voxel keys, blocks, polar bins, range images, nearest points."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dynaviz import kernels
from dynaviz.blocks.blocks import BlockGrid, read, voxels_of
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.scan import Scan
from dynaviz.kernels.keys import REACH
from dynaviz.spatial import geometry
from dynaviz.spatial.grid import in_key_range, pack, unpack, voxel_downsample
from dynaviz.spatial.nearest import Nearest, nearest_distance
from dynaviz_methods.erasor.polar import PolarBins
from dynaviz_methods.shared.range_images import image_views, slices, whole

SHARED = kernels.load("dynaviz_methods.shared.kernels")

pytestmark = pytest.mark.boundscheck

some = settings(max_examples=30)
numbers = st.floats(-100, 100, allow_subnormal=False)
quaternions = hnp.arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(
    lambda q: np.linalg.norm(q) > 1e-3
)
poses = st.builds(geometry.pose, hnp.arrays(np.float64, 3, elements=numbers), quaternions)
whole_steps = st.tuples(*[st.integers(-40, 40)] * 3)
binary_sizes = st.sampled_from([0.125, 0.25, 0.5, 1.0, 2.0])  # voxels whose borders are float32
seeds = st.integers(0, 2**32 - 1)


def clouds(most: int = 40, least: int = 0) -> st.SearchStrategy[Any]:
    """(N, 3) float32 within 60 m: on borders, duplicates, close to both, and anywhere.

    All coordinates are multiples of 2^-10 m, about a millimetre, so that shifts do not round.
    """

    def cloud(n: int, seed: int) -> Any:
        random = np.random.default_rng(seed)
        kinds = [
            random.uniform(-60, 60, (n, 3)),
            random.integers(-30, 30, (n, 3)),
            random.normal(0, 0.01, (n, 3)),
        ]
        points = np.choose(random.integers(0, 3, (n, 3)), kinds)
        return (np.round(points * 1024) / 1024).astype(np.float32)

    return st.builds(cloud, st.integers(least, most), seeds)


def shuffled(n: int, seed: int) -> Any:
    return np.random.default_rng(seed).permutation(n)


# Transforms


@some
@given(poses)
def test_inverting_twice_changes_nothing(T: Any) -> None:
    np.testing.assert_allclose(geometry.inverse(geometry.inverse(T)), T, atol=1e-12)


@some
@given(poses, poses)
def test_the_inverse_of_a_composition_reverses_it(T_a_b: Any, T_b_c: Any) -> None:
    back = geometry.compose(geometry.inverse(T_b_c), geometry.inverse(T_a_b))
    np.testing.assert_allclose(geometry.inverse(geometry.compose(T_a_b, T_b_c)), back, atol=1e-10)


@some
@given(poses, poses, poses)
def test_composition_is_associative(A: Any, B: Any, C: Any) -> None:
    left, right = (
        geometry.compose(geometry.compose(A, B), C),
        geometry.compose(A, geometry.compose(B, C)),
    )
    np.testing.assert_allclose(left, right, atol=1e-10)


@some
@given(poses, clouds())
def test_transforming_back_restores_points(T: Any, points: Any) -> None:
    away = geometry.apply(T, points)
    np.testing.assert_allclose(geometry.apply(geometry.inverse(T), away), points, atol=1e-11)


@some
@given(poses, clouds(20))
def test_transforms_preserve_distances(T: Any, points: Any) -> None:
    def distances(xyz: Any) -> Any:
        return np.linalg.norm(xyz[:, None] - xyz[None], axis=-1)

    np.testing.assert_allclose(
        distances(geometry.apply(T, points)), distances(points.astype(float)), atol=1e-11
    )


@some
@given(clouds())
def test_the_identity_changes_no_bit(points: Any) -> None:
    np.testing.assert_array_equal(geometry.transform(np.eye(4), points), points)


@some
@given(quaternions, st.sampled_from([-3.0, -1.0, 0.01, 1000.0]))
def test_length_and_sign_of_a_quaternion_do_not_matter(q: Any, factor: float) -> None:
    np.testing.assert_allclose(geometry.matrix(q * factor), geometry.matrix(q), atol=1e-12)


@some
@given(quaternions)
def test_a_rotation_survives_its_quaternion(q: Any) -> None:
    R = geometry.matrix(q)
    np.testing.assert_allclose(geometry.matrix(geometry.quaternion(R)), R, atol=1e-12)


# Voxel keys


@some
@given(clouds(), binary_sizes)
def test_keys_survive_a_round_trip(points: Any, size: float) -> None:
    keys = pack(points, size)
    middles = ((unpack(keys) + 0.5) * size).astype(np.float32)
    np.testing.assert_array_equal(pack(middles, size), keys)


@some
@given(clouds(), binary_sizes, whole_steps)
def test_a_shift_by_whole_voxels_shifts_indices(points: Any, size: float, step: Any) -> None:
    moved = points + np.multiply(step, size).astype(np.float32)
    np.testing.assert_array_equal(unpack(pack(moved, size)), unpack(pack(points, size)) + step)


@some
@given(clouds(), binary_sizes)
def test_voxels_nest(points: Any, size: float) -> None:
    np.testing.assert_array_equal(unpack(pack(points, 2 * size)), unpack(pack(points, size)) >> 1)


@some
@given(clouds(), st.floats(0.01, 5), st.integers(0, 2))
def test_indices_grow_with_coordinates(points: Any, size: float, axis: int) -> None:
    ordered = points[np.argsort(points[:, axis], kind="stable")]
    assert (np.diff(unpack(pack(ordered, size))[:, axis]) >= 0).all()


@some
@given(
    hnp.arrays(np.float32, st.tuples(st.integers(1, 4), st.just(3)), elements=st.floats(width=32)),
    st.floats(0.01, 100) | st.sampled_from([0.1, 0.3, 1 / 3]),
    st.integers(0, 2),
    st.sampled_from([-1, 1]),
    st.integers(-2, 2),
)
def test_points_in_key_range_have_a_key(
    points: Any, size: float, axis: int, side: int, steps: int
) -> None:
    """Also a few float32 numbers around the farthest coordinate."""
    edge = np.float32(side * REACH * size)
    for _ in range(abs(steps)):
        edge = np.nextafter(edge, np.float32(np.inf * steps), dtype=np.float32)
    points[0] = 0
    points[0, axis] = edge
    for point, has in zip(points, in_key_range(points, size), strict=True):
        if has:
            index = unpack(pack(point[None], size))[0]
            assert (np.abs(index) <= REACH).all()


@some
@given(clouds(), st.floats(0.05, 5), seeds)
def test_downsampling_keeps_one_point_per_voxel_and_all_counts(
    points: Any, size: float, seed: int
) -> None:
    chosen, counts = voxel_downsample(points, size)
    assert counts.sum() == len(points)
    again, ones = voxel_downsample(points[chosen], size)
    assert again.tolist() == list(range(len(chosen)))
    assert (ones == 1).all()
    other, _ = voxel_downsample(points[shuffled(len(points), seed)], size)
    assert len(other) == len(chosen)


# Blocks of voxels


def grid_of(points: Any, size: float) -> BlockGrid:
    return BlockGrid(Extent.of(Scan(0, points, np.eye(4))), size)


@some
@given(clouds(), st.sampled_from([0.05, 0.1, 0.3, 1.0]))
def test_blocks_and_keys_agree(points: Any, size: float) -> None:
    grid = grid_of(points, size)
    voxels, keys = grid.locate(points), pack(points, size)
    np.testing.assert_array_equal(grid.keys(voxels), unpack(keys))
    assert len(np.unique(voxels)) == len(np.unique(keys))  # one number a voxel


@some
@given(clouds(least=2), st.sampled_from([0.1, 0.3]), st.integers(1, 39), seeds)
def test_a_larger_extent_moves_no_point(points: Any, size: float, few: int, seed: int) -> None:
    part = points[:few]
    small, large = grid_of(part, size), grid_of(points[shuffled(len(points), seed)], size)
    np.testing.assert_array_equal(small.keys(small.locate(part)), large.keys(large.locate(part)))


@some
@given(hnp.arrays(np.int64, st.tuples(st.integers(0, 6), st.just(8))))
def test_read_finds_the_set_bits(bits: Any) -> None:
    voxels = voxels_of(np.arange(len(bits), dtype=np.int32), bits)
    everywhere = np.arange(512 * len(bits))
    np.testing.assert_array_equal(np.flatnonzero(read(bits, everywhere)), voxels)
    assert len(voxels) == sum(int(word).bit_count() for word in bits.view(np.uint64).ravel())
    assert not read(bits, np.array([-1])).any() if len(bits) else True


@some
@given(clouds(30, 2), seeds, st.data())
def test_marks_are_the_union_over_parts_of_a_scan(points: Any, seed: int, data: Any) -> None:
    """Marks of a scan are the union of those of its parts, in any order of its points."""
    grid = grid_of(points, 0.5)
    at = data.draw(st.integers(1, len(points) - 1))
    order = shuffled(len(points), seed)

    def marks(xyz: Any) -> tuple[set[int], set[int]]:
        found = grid.mark(Scan(0, xyz, np.eye(4)), np.ones(len(xyz), bool), np.ones(len(xyz), bool))
        return tuple(
            set(voxels_of(found.blocks, part).tolist())
            for part in (found.bits[:, :8], found.bits[:, 8:])
        )  # type: ignore[return-value]

    whole, first, second = marks(points[order]), marks(points[:at]), marks(points[at:])
    assert whole == (first[0] | second[0], first[1] | second[1])
    assert whole[1] == set(grid.locate(points).tolist())


# Bins around the sensor

BINS = PolarBins(max_range=40.0, rings=10, sectors=36, low=-2.0, high=3.0)
FOOT = np.array([1.5, -2.25, 0.5])


def every_bin() -> Any:
    """(rings * sectors, 3): centres of all bins."""
    ring, sector = np.divmod(np.arange(BINS.rings * BINS.sectors), BINS.sectors)
    r = (ring + 0.5) * BINS.max_range / BINS.rings
    azimuth = (sector + 0.5) * 2 * np.pi / BINS.sectors
    return (
        FOOT + np.stack([r * np.cos(azimuth), r * np.sin(azimuth), np.zeros(len(r))], 1)
    ).astype(np.float32)


def test_the_middle_of_each_bin_is_in_it() -> None:
    rows, bins = BINS.locate(every_bin(), FOOT)
    np.testing.assert_array_equal(rows, bins)
    assert len(rows) == BINS.rings * BINS.sectors


@some
@given(clouds())
def test_bins_partition_the_points_within_range_and_height_band(points: Any) -> None:
    rows, bins = BINS.locate(points, FOOT)
    away = points.astype(np.float64) - [*FOOT[:2], 0.0]
    near = np.hypot(away[:, 0], away[:, 1]) < BINS.max_range
    clear = np.abs(np.hypot(away[:, 0], away[:, 1]) - BINS.max_range) > 1e-9
    assert set(rows[clear[rows]].tolist()) == set(np.flatnonzero(near & clear).tolist())
    height = points[rows, 2].astype(np.float64) - FOOT[2]
    np.testing.assert_array_equal(bins >= 0, (height > BINS.low) & (height < BINS.high))
    assert (bins < BINS.rings * BINS.sectors).all()
    _, counts = BINS.heights(points, rows, bins)
    assert counts.sum() == (bins >= 0).sum()


@some
@given(clouds(), st.integers(0, 40))
def test_spans_and_removed_rows_partition_the_points(points: Any, at: int) -> None:
    at, n = min(at, len(points)), len(points)
    whole = BINS.locate(points, FOOT)
    parts = BINS.locate(points, FOOT, np.array([[0, at], [at, n]]))
    np.testing.assert_array_equal(np.stack(whole), np.stack(parts))
    gone = np.arange(n) < at
    left = BINS.locate(points, FOOT, gone=gone)
    np.testing.assert_array_equal(np.stack(left), np.stack(whole)[:, whole[0] >= at])


@some
@given(clouds(least=1), st.integers(0, 35))
def test_a_rotation_by_whole_sectors_rotates_the_bins(points: Any, turn: int) -> None:
    angle = 2 * np.pi * turn / BINS.sectors
    away = points.astype(np.float64) - FOOT
    c, s = np.cos(angle), np.sin(angle)
    turned = np.stack(
        [c * away[:, 0] - s * away[:, 1], s * away[:, 0] + c * away[:, 1], away[:, 2]], 1
    )
    azimuth = np.degrees(np.arctan2(away[:, 1], away[:, 0])) / 10 % 1
    r = np.hypot(away[:, 0], away[:, 1]) / 4
    band = np.minimum(np.abs(away[:, 2] - BINS.low), np.abs(away[:, 2] - BINS.high))
    clear = (
        (np.minimum(azimuth, 1 - azimuth) > 1e-3) & (np.abs(r - np.round(r)) > 1e-3) & (band > 1e-3)
    )
    (rows, bins), (other_rows, other) = (
        BINS.locate((xyz[clear] + FOOT).astype(np.float32), FOOT) for xyz in (away, turned)
    )
    np.testing.assert_array_equal(rows, other_rows)
    ring, sector = np.divmod(bins, BINS.sectors)
    np.testing.assert_array_equal(
        other, np.where(bins < 0, -1, ring * BINS.sectors + (sector + turn) % BINS.sectors)
    )


@some
@given(clouds(), st.integers(-64, 64))
def test_height_differences_do_not_depend_on_the_origin(points: Any, lift: int) -> None:
    up = np.array([0, 0, lift / 4], np.float32)
    here, there = (
        BINS.heights(xyz, *BINS.locate(xyz, foot))
        for xyz, foot in ((points, FOOT), (points + up, FOOT + up))
    )
    np.testing.assert_array_equal(here[0], there[0])
    np.testing.assert_array_equal(here[1], there[1])


# Range images

VIEWS = image_views((1.0, 0.4), (-25.0, 15.0), (-180.0, 180.0))
AT, AXES = (
    kernels.as_readonly((3.5, -1.25, 2.0), np.float64),
    kernels.as_readonly(np.eye(3), np.float64),
)


def nearest_of(points: Any, lanes: int = 2) -> tuple[Any, Any]:
    xyz, camera = kernels.as_readonly(points.T, np.float32), (AT, AXES, VIEWS, False)
    return SHARED.range_image.nearest(xyz, *whole(len(points)), *camera, lanes, np.float32(0))


def rays(view: Any, ranges: Any) -> Any:
    """(rows * columns, 3): a point at the centre of every pixel.

    Those of column 0 are at the first azimuth.
    """
    row, column = np.divmod(np.arange(int(view[0] * view[1])), int(view[1]))
    elevation, azimuth = (view[2] - row) / view[3], (column - view[4]) / view[5]
    flat = np.cos(elevation)
    away = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], 1)
    return (AT + away * np.broadcast_to(ranges, len(row))[:, None]).astype(np.float32)


@settings(max_examples=10)
@given(st.floats(1, 90), st.integers(0, 1))
def test_the_middle_of_each_pixel_is_in_it(distance: float, k: int) -> None:
    ranges, indices = nearest_of(rays(VIEWS[k], distance))
    (pixels,) = slices(VIEWS[k : k + 1])
    inner = np.arange(pixels.stop - pixels.start) % int(VIEWS[k, 1])
    inner = np.flatnonzero((inner > 0) & (inner < VIEWS[k, 1] - 1))
    np.testing.assert_array_equal(indices[pixels][inner], inner)
    np.testing.assert_allclose(ranges[pixels][inner], distance, rtol=1e-5)


@some
@given(clouds(60), clouds(60), seeds)
def test_the_image_of_two_clouds_is_the_minimum_of_both(a: Any, b: Any, seed: int) -> None:
    both = np.concatenate([a, b])
    together, indices = nearest_of(both)
    np.testing.assert_array_equal(together, np.minimum(nearest_of(a)[0], nearest_of(b)[0]))
    np.testing.assert_array_equal(nearest_of(both[shuffled(len(both), seed)], lanes=3)[0], together)
    met = indices >= 0
    away = np.linalg.norm(both[indices[met]] - AT, axis=1)
    np.testing.assert_allclose(together[met], away, rtol=1e-5)
    assert np.isinf(together[~met]).all()


# The nearest of many points


@some
@given(clouds(50, 1), clouds(50, 1), clouds(50, 1))
def test_the_distance_to_two_sets_is_the_minimum(query: Any, a: Any, b: Any) -> None:
    both = nearest_distance(query, np.concatenate([a, b]))
    np.testing.assert_array_equal(
        both, np.minimum(nearest_distance(query, a), nearest_distance(query, b))
    )


@some
@given(clouds(50, 1), clouds(50, 1), seeds)
def test_distances_do_not_depend_on_order(query: Any, reference: Any, seed: int) -> None:
    order = shuffled(len(query), seed)
    other = nearest_distance(query[order], reference[shuffled(len(reference), seed)])
    np.testing.assert_array_equal(other, nearest_distance(query, reference)[order])


@some
@given(clouds(50, 1), clouds(50, 1))
def test_points_of_the_set_have_distance_zero(points: Any, others: Any) -> None:
    tree = Nearest(np.concatenate([others, points]))
    assert (tree.distance(points) == 0).all()
    assert tree.within(points, 0.0).all()


@some
@given(clouds(50, 1), clouds(50, 1), st.lists(st.floats(0, 200, width=32), min_size=2, max_size=4))
def test_points_within_a_limit_are_within_a_larger_limit(
    query: Any, reference: Any, limits: list[float]
) -> None:
    tree, distance = Nearest(reference), nearest_distance(query, reference)
    before = np.zeros(len(query), bool)
    for limit in sorted(limits):
        within = tree.within(query, limit)
        assert (within >= before).all()
        np.testing.assert_array_equal(within, distance <= np.float32(limit))
        before = within


@some
@given(clouds(30, 1), clouds(30, 1))
def test_the_smallest_distance_is_symmetric(a: Any, b: Any) -> None:
    assert nearest_distance(a, b).min() == nearest_distance(b, a).min()
