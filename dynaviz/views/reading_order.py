"""The order of what a finished recording contains: what is seen first comes first.

Over a network, a viewer shows what has arrived. The layout, texts and cases come before the points
of the frames, and the end of a recording states that it is complete.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rerun as rr
from rerun.chunk import Chunk, LazyChunkStream, OptimizationProfile, RrdReader

from dynaviz.views import paths
from dynaviz.views.pipe import open_writer

TIMELINES = (paths.CASE, paths.WHAT_IF)  # of what comes before frames
LARGE = 100_000  # bytes: static content above this, such as the map, comes after the cases
PROPERTIES = "/__properties"


def rewrite(path: Path, layout: Any, by_frame: Sequence[str], left_out: Sequence[str] = ()) -> None:
    """Rewrite a recording in place; it stays as it is if there is no room for a second one.

    Args:
        path: of a complete file.
        layout: the only layout of the new file.
        by_frame: entities whose content makes up the frames; it stays as it was written.
        left_out: of these, entities that remain only on the timeline of cases.
    """
    ordered = path.with_name(f"{path.name}.ordered")
    try:
        _write(path, ordered, layout, _contents(by_frame), _contents(left_out))
        os.replace(ordered, path)
    except OSError:
        with contextlib.suppress(OSError):
            ordered.unlink(missing_ok=True)


def _contents(entities: Sequence[str]) -> list[str]:
    return [f"/{entity}" for entity in entities]


def _write(
    path: Path, ordered: Path, layout: Any, by_frame: list[str], left_out: list[str]
) -> None:
    reader = RrdReader(path)
    (entry,) = reader.recordings()
    stream = rr.RecordingStream(
        entry.application_id, recording_id=entry.recording_id, send_properties=False
    )
    with contextlib.closing(open_writer(ordered)) as writer:
        stream.save(writer.inlet)
        try:
            stream.send_blueprint(layout, make_active=True, make_default=True)
            for part in _parts(reader, by_frame, left_out):
                rr.send_chunks(part, recording=stream)
                stream.flush(timeout_sec=60.0)
                writer.settle()
        finally:
            stream.disconnect()


def _parts(
    reader: RrdReader, by_frame: list[str], left_out: list[str]
) -> list[list[Chunk] | LazyChunkStream]:
    """What to write, in this order."""
    static = lasting(reader.stream().filter(is_static=True).to_chunks())
    end = [chunk for chunk in static if _completes(chunk)]
    static = [chunk for chunk in static if not _completes(chunk)]
    frames = _frames(reader).filter(content=by_frame)
    if left_out:
        frames = frames.drop(content=left_out)
    return [
        [chunk for chunk in static if not _large(chunk)],
        *(reader.stream().filter(has_timeline=timeline) for timeline in TIMELINES),
        _frames(reader).drop(content=by_frame).collect(optimize=OptimizationProfile.LIVE).stream(),
        [chunk for chunk in static if _large(chunk)],
        frames,
        end,
    ]


def _frames(reader: RrdReader) -> LazyChunkStream:
    """What is neither static nor of a case."""
    left = reader.stream().drop(is_static=True)
    for timeline in TIMELINES:
        left = left.drop(has_timeline=timeline)
    return left


def lasting(chunks: Sequence[Chunk]) -> list[Chunk]:
    """The static chunks that a later one of the same entity and components does not replace.

    All properties, of which each chunk has others.
    """
    last: dict[tuple[str, tuple[str, ...], int], Chunk] = {}
    for chunk in chunks:
        names = tuple(chunk.to_record_batch().schema.names)
        entity = str(chunk.entity_path)
        key = entity, names, len(last) if entity.startswith(PROPERTIES) else 0
        last.pop(key, None)  # so that the order of what is left is that of its last chunks
        last[key] = chunk
    return list(last.values())


def _completes(chunk: Chunk) -> bool:
    """Whether a chunk states that the recording is complete."""
    if not str(chunk.entity_path).startswith(PROPERTIES):
        return False
    rows = chunk.to_record_batch()
    stated = rows["complete"].to_pylist() if "complete" in rows.schema.names else []
    return any(values and values[-1] for values in stated)


def _large(chunk: Chunk) -> bool:
    return bool(chunk.to_record_batch().nbytes > LARGE)
