"""Write a sequence with implanted movers, and its scene file, in the layout of the public benchmark."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from dynaviz.io.atomic import write_atomic
from dynaviz.sources.datasets.convert import Conversion, convert
from dynaviz.synthetic.implants.implanted_sequence import ImplantedSequence

SCENE_FILE = "implants.toml"


def write(
    sequence: ImplantedSequence,
    out: str | os.PathLike[str],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Conversion:
    """Write ``out`` as ``dynaviz.sources.datasets.convert`` does, with the scene as ``out/implants.toml``.

    Raises:
        DataError: if ``out`` exists or cannot be written, or the sequence cannot be read.
    """
    done = convert(sequence, out, progress)
    write_atomic(Path(out) / SCENE_FILE, sequence.scene.to_toml())
    return done
