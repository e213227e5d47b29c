"""The mapping of a log, guessed: which column is what, in which unit, each guess with its reason.

In reading order: `guess_mapping` reads the names of all columns (`log_columns`), sorts them by
quantity, and lets `_Guesser` find time, positions, base, velocities and commands one after another.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dropo.core.services.errors import BadFile, Incompatible
from dropo.core.services.validation import Array
from dropo.logs.floating_base import lacks_base, missing_for_base
from dropo.logs.guessing import words
from dropo.logs.guessing.base import BaseColumns, find_base, moving_base, quaternion_order
from dropo.logs.guessing.files_beside import find_files
from dropo.logs.guessing.guessed import LISTED, Guess, quote
from dropo.logs.guessing.log_columns import LogColumns
from dropo.logs.guessing.places import PlaceSettings, likeness, match
from dropo.logs.guessing.scales import (
    Choice,
    Scale,
    ScaleSettings,
    angle_unit,
    answered_unit,
    command_unit,
    time_unit,
    velocity_unit,
)
from dropo.logs.guessing.sensor_entries import take_sensors
from dropo.logs.guessing.words import ColumnName
from dropo.logs.readers.reader import Log
from dropo.logs.signals.stamps import increasing
from dropo.logs.units import known_unit, seconds, unit_named
from dropo.mjmodel.dynamics.drives import command_kind
from dropo.mjmodel.followers import followers_of
from dropo.mjmodel.joints import Joint, ModelJoints

Ask = Callable[[str, Sequence[str]], str]
"""Asks a question that has some answers, on a terminal."""
FOLLOWS: dict[str | None, float] = {
    words.POSITION: 0.4,
    words.EFFORT: 0.9,
    words.VELOCITY: 0.7,
    None: 0.7,
}
"""Correlation with the positions from which on commands of unknown kind are commanded positions, by
what the model's actuators take."""
KINDS = {
    "rad": words.POSITION,
    "m": words.POSITION,
    "rad/s": words.VELOCITY,
    "m/s": words.VELOCITY,
    "N m": words.EFFORT,
    "N": words.EFFORT,
}
"""What is commanded in an SI unit; currents and voltages may command anything."""
UNKNOWN = "nothing says otherwise"
"""Why a command whose joint has no position is in its unit."""
FOLLOWS_OTHERWISE = 0.9
"""The same of either sign and with any joint, where the model's servos take positions: a sign may
be wrong, or two columns exchanged."""
MOVES = 0.4
"""Correlation with the speeds from which on commands of unknown kind are commanded speeds, where
the model's actuators take these."""
SPANS = 1000
"""The parts of a log over which speeds are means: an encoder's steps do not hide them."""


@dataclass(frozen=True)
class GuessSettings:
    """What names and numbers of columns say.

    Attributes
    ----------
    places : PlaceSettings
        From when on a column's name is that of a joint.
    scales : ScaleSettings
        What the size of numbers says of their unit.
    word : int
        Letters that a body's name needs to stand for the joint that moves it: fewer tell little.
    """

    places: PlaceSettings = field(default_factory=PlaceSettings)
    scales: ScaleSettings = field(default_factory=ScaleSettings)
    word: int = 3


DEFAULTS = GuessSettings()


def guess_mapping(
    log: Log,
    robot: ModelJoints,
    given: dict[str, Any] | None = None,
    ask: Ask | None = None,
    settings: GuessSettings = DEFAULTS,
) -> Guess:
    """Guess which columns of a log are the joints and actuators of a robot.

    Parameters
    ----------
    log : Log
        The first of the logs.
    robot : ModelJoints
        The robot; where it has no actuators, commands are taken as those of its joints.
    given : dict, optional
        Entries of a mapping file that are not guessed.
    ask : callable, optional
        Asks what is not decided; without it, that is noted in `undecided`.
    settings : GuessSettings, optional
        What names and numbers say.

    Returns
    -------
    Guess

    Raises
    ------
    BadFile
        If the log cannot be read, or none of its columns is a position.
    Incompatible
        If the base moves in the log and is fixed in the model.
    """
    guesser = _Guesser(log, robot, given or {}, ask, settings)
    guesser.find_time()
    guesser.find_runs()
    guesser.find_files()
    guesser.find_sensors()
    guesser.find_positions()
    guesser.find_base()
    guesser.find_velocities()
    guesser.find_commands()
    guesser.say_what_is_left()
    return guesser.guess


class _Guesser:
    """A log, a robot, and what has been guessed so far."""

    def __init__(
        self,
        log: Log,
        robot: ModelJoints,
        given: dict[str, Any],
        ask: Ask | None,
        settings: GuessSettings,
    ):
        self.guess = Guess()
        self._log = log
        self._robot = robot
        self._given = given
        self._ask = ask
        self._settings = settings
        names = [*robot.joints, *robot.actuators]
        self._columns = LogColumns(log, names)
        self._positions: dict[str, tuple[ColumnName, Scale]] = {}
        self._base = find_base(self._columns.all, [joint.name for joint in self._free_joints()])

    # what all steps need

    def _decide(self, question: str, options: Sequence[str], answer: dict[str, Any]) -> str | None:
        """The answer to a question on a terminal; elsewhere None, and the question is noted.

        answer: the entries of a mapping with which it is answered by the first option.
        """
        if self._ask is not None:
            return self._ask(question, options)
        self.guess.ask(f"{question} ({' or '.join(options)})", answer)
        return None

    def _entry(self, column: ColumnName, scale: Scale) -> dict[str, Any]:
        """An entry of the mapping."""
        entry: dict[str, Any] = {"column": column.column, "unit": scale.unit}
        if scale.sign != 1:
            entry["sign"] = scale.sign
        if scale.offset:
            entry["offset"] = scale.offset
        return entry | self._source_entry(column)

    def _source_entry(self, column: ColumnName) -> dict[str, Any]:
        """Where a column stands, as far as an entry must say it."""
        if column.topic is not None:
            return {"topic": column.topic}
        file = self._columns.file_of(column)
        if file is None:
            return {}
        entry: dict[str, Any] = {"file": file.name}
        if not file.same:
            entry["clock"] = file.clock
        elif file.clock != {"unit": "s", **self.guess.mapping["time"]}:
            entry["clock"] = file.clock | {"same": True}
        return entry

    def _given_entry(self, quantity: str, name: str) -> dict[str, Any]:
        """What the given mapping says of a joint or actuator."""
        entries = self._given.get(quantity)
        entry = entries.get(name) if isinstance(entries, dict) else None
        return entry if isinstance(entry, dict) else {}

    def _match(
        self, quantity: str, columns: Sequence[ColumnName], names: Sequence[str]
    ) -> tuple[dict[str, ColumnName], list[ColumnName]]:
        """Columns by joint or actuator: those of the given mapping, then by their names."""
        fixed = {}
        for name in names:
            wanted = self._given_entry(quantity, name).get("column")
            there = columns if quantity == "ctrl" else (*self._columns.all, *self._columns.beside)
            found = next((one for one in there if one.column == wanted), None)
            if found is not None:
                fixed[name] = found
        rest = [one for one in columns if one not in fixed.values()]
        unnamed = [name for name in names if name not in fixed]
        guessed, left = match(rest, unnamed, self._settings.places)
        if quantity != "ctrl":  # a body stands for the joint that moves it
            bodies = {
                body: name
                for name, body in self._robot.bodies.items()
                if name in unnamed and name not in guessed and len(body) >= self._settings.word
            }
            more, left = match(left, list(bodies), self._settings.places)
            guessed |= {bodies[body]: column for body, column in more.items()}
        found_all = fixed | guessed
        return {name: found_all[name] for name in names if name in found_all}, left

    # step by step

    def find_time(self) -> None:
        """Find the column of stamps and its unit."""
        given = self._given.get("time")
        wanted = given.get("column") if isinstance(given, dict) else None
        if self._log.topics() or (self._log.time_column and wanted is None):
            own = self._log.time_column
            self._columns.used |= set(self._columns.of(words.TIME))
            if own is None:
                self.guess.lines.append("time: the messages' own stamps")
                return
            self.guess.lines.append(f"time: {own!r} in s, the stamps of this kind of log")
            self.guess.mapping["time"] = {"column": own}
            return
        candidates = [one for one in self._columns.all if one.column == wanted] or self._clocks()
        standing = "" if candidates else self._stamps_that_stand()
        self._columns.used |= set(self._columns.of(words.TIME))
        if not candidates:
            if self._given.get("rate") is None:
                self.guess.ask(
                    f"{self._log.path} has no column of time stamps{standing}: "
                    "how many rows a second?",
                    {"rate": "HZ"},
                )
            return
        column = candidates[0]
        self._columns.used.add(column)
        stamps = self._columns.finite(column)
        if len(stamps) < 2:
            scale = Scale("s", "its cells are dates")
        else:
            scale = time_unit(stamps, column.unit, self._settings.scales)
        if isinstance(given, dict) and given.get("unit"):
            scale = Scale(str(given["unit"]), "it was given")
        self.guess.mapping["time"] = {"column": column.column, "unit": scale.unit}
        others = f"; {quote(candidates[1:])} are left" if candidates[1:] else ""
        self.guess.lines.append(
            f"time: {column.column!r} in {scale.unit}, since {scale.why}{others}"
        )

    def _stamps_that_stand(self) -> str:
        """Words on a column that is named as stamps are, and whose numbers do not go on."""
        for column in self._columns.of(words.TIME):
            values = self._columns.read([column])[0]
            values = values[np.isfinite(values)]
            count = int(np.sum(np.diff(values) <= 0))
            if count:
                return (
                    f" that go on: of {column.column!r} {count} in {len(values)} rows repeat or "
                    f"run backward, as if written with too few digits ({values[0]:.17g})"
                )
        return ""

    def _clocks(self) -> list[ColumnName]:
        """Columns that may be stamps, whose numbers go on."""
        found = []
        named = self._columns.of(words.TIME) or [
            one
            for one in self._columns.all
            if set(words.tokens(one.column)) & set(words.TIME_UNITS)
        ]
        for column in named:
            values = self._columns.read([column])[0]
            there = values[np.isfinite(values)]
            # Each run may begin at 0 again.
            if len(there) < 2 or np.mean(np.diff(there) > 0) > 0.9:
                found.append(column)
        return sorted(found, key=lambda one: len(one.rest))

    def find_runs(self) -> None:
        """Find the column that tells runs apart."""
        if self._log.run_column is not None or "run" in self._given:
            self._columns.used |= set(self._columns.of(words.RUN))
            return
        for column in self._columns.of(words.RUN):
            self._columns.used.add(column)
            numbers = self._columns.read([column])[0]
            if not np.isfinite(numbers).all() or len(np.unique(numbers)) < len(numbers) / 10:
                self.guess.mapping["run"] = {"column": column.column}
                self.guess.lines.append(f"runs: told apart by {column.column!r}")
                return

    def find_files(self) -> None:
        """Find files beside the log that may hold what it does not."""
        names = [*self._robot.joints, *self._robot.actuators]
        time = self.guess.mapping.get("time", {})
        given = dict(_files_in(self._given))
        self._columns.add_files(find_files(self._log, names, given, time))

    def find_sensors(self) -> None:
        """Find the columns of gyros, accelerometers and other sensors of the model."""
        if not self._robot.sensors:
            return
        given = self._given.get("sensordata")
        entries = given if isinstance(given, dict) else {}
        taken: set[ColumnName] = set(self._columns.used)
        base = self._base
        if self._free_joints() and len(base.position) == 3 and len(base.quaternion) == 4:
            taken |= set(base.all()) - set(base.gyro)
        beside = [one for one in self._columns.beside if one.quantity != words.COMMAND]
        free = [one for one in (*self._columns.all, *beside) if one not in taken]
        take_sensors(self._columns, self._robot, free, entries, self.guess, self._source_entry)
        # what is another sensor's is not the base's
        others = [one for one in self._columns.all if one not in self._columns.used]
        self._base = find_base(others, [joint.name for joint in self._free_joints()])

    def find_positions(self) -> None:
        """Find the position of every hinge and slide, and their units."""
        joints = {
            name: joint
            for name, joint in self._robot.joints.items()
            if joint.kind in ("hinge", "slide")
        }
        columns = self._columns.numeric_of(words.POSITION)
        columns = [one for one in columns if one not in self._base.all()]
        found, left = self._match("qpos", columns, list(joints))
        missing = [name for name in joints if name not in found]
        if missing:  # a joint's bare name is its position
            bare = [one for one in self._columns.numeric_of(None) if one not in self._base.all()]
            more, _ = self._match("qpos", bare, missing)
            found |= more
        found = {name: found[name] for name in joints if name in found}
        if not found and not self._free_joints():
            self._refuse_positions(columns)
        self._columns.used |= set(found.values())
        self._note_ambiguous(left, list(joints), found)
        hinges = [name for name in found if joints[name].kind == "hinge"]
        self._scale_angles(hinges, found, joints)
        for name in found:
            if joints[name].kind == "slide":
                self._scale_slide(name, found[name], joints[name])
        without = [name for name in joints if name not in found]
        leaders = self._leaders(found)
        for name in [one for one in without if one in leaders]:
            self.guess.lines.append(
                f"{name} follows {leaders[name]} in the model: no column is needed"
            )
            without.remove(name)
        if without:
            self.guess.lines.append(
                f"no position in the log: {', '.join(without)}; such a joint starts where the "
                "model has it"
            )

    def _leaders(self, found: Collection[str]) -> dict[str, str]:
        """By joint the one of those found that it follows in the model."""
        followers = followers_of(self._robot.model)
        return {one.name: one.leader for one in followers if one.leader in found}

    def _free_joints(self) -> list[Joint]:
        """The free joints of the model."""
        return [joint for joint in self._robot.joints.values() if joint.kind == "free"]

    def _refuse_positions(self, columns: Sequence[ColumnName]) -> None:
        """End where no column is a joint's."""
        names = list(self._robot.joints)
        shown = quote(columns or self._columns.all)
        expected = f"columns that name the positions of the joints {', '.join(names[:LISTED])}"
        raise BadFile(self._log.path, "columns", expected, f"{shown}")

    def _note_ambiguous(
        self, left: Sequence[ColumnName], names: Sequence[str], found: dict[str, ColumnName]
    ) -> None:
        """Note joints without a column while columns of positions are left over."""
        leaders = self._leaders(found)
        without = [name for name in names if name not in found and name not in leaders]
        if not without or not left:
            return
        for name in without:
            options = [
                one
                for one in left
                if likeness(one, name) >= self._settings.places.possible
                or (one.rest and one.rest[-1].isdigit())
            ]
            if not options:
                continue
            answer = self._decide(
                f"Which column is the position of {name!r}?",
                [one.column for one in options[:LISTED]],
                {"qpos": {name: {"column": options[0].column}}},
            )
            column = next((one for one in left if one.column == answer), None)
            if column is not None:
                found[name] = column

    def _scale_angles(
        self, hinges: Sequence[str], found: dict[str, ColumnName], joints: dict[str, Joint]
    ) -> None:
        """The unit of all angles."""
        if not hinges:
            return
        columns = [found[name] for name in hinges]
        values = [self._columns.finite(column) for column in columns]
        stated = [self._given_entry("qpos", name).get("unit") for name in hinges]
        given = next((unit for unit in stated if unit is not None), None)
        hints = [given or column.unit for column in columns]
        commands, _ = match(self._columns.numeric_of(words.COMMAND), hinges, self._settings.places)
        followed = [self._paired(commands[name], found[name]) for name in commands]
        scale = angle_unit(
            values, [joints[name] for name in hinges], hints, followed, self._settings.scales
        )
        if isinstance(scale, Choice):
            question = f"{scale.what}: in which unit are {quote(columns)}?"
            entry = {"qpos": {hinges[0]: {"unit": scale.units[0]}}}
            answer = self._decide(question, scale.units, entry) or scale.units[0]
            scale = answered_unit(values, answer)
        for name, column in zip(hinges, columns, strict=True):
            self._keep_position(name, column, scale)
        whose = ", ".join(f"{name} = {found[name].column!r}" for name in hinges)
        self.guess.lines.append(f"positions: {whose}; in {scale.unit}, since {scale.why}")

    def _scale_slide(self, name: str, column: ColumnName, joint: Joint) -> None:
        """The unit of a slide's position."""
        unit = self._given_entry("qpos", name).get("unit") or column.unit
        scale = Scale("m", "slides are in m")
        if unit in ("m", "cm", "mm"):
            scale = Scale(unit, "its name says so")
        elif joint.range is not None:
            size = float(np.abs(self._columns.finite(column)).max())
            reach = max(abs(end) for end in joint.range)
            for factor, other in ((100.0, "mm"), (3.0, "cm")):
                if scale.unit == "m" and size > factor * reach:
                    scale = Scale(other, f"it reaches {size:.4g}, the joint {reach:.4g} m")
        self._keep_position(name, column, scale)
        self.guess.lines.append(
            f"positions: {name} = {column.column!r}; in {scale.unit}, since {scale.why}"
        )

    def _keep_position(self, name: str, column: ColumnName, scale: Scale) -> None:
        """Take a position into the mapping."""
        sign = self._given_entry("qpos", name).get("sign")
        if sign in (1, -1):
            scale = replace(scale, sign=int(sign))
        self._positions[name] = (column, scale)
        self.guess.mapping.setdefault("qpos", {})[name] = self._entry(column, scale)

    def find_base(self) -> None:
        """Map the pose of a free joint.

        Raises
        ------
        Incompatible
            If the base moves in the log and is fixed in the model.
        """
        free = self._free_joints()
        base = self._base
        if not free:
            used = {(one.topic, one.column) for one in self._columns.used}
            moves = moving_base(self._log, self._robot, used)
            if moves is not None and moves.level == "error":
                raise Incompatible(f"{self._log.path}: {moves.sentence} {moves.advice}")
            self._columns.used |= set(base.all())
            return
        values = dict(zip(base.all(), self._columns.read(base.all()), strict=True))
        if len(base.position) != 3 or len(base.quaternion) != 4:
            if not self._positions:
                self._refuse_positions(self._columns.numeric_of(words.POSITION))
            self.guess.lines.append(self._say_no_pose(free[0].name))
            return
        turn = self._order_of(base, values, free[0].name)
        seven = [*base.position, *turn]
        self._columns.used |= set(seven)
        entry: dict[str, Any] = {"columns": [one.column for one in seven]}
        if seven[0].topic is not None:
            entry["topic"] = seven[0].topic
        self.guess.mapping.setdefault("qpos", {})[free[0].name] = entry
        self.guess.lines.append(f"base: {free[0].name} = {quote(seven)}, in m and w, x, y, z")

    def _say_no_pose(self, name: str) -> str:
        """What becomes of a base whose pose is not in the log."""
        said = f"no pose of {name} in the log"
        if not lacks_base(self._robot, ()):
            return f"{said}: it starts where it stands in the model"
        sensors = list(self.guess.mapping.get("sensordata", {}))
        missing = missing_for_base(self._robot, list(self._positions), sensors)
        if missing:
            return (
                f"{said}, and none can be estimated without {'; '.join(missing)}. No fit through "
                "contacts starts from that; fix the base in the model if the machine hung on a "
                "stand"
            )
        return f"{said}: it is estimated from the IMU and from feet that stand on the ground"

    def _order_of(
        self, base: BaseColumns, values: dict[ColumnName, Array], joint: str
    ) -> list[ColumnName]:
        """The columns of the quaternion in the order w, x, y, z."""
        if base.named:
            return list(base.quaternion)
        given = self._given_entry("qpos", joint).get("columns")
        if isinstance(given, list) and {one.column for one in base.quaternion} <= set(given):
            return sorted(base.quaternion, key=lambda one: given.index(one.column))
        parts = np.stack([values[one] for one in base.quaternion], axis=1)
        order = quaternion_order(parts)
        if order is None:
            question = f"In which order is the quaternion {quote(base.quaternion)}?"
            seven = [one.column for one in (*base.position, *base.quaternion)]
            answer = {"qpos": {joint: {"columns": seven}}}
            order = self._decide(question, ["wxyz", "xyzw"], answer)
        else:
            self.guess.lines.append(
                f"quaternion: in the order {', '.join(order)}, since a base is upright most of "
                "the time"
            )
        four = list(base.quaternion)
        return [four[3], *four[:3]] if order == "xyzw" else four

    def find_velocities(self) -> None:
        """Find the velocities of the joints that have a position, and their units."""
        columns = self._columns.numeric_of(words.VELOCITY)
        found, _ = self._match("qvel", columns, list(self._positions))
        kept: dict[str, tuple[ColumnName, Scale]] = {}
        for name, column in found.items():
            self._columns.used.add(column)
            position, scale = self._positions[name]
            if column.topic != position.topic:
                continue
            joint = self._robot.joints[name]
            time, place, speed = self._together(position, column)
            if len(time) < 20:
                continue
            if np.ptp(speed) == 0 < np.ptp(place):
                stands = float(speed[0]) + 0.0  # which makes 0 of -0
                self.guess.lines.append(
                    f"velocity: {column.column!r} is left out, since it stands at {stands:g} while "
                    f"{position.column!r} moves; it is estimated"
                )
                continue
            hint = self._given_entry("qvel", name).get("unit") or column.unit
            place = known_unit(scale.unit)[1] * (scale.sign * place + scale.offset)
            unit = velocity_unit(time, place, speed, hint, joint, self._settings.scales)
            if unit is None:
                self.guess.lines.append(
                    f"velocity: {column.column!r} is left out, since it does not fit the change "
                    f"of {position.column!r}; it is estimated"
                )
                continue
            kept[name] = (column, unit)
        if not kept:
            return
        for name, (column, unit) in kept.items():
            self.guess.mapping.setdefault("qvel", {})[name] = self._entry(column, unit)
        whose = ", ".join(f"{name} = {column.column!r}" for name, (column, _) in kept.items())
        first = next(iter(kept.values()))[1]
        units = " and ".join(dict.fromkeys(unit.unit for _, unit in kept.values()))
        self.guess.lines.append(f"velocities: {whose}; in {units}, since {first.why}")

    def _together(self, one: ColumnName, other: ColumnName) -> tuple[Array, Array, Array]:
        """Stamps [s] and numbers of two columns of a topic, in the rows that have all."""
        first, second = self._columns.read([one, other])
        time = self._time_of(one, len(first))
        there = np.isfinite(first) & np.isfinite(second) & np.isfinite(time)
        rows = np.flatnonzero(there)
        rows = rows[increasing(time[rows])]
        return time[rows], first[rows], second[rows]

    def _time_of(self, one: ColumnName, rows: int) -> Array:
        """The stamps [s] of the rows that a column stands in, from the log's first one."""
        entry = self.guess.mapping.get("time", {})
        column = entry.get("column") or self._log.stamps(one.topic)
        if column is None:
            return np.arange(rows) / float(self._given.get("rate") or 1.0)
        unit = entry.get("unit", "s")
        file = self._columns.file_of(one)
        topic = one.topic
        values = self._log.read(topic, [column], lambda fraction, text: None)[column]
        if file is None:
            return seconds(values, unit, values[0])
        there = file.stamps()
        return there - (seconds(values[:1], unit)[0] if file.same else there[0])

    def find_commands(self) -> None:
        """Find what was commanded to each actuator."""
        names, owners = self._driven()
        given = list(self._given_commands())
        columns = self._columns.numeric_of(words.COMMAND)
        by_kind = self._commands_among(columns, names, owners) if columns else {}
        if not by_kind:
            beside = [one for one in self._columns.beside if one.quantity == words.COMMAND]
            by_kind = self._commands_among(self._columns.numeric(beside), names, owners)
            self._say_files(by_kind)
        measured = [one for one in self._columns.numeric_of(words.EFFORT) if one not in given]
        efforts, _ = self._match("ctrl", measured, names)
        if efforts and words.EFFORT not in by_kind:
            by_kind["measured torque"] = efforts
        if not by_kind and self._robot.actuators and "ctrl" not in self._given:
            by_kind = self._ask_for_commands(names, owners)
        self._take_commands(by_kind, names, owners)

    def _ask_for_commands(
        self, names: list[str], owners: dict[str, str]
    ) -> dict[str, dict[str, ColumnName]]:
        """Commands in columns whose names say the joint and not what it is, where that is so."""
        unknown = self._columns.numeric_of(None)
        found = self._match("ctrl", unknown, names)[0]
        if not found:
            by_joint, _ = match(unknown, list(owners.values()), self._settings.places)
            found = {name: by_joint[owners[name]] for name in names if owners[name] in by_joint}
        if 2 * len(found) < len(names) or not found:
            return {}
        question = f"Are {quote(list(found.values()))} what the actuators were told?"
        entries = {name: {"column": column.column} for name, column in found.items()}
        answer = self._decide(question, ["yes", "no"], {"ctrl": entries})
        return {self._kind_of(found, owners): found} if answer == "yes" else {}

    def _commands_among(
        self, candidates: Sequence[ColumnName], names: list[str], owners: dict[str, str]
    ) -> dict[str, dict[str, ColumnName]]:
        """By the kind of command which column is that of each actuator."""
        given = self._given_commands()
        free = [one for one in candidates if one not in given and not self._is_supply(one)]
        kinds = {one: one.kind for one in free} | given
        by_kind: dict[str, dict[str, ColumnName]] = {}
        for kind in (words.POSITION, words.EFFORT, words.VELOCITY, None):
            of_kind = [one for one, its in kinds.items() if its == kind]
            found = self._beside_positions(of_kind, owners)
            if len(found) < len(of_kind):
                rest = [one for one in of_kind if one not in found.values()]
                unnamed = [name for name in names if name not in found]
                found |= self._match("ctrl", rest, unnamed)[0]
            missing = [name for name in names if name not in found]
            left = [one for one in of_kind if one not in found.values()]
            joints = [owners[name] for name in missing]
            by_joint, _ = match(left, joints, self._settings.places)
            for name in missing:
                if owners[name] in by_joint:
                    found[name] = by_joint[owners[name]]
            if found:
                by_kind.setdefault(kind or self._kind_of(found, owners), found)
        return by_kind

    def _given_commands(self) -> dict[ColumnName, str | None]:
        """The commands' columns that the given mapping names, and what each is a command of.

        Its unit there says it; without one it is what the model's actuators take.
        """
        entries = self._given.get("ctrl")
        found: dict[ColumnName, str | None] = {}
        for name in entries if isinstance(entries, dict) else ():
            entry = self._given_entry("ctrl", name)
            there = (*self._columns.all, *self._columns.beside)
            column = next((one for one in there if one.column == entry.get("column")), None)
            if column is not None:
                unit = unit_named(str(entry.get("unit", ""))) or ("", 1.0)
                found[column] = KINDS.get(unit[0]) or self._kind_wanted() or column.kind
        return found

    def _is_supply(self, column: ColumnName) -> bool:
        """Whether volts are those that a machine is fed with, which hardly change."""
        if column.unit not in ("V", "mV"):
            return False
        values = self._columns.finite(column)
        return bool(values.min() > 0.5 * values.max() > 0)

    def _say_files(self, by_kind: dict[str, dict[str, ColumnName]]) -> None:
        """Say in which files beside the log the commands stand, and on which clock."""
        columns = [column for found in by_kind.values() for column in found.values()]
        for file in dict.fromkeys(map(self._columns.file_of, columns)):
            if file is not None:
                clock = "the log's clock" if file.same else "a clock of its own"
                self.guess.lines.append(
                    f"commands: in {file.log.path.name} beside the log (`file: "
                    f'"{file.name}"`), on {clock}'
                )

    def _beside_positions(
        self, columns: Sequence[ColumnName], owners: dict[str, str]
    ) -> dict[str, ColumnName]:
        """By actuator the command whose words are those of its joint's position."""
        found: dict[str, ColumnName] = {}
        for name, joint in owners.items():
            if joint not in self._positions or self._given_entry("ctrl", name).get("column"):
                continue
            wanted = self._positions[joint][0].rest
            alike = [one for one in columns if one.rest == wanted and wanted]
            if len(alike) == 1:
                found[name] = alike[0]
        return found

    def _driven(self) -> tuple[list[str], dict[str, str]]:
        """What may be commanded, and the joint of each: actuators, or joints without any."""
        if self._robot.actuators:
            owners = {
                name: one.joint.name if one.joint is not None else name
                for name, one in self._robot.actuators.items()
            }
            return list(owners), owners
        joints = [one for one in self._robot.joints.values() if one.kind in ("hinge", "slide")]
        return [one.name for one in joints], {one.name: one.name for one in joints}

    def _kind_of(self, found: dict[str, ColumnName], owners: dict[str, str]) -> str:
        """The kind of commands whose names do not say it, by how the joints follow them.

        Each for itself, or all together: a leg sags below its commands, and is near them all the
        same.
        """
        wanted = self._kind_wanted()
        if wanted and all(self._given_entry("ctrl", name).get("column") for name in found):
            return wanted
        alike = []
        pairs = []
        nearest = []
        for name, column in found.items():
            position = self._positions.get(owners[name])
            pair = None if position is None else self._moving_pair(column, position[0])
            if pair is not None:
                pairs.append(pair)
                alike.append(float(np.corrcoef(*pair)[0, 1]))
                nearest.append(self._nearest_likeness(column))
        if not alike:
            return wanted or words.POSITION
        together = float(np.corrcoef(*np.concatenate(pairs, axis=1))[0, 1])
        if max(float(np.median(alike)), together) > FOLLOWS[wanted]:
            return words.POSITION
        if wanted == words.VELOCITY and float(np.median([*map(_likeness_of_speed, pairs)])) > MOVES:
            return words.VELOCITY
        is_turned = wanted == words.POSITION and float(np.median(nearest)) > FOLLOWS_OTHERWISE
        return words.POSITION if is_turned else words.EFFORT

    def _moving_pair(self, command: ColumnName, position: ColumnName) -> Array | None:
        """(2, n) a command and a position of its topic where both are there; None if one rests."""
        if position.topic != command.topic:
            return None
        commands, places = self._paired(command, position)
        if not (len(commands) and np.ptp(commands) > 0 and np.ptp(places) > 0):
            return None
        return np.stack([commands, places])

    def _nearest_likeness(self, command: ColumnName) -> float:
        """The largest correlation of a command with any joint's position, of either sign."""
        best = 0.0
        for position, _ in self._positions.values():
            pair = self._moving_pair(command, position)
            if pair is not None:
                best = max(best, abs(float(np.corrcoef(*pair)[0, 1])))
        return best

    def _kind_wanted(self) -> str | None:
        """The kind of command that the model's actuators take; None where it has none."""
        model = self._robot.model
        kinds = [command_kind(model, one.id) for one in self._robot.actuators.values()]
        return max(dict.fromkeys(kinds), key=kinds.count) if kinds else None

    def _take_commands(
        self, by_kind: dict[str, dict[str, ColumnName]], names: list[str], owners: dict[str, str]
    ) -> None:
        """Choose the commands that fit the actuators, and take them into the mapping."""
        wanted = self._kind_wanted()
        if wanted == words.EFFORT and wanted not in by_kind and "measured torque" in by_kind:
            kind = words.EFFORT
            chosen = by_kind["measured torque"]
            why = "which was measured: no torque was commanded in the log"
        elif wanted is None and by_kind:
            kind = next(one for one in by_kind)
            chosen = by_kind[kind]
            kind = words.EFFORT if kind == "measured torque" else kind
            why = "and the model has no actuators: each such joint gets one"
            self.guess.drives = dict.fromkeys(chosen, kind)
        elif wanted in by_kind:
            kind = wanted
            chosen = by_kind[kind]
            why = "as the model's actuators take"
        else:
            self._say_no_commands(wanted, by_kind)
            return
        self._scale_commands(chosen, kind, why, owners)
        without = [name for name in names if name not in chosen]
        if without and self._robot.actuators:
            self.guess.lines.append(f"no command in the log: {', '.join(without)}; taken as 0")

    def _say_no_commands(
        self, wanted: str | None, by_kind: dict[str, dict[str, ColumnName]]
    ) -> None:
        """Say that nothing is commanded, or refuse commands of another kind."""
        if by_kind:
            kinds = " and ".join(by_kind)
            raise Incompatible(
                f"{self._log.path}: the model's actuators take {wanted} commands, and the log has "
                f"{kinds} alone. Give the model actuators of that kind, or log what they take."
            )
        if self._robot.actuators:
            self.guess.lines.append(
                "no commands in the log: all are taken as 0, as of motors that are off; where they "
                "were not, give the columns with --map, or infer them with `dropo data actions`"
            )

    def _scale_commands(
        self, chosen: dict[str, ColumnName], kind: str, why: str, owners: dict[str, str]
    ) -> None:
        """The units of commands."""
        entries = {}
        units = {}
        scales = {
            name: self._command_scale(one, kind, owners[name]) for name, one in chosen.items()
        }
        followed = [scales[name] for name in chosen if owners[name] in self._positions]
        for name, column in chosen.items():
            self._columns.used.add(column)
            given = self._given_entry("ctrl", name).get("unit")
            scale = scales[name]
            if scale.why == UNKNOWN:
                scale = next((one for one in followed if _alike(one, scale)), scale)
            if given is not None:
                scale = Scale(str(given), "it was given")
            entries[name] = self._entry(column, scale)
            units[scale.unit] = scale.why
        self.guess.mapping["ctrl"] = entries
        whose = ", ".join(f"{name} = {column.column!r}" for name, column in chosen.items())
        reasons = "; ".join(f"in {unit}, since {reason}" for unit, reason in units.items())
        self.guess.lines.append(f"commands ({kind}): {whose}, {why}; {reasons}")

    def _command_scale(self, column: ColumnName, kind: str, joint: str) -> Scale:
        """The unit of one command."""
        hint = column.unit if unit_named(column.unit or "") else None
        is_slide = (
            self._robot.joints[joint].kind == "slide" if joint in self._robot.joints else False
        )
        if kind == words.EFFORT:
            torque = "N" if is_slide else "N m"
            of_current = any(word in column.column.lower() for word in ("current", "amp"))
            if hint is None and of_current:
                hint = "A"
            reason = "its name says so" if hint else "torques are"
            return Scale(hint or torque, reason)
        if kind == words.VELOCITY:
            unit = "m/s" if is_slide else "rad/s"
            return Scale(hint or unit, "its name says so" if hint else "velocities are")
        position = self._positions.get(joint)
        if position is None:
            reason = "its name says so" if hint else UNKNOWN
            return Scale(hint or ("m" if is_slide else "rad"), reason)
        commands, places = self._paired(column, position[0])
        return command_unit(commands, places, hint, position[1])

    def _paired(self, one: ColumnName, other: ColumnName) -> tuple[Array, Array]:
        """Two columns at the same rows; of topics of other rates, by their time."""
        first, second = self._columns.read([one, other])
        if (one.topic, one.file) != (other.topic, other.file):
            at = self._time_of(one, len(first))
            known = self._time_of(other, len(second))
            second = np.interp(at, known, second)
        there = np.isfinite(first) & np.isfinite(second)
        return first[there], second[there]

    def say_what_is_left(self) -> None:
        """Name the columns that are not used."""
        left = [one for one in self._columns.all if one not in self._columns.used]
        if left:
            self.guess.lines.append(f"not used: {quote(left)}")
        if not self.guess.mapping.get("ctrl"):
            self.guess.mapping.pop("ctrl", None)


def _likeness_of_speed(pair: Array) -> float:
    """The correlation of commands with a joint's speed, both as means over short spans."""
    span = max(1, pair.shape[1] // SPANS)
    commands = np.convolve(pair[0], np.ones(span) / span, mode="valid")[:-1]
    moved = pair[1][span:] - pair[1][:-span]
    count = min(len(commands), len(moved))
    if not (np.ptp(commands[:count]) > 0 and np.ptp(moved[:count]) > 0):
        return 0.0
    return float(np.corrcoef(commands[:count], moved[:count])[0, 1])


def _files_in(given: object, above: str | None = None) -> Iterator[tuple[str, str | None]]:
    """The files beside the log that entries of a mapping name, and what all their columns are."""
    if not isinstance(given, dict):
        return
    for key, value in given.items():
        if key == "file" and isinstance(value, str):
            yield value, above
        else:
            yield from _files_in(value, "command" if key in ("ctrl", "inputs") else above)


def _alike(one: Scale, other: Scale) -> bool:
    """Whether two units are of the same quantity."""
    return known_unit(one.unit)[0] == known_unit(other.unit)[0]
