"""How a clean map is written, kept next to it, so that the same map can be written again."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from dynaviz.engine.cleaned_map import MapFile, check_voxel_size
from dynaviz.engine.region import Region
from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.io.maps import check_map_path
from dynaviz.io.plain_json import read_json

FILE = "map.json"


class MapSettings(Struct, frozen=True):
    """How a clean map is written.

    Attributes:
        out: the map.
        region, voxel_size, keep_dynamic, mark, drop_unposed: as for ``dynaviz.clean``.
        divided: whether a folder of files is written: Autoware's, or one for each tile.
        tile_size: metres, edge of the tiles; None for Autoware's.
    """

    out: str
    region: str | None = None
    voxel_size: float | None = None
    keep_dynamic: str | None = None
    mark: bool = False
    drop_unposed: bool = False
    divided: bool = False
    tile_size: float | None = None

    @classmethod
    def load(cls, folder: Path) -> MapSettings | None:
        """Those of the map that belongs to the run in a folder; None if it wrote none.

        Raises:
            DataError: for a damaged file.
        """
        path = folder / FILE
        if not path.is_file():
            return None
        hint = "Remove it to write the map with the options of the command alone"
        try:
            return msgspec.convert(read_json(path, hint), cls)
        except msgspec.ValidationError as error:
            raise DataError(path, f"is damaged: {error}", hint=hint) from None

    def save(self, folder: Path) -> None:
        """Write the file in the folder of the run; the path of a region becomes absolute."""
        region = self.region
        if region is not None and Path(region).is_file():
            region = os.path.abspath(region)
        found = msgspec.structs.replace(self, out=os.path.abspath(self.out), region=region)
        plain = msgspec.json.encode(found)
        write_atomic(folder / FILE, msgspec.json.format(plain, indent=1) + b"\n")

    def like(self, out: Path, **given: Any) -> MapSettings:
        """These settings for another map, with those that are given and not None."""
        changed = {name: value for name, value in given.items() if value not in (None, False)}
        same = {"out": os.fspath(out), "keep_dynamic": None}  # a file of the first map stays
        found = msgspec.structs.replace(self, **{**same, **changed})
        if found.divided and found.tile_size is None and out.suffix:
            return msgspec.structs.replace(found, divided=False)
        return found

    def files(self, reviewed: bool = False) -> list[MapFile]:
        """The maps to write; all options are checked before anything is read.

        Args:
            reviewed: whether decisions of a person change the map.
        """
        out = Path(self.out)
        removed = None if self.keep_dynamic is None else Path(self.keep_dynamic)
        # a file per tile of the run, otherwise Autoware's layout
        by_tile = self.tile_size is not None and bool(out.suffix)
        if by_tile or not self.divided:
            check_map_path(out)
        elif out.suffix or out.is_file():
            raise UsageError(
                f"{out}: a divided map is a folder. Give a name without a suffix, such as -o "
                f"{out.stem}"
            )
        if by_tile and out.with_suffix("").is_file():
            raise UsageError(
                f"{out.with_suffix('')}: is a file, but the tiles need a folder of this name. Give "
                "another -o"
            )
        check_voxel_size(self.voxel_size)
        if self.mark and self.voxel_size is not None:
            raise UsageError(
                "--mark keeps all points, but --voxel-size one per voxel. Give one of the two"
            )
        parsed = None if self.region is None else Region.parse(self.region)
        map_ = MapFile(
            out,
            tiled=self.divided,
            region=parsed,
            voxel_size=self.voxel_size,
            marked=self.mark,
            by_hand=reviewed,
        )
        if by_tile:
            map_ = replace(
                map_,
                path=out.with_suffix(""),
                tiled=False,
                tile_size=self.tile_size,
                suffix=out.suffix,
            )
        files = [map_]
        if removed is not None:
            check_map_path(removed)
            if removed.resolve() == out.resolve():
                raise UsageError(f"--keep-dynamic {removed}: is the map itself. Give another file")
            files.append(MapFile(removed, removed=True, region=parsed))
        return files
