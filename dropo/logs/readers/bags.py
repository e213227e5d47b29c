"""Recorded messages: MCAP files, and bags of ROS 1 and ROS 2; needs the packages `mcap` and
`rosbags`.
"""

import json
import struct
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.services.errors import BadFile, InvalidInput
from dropo.core.services.file_content import describe_options
from dropo.logs.readers.messages import LOG_TIME, STAMP, columns_of, getter
from dropo.logs.readers.reader import Arrays, Log, Progress, joined, package

BLOCK = 1 << 14
"""Messages that are held at a time."""
BROKEN = (ValueError, OSError, EOFError, AssertionError, KeyError, IndexError, struct.error)
"""What decoders raise on bytes that are none of theirs, beside their own errors."""
MCAP_MAGIC = b"\x89MCAP0\r\n"


class _Bag(Log):
    """Messages by topic, one row each, in the order of the recording."""

    def columns(self, topic: str | None) -> list[str]:
        return columns_of(self._first(self._known(topic)))

    def stamps(self, topic: str | None) -> str:
        """The column of time stamps: the messages' own where they have one, else when they were
        received.
        """
        return STAMP if STAMP in self.columns(topic) else LOG_TIME

    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        return joined(self._blocks(self._known(topic), columns, progress), columns)

    def _known(self, topic: str | None) -> str:
        there = self.topics()
        if topic is None and len(there) == 1:
            return next(iter(there))
        if topic not in there:
            listed = ", ".join(f"{name} ({kind})" for name, kind in sorted(there.items())) or "none"
            raise BadFile(
                self.path,
                "topic",
                f"one of its topics: {listed}",
                "none" if topic is None else repr(topic),
            )
        return topic

    def _first(self, topic: str) -> Any:
        message = next(self._messages(topic), None)
        if message is None:
            raise BadFile(self.path, topic, "at least one message", "none")
        return message[2]

    def _blocks(self, topic: str, columns: Sequence[str], progress: Progress) -> Iterator[Arrays]:
        getters = {name: getter(name) for name in columns if name != LOG_TIME}
        rows: dict[str, list[Any]] = {name: [] for name in columns}
        for count, (share, received, message) in enumerate(self._messages(topic), 1):
            for name in columns:
                rows[name].append(
                    np.datetime64(received, "ns") if name == LOG_TIME else getters[name](message)
                )
            if count % BLOCK == 0:
                yield {name: np.array(values) for name, values in rows.items()}
                rows = {name: [] for name in columns}
                progress(share, f"reading {topic}")
        yield {name: np.array(values) for name, values in rows.items()}

    @abstractmethod
    def _messages(self, topic: str) -> Iterator[tuple[float, int, Any]]:
        """(share of the file, received [ns], message) of a topic."""


class McapLog(_Bag):
    """An MCAP file whose messages are JSON, or ROS 1 or 2 with their definitions in the file."""

    expected = "an MCAP file"

    @cached_property
    def _summary(self) -> Any:
        reader = package("mcap.reader", self.path, "logs")
        size = self.path.stat().st_size
        with self.path.open("rb") as file:
            if (first := file.read(len(MCAP_MAGIC))) != MCAP_MAGIC:
                raise BadFile(
                    self.path,
                    "byte 0",
                    f"an MCAP file, which begins with {MCAP_MAGIC!r}",
                    repr(first),
                )
            file.seek(max(0, size - len(MCAP_MAGIC)))
            if file.read() != MCAP_MAGIC:
                raise self.broken(
                    self.expected,
                    f"byte {size}",
                    "it ends before its footer; `mcap recover` saves what is whole",
                )
            file.seek(0)
            try:
                summary = reader.make_reader(file).get_summary()
            except (*BROKEN, self._error) as error:
                raise self.broken(self.expected, f"byte {file.tell()}", repr(error)) from None
        if summary is None:
            raise self.broken(
                self.expected, f"byte {size}", "no summary; `mcap recover` writes one"
            )
        return summary

    @property
    def _error(self) -> type[Exception]:
        found: type[Exception] = package("mcap.exceptions", self.path, "logs").McapError
        return found

    def topics(self) -> dict[str, str]:
        schemas = self._summary.schemas
        kinds = {
            channel.topic: getattr(schemas.get(channel.schema_id), "name", "")
            for channel in self._summary.channels.values()
        }
        return {topic: str(kind) for topic, kind in kinds.items()}

    def _messages(self, topic: str) -> Iterator[tuple[float, int, Any]]:
        reader = package("mcap.reader", self.path, "logs")
        decoders: dict[int, Callable[[bytes], Any]] = {}
        statistics = self._summary.statistics
        begin = statistics.message_start_time
        length = max(1, statistics.message_end_time - statistics.message_start_time)
        with self.path.open("rb") as file:
            try:
                for schema, channel, message in reader.make_reader(
                    file, validate_crcs=True
                ).iter_messages(topics=[topic]):
                    if channel.id not in decoders:
                        decoders[channel.id] = self._decoder(schema, channel)
                    yield (
                        (message.log_time - begin) / length,
                        message.log_time,
                        decoders[channel.id](message.data),
                    )
            except (*BROKEN, self._error) as error:
                if isinstance(error, InvalidInput):
                    raise
                raise self.broken("messages", f"{topic}, byte {file.tell()}", repr(error)) from None

    def _decoder(self, schema: Any, channel: Any) -> Callable[[bytes], Any]:
        kind = channel.message_encoding
        if kind == "json":
            return json.loads
        if (
            kind not in ("cdr", "ros1")
            or schema is None
            or schema.encoding not in ("ros2msg", "ros1msg")
        ):
            wanted = describe_options(
                "messages in an encoding that is read", kind, ("json", "cdr", "ros1")
            )
            raise BadFile(
                self.path,
                channel.topic,
                wanted,
                f"{kind!r} with a schema {getattr(schema, 'encoding', None)!r}",
            )
        typesys = package("rosbags.typesys", self.path, "logs")
        store = typesys.get_typestore(typesys.Stores.EMPTY)
        store.register(typesys.get_types_from_msg(schema.data.decode(), _full(schema.name)))
        read = store.deserialize_cdr if kind == "cdr" else store.deserialize_ros1
        return lambda data: read(data, _full(schema.name))


def _full(name: str) -> str:
    """ "sensor_msgs/msg/JointState" of "sensor_msgs/JointState"."""
    return name if "/msg/" in name else name.replace("/", "/msg/")


class RosLog(_Bag):
    """A ROS 1 bag (.bag) or a ROS 2 bag (its folder, or the .db3 file in it)."""

    expected = "a ROS bag"

    def __init__(self, path: str | Path):
        super().__init__(path)
        self._place = self.path.parent if self.path.suffix == ".db3" else self.path

    def _reader(self) -> Any:
        highlevel = package("rosbags.highlevel", self.path, "logs")
        typesys = package("rosbags.typesys", self.path, "logs")
        try:
            reader = highlevel.AnyReader(
                [self._place], default_typestore=typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
            )
            reader.open()
        except self._errors as error:
            size = sum(
                file.stat().st_size
                for file in ([self._place] if self._place.is_file() else self._place.iterdir())
            )
            raise self.broken(self.expected, f"of {size} bytes", error) from None
        return reader

    @property
    def _errors(self) -> tuple[type[Exception], ...]:
        sqlite = package("sqlite3", self.path, "logs")
        own = package("rosbags.highlevel", self.path, "logs")
        one = package("rosbags.rosbag1", self.path, "logs")
        two = package("rosbags.rosbag2", self.path, "logs")
        return (*BROKEN, own.AnyReaderError, one.ReaderError, two.ReaderError, sqlite.Error)

    @cached_property
    def _topics(self) -> dict[str, str]:
        reader = self._reader()
        try:
            return {connection.topic: connection.msgtype for connection in reader.connections}
        finally:
            reader.close()

    def topics(self) -> dict[str, str]:
        return self._topics

    def _messages(self, topic: str) -> Iterator[tuple[float, int, Any]]:
        reader = self._reader()
        row = 0
        connections = [connection for connection in reader.connections if connection.topic == topic]
        total = max(1, sum(connection.msgcount for connection in connections))
        try:
            for row, (connection, received, data) in enumerate(reader.messages(connections)):
                yield row / total, received, reader.deserialize(data, connection.msgtype)
        except self._errors as error:
            raise self.broken("messages", f"{topic}, message {row}", repr(error)) from None
        finally:
            reader.close()
