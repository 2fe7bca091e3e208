"""What was drawn of single frames, read back from a recording while it is written, to show it again elsewhere."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable

import numpy as np
import pyarrow as pa
from rerun.chunk import Chunk

from dynaviz.arrays import F64, Intp
from dynaviz.viz import paths

Row = dict[str, tuple[pa.Field, pa.ListArray]]  # components of an entity at one time: Arrow field and one list
POINTS, VOXELS, VOXEL_SIZE = "Points3D:positions", "VoxelGridMap:voxel_indices", "VoxelGridMap:voxel_size"


def rows_of(chunks: Iterable[Chunk], frames: Collection[int]) -> dict[tuple[str, int], Row]:
    """The components of each entity in some frames, by entity path and frame; later rows replace earlier ones."""
    found: defaultdict[tuple[str, int], Row] = defaultdict(dict)
    for chunk in chunks:
        batch = chunk.to_record_batch()
        for row, frame in enumerate(batch[paths.FRAME].to_pylist()):
            if frame in frames:
                found[str(chunk.entity_path).removeprefix("/"), frame] |= _components(batch, row, chunk.timeline_names)
    return dict(found)


def _components(batch: pa.RecordBatch, row: int, timelines: Collection[str]) -> Row:
    names = [name for name in batch.schema.names if not name.startswith("rerun") and name not in timelines]
    columns = {name: batch.column(name).slice(row, 1) for name in names}
    return {
        name: (batch.schema.field(name), column) for name, column in columns.items() if column.is_valid()[0].as_py()
    }


def values(row: Row, name: str) -> np.ndarray:
    """A component's values, fixed-size lists as columns; the component must be present."""
    array = row[name][1].flatten()
    width = array.type.list_size if pa.types.is_fixed_size_list(array.type) else None
    flat = (array.flatten() if width else array).to_numpy(zero_copy_only=False)
    return flat.reshape(-1, width) if width else flat


def positions(row: Row) -> F64 | None:
    """(N, 3) metres, world frame: the points or the centres of the voxels of an entity; None if it has neither."""
    if POINTS in row:
        return values(row, POINTS).astype(np.float64)
    if VOXELS in row:
        return (values(row, VOXELS) + 0.5) * values(row, VOXEL_SIZE)[0].astype(np.float64)
    return None


def only(row: Row, chosen: Intp) -> Row:
    """The row with some of its points or voxels; components with one value for all are unchanged."""
    count = len(values(row, POINTS if POINTS in row else VOXELS))
    left = {}
    for name, (field, column) in row.items():
        flat = column.flatten()
        if len(flat) == count:
            flat = flat.take(pa.array(chosen))
            column = pa.ListArray.from_arrays(pa.array([0, len(flat)], pa.int32()), flat, type=field.type)
        left[name] = field, column
    return left


def at_case(path: str, number: int, row: Row) -> Chunk:
    """A chunk that shows a row at an index of the timeline ``case``."""
    fields = [pa.field(paths.CASE, pa.int64()), *(field for field, _ in row.values())]
    columns = [pa.array([number], pa.int64()), *(column for _, column in row.values())]
    batch = pa.RecordBatch.from_arrays(columns, schema=pa.schema(fields))
    (chunk,) = Chunk.from_record_batch(batch, index=paths.CASE, entity_path=f"/{path}")
    return chunk
