"""What one walk through a sequence tells."""

from __future__ import annotations

import dataclasses
import math
from itertools import product
from typing import Any

import numpy as np
import pytest
from helpers.worlds import InMemory, room

from dynaviz.contracts.extent import CELL, PARTS, Extent
from dynaviz.contracts.scan import Scan
from dynaviz.errors import DynavizError
from dynaviz.sources.summary import summarize


def test_it_counts_and_bounds() -> None:
    sequence = room()
    seen = summarize(sequence)
    points = np.concatenate([scan.points for scan in sequence.scans])
    assert (seen.frames, seen.points) == (6, len(points))
    np.testing.assert_array_equal(seen.extent.low, points.min(0))
    np.testing.assert_array_equal(seen.extent.high, points.max(0))
    cells = np.unique(np.floor(points.astype(np.float64) * (1 / CELL)).astype(np.int32), axis=0)
    np.testing.assert_array_equal(seen.extent.cells, cells)


def test_it_tells_how_far_it_is() -> None:
    done: list[int] = []
    summarize(room(frames=3), done.append)
    assert done == [1, 2, 3]


def test_an_extent_of_scans_is_that_of_their_sequence() -> None:
    sequence = room(frames=3)
    theirs, ours = summarize(sequence).extent, Extent.of(*sequence.scans)
    for field in dataclasses.fields(Extent):
        np.testing.assert_array_equal(getattr(ours, field.name), getattr(theirs, field.name))


def test_ray_origins_count_and_points_that_are_not_finite_do_not() -> None:
    points = np.array([[1, 1, 1], [np.nan, 50, 50], [50, np.inf, 50]], np.float32)
    extent = Extent.of(Scan(0, points, np.eye(4)))
    np.testing.assert_array_equal(extent.low, [0, 0, 0])
    np.testing.assert_array_equal(extent.high, [1, 1, 1])
    np.testing.assert_array_equal(extent.cells, [[1, 1, 1]])


def test_a_sequence_of_empty_scans_has_a_summary() -> None:
    seen = summarize(InMemory([Scan(0, np.zeros((0, 3), np.float32), np.eye(4))]))
    assert (seen.frames, seen.points, len(seen.extent.cells)) == (1, 0, 0)


@pytest.mark.parametrize("far", [5.4e6, -1e30])
def test_points_too_far_from_the_origin_are_rejected(far: float) -> None:
    with pytest.raises(
        DynavizError, match=r"frame 3: a point or sensor position is .* km from the world's origin"
    ):
        Extent.of(Scan(3, np.array([[0, far, 0]], np.float32), np.eye(4)))


def test_the_same_content_has_the_same_digest() -> None:
    assert summarize(room()).digest == summarize(room()).digest


def other(scan: Scan, **changes: Any) -> Scan:
    return dataclasses.replace(scan, **changes)


@pytest.mark.parametrize(
    "change",
    [
        lambda scan: other(scan, points=np.nextafter(scan.points, np.float32(100))),
        lambda scan: other(
            scan,
            T_world_sensor=scan.T_world_sensor + np.diag([0, 0, 1e-12, 0]),
            origins=scan.origins,
        ),
        lambda scan: other(scan, origins=scan.origins + 1e-12),
        lambda scan: other(scan, labels=1 - scan.labels),
        lambda scan: other(scan, labels=None),
        lambda scan: other(scan, points=scan.points[::-1]),
    ],
    ids=["points", "pose", "origins", "labels", "no labels", "order"],
)
def test_any_other_content_has_another_digest(change: Any) -> None:
    sequence = room(frames=2)
    assert (
        summarize(InMemory([sequence[0], change(sequence[1])])).digest != summarize(sequence).digest
    )


def test_a_point_cannot_move_from_one_frame_to_the_next_unseen() -> None:
    scan = room(frames=1)[0]

    def cut(at: int) -> InMemory:
        return InMemory(
            [
                Scan(k, rows, np.eye(4))
                for k, rows in enumerate((scan.points[:at], scan.points[at:]))
            ]
        )

    assert summarize(cut(10)).digest != summarize(cut(11)).digest


@pytest.mark.parametrize(
    ("around", "axes"), [(0.0, (0, 1, 2)), (0.3, (0, 1, 2)), (0.9, (0, 1, 2)), (3.2, (2,))]
)
def test_extents_know_the_parts_of_cells_that_contain_points_and_grow_by_parts(
    around, axes
) -> None:
    points = np.random.default_rng(0).normal(0, 4, (100, 3)).astype(np.float32)
    size = CELL / PARTS
    farther = [
        range(-m, m + 1)
        for m in (math.ceil(around / size) if axis in axes else 0 for axis in range(3))
    ]
    index = np.floor(points.astype(np.float64) / size).astype(np.int64)
    expected = {tuple(place) for shift in product(*farther) for place in (index + shift).tolist()}

    extent = Extent.of(Scan(0, points, np.eye(4))).widened(around, axes)

    cell, bit = np.nonzero(
        extent.parts[:, None] >> np.arange(PARTS**3, dtype=np.uint64) & np.uint64(1)
    )
    part = np.stack(np.unravel_index(bit, (PARTS,) * 3), 1)
    assert {tuple(place) for place in (PARTS * extent.cells[cell] + part).tolist()} == expected
    assert len(extent.cells) == len(np.unique(extent.cells, axis=0))
