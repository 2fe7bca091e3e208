"""The one data vocabulary: Scan, Label, Outcome, Sequence, and the walk through a sequence."""

from __future__ import annotations

import dataclasses
import queue
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Protocol, runtime_checkable

import numpy as np

from dynaviz.arrays import F32, F64, I32, U8, U16, Bool
from dynaviz.errors import UsageError
from dynaviz.sensors import Sensor


class Label(IntEnum):
    """Ground truth of a point; unlabelled points count nowhere."""

    STATIC = 0
    DYNAMIC = 1
    UNLABELLED = 255


class Outcome(IntEnum):
    """What became of a point: its ground truth crossed with the method's answer ("positive" = dynamic)."""

    STATIC_KEPT = 0
    DYNAMIC_REMOVED = 1
    FALSE_POSITIVE = 2
    FALSE_NEGATIVE = 3
    UNLABELLED_KEPT = 4
    UNLABELLED_REMOVED = 5


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One sweep of the sensor, in the world frame. Its arrays are read-only.

    Attributes:
        index: number of the frame in its data set (a file's number), not its position in the sequence.
        points: (N, 3) float32, metres, world frame; C-contiguous. May hold non-finite values.
        T_world_sensor: (4, 4) float64, metres; the sensor's pose.
        stamp_ns: time of the sweep in nanoseconds, or None where the data has none.
        labels: (N,) uint8, a ``Label`` per point, or None without ground truth.
        classes: (N,) uint16, the data set's class per point, or None.
        instances: (N,) int32, an object's number per point, 0 for none; or None.
        origins: (1, 3) or (N, 3) float64, metres, world frame; where each ray started. Default: the sensor's position.
        class_names: what the numbers in ``classes`` mean, as far as the data tell.

    Raises:
        ValueError: where shapes do not fit together.
    """

    index: int
    points: F32
    T_world_sensor: F64
    stamp_ns: int | None = None
    labels: U8 | None = None
    classes: U16 | None = None
    instances: I32 | None = None
    origins: F64 = None  # type: ignore[assignment]  # filled from the pose below
    class_names: Mapping[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.points)
        if np.shape(self.T_world_sensor) != (4, 4):
            raise ValueError(f"scan {self.index}: T_world_sensor has shape {np.shape(self.T_world_sensor)}, not (4, 4)")
        self._set("points", np.float32, (n, 3))
        self._set("T_world_sensor", np.float64, (4, 4))
        for name, dtype in (("labels", np.uint8), ("classes", np.uint16), ("instances", np.int32)):
            if getattr(self, name) is not None:
                self._set(name, dtype, (n,))
        if self.origins is None:
            object.__setattr__(self, "origins", self.T_world_sensor[None, :3, 3])
        self._set("origins", np.float64, (1 if len(self.origins) == 1 else n, 3))

    def _set(self, name: str, dtype: Any, shape: tuple[int, ...]) -> None:
        """Replace a field by a read-only contiguous array of the given kind."""
        array = np.ascontiguousarray(getattr(self, name), dtype).view()
        if array.shape != shape:
            raise ValueError(f"scan {self.index}: {name} has shape {array.shape}, not {shape}")
        array.flags.writeable = False
        object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.points)

    @property
    def position(self) -> F64:
        """(3,) float64, metres, world frame: where the sensor is."""
        position: F64 = self.T_world_sensor[:3, 3]
        return position

    def without_truth(self) -> Scan:
        """The same scan as a method may see it: no labels, classes or instances."""
        return dataclasses.replace(self, labels=None, classes=None, instances=None, class_names={})


def outcomes(labels: U8 | None, dynamic: Bool) -> U8:
    """Cross ground truth with an answer.

    Args:
        labels: (N,) uint8, a ``Label`` per point, or None without ground truth.
        dynamic: (N,) bool, True where the method removes the point.

    Returns:
        (N,) uint8, an ``Outcome`` per point.
    """
    if labels is None:
        return np.where(dynamic, Outcome.UNLABELLED_REMOVED, Outcome.UNLABELLED_KEPT).astype(np.uint8)
    table = np.full((256, 2), (Outcome.UNLABELLED_KEPT, Outcome.UNLABELLED_REMOVED), np.uint8)
    table[Label.STATIC] = Outcome.STATIC_KEPT, Outcome.FALSE_POSITIVE
    table[Label.DYNAMIC] = Outcome.FALSE_NEGATIVE, Outcome.DYNAMIC_REMOVED
    crossed: U8 = table[labels, dynamic.astype(np.intp)]
    return crossed


@runtime_checkable
class Sequence(Protocol):
    """Frames of one drive, read one at a time; reading the same frame twice gives the same arrays."""

    @property
    def name(self) -> str:
        """A short name, fit for a folder and a table's row."""
        ...

    @property
    def sensor(self) -> Sensor:
        """Facts of the sensor that recorded it."""
        ...

    @property
    def has_labels(self) -> bool:
        """Whether any frame has ground truth."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, position: int) -> Scan:
        """Read the frame at a position 0 ... len - 1; IndexError beyond."""
        ...


@dataclass(frozen=True)
class SequenceSlice:
    """Some frames of a sequence (``--frames A:B --stride K``), perhaps with another sensor or name."""

    whole: Sequence
    positions: range
    sensor: Sensor
    name: str

    @property
    def has_labels(self) -> bool:
        """Whether the whole has ground truth."""
        return self.whole.has_labels

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, position: int) -> Scan:
        return self.whole[self.positions[position]]


def select_frames(
    sequence: Sequence, frames: str | None = None, stride: int = 1, sensor: Sensor | None = None
) -> Sequence:
    """Choose frames of a sequence.

    Args:
        sequence: any sequence.
        frames: ``A:B``, positions as in a Python slice, end exclusive; either may be left out.
        stride: every how manieth of them, at least 1.
        sensor: another sensor than the sequence says.

    Raises:
        UsageError: for a range that is none, or holds no frame.
    """
    if frames is None and stride == 1 and sensor is None:
        return sequence
    if stride < 1:
        raise UsageError(f"--stride {stride}: give 1 for every frame, 2 for every other ...")
    try:
        first, last = (int(x) if x.strip() else None for x in (frames or ":").split(":"))
    except ValueError:
        raise UsageError(f"--frames {frames}: give A:B, as 0:100 for the first hundred frames") from None
    positions = range(len(sequence))[slice(first, last, stride)]
    if not positions:
        raise UsageError(f"--frames {frames}: chooses none of the {len(sequence)} frames in {sequence.name}")
    return SequenceSlice(sequence, positions, sensor or sequence.sensor, sequence.name)


def stream(sequence: Sequence, ahead: int = 2) -> Iterator[Scan]:
    """Walk through a sequence, reading up to ``ahead`` frames on a thread of its own.

    An error while reading comes out at the frame that caused it. Leaving the loop early stops the thread.
    """
    ready: queue.Queue[Scan | BaseException | None] = queue.Queue(maxsize=ahead)
    left = threading.Event()

    def put(item: Scan | BaseException | None) -> None:
        while not left.is_set():
            try:
                return ready.put(item, timeout=0.1)
            except queue.Full:
                continue

    def read() -> None:
        try:
            for position in range(len(sequence)):
                if left.is_set():
                    return
                put(sequence[position])
            put(None)
        except BaseException as error:  # handed over to the reader of the queue
            put(error)

    thread = threading.Thread(target=read, name="read-ahead", daemon=True)
    thread.start()
    try:
        while (item := ready.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item
    finally:
        left.set()
        thread.join()
