"""An example metric: the volume of ghosts and holes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Figure, Labelled
from dynaviz.contracts.scan import Outcome
from dynaviz.spatial.grid import KeySet, in_key_range, pack

EDGE = 0.2  # metres
KINDS = {"ghosts": Outcome.FALSE_NEGATIVE, "holes": Outcome.FALSE_POSITIVE}


class GhostVolume:
    """Section ``ghost_volume``.

    Volume of the false negatives and false positives in cubic metres, by voxels of 0.2 m.

    Unlike SA and DA, the volume does not change with the number of points on a surface that many
    scans see.
    """

    def __init__(self, info: MethodInfo) -> None:
        self._voxels = {kind: KeySet() for kind in KINDS}

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Add the voxels of a scan's wrong points.

        The returned numbers become curves over the frames.
        """
        volumes = {}
        for kind, outcome in KINDS.items():
            points = labelled.scan.points[labelled.outcome == outcome]
            self._voxels[kind].add(pack(points[in_key_range(points, EDGE)], EDGE))
            volumes[f"ghost_volume/{kind}"] = self._volume(kind)
        return volumes

    def finish(self) -> Mapping[str, Any]:
        """Return the section of ``result.json``."""
        return {
            "ghost_volume": {"edge_m": EDGE, **{f"{kind}_m3": self._volume(kind) for kind in KINDS}}
        }

    def figures(self) -> Mapping[str, Figure]:
        """Draw nothing in addition to the curves."""
        return {}

    def _volume(self, kind: str) -> float:
        return round(len(self._voxels[kind]) * EDGE**3, 3)
