"""Binary logs that a Crazyflie writes to its memory card (its uSD deck).

Layout, as the firmware's documentation has it, all little-endian: byte 0xBC; version (uint16) and
number of kinds of events (uint16); of each kind its number (uint16), its name up to a zero byte,
its number of variables (uint16), and each variable as "name(t)" up to a zero byte, t being a letter
of Python's struct; then events: number (uint16), time (version 1: uint32 in ms, version 2: uint64
in us), the variables; at last a CRC-32 of all before it.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from zlib import crc32

import numpy as np

from dropo.core.services.errors import BadFile
from dropo.logs.readers.reader import CRAZYFLIE_MAGIC, Arrays, Log, Progress

TIME = "timestamp"
CLOCKS = {1: ("u4", 1e-3), 2: ("u8", 1e-6)}
"""By version how a time is stored, and its factor to seconds."""
KINDS = {
    **{"b": "i1", "B": "u1", "h": "i2", "H": "u2", "i": "i4", "I": "u4", "l": "i4", "L": "u4"},
    **{"q": "i8", "Q": "u8", "e": "f2", "f": "f4", "d": "f8"},
}
"""Letters of variables, as NumPy stores them."""


@dataclass(frozen=True)
class _Event:
    """A kind of event: its name, and a record of it."""

    name: str
    record: np.dtype


class CrazyflieLog(Log):
    """A log of the memory card; each kind of event is a topic, its variables are columns.

    `timestamp` is in seconds. Several kinds need `topic` in the mapping.
    """

    expected = "a log of a Crazyflie's memory card"

    @cached_property
    def _events(self) -> dict[str, Arrays]:
        """The columns of each kind of event."""
        data = self.path.read_bytes()
        if data[:1] != CRAZYFLIE_MAGIC:
            expected = f"{self.expected}, which begins with {CRAZYFLIE_MAGIC!r}"
            raise BadFile(self.path, "byte 0", expected, repr(data[:1]))
        try:
            version, count = struct.unpack_from("<HH", data, 1)
            if version not in CLOCKS:
                got = str(version)
                raise BadFile(self.path, "byte 1", f"version {' or '.join(map(str, CLOCKS))}", got)
            kinds, place = self._read_kinds(data, version, count)
        except (struct.error, ValueError, KeyError) as error:
            raise self.broken(self.expected, "its header", error) from None
        (wanted,) = struct.unpack("<I", data[-4:])
        if crc32(data[:-4]) != wanted:
            reason = "its last four bytes are not the sum of the others"
            raise self.broken(self.expected, f"byte {len(data) - 4}", reason)
        return self._read_events(data, kinds, place, CLOCKS[version][1])

    def _read_kinds(self, data: bytes, version: int, count: int) -> tuple[dict[int, _Event], int]:
        """The kinds of events by number, and where the events begin."""
        kinds = {}
        place = 5
        for _ in range(count):
            (number,) = struct.unpack_from("<H", data, place)
            name, place = _text(data, place + 2)
            (variables,) = struct.unpack_from("<H", data, place)
            place += 2
            fields = [("number", "<u2"), (TIME, "<" + CLOCKS[version][0])]
            for _ in range(variables):
                text, place = _text(data, place)
                variable, _, letter = text.rstrip(")").rpartition("(")
                fields.append((variable, "<" + KINDS[letter]))
            kinds[number] = _Event(name, np.dtype(fields))
        return kinds, place

    def _read_events(
        self, data: bytes, kinds: dict[int, _Event], place: int, second: float
    ) -> dict[str, Arrays]:
        """The columns of each kind of event that there is."""
        rows: dict[int, list[int]] = {number: [] for number in kinds}
        end = len(data) - 4
        while place < end:
            number = int.from_bytes(data[place : place + 2], "little")
            if number not in kinds or place + kinds[number].record.itemsize > end:
                reason = f"an event of the unknown kind {number}, or one that is cut off"
                raise self.broken("events", f"byte {place}", reason)
            rows[number].append(place)
            place += kinds[number].record.itemsize
        found = {}
        for number, places in rows.items():
            event = kinds[number]
            raw = b"".join(data[at : at + event.record.itemsize] for at in places)
            table = np.frombuffer(raw, dtype=event.record)
            columns = {
                name: table[name].astype(float) for name in event.record.names or () if places
            }
            if columns:
                columns.pop("number")
                columns[TIME] = columns[TIME] * second
                found[event.name] = columns
        return found

    def topics(self) -> dict[str, str]:
        """List the kinds of events that there are."""
        return dict.fromkeys(self._events, "events")

    def stamps(self, topic: str | None) -> str:
        """Name the column of time stamps."""
        return TIME

    def columns(self, topic: str | None) -> list[str]:
        """List the names of the columns."""
        return list(self._of(topic))

    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        """Read columns by name."""
        progress(1.0, f"reading {self.path.name}")
        return {name: self._of(topic)[name] for name in columns}

    def _of(self, topic: str | None) -> Arrays:
        """The columns of a kind of event; None where there is one alone."""
        there = self._events
        if topic is None and len(there) == 1:
            return next(iter(there.values()))
        if topic not in there:
            got = "none" if topic is None else repr(topic)
            expected = f"one of its kinds of events: {', '.join(there) or 'none'}"
            raise BadFile(self.path, "topic", expected, got)
        return there[topic]


def _text(data: bytes, place: int) -> tuple[str, int]:
    """The text up to a zero byte, and the place behind it."""
    end = data.index(0, place)
    return data[place:end].decode(), end + 1
