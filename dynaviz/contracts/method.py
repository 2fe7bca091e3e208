"""The contracts of labellers and methods, which decide which points of a scan are
dynamic, and why.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, ClassVar, Protocol, runtime_checkable

from dynaviz.arrays import F32, U8, Bool
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.probe import SILENT, Probe, State
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor


class Cause(StrEnum):
    """Why methods fail, in the terms of the benchmark's paper (Section II and Figs. 2 and 3)."""

    GRAZING_RAYS = "grazing rays"  # rays that pass a surface at a small angle make it look free
    # rays pass through the part of its voxel or pixel that it does not fill
    PARTLY_EMPTY = "partly empty cell"
    SPARSE_RINGS = "sparse rings"  # the sensor's rings are too far apart at that range
    NOTHING_BEHIND = "nothing behind"  # no surface behind the object returned a ray through it
    STANDING = "standing too long"  # hit more often than crossed by rays
    OCCUPIED = "mostly occupied"  # the same, though the object moved on
    HEIGHT_LIMIT = "height limit"  # outside the height band that the method judges
    OUT_OF_RANGE = "out of range"  # outside the range or field of view that the method judges
    NOT_YET_FREE = (
        "not yet known free"  # the space was not observed as free before the object arrived
    )
    TAKEN_FOR_GROUND = "taken for ground"  # protected as ground
    SHARED_CELL = "shared cell"  # judged together with other objects in its voxel, bin or cluster


@dataclass(frozen=True, slots=True)
class Reason:
    """Why a point got its label. Its code is its position in ``MethodInfo.reasons``.

    Attributes:
        name: short identifier, as in tables.
        meaning: one line for the reader.
        cause: the failure cause if the label is wrong; None if the method cannot know.
    """

    name: str
    meaning: str
    cause: Cause | None = None


AT_SENSOR = Reason(
    "at_sensor",
    "kept unjudged: at the sensor, nearer than its minimum range, or part of its carrier",
)
"""The last reason of every method: of points that the run does not show to it."""


@dataclass(frozen=True, slots=True)
class MethodInfo:
    """Facts about a method, known before it runs.

    Attributes:
        name: as on the command line, in tables and in the recording's paths.
        title: as written in prose.
        paper: where it was published.
        reasons: the legend of the reason codes, by code; ``AT_SENSOR`` is appended.
        emits: the states it can show.
        needs_map: whether it needs the raw map before the first scan (an offline method).
        uses: facts of the sensor, by their names in ``Sensor``, that it can do without, but not as
            well. Like those without which it raises UsageError, they are estimated from the scans
            if they are unknown.
        compares: whether "dynamic" means that a point changed between two drives, as its reason
            names.
        colour: RGB, 0 to 255: its own in every figure; None for one that follows from the name.
        compiles_long: whether its kernels compile so long that ``dynaviz demo`` leaves it out.
    """

    name: str
    title: str
    paper: str
    reasons: tuple[Reason, ...]
    emits: tuple[State, ...] = ()
    needs_map: bool = False
    uses: tuple[str, ...] = ()
    compares: bool = False
    colour: tuple[int, int, int] | None = None
    compiles_long: bool = False

    def __post_init__(self) -> None:
        if AT_SENSOR not in self.reasons:
            object.__setattr__(self, "reasons", (*self.reasons, AT_SENSOR))


@dataclass(frozen=True, slots=True)
class Context:
    """What is known before the first scan.

    Attributes:
        extent: bounds and coarse cells of all points. Use it to allocate memory, never to decide a
            label.
        sensor: facts about the sensor.
        probe: receives the method's states.
        seed: for all randomness; the same seed gives the same labels.
        raw_map: (M, 3) float32, metres, world frame: all points of all scans if ``info.needs_map``;
            else, and live, None.
    """

    extent: Extent
    sensor: Sensor = field(default_factory=Sensor)
    probe: Probe = SILENT
    seed: int = 0
    raw_map: F32 | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """The answer for one scan.

    Attributes:
        dynamic: (N,) bool: True for points that are dynamic and to be removed.
        reasons: (N,) uint8: for each point the code of the reason for its label, an index into
            ``info.reasons``.
        answered: False if another program has no answer for this scan: none of its points is
            scored. Methods answer every scan.
    """

    dynamic: Bool
    reasons: U8
    answered: bool = True

    def __len__(self) -> int:
        return len(self.dynamic)


class Labeller(Protocol):
    """Labels the points of scans.

    A method, or the output of another program (``dynaviz.engine.external``).

    ``begin`` is called once per sequence, then ``label`` for each scan. Scans carry no ground
    truth, and their arrays are read-only.
    """

    @property
    def info(self) -> MethodInfo:
        """Name, title, and the legend of the reason codes."""
        ...

    def begin(self, context: Context) -> None:
        """Prepare for a sequence; forget any earlier one."""
        ...

    def label(self, scan: Scan) -> Labels:
        """Label each point of a scan."""
        ...


@runtime_checkable
class Method(Labeller, Protocol):
    """A labeller that learns from the scans.

    ``begin`` is called once, ``observe`` for every scan, then ``label`` for every scan after all
    were observed; in online mode ``label`` follows each scan's own ``observe``. Labels depend only
    on the scans, the parameters and the seed: not on the number of threads, and not on the probe.

    A method may also implement ``dynaviz.contracts.evidence.Explains``: for any points, the numbers
    behind their labels.

    ``Params`` is a frozen dataclass of the numbers a user may tune; its fields are the paper's
    "number of parameters".
    """

    info: ClassVar[MethodInfo]
    Params: ClassVar[type[Any]]

    def __init__(self, params: Any) -> None: ...

    def observe(self, scan: Scan) -> None:
        """Learn from one scan."""
        ...


@runtime_checkable
class Live(Protocol):
    """A method that can run live: on scans as they come, in bounded memory.

    Its context has a ``Window`` as extent, and no raw map: if ``info.needs_map``, its labels of a
    scan are those of an offline run over the scans that were not forgotten, up to this one.
    Register all state of a ``BlockGrid`` with ``per_block``, which resets it where the window
    forgets. Store nothing else that grows, except what ``forget`` drops.
    """

    def forget(self, index: int) -> None:
        """Drop what is stored about the scan with this index, for example its labels.

        It may be unknown.
        """
        ...


@runtime_checkable
class Relabels(Protocol):
    """A method that stores labels, and can decide those of the last scans again, by what it knows
    now.
    """

    def relabel(self, scans: Sequence[Scan]) -> list[Labels]:
        """Label scans again, in order; later answers of ``label`` stay the same."""
        ...


@dataclass(frozen=True, slots=True)
class Halo:
    """What decides the labels in a tile of the map, apart from the points in it.

    Attributes:
        metres: points within this distance of the tile; infinite if all points can.
        along_rays: also the points anywhere along the rays that cross the tile.
    """

    metres: float
    along_rays: bool = False


@runtime_checkable
class Tileable(Protocol):
    """A method whose label of a point depends on the map around it only, so that it can run on
    tiles of a map.
    """

    def halo(self) -> Halo:
        """What decides the labels in a tile, with these parameters."""
        ...


@runtime_checkable
class CompilesAhead(Protocol):
    """A method with kernels that compile for long and are called late in a run."""

    @classmethod
    def compile_ahead(cls, scan: Scan) -> None:
        """Call these kernels with a scan, so that they are compiled and stored on disk.

        The first run of all calls it in another process.
        """
        ...
