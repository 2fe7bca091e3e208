"""Write maps of what a run kept and removed, with attributes, in a second pass over the sequence."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64, Bool
from dynaviz.contracts.attributes import Attributes, attributes_of, origin_of
from dynaviz.contracts.scan import Sequence as ScanSequence
from dynaviz.engine.region import Region
from dynaviz.errors import UsageError
from dynaviz.io.map_tiles import MapTiles
from dynaviz.io.maps import MapWriter, TiledMap, open_map
from dynaviz.progress import Progress, silent
from dynaviz.spatial.grid import KeySet, in_key_range, pack


@dataclass(frozen=True)
class MapFile:
    """A map to write.

    Attributes:
        path: the file, or the folder of a tiled map.
        removed: write the points that the run removed, instead of those that it kept.
        tiled: write Autoware's divided map.
        tile_size: edge of the squares that get a file each in the folder, metres; None for one file.
        suffix: of these files.
        region: write only the points inside.
        voxel_size: write one point per voxel of this edge, metres: the first one. None for all points.
    """

    path: Path
    removed: bool = False
    tiled: bool = False
    tile_size: float | None = None
    suffix: str = ""
    region: Region | None = None
    voxel_size: float | None = None


@dataclass
class WrittenMap:
    """A map that was written: its points, and the names of their attributes."""

    path: Path
    points: int = 0
    attributes: tuple[str, ...] = field(default=())


def write_maps(
    sequence: ScanSequence, labels: Sequence[Bool], files: Sequence[MapFile], progress: Progress = silent
) -> list[WrittenMap]:
    """Write maps in one pass. Points that are not finite are left out.

    Args:
        sequence: what the labels belong to.
        labels: (N,) bool for each frame by position, True for removed points.
        files: what to write.
        progress: called after each frame.

    Raises:
        DataError: for data that cannot be read, or files that cannot be written.
        MissingDependency: for LAS and LAZ if laspy is not installed.
    """
    fields, origin = _dtypes(sequence), origin_of(sequence)
    conform = _Conform(fields)
    with contextlib.ExitStack() as stack:
        maps = [_Map(stack.enter_context(_writer(file, fields, origin)), file, origin, fields) for file in files]
        for position in range(len(sequence)):
            points = sequence[position].points
            attributes = conform(attributes_of(sequence, position), len(points), position)
            for each in maps:
                each.add(points, labels[position], attributes)
            progress("write", position + 1, len(sequence))
    return [each.written for each in maps]


def check_voxel_size(size: float | None) -> None:
    """Raise UsageError unless a voxel size is above 1 mm, or None."""
    if size is not None and not 0.001 <= size < np.inf:
        raise UsageError(f"--voxel-size {size}: give metres, at least 0.001")


def _writer(file: MapFile, fields: Mapping[str, np.dtype[Any]], origin: F64) -> MapWriter:
    if file.tile_size is not None:
        return MapTiles(file.path, fields, origin, file.tile_size, file.suffix)
    return TiledMap(file.path, fields, origin) if file.tiled else open_map(file.path, fields, origin)


def _dtypes(sequence: ScanSequence) -> dict[str, np.dtype[Any]]:
    """Attributes of the first frame that has any, with their types; x, y and z are coordinates."""
    for position in range(min(len(sequence), 10)):
        if found := attributes_of(sequence, position):
            return {name: array.dtype for name, array in found.items() if name not in ("x", "y", "z", "points")}
    return {}


class _Conform:
    """Gives all frames the attributes of the first: what a frame lacks becomes 0, with one warning."""

    def __init__(self, fields: Mapping[str, np.dtype[Any]]) -> None:
        self._fields, self._warned = fields, False

    def __call__(self, attributes: Attributes, points: int, position: int) -> Attributes:
        missing = [name for name in self._fields if name not in attributes]
        if missing and not self._warned:
            self._warned = True
            warnings.warn(f"frame {position} has no {', '.join(missing)}; the map has 0 there", stacklevel=3)
        return {
            name: attributes[name].astype(dtype, copy=False) if name in attributes else np.zeros(points, dtype)
            for name, dtype in self._fields.items()
        }


class _Map:
    """Adds frames to a map."""

    def __init__(self, writer: MapWriter, file: MapFile, origin: F64, fields: Mapping[str, Any]) -> None:
        self._writer, self._file, self._origin, self._voxels = writer, file, origin, KeySet()
        self.written = WrittenMap(file.path, 0, tuple(fields))

    def add(self, points: NDArray[np.float32], dynamic: Bool, attributes: Attributes) -> None:
        chosen = np.flatnonzero((dynamic == self._file.removed) & np.isfinite(points).all(1))
        xyz = points[chosen].astype(np.float64) + self._origin
        if self._file.region is not None:
            inside = self._file.region.contains(xyz)
            chosen, xyz = chosen[inside], xyz[inside]
        if self._file.voxel_size is not None:
            new = self._first_in_voxels(points[chosen], self._file.voxel_size)
            chosen, xyz = chosen[new], xyz[new]
        self._writer.append(xyz, {name: array[chosen] for name, array in attributes.items()})
        self.written.points += len(chosen)

    def _first_in_voxels(self, points: NDArray[np.float32], size: float) -> Bool:
        """(N,) bool: the first points in voxels without a point; those beyond the range of keys are all kept."""
        new: Bool = np.ones(len(points), np.bool_)
        near = in_key_range(points, size)
        new[near] = self._voxels.add(pack(points[near], size))
        return new
