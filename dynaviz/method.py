"""The contract of a method that tells moving from standing points."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, ClassVar, Protocol

from dynaviz.arrays import F32, U8, Bool
from dynaviz.probe import SILENT, Probe, State
from dynaviz.scan import Scan
from dynaviz.sensors import Sensor
from dynaviz.spatial.extent import Extent


class Cause(StrEnum):
    """Why methods fail, in the paper's terms (Section II and Figs. 2 and 3)."""

    GRAZING_RAYS = "grazing rays"  # rays that pass a surface at a small angle make it look free
    SPARSE_RINGS = "sparse rings"  # the sensor's rings lie too far apart there to judge
    NOTHING_BEHIND = "nothing behind"  # nothing behind the object ever sent a ray back through it
    STANDING = "standing too long"  # seen there more often than seen through
    HEIGHT_LIMIT = "height limit"  # outside the heights that are judged
    OUT_OF_RANGE = "out of range"  # outside the range or view that is judged
    NOT_YET_FREE = "not yet known free"  # the space had to be seen free before the object came
    TAKEN_FOR_GROUND = "taken for ground"  # protected as ground
    SHARED_CELL = "shared cell"  # judged together with other things in its voxel, bin or cluster


@dataclass(frozen=True, slots=True)
class Reason:
    """Why a point got its label. A code is the position in ``MethodInfo.reasons``.

    Attributes:
        name: short, as in tables.
        meaning: a line for a reader.
        cause: what is to blame where the label is wrong; None where the method cannot know.
    """

    name: str
    meaning: str
    cause: Cause | None = None


@dataclass(frozen=True, slots=True)
class MethodInfo:
    """What there is to know of a method before it runs.

    Attributes:
        name: as in the command line, the tables and the recording's paths.
        title: as a reader would write it.
        paper: where it was published.
        reasons: the legend of ``explain``, by code.
        emits: the states it can show.
        needs_map: whether it needs the raw map before the first scan (an offline method).
    """

    name: str
    title: str
    paper: str
    reasons: tuple[Reason, ...]
    emits: tuple[State, ...] = ()
    needs_map: bool = False


@dataclass(frozen=True, slots=True)
class Context:
    """What a method is told before the first scan.

    Attributes:
        extent: where points will lie: bounds and coarse cells. It may serve to lay out memory, never to decide a label.
        sensor: facts of the sensor.
        probe: who listens to the method's states.
        seed: for everything random; the same seed gives the same labels.
        raw_map: (M, 3) float32, metres, world frame: all points of all scans, where ``info.needs_map``; else None.
    """

    extent: Extent
    sensor: Sensor = field(default_factory=Sensor)
    probe: Probe = SILENT
    seed: int = 0
    raw_map: F32 | None = None


class Method(Protocol):
    """Learns from scans, then answers for each of their points.

    ``begin`` once, ``observe`` for every scan, then ``label`` for every scan once all were observed; in online mode
    ``label`` comes right after the scan's own ``observe``. Scans carry no ground truth, and their arrays are read-only.
    Labels depend on nothing but the scans, the parameters and the seed: not on threads, not on who listens.

    ``Params`` is a frozen dataclass of the numbers a user may tune; its fields are the paper's "number of parameters".
    """

    info: ClassVar[MethodInfo]
    Params: ClassVar[type[Any]]

    def __init__(self, params: Any) -> None: ...

    def begin(self, context: Context) -> None:
        """Prepare for a sequence; forget any earlier one."""
        ...

    def observe(self, scan: Scan) -> None:
        """Learn from one scan."""
        ...

    def label(self, scan: Scan) -> Bool:
        """(N,) bool: True where the point moved and is to be removed. The scan was observed before."""
        ...

    def explain(self, scan: Scan) -> U8:
        """(N,) uint8: for each point the code of the reason for its label, an index into ``info.reasons``."""
        ...
