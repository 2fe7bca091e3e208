"""The ground, and the space above it that no point occupies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dynaviz.arrays import F32, F64, I64, U64, Bool
from dynaviz.errors import UsageError
from dynaviz.synthetic.implants.survey import CELL, LAYER, Survey

GROUND = 3  # columns along the edge of a ground cell: 0.6 m
BOTTOM = 0.03  # share of a cell's points that may lie below its ground: multipath returns
STEP, SLOPE = 0.06, 0.12  # metres and metres per metre: largest rise between neighbouring ground cells
APART = 3  # ground cells; gaps between rings that the ground bridges
AROUND = 14  # ground cells around the sensor in which the ground is searched
FIT = 3  # ground cells; standard deviation of the weights of a plane fit is a third of it
ROUGH = (0.2, 0.1, 0.08)  # metres; ground cells higher above the plane of their neighbours are dropped, in rounds
OBSTACLE = 0.25  # metres above the ground
TALL = {"low": 2.3, "high": 4.3}  # metres; space above this is not needed by cars and persons, and by trucks
PASSED, SURE = 2, 5  # a ground cell shows only its ground this many times as often as an obstacle, and in as many parts
LARGEST = 100_000_000  # columns in the bounding box


@dataclass(frozen=True, eq=False)
class SpaceAboveGround:
    """A grid of columns of ``CELL`` metres over the surveyed area.

    Attributes:
        origin: (2,) int64: index of the first column.
        shape: number of columns along x and y.
        ground: (X, Y) float64, metres: height of the ground on the coarse grid; NaN where unknown.
        lowest: (X, Y) float32, metres above the ground: the lowest obstacle of each column; infinite if it has none.
        passing: (P, 2) float64, metres: columns through which movers passed; they are free at other times.
        parts: (P,) uint64: when, as in ``Survey.parts``.
    """

    origin: I64
    shape: tuple[int, int]
    ground: F64
    lowest: F32
    passing: F64
    parts: U64

    @classmethod
    def of(cls, survey: Survey) -> SpaceAboveGround:
        """Estimate the ground and the free space.

        Raises:
            UsageError: if no ground is found under the trajectory, or the area is too large.
        """
        if not len(survey.columns):
            raise UsageError("implants: the sequence has no points near the sensor")
        cells = survey.columns // GROUND
        first, last = cells.min(0), cells.max(0)
        size = last - first + 1
        if int(size[0]) * int(size[1]) * GROUND**2 > LARGEST:
            km = size * GROUND * CELL / 1000
            raise UsageError(
                f"implants: the sequence covers {km[0]:.1f} by {km[1]:.1f} km, too much for a grid of {CELL} m. "
                "Use fewer frames, for example 0:2000"
            )
        ground = _ground(survey, cells - first, (int(size[0]), int(size[1])), first)
        origin, shape = first * GROUND, (int(size[0]) * GROUND, int(size[1]) * GROUND)
        space = cls(origin, shape, ground, np.full(shape, np.inf, np.float32), np.empty((0, 2)), np.empty(0, np.uint64))
        centres: F64 = ((survey.columns + 0.5) * CELL).astype(np.float64)
        above = survey.height - space.height(centres)
        passed = _passed(survey, (cells - first) @ (size[1], 1), above)
        obstacle = (above > OBSTACLE) & ~passed
        x, y = (survey.columns[obstacle] - origin).T
        np.minimum.at(space.lowest, (x, y), above[obstacle].astype(np.float32))
        return replace(space, passing=centres[passed], parts=survey.parts[passed])

    def height(self, xy: F64) -> F64:
        """(N,) float64: height of the ground, metres, at (N, 2) metres; NaN where unknown. Bilinear."""
        at = np.asarray(xy) / (CELL * GROUND) - self.origin / GROUND - 0.5
        low = np.clip(np.floor(at).astype(np.int64), 0, np.maximum(np.array(self.ground.shape) - 2, 0))
        (i, j), (u, v) = low.T, np.clip(at - low, 0, 1).T
        k, m = np.minimum(i + 1, self.ground.shape[0] - 1), np.minimum(j + 1, self.ground.shape[1] - 1)
        g = self.ground
        height: F64 = (1 - u) * ((1 - v) * g[i, j] + v * g[i, m]) + u * ((1 - v) * g[k, j] + v * g[k, m])
        return height

    def passed(self, when: np.uint64) -> F64:
        """(N, 2) float64, metres: columns in which a mover is at a part of the recording."""
        there: F64 = self.passing[(self.parts & when) != 0]
        return there

    def known_ground(self) -> F64:
        """(N, 2) float64, metres: centres of the ground cells with a known height."""
        cells: F64 = (np.argwhere(np.isfinite(self.ground)) + 0.5) * CELL * GROUND + self.origin * CELL
        return cells

    @cached_property
    def clearance(self) -> dict[str, F32]:
        """For each entry of ``TALL``: (X, Y) metres to the nearest column that is blocked or has no known ground."""
        from scipy.ndimage import distance_transform_edt

        known = np.repeat(np.repeat(np.isfinite(self.ground), GROUND, 0), GROUND, 1)
        return {
            name: (CELL * distance_transform_edt(np.pad(known & ~(self.lowest < tall), 1))[1:-1, 1:-1]).astype(
                np.float32
            )
            for name, tall in TALL.items()
        }

    def clear(self, xy: F64, tall: str = "low") -> F64:
        """(N,) metres from (N, 2) metres to the nearest blocked column, less the rounding of the grid."""
        column = np.floor(np.asarray(xy) / CELL).astype(np.int64) - self.origin
        inside = ((column >= 0) & (column < self.shape)).all(-1)
        i, j = np.clip(column, 0, np.array(self.shape) - 1).T
        clear: F64 = np.where(inside, self.clearance[tall][i, j] - CELL, 0.0)
        return clear


def _passed(survey: Survey, cells: I64, above: F64) -> Bool:
    """(V,) bool: voxels that a mover left and that nothing labels: most of the time, their cell shows only its ground.

    A static obstacle hides the ground behind its face, and is seen as often as the ground at its foot.

    Args:
        survey: its voxels.
        cells: (V,) int64: number of the ground cell of each voxel.
        above: (V,) metres above the ground.
    """
    body, ground = (above > OBSTACLE) & (above < TALL["high"]), np.abs(above) <= 2 * LAYER
    when = np.zeros((2, int(cells.max()) + 1), np.uint64)
    for row, chosen in zip(when, (body, ground), strict=True):
        np.bitwise_or.at(row, cells[chosen], survey.parts[chosen])
    taken, seen = when
    free, taken = (np.unpackbits(bits.view(np.uint8).reshape(-1, 8), axis=1).sum(1) for bits in (seen & ~taken, taken))
    mostly: Bool = free >= np.maximum(PASSED * taken, SURE)
    return body & mostly[cells]


def _ground(survey: Survey, cells: I64, shape: tuple[int, int], first: I64) -> F64:
    """(X, Y) heights of the ground: the lowest dense layer of each cell, if it is connected to the trajectory."""
    bottom = _lowest_layers(survey, cells, shape)
    near = ((survey.positions[:, :2] / (CELL * GROUND)).astype(np.int64) - first, survey.positions[:, 2])
    connected = _connected(bottom, *near)
    if not connected.any():
        raise UsageError("implants: no ground is visible under the sensor's path. Check that z points up in the poses")
    bottom[~connected] = np.nan
    for limit in ROUGH:
        with np.errstate(invalid="ignore"):
            above = bottom - _smooth(bottom)
            bottom[(above > limit) | (above < -2 * limit)] = np.nan
    return _smooth(bottom)


def _lowest_layers(survey: Survey, cells: I64, shape: tuple[int, int]) -> F64:
    """(X, Y) metres: mean height of the lowest two layers of each cell that are more than stray points; NaN if none."""
    flat = cells[:, 0] * shape[1] + cells[:, 1]
    layer = np.floor(survey.height / LAYER).astype(np.int64)
    order = np.lexsort((layer, flat))
    flat, layer, count = flat[order], layer[order], survey.count[order]
    total = np.bincount(flat, count, shape[0] * shape[1])
    starts = np.flatnonzero(np.diff(flat, prepend=-1))
    running = np.cumsum(count)
    below = running - np.repeat((running - count)[starts], np.diff(starts, append=len(flat)))  # with its own points
    dense = (below >= 2) & (below > BOTTOM * total[flat])
    ground_layer = np.full(shape[0] * shape[1], np.iinfo(np.int64).max)
    np.minimum.at(ground_layer, flat[dense], layer[dense])
    in_ground = (layer >= ground_layer[flat]) & (layer <= ground_layer[flat] + 1)
    weight = np.bincount(flat[in_ground], count[in_ground], len(total))
    heights = np.bincount(flat[in_ground], (count * survey.height[order])[in_ground], len(total))
    with np.errstate(invalid="ignore"):
        bottom: F64 = (heights / np.where(weight > 0, weight, np.nan)).reshape(shape)
    return bottom


def _connected(bottom: F64, under: I64, z: F64) -> Bool:
    """(X, Y) bool: the cells that join each other by small steps, of which most lie near and below the sensor."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    known = np.isfinite(bottom)
    number = np.full(bottom.shape, -1, np.int64)
    number[known] = np.arange(int(known.sum()))
    edges = [np.empty((2, 0), np.int64)]
    for dx in range(APART + 1):
        for dy in range(-APART, APART + 1):
            if (dx, dy) <= (0, 0) or dx * dx + dy * dy > APART * APART:
                continue
            here, there = _shifted(bottom.shape, dx, dy)
            with np.errstate(invalid="ignore"):
                flat = np.abs(bottom[there] - bottom[here]) < STEP + SLOPE * CELL * GROUND * np.hypot(dx, dy)
            edges.append(np.stack([number[here][flat], number[there][flat]]))
    a, b = np.concatenate(edges, axis=1)
    count = int(known.sum())
    _, part = connected_components(coo_array((np.ones(len(a), np.bool_), (a, b)), shape=(count, count)), directed=False)
    votes = np.zeros(count, np.int64)
    for (x, y), height in zip(under.tolist(), z.tolist(), strict=True):
        box = np.s_[max(x - AROUND, 0) : x + AROUND + 1, max(y - AROUND, 0) : y + AROUND + 1]
        near = number[box][known[box] & (bottom[box] < height - 0.2)]
        np.add.at(votes, part[near], 1)
    if not votes.any():
        return np.zeros(bottom.shape, np.bool_)
    best = int(votes.argmax())
    joined = np.zeros(bottom.shape, np.bool_)
    joined[known] = part == best
    return joined


def _shifted(shape: tuple[int, ...], dx: int, dy: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices of a grid, and of the same cells shifted by dx >= 0 and dy."""
    X, Y = shape
    ys = (slice(0, Y - dy), slice(dy, Y)) if dy >= 0 else (slice(-dy, Y), slice(0, Y + dy))
    return (slice(0, X - dx), ys[0]), (slice(dx, X), ys[1])


def _smooth(bottom: F64) -> F64:
    """Plane fits to the known cells around each cell; NaN where fewer than three lie near it."""
    from scipy.ndimage import convolve1d, maximum_filter

    known = np.isfinite(bottom)
    steps = np.arange(-2 * FIT, 2 * FIT + 1)
    bell = np.exp(-0.5 * (steps / (0.6 * FIT)) ** 2)

    def moment(values: F64, i: int, j: int) -> F64:
        """Weighted sum of values times the offset along x to the power i and along y to the power j."""
        rows = convolve1d(values, (bell * (-steps) ** i), axis=0, mode="constant")
        done: F64 = convolve1d(rows, (bell * (-steps) ** j), axis=1, mode="constant")
        return done

    level = float(np.nanmedian(bottom))
    z, w = np.where(known, bottom - level, 0.0), known.astype(np.float64)
    s, sx, sy = moment(w, 0, 0), moment(w, 1, 0), moment(w, 0, 1)
    sxx, sxy, syy = moment(w, 2, 0) + 0.5, moment(w, 1, 1), moment(w, 0, 2) + 0.5  # a ridge on the slopes
    t, tx, ty = moment(z, 0, 0), moment(z, 1, 0), moment(z, 0, 1)
    # Cramer's rule for the height at offset zero of the plane t = s a + sx b + sy c, ...
    determinant = s * (sxx * syy - sxy**2) - sx * (sx * syy - sxy * sy) + sy * (sx * sxy - sxx * sy)
    numerator = t * (sxx * syy - sxy**2) - sx * (tx * syy - sxy * ty) + sy * (tx * sxy - sxx * ty)
    with np.errstate(divide="ignore", invalid="ignore"):
        fitted = numerator / determinant + level
    enough = (s > 0.5) & maximum_filter(known, 2 * APART + 1)
    smooth: F64 = np.where(enough, fitted, np.nan)
    return smooth
