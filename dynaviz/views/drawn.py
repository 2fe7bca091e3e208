"""What was drawn of single frames, read back from a recording while it is written, to show it again
elsewhere.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

import numpy as np
import pyarrow as pa
from rerun.chunk import Chunk

from dynaviz.arrays import F64, Intp
from dynaviz.views import paths

# components of an entity at one time: Arrow field and one list
Row = dict[str, tuple[pa.Field, pa.ListArray]]
POINTS = "Points3D:positions"
VOXELS = "VoxelGridMap:voxel_indices"
VOXEL_SIZE = "VoxelGridMap:voxel_size"


def rows_of(chunks: Iterable[Chunk], frames: Collection[int]) -> dict[tuple[str, int], Row]:
    """What each entity shows in some frames.

    Its last components up to each, by entity path and frame.
    """
    found: dict[tuple[str, int], tuple[int, list[tuple[pa.RecordBatch, int]]]] = {}
    for chunk in chunks:
        batch = chunk.to_record_batch()
        path = str(chunk.entity_path).removeprefix("/")
        for row, drawn in enumerate(batch[paths.FRAME].to_pylist()):
            for frame in frames:
                last, parts = found.get((path, frame), (-1, []))
                if last <= drawn <= frame:
                    found[path, frame] = drawn, [*(parts if last == drawn else []), (batch, row)]
    return {
        place: {
            name: part for batch, row in parts for name, part in _components(batch, row).items()
        }
        for place, (_, parts) in found.items()
    }


def _components(batch: pa.RecordBatch, row: int) -> Row:
    data = [field for field in batch.schema if (field.metadata or {}).get(b"rerun:kind") == b"data"]
    columns = [(field, batch.column(field.name).slice(row, 1)) for field in data]
    return {
        field.name: (field, column) for field, column in columns if column.is_valid()[0].as_py()
    }


def values(row: Row, name: str) -> np.ndarray:
    """A component's values, fixed-size lists as columns; the component must be present."""
    return as_columns(row[name][1].flatten())


def as_columns(array: pa.Array) -> np.ndarray:
    """The values of an Arrow array, fixed-size lists as columns."""
    width = array.type.list_size if pa.types.is_fixed_size_list(array.type) else None
    flat = array.flatten() if width else array
    of = pa.types
    values: np.ndarray
    if (of.is_integer(flat.type) or of.is_floating(flat.type)) and not flat.null_count:
        # to_numpy imports pandas, which takes longer than reading most recordings
        values = np.from_dlpack(flat)
    elif of.is_string(flat.type) or (of.is_boolean(flat.type) and not flat.null_count):
        values = np.array(flat.to_pylist(), object if of.is_string(flat.type) else np.bool_)
    else:
        values = flat.to_numpy(zero_copy_only=False)
    return values.reshape(-1, width) if width else values


def positions(row: Row) -> F64 | None:
    """(N, 3) metres, world frame: the points or the centres of the voxels of an entity.

    None if it has neither.
    """
    if POINTS in row:
        return values(row, POINTS).astype(np.float64)
    if VOXELS in row:
        centres: F64 = (values(row, VOXELS) + 0.5) * values(row, VOXEL_SIZE)[0].astype(np.float64)
        return centres
    return None


def deciding(here: Mapping[str, Row], states: Iterable[str], low: F64, high: F64) -> str | None:
    """The path of the state with the largest share of its points or voxels in a box.

    None if none has any.
    """
    best = None
    most = 0.0
    for path in states:
        if (xyz := positions(here.get(path, {}))) is not None and len(xyz):
            share = float(((xyz >= low) & (xyz <= high)).all(1).mean())
            if share > most:
                best = path
                most = share
    return best


def only(row: Row, chosen: Intp) -> Row:
    """The row with some of its points or voxels.

    Components with one value for all are unchanged.
    """
    count = len(values(row, POINTS if POINTS in row else VOXELS))
    left = {}
    for name, (field, column) in row.items():
        flat = column.flatten()
        if len(flat) == count:
            flat = flat.take(pa.array(chosen))
            column = pa.ListArray.from_arrays(
                pa.array([0, len(flat)], pa.int32()), flat, type=field.type
            )
        left[name] = field, column
    return left


def at_case(path: str, number: int, row: Row) -> Chunk:
    """A chunk that shows a row at an index of the timeline ``case``."""
    fields = [pa.field(paths.CASE, pa.int64()), *(field for field, _ in row.values())]
    columns = [pa.array([number], pa.int64()), *(column for _, column in row.values())]
    batch = pa.RecordBatch.from_arrays(columns, schema=pa.schema(fields))
    (chunk,) = Chunk.from_record_batch(batch, index=paths.CASE, entity_path=f"/{path}")
    return chunk
