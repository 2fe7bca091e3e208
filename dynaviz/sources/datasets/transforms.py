"""The transform tree of a bag, from /tf and /tf_static, and transforms between its frames over
time.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from dynaviz.arrays import F64
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import Trajectory

WORLD_FRAMES = ("map", "world", "odom", "earth")  # usual names of fixed frames


@dataclass(frozen=True)
class Chain:
    """A product of transforms over time, T_a_b T_b_c ..., each optionally inverted.

    Attributes:
        links: trajectories, and whether each is inverted.
    """

    links: tuple[tuple[Trajectory, bool], ...]

    @property
    def span(self) -> tuple[float, float]:
        """First and last time covered by all transforms, nanoseconds."""
        spans = [link.span for link, _ in self.links] or [(-np.inf, np.inf)]
        return max(first for first, _ in spans), min(last for _, last in spans)

    def at(self, times: ArrayLike) -> F64:
        """(N, 4, 4) float64, metres, at (N,) int64 nanoseconds."""
        T: F64 = np.broadcast_to(np.eye(4), (np.size(times), 4, 4))
        for link, inverted in self.links:
            poses = link.at(times)
            T = geometry.compose(T, geometry.inverse(poses) if inverted else poses)
        return T

    def then(self, other: Chain) -> Chain:
        """This chain, followed by another."""
        return Chain(self.links + other.links)


@dataclass
class TransformTree:
    """The parent of each frame, and its pose in the parent.

    Attributes:
        parents: the parent of each frame; the last one added.
        links: T_parent_frame of each frame over time; a single pose if it never moves. Set by
            ``build``.
    """

    parents: dict[str, str] = field(default_factory=dict)
    links: dict[str, Trajectory] = field(default_factory=dict)
    _samples: dict[str, list[tuple[int, F64]]] = field(default_factory=lambda: defaultdict(list))

    def add(self, parent: str, child: str, time: int, T_parent_child: F64, static: bool) -> None:
        """Add a transform."""
        if static:
            self._samples[frame_name(child)].clear()
        self.parents[frame_name(child)] = frame_name(parent)
        self._samples[frame_name(child)].append((time, T_parent_child))

    def build(self) -> None:
        """Make the links, after all transforms were added."""
        for child, samples in self._samples.items():
            times = np.array([time for time, _ in samples], np.int64)
            poses = np.array([T for _, T in samples])
            moves = np.abs(poses - poses[0]).max() > 1e-9
            self.links[child] = (
                Trajectory.of(times, poses) if moves else Trajectory(times[:1], poses[:1])
            )

    def ancestors(self, frame: str) -> list[str]:
        """The frame and its ancestors, up to the root."""
        ancestors = [frame_name(frame)]
        while (parent := self.parents.get(ancestors[-1])) is not None and parent not in ancestors:
            ancestors.append(parent)
        return ancestors

    def lookup(self, a: str, b: str) -> Chain | None:
        """T_a_b over time; None if the frames are not connected."""
        up_a = self.ancestors(a)
        up_b = self.ancestors(b)
        shared = next((frame for frame in up_b if frame in up_a), None)
        if shared is None:
            return None
        up = [(self.links[frame], True) for frame in up_a[: up_a.index(shared)]]
        down = [(self.links[frame], False) for frame in reversed(up_b[: up_b.index(shared)])]
        return Chain((*up, *down))

    def world_candidates(self, frame: str) -> list[str]:
        """Ancestors that may be the world.

        The frame moves in them, or they have the usual name of a fixed frame.
        """
        moving = False
        candidates = []
        for child, parent in pairwise(self.ancestors(frame)):
            moving |= len(self.links[child].times) > 1
            name = parent.rpartition("/")[2]
            if name in WORLD_FRAMES or (moving and not name.startswith("base")):
                candidates.append(parent)
        return candidates


def frame_name(frame: str) -> str:
    """A frame name without the leading slash of older ROS versions."""
    return frame.lstrip("/")
