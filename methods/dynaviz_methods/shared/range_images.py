"""Layout of range images at several resolutions, as filled by ``dynaviz.SHARED.range_image``.

Rows run downwards from the highest elevation, columns with increasing azimuth; integer coordinates
are pixel centres (Kim and Kim, IROS 2020). All images are stored one after another in one flat
array.
"""

from __future__ import annotations

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I64
from dynaviz.contracts.probe import ImageSpan, RangeImage

SHARED = kernels.load("dynaviz_methods.shared.kernels")


def image_views(
    resolutions: tuple[float, ...], elevation: tuple[float, ...], azimuth: tuple[float, ...]
) -> F64:
    """Lay out images of the same field of view.

    Args:
        resolutions: resolution of each image, pixels per degree.
        elevation: (lowest, highest), degrees above the horizon.
        azimuth: (from, to), degrees, within -180 ... 180.

    Returns:
        (K, 7) float64: rows, columns, row at elevation 0, rows per radian, column at azimuth 0,
        columns per radian, and the index of the first pixel in the flat array.
    """
    views = []
    start = 0
    (low, high) = np.radians(elevation)
    (begin, end) = np.radians(azimuth)
    for resolution in resolutions:
        rows = max(1, round((elevation[1] - elevation[0]) * resolution))
        columns = max(1, round((azimuth[1] - azimuth[0]) * resolution))
        per_row = rows / (high - low)
        per_column = columns / (end - begin)
        views.append(
            (rows, columns, high * per_row, per_row, -begin * per_column, per_column, start)
        )
        start += rows * columns
    return kernels.as_readonly(views, np.float64)


def chunks(spans: I64) -> I64:
    """Split spans of points, (S, 2) int64, each [first, end), into pieces of the size that the
    kernels take.
    """
    most = SHARED.range_image.CHUNK
    (first, last) = spans.T
    pieces = -(-(last - first) // most)
    start = np.repeat(first - most * (np.cumsum(pieces) - pieces), pieces) + most * np.arange(
        pieces.sum()
    )
    return kernels.as_readonly(
        np.stack([start, np.minimum(start + most, np.repeat(last, pieces))], 1), np.int64
    )


def whole(points: int) -> tuple[I64, np.float32]:
    """All points, without a range limit.

    The chunks of that many points, and an infinite reach, metres.
    """
    return chunks(np.array([[0, points]])), np.float32(np.inf)


def slices(views: F64) -> list[slice]:
    """The slice of each image in the flat array."""
    return [slice(int(view[6]), int(view[6] + view[0] * view[1])) for view in views]


def picture(flat: F32, view: F64) -> RangeImage:
    """One of the images as seen from the sensor, with the left on the left.

    NaN where not finite.
    """
    (pixels,) = slices(view[None])
    image = flat[pixels].reshape(int(view[0]), int(view[1]))[:, ::-1]
    return RangeImage(np.where(np.isfinite(image), image, np.float32(np.nan)), span_of(view))


def span_of(view: F64) -> ImageSpan:
    """The directions that an image shows, as ``picture`` turns it."""
    rows, columns, level, per_row, ahead, per_column = view[:6].tolist()
    return ImageSpan(
        left=(columns - 0.5 - ahead) / per_column,
        right=(-0.5 - ahead) / per_column,
        top=(level + 0.5) / per_row,
        bottom=(level - rows + 0.5) / per_row,
    )
