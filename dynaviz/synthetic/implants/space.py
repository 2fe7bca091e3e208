"""The ground, and the space above it that no point occupies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dynaviz.arrays import F32, F64, I64, U64, Bool
from dynaviz.errors import UsageError
from dynaviz.spatial.scan_ground import EDGE
from dynaviz.synthetic.implants.survey import CELL, LAYER, Survey

GROUND = round(EDGE / CELL)  # columns along the edge of a ground cell
APART = 2  # ground cells; gaps between rings that the ground bridges
FIT = 2  # ground cells; standard deviation of the weights of a plane fit is 0.6 of it
OBSTACLE = 0.25  # metres above the ground
# metres; space above this is not needed by cars and persons, and by trucks
TALL = {
    "low": 2.3,
    "high": 4.3,
}
# a ground cell shows only its ground this many times as often as an obstacle, and in as many parts
PASSED = 2
SURE = 5
LARGEST = 100_000_000  # columns in the bounding box


@dataclass(frozen=True, eq=False)
class SpaceAboveGround:
    """A grid of columns of ``CELL`` metres over the surveyed area.

    Attributes:
        origin: (2,) int64: index of the first column.
        shape: number of columns along x and y.
        ground: (X, Y) float64, metres: height of the ground on the coarse grid; NaN where unknown.
        lowest: (X, Y) float32, metres above the ground: the lowest obstacle of each column;
            infinite if it has none.
        passing: (P, 2) float64, metres: columns through which movers passed; they are free at other
            times.
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
        first = cells.min(0)
        last = cells.max(0)
        size = last - first + 1
        if int(size[0]) * int(size[1]) * GROUND**2 > LARGEST:
            km = size * GROUND * CELL / 1000
            raise UsageError(
                f"implants: the sequence covers {km[0]:.1f} by {km[1]:.1f} km, too much for a grid "
                f"of {CELL} m. "
                "Use fewer frames, for example 0:2000"
            )
        ground = _ground(survey, first, (int(size[0]), int(size[1])))
        origin = first * GROUND
        shape = (int(size[0]) * GROUND, int(size[1]) * GROUND)
        space = cls(
            origin,
            shape,
            ground,
            np.full(shape, np.inf, np.float32),
            np.empty((0, 2)),
            np.empty(0, np.uint64),
        )
        centres: F64 = ((survey.columns + 0.5) * CELL).astype(np.float64)
        passed = _passed(survey, (cells - first) @ (size[1], 1))
        obstacle = (survey.height > OBSTACLE) & ~passed
        x, y = (survey.columns[obstacle] - origin).T
        np.minimum.at(space.lowest, (x, y), survey.height[obstacle].astype(np.float32))
        return replace(space, passing=centres[passed], parts=survey.parts[passed])

    def height(self, xy: F64) -> F64:
        """(N,) float64: height of the ground, metres, at (N, 2) metres; NaN where unknown.

        Bilinear.
        """
        at = np.asarray(xy) / (CELL * GROUND) - self.origin / GROUND - 0.5
        low = np.clip(
            np.floor(at).astype(np.int64), 0, np.maximum(np.array(self.ground.shape) - 2, 0)
        )
        (i, j) = low.T
        (u, v) = np.clip(at - low, 0, 1).T
        k = np.minimum(i + 1, self.ground.shape[0] - 1)
        m = np.minimum(j + 1, self.ground.shape[1] - 1)
        g = self.ground
        height: F64 = (1 - u) * ((1 - v) * g[i, j] + v * g[i, m]) + u * (
            (1 - v) * g[k, j] + v * g[k, m]
        )
        return height

    def passed(self, when: np.uint64) -> F64:
        """(N, 2) float64, metres: columns in which a mover is at a part of the recording."""
        there: F64 = self.passing[(self.parts & when) != 0]
        return there

    def known_ground(self) -> F64:
        """(N, 2) float64, metres: centres of the ground cells with a known height."""
        cells: F64 = (
            np.argwhere(np.isfinite(self.ground)) + 0.5
        ) * CELL * GROUND + self.origin * CELL
        return cells

    @cached_property
    def clearance(self) -> dict[str, F32]:
        """For each entry of ``TALL``.

        (X, Y) metres to the nearest column that is blocked or has no known ground.
        """
        from scipy.ndimage import distance_transform_edt

        known = np.repeat(np.repeat(np.isfinite(self.ground), GROUND, 0), GROUND, 1)
        return {
            name: (
                CELL * distance_transform_edt(np.pad(known & ~(self.lowest < tall), 1))[1:-1, 1:-1]
            ).astype(np.float32)
            for name, tall in TALL.items()
        }

    def clear(self, xy: F64, tall: str = "low") -> F64:
        """(N,) metres from (N, 2) metres to the nearest blocked column, less the rounding of the
        grid.
        """
        column = np.floor(np.asarray(xy) / CELL).astype(np.int64) - self.origin
        inside = ((column >= 0) & (column < self.shape)).all(-1)
        i, j = np.clip(column, 0, np.array(self.shape) - 1).T
        clear: F64 = np.where(inside, self.clearance[tall][i, j] - CELL, 0.0)
        return clear


def _passed(survey: Survey, cells: I64) -> Bool:
    """(V,) bool: voxels that a mover left and that nothing labels.

    Most of the time, their cell shows only its ground.

    A static obstacle hides the ground behind its face, and is seen as often as the ground at its
    foot.

    Args:
        survey: its voxels.
        cells: (V,) int64: number of the ground cell of each voxel.
    """
    above = survey.height
    body = (above > OBSTACLE) & (above < TALL["high"])
    ground = np.abs(above) <= 2 * LAYER
    when = np.zeros((2, int(cells.max()) + 1), np.uint64)
    for row, chosen in zip(when, (body, ground), strict=True):
        np.bitwise_or.at(row, cells[chosen], survey.parts[chosen])
    taken, seen = when
    free, taken = (
        np.unpackbits(bits.view(np.uint8).reshape(-1, 8), axis=1).sum(1)
        for bits in (seen & ~taken, taken)
    )
    mostly: Bool = free >= np.maximum(PASSED * taken, SURE)
    return body & mostly[cells]


def _ground(survey: Survey, first: I64, shape: tuple[int, int]) -> F64:
    """(X, Y) metres: height of the ground that scans show, smoothed; NaN where none is near."""
    cells = survey.cells - first
    inside = ((cells >= 0) & (cells < shape)).all(1)
    if not inside.any():
        raise UsageError(
            "implants: no ground is visible under the sensor's path. Check that z points up in the "
            "poses"
        )
    ground = np.full(shape, np.nan)
    ground[tuple(cells[inside].T)] = survey.ground[inside]
    return _smooth(ground)


def _smooth(bottom: F64) -> F64:
    """Plane fits to the known cells around each cell; NaN where fewer than three lie near it."""
    from scipy.ndimage import convolve1d, maximum_filter

    known = np.isfinite(bottom)
    steps = np.arange(-2 * FIT, 2 * FIT + 1)
    bell = np.exp(-0.5 * (steps / (0.6 * FIT)) ** 2)

    def moment(values: F64, i: int, j: int) -> F64:
        """Weighted sum of values times the offset along x to the power i and along y to the power
        j.
        """
        rows = convolve1d(values, (bell * (-steps) ** i), axis=0, mode="constant")
        done: F64 = convolve1d(rows, (bell * (-steps) ** j), axis=1, mode="constant")
        return done

    level = float(np.nanmedian(bottom))
    z = np.where(known, bottom - level, 0.0)
    w = known.astype(np.float64)
    s = moment(w, 0, 0)
    sx = moment(w, 1, 0)
    sy = moment(w, 0, 1)
    # a ridge on the slopes
    sxx = moment(w, 2, 0) + 0.5
    sxy = moment(w, 1, 1)
    syy = moment(w, 0, 2) + 0.5
    t = moment(z, 0, 0)
    tx = moment(z, 1, 0)
    ty = moment(z, 0, 1)
    # Cramer's rule for the height at offset zero of the plane t = s a + sx b + sy c, ...
    determinant = s * (sxx * syy - sxy**2) - sx * (sx * syy - sxy * sy) + sy * (sx * sxy - sxx * sy)
    numerator = t * (sxx * syy - sxy**2) - sx * (tx * syy - sxy * ty) + sy * (tx * sxy - sxx * ty)
    with np.errstate(divide="ignore", invalid="ignore"):
        fitted = numerator / determinant + level
    enough = (s > 0.5) & maximum_filter(known, 2 * APART + 1)
    smooth: F64 = np.where(enough, fitted, np.nan)
    return smooth
