"""The problem file that an import writes: all that the log tells, and what may be fitted."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.services.files.strict_yaml import format_yaml
from dropo.core.services.validation import Array
from dropo.mjmodel.dynamics.drives import servo_of
from dropo.mjmodel.dynamics.forces import inverse_forces
from dropo.mjmodel.joints import Joint, ModelJoints, numbers_of
from dropo.mjmodel.standing import floating_base

HEAD = """\
# Written by `dropo {command}`, which writes it anew until you change it. All keys: `dropo schema`.
"""
NOISE = """
# Variance of every signal's noise as the import measured it; left out, it is learned from the data.
# epsilon: {{{levels}}}
"""
PARAMETERS = """
# What may be fitted. `dropo diagnose` finds by itself what is missing; for `dropo fit` take the
# "# " away before `parameters:` and before some lines, and set bounds that you believe in.
# parameters:
"""
ONE_EACH = (
    '#   # one of each joint, or one factor for all, with "shared: true" and "target: relative":\n'
)
APART = "#   # or joint by joint:\n"


@dataclass(frozen=True)
class TextSettings:
    """What a problem file proposes.

    Attributes
    ----------
    segment : float
        Seconds of a segment, which `lambda` gives in control steps.
    segments : int
        Segments that the shortest trajectory holds at least.
    held_out_every : int
        Of so many runs, the last one is held out.
    factor : float
        Factors on gains are searched from 1 / this to this.
    motor : (float, float)
        Factors on motors' gains are searched between these.
    slippery : float
        The factor on friction at contacts is searched from 1 / this to this.
    quantile : float
        Quantile of forces and speeds in the data from which the bounds of frictions are made.
    rows : int
        Rows that forces are computed for at most.
    """

    segment: float = 0.2
    segments: int = 4
    held_out_every: int = 3
    factor: float = 5.0
    motor: tuple[float, float] = (0.3, 2.0)
    slippery: float = 3.0
    quantile: float = 0.98
    rows: int = 3000


DEFAULTS = TextSettings()


def held_out_runs(names: Sequence[str], settings: TextSettings = DEFAULTS) -> list[str]:
    """Choose the runs that no fit sees.

    Parameters
    ----------
    names : sequence of str
        All runs.
    settings : TextSettings, optional
        How many.

    Returns
    -------
    list of str
        The last of every three, of two runs the second, and none of one.
    """
    every = min(settings.held_out_every, len(names))
    return list(names[every - 1 :: every]) if len(names) > 1 else []


def segment_steps(
    control_step: float, lengths: Sequence[int], settings: TextSettings = DEFAULTS
) -> int:
    """Choose the control steps of a segment.

    Parameters
    ----------
    control_step : float
        [s]
    lengths : sequence of int
        Rows of each trajectory.
    settings : TextSettings, optional
        How long.

    Returns
    -------
    int
        At least 1.
    """
    typical = int(np.median(lengths))
    most = max(1, (typical - 1) // settings.segments)
    return max(1, min(round(settings.segment / control_step), most))


def format_problem(
    content: dict[str, Any],
    command: str,
    robot: ModelJoints,
    variances: dict[str, float],
    motion: tuple[Array, Array] | None,
    control_step: float,
    settings: TextSettings = DEFAULTS,
) -> str:
    """Write a problem file with noise and parameters as comments.

    Parameters
    ----------
    content : dict
        The keys that hold.
    command : str
        What wrote it.
    robot : ModelJoints
        The robot.
    variances : dict
        Of the noise, by signal.
    motion : ((n, nq) array, (n, nv) array) or None
        Rows that follow each other, where whole states were observed.
    control_step : float
        Their distance [s].
    settings : TextSettings, optional
        What is proposed.

    Returns
    -------
    str
        YAML.
    """
    text = HEAD.format(command=command) + _with_comments(format_yaml(content), control_step)
    if variances:
        levels = ", ".join(
            f"{_flow_key(name)}: {_scientific(value)}" for name, value in variances.items()
        )
        text += NOISE.format(levels=levels)
    bounds = _Bounds(robot, motion, control_step, settings)
    return text + PARAMETERS + "".join(bounds.lines())


def _flow_key(name: str) -> str:
    """A signal as a key within braces, where brackets need quotes."""
    return f'"{name}"' if "[" in name else name


def _with_comments(text: str, control_step: float) -> str:
    """The YAML with a word on keys whose reason does not show."""
    out = []
    for line in text.splitlines():
        if line.startswith("lambda:"):
            seconds = int(line.split(":")[1]) * control_step
            line = f"{line}  # control steps in a segment or window: {seconds:.3g} s"
        elif line.startswith("whole_runs:"):
            line = f"{line}  # a fit finds start states along whole runs; in contact, segments"
        elif line.startswith("start_noise:"):
            line = f"{line}  # segments start from rows as noisy as the rest"
        elif line.startswith("held_out:"):
            line = f"{line}  # runs that no fit sees"
        out.append(line)
    return "\n".join(out) + "\n"


def _scientific(value: float) -> str:
    """A number as YAML 1.1 and 1.2 read it."""
    return f"{value:.2e}"


def _round_up(value: float) -> float:
    """The next of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= 0.999 * value))


class _Bounds:
    """Search intervals of what joints and actuators may have, by the motion where there is one."""

    def __init__(
        self,
        robot: ModelJoints,
        motion: tuple[Array, Array] | None,
        control_step: float,
        settings: TextSettings,
    ):
        self._robot = robot
        self._settings = settings
        self._joints = [one for one in robot.joints.values() if one.kind in ("hinge", "slide")]
        self._inertia = np.array([numbers_of(robot.model, one).inertia for one in self._joints])
        self._forces, self._speeds = self._sizes(motion, control_step)

    def _sizes(
        self, motion: tuple[Array, Array] | None, control_step: float
    ) -> tuple[Array, Array]:
        """The size of every joint's force and speed in the data."""
        places = [joint.qvel for joint in self._joints]
        if motion is None or len(motion[0]) < 10 or not places:
            return 10.0 * self._inertia, np.ones(len(places))
        positions, velocities = (part[: self._settings.rows] for part in motion)
        accelerations = np.gradient(velocities, control_step, axis=0)
        forces = inverse_forces(self._robot.model, positions, velocities, accelerations)
        quantile = self._settings.quantile
        sizes = np.quantile(np.abs(forces[:, places]), quantile, axis=0)
        speeds = np.quantile(np.abs(velocities[:, places]), quantile, axis=0)
        return np.maximum(sizes, 1e-6), np.maximum(speeds, 0.05)

    def lines(self) -> list[str]:
        """All commented entries."""
        if not self._joints:
            return [self._mass()]
        kinds = {joint.kind for joint in self._joints}
        found = [ONE_EACH]
        for kind in sorted(kinds):
            found += self._of_kind(kind, kinds)
        found += self._gains()
        found.append(APART)
        for i, joint in enumerate(self._joints):
            found += self._of_joint(i, joint)
        for name in self._robot.actuators:
            found.append(self._gain(name))
        return [*found, self._mass(), *self._friction()]

    def _high(self, i: int) -> dict[str, float]:
        """The upper bounds of a joint."""
        own = numbers_of(self._robot.model, self._joints[i])
        force = max(self._forces[i], 0.3 * self._forces.max())
        armature = max(10 * self._inertia[i], self._inertia.max())
        highs = {
            "dof_armature": max(armature, 2 * own.armature),
            "dof_damping": max(force / self._speeds[i], 2 * own.damping),
            "dof_frictionloss": max(0.5 * force, 2 * own.friction),
        }
        return {name: _round_up(high) for name, high in highs.items()}

    def _of_kind(self, kind: str, kinds: set[str]) -> list[str]:
        """An entry for each joint of a kind, by a pattern or a list."""
        own = [i for i, joint in enumerate(self._joints) if joint.kind == kind]
        all_alike = len(self._joints) == len(self._robot.joints) and len(kinds) == 1
        listed = ", ".join(_quote(self._joints[i].name) for i in own)
        name = '"*"' if all_alike else f"[{listed}]"
        suffix = "" if len(kinds) == 1 else f"_of_{kind}s"
        lines = []
        for field, unit in self._units(self._joints[own[0]]).items():
            high = max(self._high(i)[field] for i in own)
            key = field.removeprefix("dof_") + suffix
            lines.append(_entry(key, field, name, 0, high, unit))
        return lines

    def _units(self, joint: Joint) -> dict[str, str]:
        """The units of what a joint may have."""
        return {
            "dof_armature": joint.inertia,
            "dof_damping": joint.damping,
            "dof_frictionloss": joint.force,
        }

    def _of_joint(self, i: int, joint: Joint) -> list[str]:
        """The entries of a joint."""
        lines = []
        for field, unit in self._units(joint).items():
            key = f"{joint.name}_{field.removeprefix('dof_')}"
            lines.append(_entry(key, field, _quote(joint.name), 0, self._high(i)[field], unit))
        return lines

    def _gains(self) -> list[str]:
        """One factor for the gains of all actuators of a kind."""
        kinds: dict[tuple[str, ...], list[str]] = {}
        for name in self._robot.actuators:
            kinds.setdefault(self._field(name), []).append(name)
        lines = []
        for field, names in kinds.items():
            whole = len(names) == len(self._robot.actuators)
            listed = '"*"' if whole else f"[{', '.join(map(_quote, names))}]"
            shared = ", shared: true" if len(names) > 1 else ""
            kind = "servos" if len(field) == 1 else "motors"
            key = "gain" if len(kinds) == 1 else f"gain_of_{kind}"
            lines.append(self._factor(key, field, listed, shared))
        return lines

    def _gain(self, name: str) -> str:
        """The factor on the gain of an actuator."""
        return self._factor(f"{name}_gain", self._field(name), _quote(name), "")

    def _field(self, name: str) -> tuple[str, ...]:
        """The field of an actuator's gain, and its index."""
        number = self._robot.actuators[name].id
        is_servo = servo_of(self._robot.model, number) is not None
        return ("actuator_kp",) if is_servo else ("actuator_gainprm", "index: 0, ")

    def _factor(self, key: str, field: tuple[str, ...], name: str, shared: str) -> str:
        """An entry of a factor."""
        factor = self._settings.factor
        low, high = (1 / factor, factor) if len(field) == 1 else self._settings.motor
        index = field[1] if len(field) > 1 else ""
        return (
            f"#   {_quote(key)}: {{field: {field[0]}, name: {name}, {index}target: relative"
            f"{shared}, low: {low:g}, high: {high:g}}}\n"
        )

    def _mass(self) -> str:
        """The mass of the heaviest body."""
        body, mass = self._robot.heaviest_body
        return (
            f"#   mass: {{field: body_mass, name: {_quote(body)}, low: {mass / 2:.3g}, "
            f"high: {2 * mass:.3g}, unit: kg}}\n"
        )

    def _friction(self) -> list[str]:
        """One factor on the friction of everything that a machine with a free base touches."""
        if floating_base(self._robot.model) is None:
            return []
        factor = self._settings.slippery
        return [
            '#   contact_friction: {field: geom_friction, name: "*", index: 0, target: relative, '
            f"shared: true, low: {1 / factor:.2g}, high: {factor:g}}}\n"
        ]


def _entry(key: str, field: str, name: str, low: float, high: float, unit: str) -> str:
    """A commented entry."""
    return (
        f"#   {_quote(key)}: {{field: {field}, name: {name}, low: {low:g}, high: {high:g}, "
        f"unit: {unit}}}\n"
    )


def _quote(name: str) -> str:
    """A name as YAML reads it as a text."""
    plain = name.replace("_", "").replace("-", "").replace("/", "").isalnum()
    is_word = plain and name[0].isalpha() and name.lower() not in ("null", "true", "false", "nan")
    return name if is_word else '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'
