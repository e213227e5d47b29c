"""Recordings of SAGE, the Sim2Real Actuator Gap Estimator: a folder of CSV files for a motion.

Layout, as its documentation has it: `joint_list.txt` names the joints, a line each;
`state_motor.csv` has what was measured and `control.csv` what was commanded, rows of `type`,
`timestamp` and lists `positions`, `velocities`, `torques` in the order of the joints; `event.csv`
says when the motion began and when the motors were switched off.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from dropo.core.services.errors import BadFile
from dropo.core.services.validation import Array
from dropo.logs.readers.reader import Arrays, Log, Progress, part_progress
from dropo.logs.readers.tables import CsvLog

FILES = {"state": "state_motor.csv", "control": "control.csv"}
"""Topics, and the file of each."""
JOINTS = "joint_list.txt"
EVENTS = "event.csv"
BEGIN, END = "MOTION_START", "DISABLE"
TIME = "time"
"""The column of stamps in seconds, made of `timestamp`."""
STEPS = {1.0: (2e-5, 0.5), 1e-3: (0.5, 500.0), 1e-6: (500.0, np.inf)}
"""By factor to seconds, between which bounds the median step of the stamps is."""


class SageLog(Log):
    """A folder of a motion; columns are "positions[elbow]" and so on, of the topics state, control.

    Rows before the motion began and behind its end are left out, where events tell.
    """

    def topics(self) -> dict[str, str]:
        """List the tables that are there.

        Raises
        ------
        BadFile
            If what was measured is not among them.
        """
        found = {topic: name for topic, name in FILES.items() if (self.path / name).is_file()}
        if "state" not in found:
            raise BadFile(self.path / FILES["state"], "", "what was measured", "no such file")
        return found

    def stamps(self, topic: str | None) -> str:
        """Name the column of time stamps."""
        return TIME

    @cached_property
    def joints(self) -> list[str]:
        """The names of the joints, in the order of the lists.

        Raises
        ------
        BadFile
            If their file cannot be read.
        """
        path = self.path / JOINTS
        try:
            lines = path.read_text().splitlines()
        except (OSError, UnicodeDecodeError):
            raise BadFile(path, "", "a joint's name in every line", "no such text") from None
        return [line.strip() for line in lines if line.strip()]

    def columns(self, topic: str | None) -> list[str]:
        """List the names of the columns."""
        return [TIME, *self._places(topic)]

    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        """Read columns by name."""
        log = self._table(topic)
        places = self._places(topic)
        own = log.columns(None)
        kind = ["type"] if "type" in own else []
        wanted = [places[name] for name in columns if name != TIME]
        needed = list(dict.fromkeys(["timestamp", *kind, *wanted]))
        found = log.read(None, needed, part_progress(progress, 0, 1))
        stamps = found["timestamp"].astype(float)
        keep = self._inside(stamps)
        if kind:  # rows of another type say other things
            names, counts = np.unique(found["type"], return_counts=True)
            keep &= found["type"] == names[np.argmax(counts)]
        time = stamps * _factor(stamps)
        out: Arrays = {}
        for name in columns:
            out[name] = (time if name == TIME else found[places[name]])[keep]
        return out

    def _table(self, topic: str | None) -> CsvLog:
        """The file of a topic."""
        there = self.topics()
        if topic not in there:
            got = "none" if topic is None else repr(topic)
            raise BadFile(self.path, "topic", f"one of its tables: {', '.join(there)}", got)
        return CsvLog(self.path / there[topic])

    def _places(self, topic: str | None) -> dict[str, str]:
        """By "positions[elbow]" the column "positions[1]" of the file."""
        log = self._table(topic)
        found = {}
        own = log.columns(None)
        if "timestamp" not in own:
            raise BadFile(log.path, "line 1", "a column 'timestamp'", ", ".join(own[:6]))
        lists: dict[str, int] = {}
        for name in own:
            if name.endswith("]"):
                field = name.rpartition("[")[0]
                lists[field] = lists.get(field, 0) + 1
        for field, count in lists.items():
            if count != len(self.joints):
                expected = f"lists of {len(self.joints)} numbers, as {JOINTS} has joints"
                raise BadFile(log.path, field, expected, f"{count}")
            for i, joint in enumerate(self.joints):
                found[f"{field}[{joint}]"] = f"{field}[{i}]"
        return found

    def _inside(self, stamps: Array) -> np.ndarray:
        """Which rows are between the motion's begin and end; all where events do not tell."""
        path = self.path / EVENTS
        if not path.is_file():
            return np.ones(len(stamps), dtype=bool)
        log = CsvLog(path)
        found = log.read(None, log.columns(None), lambda fraction, text: None)
        begin, end = -np.inf, np.inf
        times = found.get("timestamp", np.empty(0))
        for name, values in found.items():
            if name == "timestamp" or values.dtype.kind not in "US":
                continue
            for word, time in zip(values, times, strict=True):
                begin = float(time) if word == BEGIN else begin
                end = float(time) if word == END else end
        inside = (stamps >= begin) & (stamps <= end)
        return inside if inside.sum() > 1 else np.ones(len(stamps), dtype=bool)


def _factor(stamps: Array) -> float:
    """The factor from stamps to seconds: recordings have microseconds, simulations seconds."""
    step = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 1.0
    return next((f for f, (low, high) in STEPS.items() if low <= step < high), 1.0)
