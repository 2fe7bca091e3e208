"""The tree of frames that a bag's /tf and /tf_static tell, and the way from one to another over time."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from dynaviz.arrays import F64
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import Trajectory

WORLDS = ("map", "world", "odom", "earth")  # what people call a frame that stands still


@dataclass(frozen=True)
class Chain:
    """Transforms one after the other, T_a_b T_b_c ...; each as it is, or inverted.

    Attributes:
        links: trajectories, and whether each counts inverted.
    """

    links: tuple[tuple[Trajectory, bool], ...]

    @property
    def span(self) -> tuple[float, float]:
        """First and last time at which all are known, nanoseconds."""
        spans = [link.span for link, _ in self.links] or [(-np.inf, np.inf)]
        return max(first for first, _ in spans), min(last for _, last in spans)

    def at(self, times: ArrayLike) -> F64:
        """(N, 4, 4) float64, metres, at (N,) int64 nanoseconds."""
        T: F64 = np.broadcast_to(np.eye(4), (np.size(times), 4, 4))
        for link, inverted in self.links:
            step = link.at(times)
            T = geometry.compose(T, geometry.inverse(step) if inverted else step)
        return T

    def then(self, other: Chain) -> Chain:
        """The other one after this one."""
        return Chain(self.links + other.links)


@dataclass
class Frames:
    """Which frame hangs on which, and where.

    Attributes:
        parents: the parent of each frame; the last one that was told.
        links: T_parent_frame of each frame over time; one pose where it never moves.
    """

    parents: dict[str, str] = field(default_factory=dict)
    links: dict[str, Trajectory] = field(default_factory=dict)
    _told: dict[str, list[tuple[int, F64]]] = field(default_factory=lambda: defaultdict(list))

    def tell(self, parent: str, child: str, time: int, T_parent_child: F64, static: bool) -> None:
        """Add a transform."""
        if static:
            self._told[plain(child)].clear()
        self.parents[plain(child)] = plain(parent)
        self._told[plain(child)].append((time, T_parent_child))

    def settle(self) -> None:
        """All is told: make the links."""
        for child, told in self._told.items():
            times, poses = np.array([time for time, _ in told], np.int64), np.array([T for _, T in told])
            moves = np.abs(poses - poses[0]).max() > 1e-9
            self.links[child] = Trajectory.of(times, poses) if moves else Trajectory(times[:1], poses[:1])

    def above(self, frame: str) -> list[str]:
        """The frame and all that it hangs on, up to the root."""
        found = [plain(frame)]
        while (parent := self.parents.get(found[-1])) is not None and parent not in found:
            found.append(parent)
        return found

    def between(self, a: str, b: str) -> Chain | None:
        """T_a_b over time; None where the two do not hang together."""
        up_a, up_b = self.above(a), self.above(b)
        shared = next((frame for frame in up_b if frame in up_a), None)
        if shared is None:
            return None
        up = [(self.links[frame], True) for frame in up_a[: up_a.index(shared)]]
        down = [(self.links[frame], False) for frame in reversed(up_b[: up_b.index(shared)])]
        return Chain((*up, *down))

    def worlds(self, frame: str) -> list[str]:
        """Frames above one in which it moves, or stands still where their name says that they are the world."""
        up, moving, found = self.above(frame), False, []
        for child, parent in pairwise(up):
            moving |= len(self.links[child].times) > 1
            name = parent.rpartition("/")[2]
            if name in WORLDS or (moving and not name.startswith("base")):
                found.append(parent)
        return found


def plain(frame: str) -> str:
    """A frame's name without the slash that some still put before it."""
    return frame.lstrip("/")
