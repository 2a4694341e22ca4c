"""Bags of ROS 1 and ROS 2 as one kind of file, read by ``rosbags`` without either ROS."""

from __future__ import annotations

import contextlib
import resource
from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags import rosbag1, rosbag2
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from surg_recording.file_io import bounded, regular_file
from surg_recording.recording_errors import EpisodeError, telling

METADATA = "metadata.yaml"
"""The file that makes a folder a bag of ROS 2."""
STORAGES = (".mcap", ".db3")
MOST_UNPACKED, SPARE = 1000, 1 << 30
"""A file of ROS 2 that is compressed as a whole unpacks, beside others, to at most this many times
its size and some more [bytes]: 4K pictures without content shrink to a thousandth."""


class BagFile:
    """An open bag: a file of ROS 1, a folder of ROS 2, or the one file in such a folder."""

    def __init__(self, path: Path) -> None:
        """Open it.

        Raises:
            EpisodeError: It is no bag, was not closed, or is damaged.
        """
        self.path = path.parent if path.suffix in STORAGES else path
        self.ros2 = self.path.is_dir()
        if self.ros2 and not (self.path / METADATA).exists():
            if not any(file.suffix in STORAGES for file in self.path.iterdir()):
                raise EpisodeError(
                    f"{path}: holds no bag; looked for {METADATA} and *{', *'.join(STORAGES)} of"
                    " ROS 2. Of ROS 1 name the files: *.bag"
                )
            raise EpisodeError(
                f"{path}: {METADATA} is missing beside it. 'ros2 bag reindex {self.path}' writes it"
            )
        regular_file(self.path / METADATA if self.ros2 else path)
        with _told(path):
            self._reader = rosbag2.Reader(path=self.path) if self.ros2 else rosbag1.Reader(path)
            each = self._reader
            stored = each.paths if isinstance(each, rosbag2.Reader) else [path]
            size = max(regular_file(file).stat().st_size for file in stored)
            with bounded(resource.RLIMIT_FSIZE, size * MOST_UNPACKED + SPARE):
                self._reader.open()
        self._types = get_typestore(Stores.ROS2_HUMBLE if self.ros2 else Stores.EMPTY)
        self._defined: set[str] = set()
        self.kinds = {each.topic: _short(each.msgtype) for each in self._reader.connections}
        """Topic → type, such as sensor_msgs/Image, in either ROS."""

    def __enter__(self) -> BagFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._reader.close()

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, Any, int]]:
        """Topic, message and time of reception [ns], in the order of that time.

        Arrays of numbers are numpy's; a time has ``sec`` and ``nanosec``.

        Raises:
            EpisodeError: A message cannot be read.
        """
        chosen = [each for each in self._reader.connections if each.topic in topics]
        with _told(self.path):
            for each in chosen:
                self._define(each)
            read = self._types.deserialize_cdr if self.ros2 else self._types.deserialize_ros1
            for connection, time_ns, data in self._reader.messages(chosen) if chosen else ():
                yield connection.topic, read(data, connection.msgtype), time_ns

    def as_ros1(self) -> Iterator[tuple[int, str, str, bytes]]:
        """Time [ns], topic, type and the message as ROS 1 serialises it, of a bag of ROS 2."""
        with _told(self.path):
            for each in self._reader.connections:
                self._define(each)
            for connection, time_ns, data in self._reader.messages():
                plain = bytes(self._types.cdr_to_ros1(data, connection.msgtype))
                yield time_ns, connection.topic, _short(connection.msgtype), plain

    def _define(self, connection: Any) -> None:
        """Learn a type from the bag; those that it does not define are ROS 2's own."""
        kind, definition = connection.msgtype, connection.msgdef
        if kind in self._defined or definition.format != MessageDefinitionFormat.MSG:
            return
        self._defined.add(kind)
        learn(self._types, kind, definition.data)


def learn(types: Any, kind: str, definition: str) -> None:
    """Add a type, and those that it is made of, to a type store that knows some of them."""
    found = get_types_from_msg(definition, kind)
    types.register({name: each for name, each in found.items() if name not in types.fielddefs})


def _short(kind: str) -> str:
    return kind.replace("/msg/", "/")


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    """What a damaged bag makes the library raise, as one kind of error."""
    try:
        with telling(path, "not a bag that can be read; copy or record it again"):
            yield
    except EpisodeError as problem:
        said = str(problem)
        if "not indexed" in said:
            said = f"{path}: was not closed, so it has no index; rosbag reindex {path} writes one"
        elif "index looks damaged" in said:
            said = (
                f"{path}: cut off or damaged: its index cannot be read; copy it again, or keep its"
                f" whole chunks by rosbag reindex {path}"
            )
        raise EpisodeError(said) from None
