"""ROS 1 bags (.bag) and ROS 2 bags (folder with metadata.yaml, .db3, .mcap), read with rosbags."""

from __future__ import annotations

import contextlib
import threading
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dynaviz.errors import DataError, DynavizError, MissingDependency
from dynaviz.io.mcap import check_mcap

SUFFIXES = (".bag", ".mcap", ".db3")
_HINT = (
    "Copy it again, or repair it: rosbag reindex (.bag), ros2 bag reindex (folder), mcap recover "
    "(.mcap)"
)


class Bag:
    """An open bag. Its files are closed when the object is garbage-collected.

    Args:
        path: a .bag, .mcap or .db3 file, a folder with metadata.yaml, or a folder with the .bag,
            .mcap or .db3 files of one drive.

    Raises:
        DataError: if the bag is truncated or corrupt.
        MissingDependency: if rosbags is not installed.
    """

    def __init__(self, path: Path) -> None:
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ModuleNotFoundError:
            raise MissingDependency(
                f"{path}: ROS bags need rosbags. Install it with: pip install rosbags"
            ) from None
        self.path = path
        self._lock = threading.Lock()
        for file in [path] if path.is_file() else _parts(path):
            check_mcap(file)
        several = path.is_dir() and not (path / "metadata.yaml").exists()
        with self._errors():
            # ROS 2 bags before Jazzy do not store message definitions; the common ones are the same
            # in all releases.
            files = _parts(path) if several else [path]
            self._reader = AnyReader(files, default_typestore=get_typestore(Stores.LATEST))
            self._reader.open()
        weakref.finalize(self, self._reader.close)

    @property
    def topics(self) -> dict[str, str]:
        """The type of each topic that has messages, such as ``sensor_msgs/msg/PointCloud2``.

        Raises:
            DataError: if the bag is corrupt.
        """
        with self._errors():
            counts = {name: info.msgcount for name, info in self._reader.topics.items()}
            connections = self._reader.connections
            if not all(
                isinstance(name, str) for each in connections for name in (each.topic, each.msgtype)
            ):
                raise TypeError("a topic or its type is not text")
            if len({(each.topic, each.msgtype) for each in connections}) > len(
                {each.topic for each in connections}
            ):
                raise TypeError("a topic has messages of several types")
            return {each.topic: each.msgtype for each in connections if counts[each.topic]}

    @property
    def contents(self) -> dict[str, str]:
        """For each topic that has messages.

        Its type, their number, and their mean rate, in words.
        """
        with self._errors():
            seconds = self._reader.duration / 1e9
            counts = {name: info.msgcount for name, info in self._reader.topics.items()}
        rates = {
            name: f", {n / seconds:.1f} Hz" if seconds > 0 and n > 1 else ""
            for name, n in counts.items()
        }
        return {
            name: f"{kind}, {counts[name]:,} messages{rates[name]}"
            for name, kind in sorted(self.topics.items())
        }

    def messages(self, *topics: str) -> Iterator[tuple[str, int, Any]]:
        """Messages in recorded order: topic, recording time in ns, and message.

        Raises:
            DataError: if the bag is corrupt.
        """
        connections = [
            connection for connection in self._reader.connections if connection.topic in topics
        ]
        if connections:
            with self._errors():
                for connection, time, raw in self._reader.messages(connections):
                    yield connection.topic, time, self._reader.deserialize(raw, connection.msgtype)

    def message(self, topic: str, time: int, nth: int = 0) -> Any:
        """A message by its recording time; the n-th if several have the same time.

        Raises:
            DataError: if the bag is corrupt.
        """
        connections = [
            connection for connection in self._reader.connections if connection.topic == topic
        ]
        with self._lock, self._errors():
            for k, (connection, _, raw) in enumerate(
                self._reader.messages(connections, start=time, stop=time + 1)
            ):
                if k == nth:
                    return self._reader.deserialize(raw, connection.msgtype)
        raise DataError(
            self.path,
            f"no message of {topic} at {time} ns",
            hint="The bag has changed: open it again",
        )

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        """Turn the many types of errors that rosbags raises for corrupt bags into DataError."""
        try:
            yield
        except DynavizError:
            raise
        except Exception as error:
            reason = " ".join(str(error).split())[:120] or type(error).__name__
            raise DataError(self.path, f"truncated or corrupt bag ({reason})", hint=_HINT) from None


def _parts(path: Path) -> list[Path]:
    """The files of a drive that was split into several bags, of one kind, in order."""
    kinds = (sorted(path.glob(f"*{suffix}")) for suffix in SUFFIXES)
    return next((files for files in kinds if files), [])


def is_bag(path: Path) -> bool:
    """Whether a path is a bag, judged by file names only."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or bool(_parts(path))
    return path.suffix.lower() in SUFFIXES and path.is_file()
