"""Write LAS and LAZ maps with laspy, with all attributes: LAS 1.4, or the version of the file that was cleaned."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64
from dynaviz.errors import DataError
from dynaviz.io.atomic import atomic_file
from dynaviz.io.las import import_laspy, read_las_header

LAS = (".las", ".laz")
SCALE = 1e-4  # metres
_WITHOUT_COLOUR, _WITH_COLOUR = 6, 7  # point formats of LAS 1.4
_COLOURS = ("red", "green", "blue")


@dataclass(frozen=True)
class LasHead:
    """What the header of a LAS map states besides the dimensions.

    Attributes:
        like: a LAS file whose header the map takes over: version and point format, scales and offsets, global encoding,
            and all records, such as the coordinate system; None for a plain header.
        adjusted_gps_time: whether ``gps_time`` is adjusted standard GPS time (``dynaviz.io.gps_time``), if ``like`` is
            None.
    """

    like: Path | None = None
    adjusted_gps_time: bool = False


class LasMap:
    """Writes a LAS file, or LAZ if the path ends so.

    An attribute becomes the standard dimension of its name (``intensity``, ``gps_time``, ``return_number``, ``red``
    ...) if that can store its type without loss, otherwise an extra dimension. Intensities in floats become the extra
    dimension ``intensity_float32``; for viewers, ``intensity`` then has them rounded, scaled by 65535 if those of the
    first points are at most 1.
    """

    def __init__(
        self, path: Path, fields: Mapping[str, np.dtype[Any]], origin: F64, head: LasHead | None = None
    ) -> None:
        self._laspy = import_laspy(path)
        self._path, self._stack = path, contextlib.ExitStack()
        self._parts: dict[str, tuple[str, int]] = {}  # of dimensions with several values
        self._header = self._new_header(fields, origin, head or LasHead())
        self._names = {
            name: self._dimension(name, np.dtype(dtype)) for name, dtype in fields.items() if name not in self._parts
        }
        self._gain: float | None = None

    def _new_header(self, fields: Mapping[str, np.dtype[Any]], origin: F64, head: LasHead) -> Any:
        if head.like is not None:
            header = deepcopy(read_las_header(head.like))
            several = {f"{name}_{k}": (name, k) for name, n in _several(header) for k in range(n)}
            self._parts = {part: place for part, place in several.items() if part in fields}
            present = {*fields, *(name for name, _ in self._parts.values())}
            dropped = [name for name in header.point_format.extra_dimension_names if name not in present]
            header.remove_extra_dims(dropped)
            return header
        colours = all(name in fields for name in _COLOURS)
        header = self._laspy.LasHeader(point_format=_WITH_COLOUR if colours else _WITHOUT_COLOUR, version="1.4")
        header.scales, header.offsets = np.full(3, SCALE), np.asarray(origin, np.float64)
        if head.adjusted_gps_time:
            header.global_encoding.gps_time_type = self._laspy.header.GpsTimeType.STANDARD
        return header

    def _dimension(self, name: str, dtype: np.dtype[Any]) -> str:
        """The dimension for an attribute; added to the header if it is an extra one."""
        dtype = np.dtype(np.uint8) if dtype.kind == "b" else dtype.newbyteorder("<")
        standard = {dimension.name: dimension for dimension in self._header.point_format.standard_dimensions}
        extra = tuple(self._header.point_format.extra_dimension_names)
        if name in standard and _fits(dtype, standard[name]):
            return name
        if name in extra:  # of the file whose header this is
            return name
        taken = {*self._header.point_format.dimension_names, *"xyz"}
        own = f"{name}_{dtype.name}" if name in taken else name
        own = own.encode()[:32].decode(errors="ignore")
        self._header.add_extra_dim(self._laspy.ExtraBytesParams(name=own, type=dtype.newbyteorder("=")))
        return own

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            part = stack.enter_context(atomic_file(self._path))
            self._file: IO[bytes] = stack.enter_context(open(part, "w+b"))
            packed = self._path.suffix.lower() == ".laz"
            self._writer = stack.enter_context(
                self._laspy.open(self._file, mode="w", header=self._header, do_compress=packed, closefd=False)
            )
            self._stack = stack.pop_all()
        return self

    def __exit__(self, kind: Any, *error: Any) -> None:
        if kind is None and self._header.evlrs:
            self._writer.write_evlrs(self._header.evlrs)
        self._stack.__exit__(kind, *error)

    def append(self, xyz: F64, fields: Mapping[str, NDArray[Any]]) -> None:
        """As ``dynaviz.io.maps.MapWriter``."""
        if not len(xyz):
            return
        points = self._laspy.ScaleAwarePointRecord.zeros(len(xyz), header=self._header)
        try:
            for axis, name in enumerate("xyz"):
                points[name] = xyz[:, axis]
            for name, dimension in self._names.items():
                points[dimension] = fields[name]
            for part, (name, k) in self._parts.items():
                points[name][:, k] = fields[part]
        except OverflowError as error:
            hint = "Write PCD, or limit the map with --region"
            raise DataError(self._path, f"LAS cannot store a value ({error})", hint=hint) from None
        if self._names.get("intensity", "intensity") != "intensity":
            points["intensity"] = self._rounded(np.asarray(fields["intensity"], np.float64))
        self._writer.write_points(points)

    def _rounded(self, intensity: F64) -> NDArray[np.uint16]:
        intensity = np.nan_to_num(intensity)
        if self._gain is None:
            self._gain = 65535.0 if intensity.max() <= 1 else 1.0
        return np.clip(np.rint(intensity * self._gain), 0, 65535).astype(np.uint16)


def _several(header: Any) -> list[tuple[str, int]]:
    """The extra dimensions with several values per point, and how many they have."""
    return [(each.name, each.num_elements) for each in header.point_format.extra_dimensions if each.num_elements > 1]


def _fits(dtype: np.dtype[Any], dimension: Any) -> bool:
    """Whether a standard dimension stores every value of a type; fields of a few bits hold what LAS files contain."""
    if dimension.num_bits < 8:
        return dtype == np.uint8
    return bool(np.can_cast(dtype, dimension.dtype, "safe"))
