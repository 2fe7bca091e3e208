"""Open a sequence also if it has no poses, for commands that can say something without."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynaviz.contracts.scan import Sequence


def open_posed_or_not(path: str, options: dict[str, Any]) -> tuple[Sequence, str]:
    """The sequence, and the problem if it has no poses: then each scan is in its own frame.

    Raises:
        DataError, UsageError: as ``dynaviz.open``.
    """
    from dynaviz import api
    from dynaviz.errors import NoPoses
    from dynaviz.sources.datasets.pose_matching import NO_POSES

    try:
        return api.open(path, **options), ""
    except NoPoses as error:
        if options.get("poses") is not None:
            raise
        return api.open(path, **{**options, "poses": NO_POSES}), error.problem


def proposal(path: str) -> str:
    """The command that estimates poses and cleans the map."""
    name = Path(path.partition("#")[0]).stem or "clean"
    return shlex.join(["dynaviz", "clean", path, "-o", f"{name}_clean.laz"])
