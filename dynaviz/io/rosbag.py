"""Bags of ROS 1 (.bag) and ROS 2 (a folder with metadata.yaml, .db3, .mcap), read message by message with rosbags."""

from __future__ import annotations

import contextlib
import threading
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dynaviz.errors import DataError, DynavizError, MissingDependency

SUFFIXES = (".bag", ".mcap", ".db3")
_MEND = "Record or copy it again, or mend it: rosbag reindex (.bag), ros2 bag reindex (folder), mcap recover (.mcap)"


class Bag:
    """An open bag. Its files are closed when nothing refers to it any more.

    Args:
        path: a .bag, .mcap or .db3 file, a folder with metadata.yaml, or a folder with the .bag files of one drive.

    Raises:
        DataError: for a bag that is damaged or not whole.
        MissingDependency: without rosbags.
    """

    def __init__(self, path: Path) -> None:
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ModuleNotFoundError:
            raise MissingDependency(f"{path}: bags need rosbags. Install it with: pip install 'dynaviz[ros]'") from None
        self.path, self._lock = path, threading.Lock()
        several = path.is_dir() and not (path / "metadata.yaml").exists()
        with self._told():
            # Bags of ROS 2 before Jazzy do not define their messages; the usual ones are the same in all releases.
            files = sorted(path.glob("*.bag")) if several else [path]
            self._reader = AnyReader(files, default_typestore=get_typestore(Stores.LATEST))
            self._reader.open()
        weakref.finalize(self, self._reader.close)

    @property
    def topics(self) -> dict[str, str]:
        """The type of each topic that has messages, as ``sensor_msgs/msg/PointCloud2``.

        Raises:
            DataError: where the bag is damaged.
        """
        with self._told():
            counts = {name: info.msgcount for name, info in self._reader.topics.items()}
            found = self._reader.connections
            return {connection.topic: connection.msgtype for connection in found if counts[connection.topic]}

    def messages(self, *topics: str) -> Iterator[tuple[str, int, Any]]:
        """Messages in the order in which they were recorded: topic, time of recording in ns, and the message.

        Raises:
            DataError: where the bag is damaged.
        """
        connections = [connection for connection in self._reader.connections if connection.topic in topics]
        if connections:
            with self._told():
                for connection, time, raw in self._reader.messages(connections):
                    yield connection.topic, time, self._reader.deserialize(raw, connection.msgtype)

    def message(self, topic: str, time: int, nth: int = 0) -> Any:
        """A message by its time of recording, of several at that time the n-th.

        Raises:
            DataError: where the bag is damaged.
        """
        connections = [connection for connection in self._reader.connections if connection.topic == topic]
        with self._lock, self._told():
            for k, (connection, _, raw) in enumerate(self._reader.messages(connections, start=time, stop=time + 1)):
                if k == nth:
                    return self._reader.deserialize(raw, connection.msgtype)
        raise DataError(
            self.path, f"has no message of {topic} at {time} any more", hint="It was changed: open it again"
        )

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """Damaged bags make rosbags and its decompressors fail in many ways: all are told alike."""
        try:
            yield
        except DynavizError:
            raise
        except Exception as error:
            what = " ".join(str(error).split())[:120] or type(error).__name__
            raise DataError(self.path, f"is no whole bag ({what})", hint=_MEND) from None


def is_bag(path: Path) -> bool:
    """Whether a bag is at a path, by names alone."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or next(path.glob("*.bag"), None) is not None
    return path.suffix.lower() in SUFFIXES and path.is_file()
