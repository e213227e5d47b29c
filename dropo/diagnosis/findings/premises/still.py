"""Joints that never move in the data: they are held, and effects at them are listed as unknown.

Those that hardly move are named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.tables import number
from dropo.diagnosis.result import Diagnosis
from dropo.mjmodel.joints import Joint, actuators, joints
from dropo.mjmodel.robot_simulator import RobotSimulator
from dropo.simulators.mujoco.simulator import MujocoSimulator

MOVES = 1e-12
"""A column that changes by less never moves [rad, m and their derivatives]."""
ROUNDING = 1e-9
"""Readings that differ by less are the same [rad, m]."""


@dataclass(frozen=True)
class StillSettings:
    """When a joint hardly moves.

    Attributes
    ----------
    flicker : int
        One that moves over so many ticks of its encoder, or fewer, does not move beyond these.
    ticks : int
        Nor does one that moves over so many, ...
    share : float
        ... if that is less than this fraction of the largest motion of a joint of its kind.
    """

    flicker: int = 4
    ticks: int = 100
    share: float = 0.01


STILL = StillSettings()


@dataclass(frozen=True, eq=False)
class Held:
    """A problem without the columns of joints that never move, which its model holds.

    Attributes
    ----------
    came : Problem
        The problem with them.
    problem : Problem
        Without them.
    still : sequence of (Joint, float)
        The joints, and where they stay [rad, m].
    """

    came: Problem
    problem: Problem
    still: Sequence[tuple[Joint, float]]

    @property
    def sentences(self) -> tuple[str, ...]:
        """One for each joint."""
        return tuple(_sentence(joint, value) for joint, value in self.still)

    def at(self, instance: EffectInstance) -> bool:
        """Say whether an effect acts at such a joint or its drive.

        Parameters
        ----------
        instance : EffectInstance
            Any effect.

        Returns
        -------
        bool
        """
        names = {joint.name for joint, _ in self.still}
        model = self.problem.simulator.model
        drives = actuators(model)
        names |= {one.name for one in drives if one.joint is not None and one.joint.name in names}
        return instance.target in names

    def restored(self, found: Diagnosis, not_identifiable: Sequence[EffectInstance]) -> Diagnosis:
        """Return a diagnosis with a problem in which the joints are free again.

        Parameters
        ----------
        found : Diagnosis
            Of the problem that holds them.
        not_identifiable : sequence of EffectInstance
            The effects at the joints, which were not looked for.

        Returns
        -------
        Diagnosis

        Raises
        ------
        AssertionError
            If it is of another simulator than MuJoCo's, in which no joint is held.
        """
        simulator = found.problem.simulator
        came = self.came.simulator
        if not (isinstance(simulator, MujocoSimulator) and isinstance(came, MujocoSimulator)):
            raise AssertionError("only a MujocoSimulator holds joints")
        free = simulator.with_joints_of(came).observing(came.observation)
        labels = list(dict.fromkeys(one.label for one in not_identifiable))
        listed = (
            (f"Not told, since their joint never moves: {', '.join(labels)}.",) if labels else ()
        )
        return replace(
            found,
            problem=replace(self.came, simulator=free),
            undetermined=(*found.undetermined, *listed),
            warnings=(*found.warnings, *self.sentences),
        )


def _sentence(joint: Joint, value: float) -> str:
    """What is said of a joint that never moves."""
    return (
        f"The joint {joint.name!r} never moves in these data: it is taken to be held at "
        f"{number(value, 3)} {joint.length}, and nothing is told of its friction, damping, rotor "
        "and drive."
    )


def still_joints(simulator: RobotSimulator, data: Trajectories) -> list[tuple[Joint, float]]:
    """List the hinges and slides whose columns never change, and where they stay.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.
    data : Trajectories
        What was measured.

    Returns
    -------
    list of (Joint, float)
        [rad, m]
    """
    columns = simulator.layout.column_places
    rows = np.concatenate([data.observations, data.next_observations])
    found = []
    for joint in joints(simulator.model):
        place = columns.get(("qpos", joint.qpos))
        rate = columns.get(("qvel", joint.qvel))
        if place is None or np.ptp(rows[:, place]) > MOVES:
            continue
        if rate is None or np.ptp(rows[:, rate]) <= MOVES:
            found.append((joint, float(rows[0, place])))
    return found


def still_sentences(problem: Problem, settings: StillSettings = STILL) -> tuple[str, ...]:
    """Name the joints that never move in a problem's data, or hardly, a sentence each.

    Parameters
    ----------
    problem : Problem
        A robot and its data.
    settings : StillSettings, optional
        What is hardly.

    Returns
    -------
    tuple of str
    """
    simulator = problem.simulator
    if not isinstance(simulator, RobotSimulator):
        return ()
    never = [_sentence(*one) for one in still_joints(simulator, problem.trajectories)]
    return (*never, *hardly_moving_sentences(problem, settings))


def hardly_moving_sentences(problem: Problem, settings: StillSettings = STILL) -> tuple[str, ...]:
    """Name the joints that move, but hardly beyond their encoders' ticks, a sentence each.

    Parameters
    ----------
    problem, settings
        As of `still_sentences`.

    Returns
    -------
    tuple of str
    """
    simulator = problem.simulator
    if not isinstance(simulator, RobotSimulator):
        return ()
    data = problem.trajectories
    columns = simulator.layout.column_places
    rows = np.concatenate([data.observations, data.next_observations])
    positions = {
        joint: rows[:, columns["qpos", joint.qpos]]
        for joint in joints(simulator.model)
        if ("qpos", joint.qpos) in columns
    }
    largest: dict[str, float] = {}
    for joint, values in positions.items():
        largest[joint.kind] = max(largest.get(joint.kind, 0.0), float(np.ptp(values)))
    found = []
    for joint, values in positions.items():
        span = float(np.ptp(values))
        steps = np.diff(np.unique(values))
        steps = steps[steps > ROUNDING]
        if not len(steps):
            continue
        ticks = round(span / float(steps.min()))
        is_little = ticks <= settings.ticks and span <= settings.share * largest[joint.kind]
        if ticks <= settings.flicker or is_little:
            found.append(
                f"The joint {joint.name!r} hardly moves in these data: over {ticks} "
                f"tick{'s' if ticks > 1 else ''} of its encoder ({number(span, 3)} {joint.length}) "
                "in all. What is told of its friction, damping, rotor and drive is worth little: "
                "record it moving."
            )
    return tuple(found)


def hold_still(problem: Problem) -> Held | None:
    """Hold the joints that never move, and leave their columns out.

    Parameters
    ----------
    problem : Problem
        A robot and its data.

    Returns
    -------
    Held or None
        None where all joints move, or none, or where they cannot be held.
    """
    simulator = problem.simulator
    if not isinstance(simulator, MujocoSimulator):
        return None
    still = still_joints(simulator, problem.trajectories)
    if problem.held_out is not None:
        also = {joint.name: value for joint, value in still_joints(simulator, problem.held_out)}
        still = [one for one in still if also.get(one[0].name) == one[1]]
    own = {("qpos", joint.qpos) for joint, _ in still} | {
        ("qvel", joint.qvel) for joint, _ in still
    }
    columns = simulator.layout.columns
    kept = np.array(
        [i for i, one in enumerate(columns) if (one.field, one.place) not in own], dtype=np.int64
    )
    if not still or not len(kept):
        return None
    held = simulator.with_held_joints({joint.id: value for joint, value in still})
    if held is None:
        return None
    items = [f"{columns[i].field}[{columns[i].place}]" for i in kept.tolist()]
    return Held(problem, _without(problem, held.observing(items), kept), still)


def _without(problem: Problem, simulator: MujocoSimulator, kept: Ints) -> Problem:
    """A problem with some of its columns, those of the simulator."""
    names = {signal.name for signal in simulator.signals}
    old = [signal.name for signal in problem.simulator.signals]
    of_signals = [i for i, name in enumerate(old) if name in names]
    epsilon = problem.epsilon
    if epsilon is not None and np.ndim(epsilon):
        epsilon = np.asarray(epsilon, dtype=float)[of_signals]

    def narrow(data: Trajectories | None) -> Trajectories | None:
        if data is None:
            return None
        before, after = data.observations[:, kept], data.next_observations[:, kept]
        return replace(data, observations=before, next_observations=after)

    set_columns = problem.set_columns
    return replace(
        problem,
        simulator=simulator,
        trajectories=narrow(problem.trajectories) or problem.trajectories,
        held_out=narrow(problem.held_out),
        everything=narrow(problem.everything),
        epsilon=epsilon,
        set_columns=None if set_columns is None else set_columns[kept],
        estimated={name: sd for name, sd in problem.estimated.items() if name in names},
    )
