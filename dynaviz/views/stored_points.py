"""Points of cases as they are stored in a recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr

from dynaviz.contracts.metric import CaseSample

ARCHETYPE = "dynaviz.CasePoints"


def component(sample: CaseSample) -> rr.DynamicArchetype:
    """Points of cases, to log."""
    parts = {
        "case": sample.case.astype(np.uint16),
        "frame": sample.frames.astype(np.uint32),
        "xyz": np.ascontiguousarray(sample.points, np.float32).ravel(),
    }
    return rr.DynamicArchetype(ARCHETYPE, components=parts)


def read(components: Mapping[str, Any]) -> CaseSample | None:
    """The inverse of ``component``, of the static components of an entity; None without any."""
    names = [f"{ARCHETYPE}:{name}" for name in ("case", "frame", "xyz")]
    if not all(name in components for name in names):
        return None
    case = components[names[0]].astype(np.int64)
    frames = components[names[1]].astype(np.int64)
    points = components[names[2]].reshape(-1, 3)
    if not len(case) == len(frames) == len(points):
        raise ValueError("the points of cases have different lengths")
    return CaseSample(case, frames, points)
