"""The shared data types Scan, Label, Outcome and Sequence; streaming frames."""

from __future__ import annotations

import dataclasses
import queue
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Literal, Protocol, TypeVar, runtime_checkable

import numpy as np

from dynaviz.arrays import F32, F64, I32, U8, U16, Bool, Intp
from dynaviz.contracts.sensors import Sensor


class Label(IntEnum):
    """Ground truth of a point; unlabelled points are not scored."""

    STATIC = 0
    DYNAMIC = 1
    UNLABELLED = 255


class Outcome(IntEnum):
    """Outcome of a point: its ground truth combined with the method's label
    ("positive" = dynamic).
    """

    STATIC_KEPT = 0
    DYNAMIC_REMOVED = 1
    FALSE_POSITIVE = 2
    FALSE_NEGATIVE = 3
    UNLABELLED_KEPT = 4
    UNLABELLED_REMOVED = 5


TRUTH: Mapping[int, str] = {
    Label.STATIC: "static",
    Label.DYNAMIC: "dynamic",
}
"""The words for the ground truth of a point; unlabelled points have none."""

ErrorKind = Literal["false_negative", "false_positive"]
ERRORS: Mapping[str, Outcome] = {
    "false_negative": Outcome.FALSE_NEGATIVE,
    "false_positive": Outcome.FALSE_POSITIVE,
}
"""The two kinds of wrong points: dynamic points that were kept, and static points that were
removed.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One sweep of the sensor, in the world frame. Its arrays are read-only.

    Attributes:
        index: number of the frame in its data set (for example the file's number), not its position
            in the sequence.
        points: (N, 3) float32, metres, world frame; C-contiguous. May contain non-finite values.
        T_world_sensor: (4, 4) float64, metres; the sensor's pose.
        stamp_ns: time of the sweep in nanoseconds, or None if unknown.
        labels: (N,) uint8, a ``Label`` per point, or None without ground truth.
        classes: (N,) uint16, the data set's class per point, or None.
        instances: (N,) int32, object number per point, 0 for no object; or None.
        origins: (1, 3) or (N, 3) float64, metres, world frame; origin of each ray. Default: the
            sensor's position.
        class_names: names of the numbers in ``classes``, if known.
        times: (N,) float32, seconds; when each point was measured, relative to the scan's time; or
            None if unknown.

    Raises:
        ValueError: if the shapes do not match.
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
    times: F32 | None = None

    def __post_init__(self) -> None:
        n = len(self.points)
        if np.shape(self.T_world_sensor) != (4, 4):
            raise ValueError(
                f"scan {self.index}: T_world_sensor has shape {np.shape(self.T_world_sensor)}, not "
                "(4, 4)"
            )
        self._set("points", np.float32, (n, 3))
        self._set("T_world_sensor", np.float64, (4, 4))
        arrays = (
            ("labels", np.uint8),
            ("classes", np.uint16),
            ("instances", np.int32),
            ("times", np.float32),
        )
        for name, dtype in arrays:
            if getattr(self, name) is not None:
                self._set(name, dtype, (n,))
        if self.origins is None:
            object.__setattr__(self, "origins", self.T_world_sensor[None, :3, 3])
        self._set("origins", np.float64, (1 if len(self.origins) == 1 else n, 3))

    def _set(self, name: str, dtype: Any, shape: tuple[int, ...]) -> None:
        """Replace a field by a read-only contiguous array of the given type and shape."""
        array = np.ascontiguousarray(getattr(self, name), dtype).view()
        if array.shape != shape:
            raise ValueError(f"scan {self.index}: {name} has shape {array.shape}, not {shape}")
        array.flags.writeable = False
        object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.points)

    @property
    def position(self) -> F64:
        """(3,) float64, metres, world frame: position of the sensor."""
        position: F64 = self.T_world_sensor[:3, 3]
        return position

    def squared_ranges(self, chosen: Intp | None = None) -> F32:
        """(N,) float32, square metres: squared range of each point from the origin of its ray.

        Compare them with squared limits: the square root of a value just below a limit may round up
        to that limit.

        Args:
            chosen: (K,) indices of points, to compute only theirs; None for all.
        """
        points = self.points
        origins = self.origins
        if chosen is not None:
            points = points[chosen]
            origins = origins if len(origins) == 1 else origins[chosen]
        x, y, z = (points[:, axis] - origins[:, axis].astype(np.float32) for axis in range(3))
        with np.errstate(over="ignore"):  # infinite is beyond every limit, too
            squared: F32 = x * x + y * y + z * z
        return squared

    def without_truth(self) -> Scan:
        """The scan without labels, classes and instances, as methods receive it."""
        return dataclasses.replace(self, labels=None, classes=None, instances=None, class_names={})

    def chosen(self, rows: Intp) -> Scan:
        """The scan reduced to some of its points, (K,) rows."""
        fields = ("points", "labels", "classes", "instances", "times")
        arrays = {
            name: array[rows] for name in fields if (array := getattr(self, name)) is not None
        }
        origins = self.origins if len(self.origins) == 1 else self.origins[rows]
        return dataclasses.replace(self, **arrays, origins=origins)

    def moved(self, offset: F64) -> Scan:
        """The scan with ``offset``, (3,) metres, added to all positions.

        In float64 before rounding.
        """
        T_world_sensor = self.T_world_sensor.copy()
        T_world_sensor[:3, 3] += offset
        points = (self.points.astype(np.float64) + offset).astype(np.float32)
        return dataclasses.replace(
            self, points=points, T_world_sensor=T_world_sensor, origins=self.origins + offset
        )

    def unscored(self) -> Scan:
        """The scan with all points unlabelled, as if its sequence had ground truth for other scans
        only.
        """
        labels = None if self.labels is None else np.full(len(self), Label.UNLABELLED, np.uint8)
        return dataclasses.replace(self, labels=labels, classes=None, instances=None)


def outcomes(labels: U8 | None, dynamic: Bool) -> U8:
    """Combine ground truth with a method's labels.

    Args:
        labels: (N,) uint8, a ``Label`` per point, or None without ground truth.
        dynamic: (N,) bool, True if the method removes the point.

    Returns:
        (N,) uint8, an ``Outcome`` per point.
    """
    if labels is None:
        return np.where(dynamic, Outcome.UNLABELLED_REMOVED, Outcome.UNLABELLED_KEPT).astype(
            np.uint8
        )
    table = np.full((256, 2), (Outcome.UNLABELLED_KEPT, Outcome.UNLABELLED_REMOVED), np.uint8)
    table[Label.STATIC] = Outcome.STATIC_KEPT, Outcome.FALSE_POSITIVE
    table[Label.DYNAMIC] = Outcome.FALSE_NEGATIVE, Outcome.DYNAMIC_REMOVED
    combined: U8 = table[labels, dynamic.astype(np.intp)]
    return combined


@runtime_checkable
class Sequence(Protocol):
    """Frames of one drive, read one at a time. Reading a frame twice gives the same arrays."""

    @property
    def name(self) -> str:
        """A short name, used for folders and table rows."""
        ...

    @property
    def sensor(self) -> Sensor:
        """The sensor that recorded the sequence."""
        ...

    @property
    def has_labels(self) -> bool:
        """Whether any frame has ground truth."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, position: int) -> Scan:
        """Read the frame at a position from 0 to len - 1; raises IndexError otherwise."""
        ...


F = TypeVar("F", covariant=True)


class Frames(Protocol[F]):
    """What can be read frame by frame."""

    def __len__(self) -> int: ...

    def __getitem__(self, position: int) -> F: ...


def stream(sequence: Frames[F], ahead: int = 2) -> Iterator[F]:
    """Iterate over frames, such as those of a sequence.

    A separate thread reads up to ``ahead`` frames in advance.

    A read error is raised at the frame that caused it. Leaving the loop early stops the thread.
    """
    ready: queue.Queue[F | BaseException | None] = queue.Queue(maxsize=ahead)
    stopped = threading.Event()

    def put(item: F | BaseException | None) -> None:
        while not stopped.is_set():
            try:
                return ready.put(item, timeout=0.1)
            except queue.Full:
                continue

    def read() -> None:
        try:
            for position in range(len(sequence)):
                if stopped.is_set():
                    return
                put(sequence[position])
            put(None)
        except BaseException as error:  # raised again in the consuming thread
            put(error)

    thread = threading.Thread(target=read, name="read-ahead", daemon=True)
    thread.start()
    try:
        while (item := ready.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item
    finally:
        stopped.set()
        thread.join()
