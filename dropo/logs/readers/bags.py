"""Recorded messages: MCAP files, and bags of ROS 1 and ROS 2; needs `mcap` and `rosbags`."""

import json
import struct
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.services.errors import BadFile, InvalidInput
from dropo.core.services.files.file_content import describe_options
from dropo.logs.readers.messages import LOG_TIME, STAMP, columns_of, make_getter
from dropo.logs.readers.reader import Arrays, Log, Progress, join_blocks, package

BLOCK = 1 << 14
"""Messages that are held at a time."""
BROKEN = (ValueError, OSError, EOFError, AssertionError, KeyError, IndexError, struct.error)
"""What decoders raise on bytes that are none of theirs, beside their own errors."""
ENCODINGS = ("json", "cdr", "ros1")
"""Encodings of messages that are read."""
FRAMES = "transforms["
"""What columns of tf begin with."""
FIRST = 500
"""Messages of tf in which frames are looked for."""
MCAP_MAGIC = b"\x89MCAP0\r\n"


class _Bag(Log):
    """Messages by topic, one row each, in the order of the recording."""

    def columns(self, topic: str | None) -> list[str]:
        """List the names of the columns."""
        known = self._known(topic)
        names = columns_of(self._first(known))
        if not any(name.startswith(FRAMES) for name in names):
            return names
        # frames come in messages of their own
        found = dict.fromkeys(names)
        for count, (_, _, message) in enumerate(self._messages(known)):
            found |= dict.fromkeys(columns_of(message))
            if count >= FIRST:
                break
        return list(found)

    def stamps(self, topic: str | None) -> str:
        """Name the column of time stamps.

        Parameters
        ----------
        topic : str or None
            One of its topics; None where there is only one.

        Returns
        -------
        str
            The messages' own stamps where they have such, else when they were received.

        Raises
        ------
        BadFile
            If there is no such topic, or no message of it.
        """
        return STAMP if STAMP in self.columns(topic) else LOG_TIME

    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        """Read columns by name."""
        return join_blocks(self._blocks(self._known(topic), columns, progress), columns)

    def _known(self, topic: str | None) -> str:
        """A topic that the recording has; None where it has one alone."""
        there = self.topics()
        if topic is None and len(there) == 1:
            return next(iter(there))
        if topic not in there:
            listed = ", ".join(f"{name} ({kind})" for name, kind in sorted(there.items()))
            got = "none" if topic is None else repr(topic)
            raise BadFile(self.path, "topic", f"one of its topics: {listed or 'none'}", got)
        return topic

    def _first(self, topic: str) -> Any:
        """The first message of a topic."""
        message = next(self._messages(topic), None)
        if message is None:
            raise BadFile(self.path, topic, "at least one message", "none")
        return message[2]

    def _blocks(self, topic: str, columns: Sequence[str], progress: Progress) -> Iterator[Arrays]:
        """The columns, some messages at a time."""
        getters = {name: make_getter(name) for name in columns if name != LOG_TIME}
        rows: dict[str, list[Any]] = {name: [] for name in columns}
        for count, (done, received, message) in enumerate(self._messages(topic), 1):
            for name, values in rows.items():
                if name == LOG_TIME:
                    values.append(np.datetime64(received, "ns"))
                else:
                    values.append(getters[name](message))
            if count % BLOCK == 0:
                yield {name: np.array(values) for name, values in rows.items()}
                rows = {name: [] for name in columns}
                progress(done, f"reading {topic}")
        yield {name: np.array(values) for name, values in rows.items()}

    @abstractmethod
    def _messages(self, topic: str) -> Iterator[tuple[float, int, Any]]:
        """The messages of a topic, with the fraction of the file that is read and when each was
        received [ns].
        """


class McapLog(_Bag):
    """An MCAP file whose messages are JSON, or ROS 1 or 2 with their definitions in the file."""

    expected = "an MCAP file"

    @cached_property
    def _summary(self) -> Any:
        """The summary at the end of the file, which is found whole."""
        reader = package("mcap.reader", self.path, "logs")
        size = self.path.stat().st_size
        with self.path.open("rb") as file:
            first = file.read(len(MCAP_MAGIC))
            if first != MCAP_MAGIC:
                expected = f"{self.expected}, which begins with {MCAP_MAGIC!r}"
                raise BadFile(self.path, "byte 0", expected, repr(first))
            file.seek(max(0, size - len(MCAP_MAGIC)))
            if file.read() != MCAP_MAGIC:
                reason = "it ends before its footer; `mcap recover` saves what is whole"
                raise self.broken(self.expected, f"byte {size}", reason)
            file.seek(0)
            try:
                summary = reader.make_reader(file).get_summary()
            except (*BROKEN, self._error) as error:
                raise self.broken(self.expected, f"byte {file.tell()}", repr(error)) from None
        if summary is None:
            reason = "no summary; `mcap recover` writes one"
            raise self.broken(self.expected, f"byte {size}", reason)
        return summary

    @property
    def _error(self) -> type[Exception]:
        """The decoder's own error."""
        found: type[Exception] = package("mcap.exceptions", self.path, "logs").McapError
        return found

    def topics(self) -> dict[str, str]:
        """List the topics, each with the type of its messages."""
        schemas = self._summary.schemas
        kinds = {}
        for channel in self._summary.channels.values():
            schema = schemas.get(channel.schema_id)
            kinds[channel.topic] = str(getattr(schema, "name", ""))
        return kinds

    def _messages(self, topic: str) -> Iterator[tuple[float, int, Any]]:
        """The messages of a topic."""
        reader = package("mcap.reader", self.path, "logs")
        decoders: dict[int, Callable[[bytes], Any]] = {}
        statistics = self._summary.statistics
        begin = statistics.message_start_time
        duration = max(1, statistics.message_end_time - begin)
        with self.path.open("rb") as file:
            try:
                messages = reader.make_reader(file, validate_crcs=True)
                for schema, channel, message in messages.iter_messages(topics=[topic]):
                    if channel.id not in decoders:
                        decoders[channel.id] = self._decoder(schema, channel)
                    done = (message.log_time - begin) / duration
                    yield done, message.log_time, decoders[channel.id](message.data)
            except (*BROKEN, self._error) as error:
                if isinstance(error, InvalidInput):
                    raise
                raise self.broken("messages", f"{topic}, byte {file.tell()}", repr(error)) from None

    def _decoder(self, schema: Any, channel: Any) -> Callable[[bytes], Any]:
        """The function from the bytes of a channel to a message."""
        kind = channel.message_encoding
        if kind == "json":
            return json.loads
        schema_encoding = getattr(schema, "encoding", None)
        if kind not in ("cdr", "ros1") or schema_encoding not in ("ros2msg", "ros1msg"):
            expected = describe_options("messages in an encoding that is read", kind, ENCODINGS)
            got = f"{kind!r} with a schema {schema_encoding!r}"
            raise BadFile(self.path, channel.topic, expected, got)
        typesys = package("rosbags.typesys", self.path, "logs")
        store = typesys.get_typestore(typesys.Stores.EMPTY)
        name = _full_type(schema.name)
        store.register(typesys.get_types_from_msg(schema.data.decode(), name))
        read = store.deserialize_cdr if kind == "cdr" else store.deserialize_ros1
        return lambda data: read(data, name)


def _full_type(name: str) -> str:
    """The full name of a message type, such as "sensor_msgs/msg/JointState"."""
    return name if "/msg/" in name else name.replace("/", "/msg/")


class RosLog(_Bag):
    """A ROS 1 bag (.bag) or a ROS 2 bag (its folder, or the .db3 file in it).

    Parameters
    ----------
    path : str or Path
        The file or folder.
    """

    expected = "a ROS bag"

    def __init__(self, path: str | Path):
        super().__init__(path)
        self._place = self.path.parent if self.path.suffix == ".db3" else self.path

    def _reader(self) -> Any:
        """An open reader of the bag."""
        highlevel = package("rosbags.highlevel", self.path, "logs")
        typesys = package("rosbags.typesys", self.path, "logs")
        types = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        try:
            reader = highlevel.AnyReader([self._place], default_typestore=types)
            reader.open()
        except self._errors as error:
            files = [self._place] if self._place.is_file() else self._place.iterdir()
            size = sum(file.stat().st_size for file in files)
            raise self.broken(self.expected, f"of {size} bytes", error) from None
        return reader

    @property
    def _errors(self) -> tuple[type[Exception], ...]:
        """The errors of the decoders."""
        sqlite = package("sqlite3", self.path, "logs")
        own = package("rosbags.highlevel", self.path, "logs")
        one = package("rosbags.rosbag1", self.path, "logs")
        two = package("rosbags.rosbag2", self.path, "logs")
        return (*BROKEN, own.AnyReaderError, one.ReaderError, two.ReaderError, sqlite.Error)

    @cached_property
    def _topics(self) -> dict[str, str]:
        """The topics, each with the type of its messages."""
        reader = self._reader()
        try:
            return {connection.topic: connection.msgtype for connection in reader.connections}
        finally:
            reader.close()

    def topics(self) -> dict[str, str]:
        """List the topics, each with the type of its messages."""
        return self._topics

    def _messages(self, topic: str) -> Iterator[tuple[float, int, Any]]:
        """The messages of a topic."""
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
