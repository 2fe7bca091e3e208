"""Write LAS and LAZ maps with laspy, with all attributes.

LAS 1.4, or the version of the file that was cleaned.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64
from dynaviz.errors import DataError
from dynaviz.io.atomic import atomic_file
from dynaviz.io.las import import_laspy, read_las_header

LAS = (".las", ".laz")
SCALE = 1e-4  # metres
# point formats of LAS 1.4
_WITHOUT_COLOUR = 6
_WITH_COLOUR = 7
_COLOURS = ("red", "green", "blue")


@dataclass(frozen=True)
class LasHead:
    """What the header of a LAS map states besides the dimensions.

    Attributes:
        like: a LAS file whose header the map takes over: version and point format, scales and
            offsets, global encoding, and all records, such as the coordinate system; None for a
            plain header.
        adjusted_gps_time: whether ``gps_time`` is adjusted standard GPS time (``dynaviz.io.las``),
            if ``like`` is None.
    """

    like: Path | None = None
    adjusted_gps_time: bool = False


@contextlib.contextmanager
def las_map(
    path: Path, fields: Mapping[str, np.dtype[Any]], origin: F64, head: LasHead | None = None
) -> Iterator[Callable[[F64, Mapping[str, NDArray[Any]]], None]]:
    """Write a LAS file, or LAZ if the path ends so.

    Arguments and what is yielded as in ``dynaviz.io.maps.open_map``.

    An attribute becomes the standard dimension of its name (``intensity``, ``gps_time``,
    ``return_number``, ``red`` ...) if that can store its type without loss, otherwise an extra
    dimension. Intensities in floats become the extra dimension ``intensity_float32``; for viewers,
    ``intensity`` then has them rounded, scaled by 65535 if those of the first points are at most 1.
    """
    laspy = import_laspy(path)
    header, parts = _new_header(laspy, fields, origin, head or LasHead())
    names = {
        name: _dimension(laspy, header, name, np.dtype(dtype))
        for name, dtype in fields.items()
        if name not in parts
    }
    gain: float | None = None

    def append(xyz: F64, fields: Mapping[str, NDArray[Any]]) -> None:
        nonlocal gain
        if not len(xyz):
            return
        points = laspy.ScaleAwarePointRecord.zeros(len(xyz), header=header)
        try:
            for axis, name in enumerate("xyz"):
                points[name] = xyz[:, axis]
            for name, dimension in names.items():
                points[dimension] = fields[name]
            for part, (name, k) in parts.items():
                points[name][:, k] = fields[part]
        except OverflowError as error:
            hint = "Write PCD, or limit the map with --region"
            raise DataError(path, f"LAS cannot store a value ({error})", hint=hint) from None
        if names.get("intensity", "intensity") != "intensity":
            intensity = np.nan_to_num(np.asarray(fields["intensity"], np.float64))
            gain = gain or (65535.0 if intensity.max() <= 1 else 1.0)
            points["intensity"] = np.clip(np.rint(intensity * gain), 0, 65535).astype(np.uint16)
        writer.write_points(points)

    packed = path.suffix.lower() == ".laz"
    with (
        atomic_file(path) as temporary,
        open(temporary, "w+b") as file,
        laspy.open(file, mode="w", header=header, do_compress=packed, closefd=False) as writer,
    ):
        yield append
        if header.evlrs:
            writer.write_evlrs(header.evlrs)


def _new_header(
    laspy: Any, fields: Mapping[str, np.dtype[Any]], origin: F64, head: LasHead
) -> tuple[Any, dict[str, tuple[str, int]]]:
    """The header; and the attributes that are one of several values of a dimension.

    Its name, and which value.
    """
    if head.like is not None:
        header = deepcopy(read_las_header(head.like))
        several = {f"{name}_{k}": (name, k) for name, n in _several(header) for k in range(n)}
        parts = {part: place for part, place in several.items() if part in fields}
        present = {*fields, *(name for name, _ in parts.values())}
        header.remove_extra_dims(
            [name for name in header.point_format.extra_dimension_names if name not in present]
        )
        return header, parts
    colours = all(name in fields for name in _COLOURS)
    header = laspy.LasHeader(
        point_format=_WITH_COLOUR if colours else _WITHOUT_COLOUR, version="1.4"
    )
    header.scales = np.full(3, SCALE)
    header.offsets = np.asarray(origin, np.float64)
    if head.adjusted_gps_time:
        header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    return header, {}


def _dimension(laspy: Any, header: Any, name: str, dtype: np.dtype[Any]) -> str:
    """The dimension for an attribute; added to the header if it is an extra one."""
    dtype = np.dtype(np.uint8) if dtype.kind == "b" else dtype.newbyteorder("<")
    standard = {dimension.name: dimension for dimension in header.point_format.standard_dimensions}
    if name in standard and _fits(dtype, standard[name]):
        return name
    if name in header.point_format.extra_dimension_names:  # of the file whose header this is
        return name
    own = f"{name}_{dtype.name}" if name in {*header.point_format.dimension_names, *"xyz"} else name
    own = own.encode()[:32].decode(errors="ignore")
    header.add_extra_dim(laspy.ExtraBytesParams(name=own, type=dtype.newbyteorder("=")))
    return own


def _several(header: Any) -> list[tuple[str, int]]:
    """The extra dimensions with several values per point, and how many they have."""
    return [
        (each.name, each.num_elements)
        for each in header.point_format.extra_dimensions
        if each.num_elements > 1
    ]


def _fits(dtype: np.dtype[Any], dimension: Any) -> bool:
    """Whether a standard dimension stores every value of a type.

    Fields of a few bits hold what LAS files contain.
    """
    if dimension.num_bits < 8:
        return dtype == np.uint8
    return bool(np.can_cast(dtype, dimension.dtype, "safe"))
