"""Pushing, simulation against simulation: an arm pushes a box whose centre of mass is off centre.

The problem of the thesis' section 6.3.3.
"""

from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import FieldParameter
from dropo.mjmodel.files.loading import load_model
from dropo.mjmodel.observation import exponential, multiply
from dropo.problems.panda.pusher import BOX, drive
from dropo.simulators.mujoco.simulator import MujocoSimulator

FRAME_SKIP = 2  # physics steps of 5 ms
STEPS = 1050  # transitions of 10 ms, as in the thesis
HORIZON = 10
"""lambda of the thesis, in control steps."""
DRAWS = 50
"""K of the thesis."""
EPSILON = 1e-4
"""epsilon of the thesis."""
SETTINGS = {"likelihood": "linear", "draws": DRAWS}
"""Settings of a fit: the linear likelihood takes a quarter of the emulated one's steps; K is for
likelihoods that draw.
"""
NAMES = ("box_mass", "friction_x", "friction_y", "com_x", "com_y")
TRUTH = dict(zip(NAMES, (1.1, 0.45, 0.6, 0.0, 0.03), strict=True))
"""The target's own numbers; besides, its box has another inertia, and its arm other gains."""
SHELL = 0.3  # [kg] of the box without its bolts
HEIGHT = -0.02  # [m] of the bolts above the box' middle
GAINS = (0.85, 1.1, 0.9, 1.15, 0.9, 1.1, 0.85)  # the target's, in the model's own ones
PLACE_NOISE = (5e-4, 5e-4, 2e-5, 5e-5, 5e-5, 2e-3)
"""Standard deviations of the box' place [m] and turn [rad]; a box on a table hardly tilts, so its
height and tilt are averaged.
"""
SPEED_NOISE = (5e-3, 5e-3, 5e-4, 1e-3, 1e-3, 2e-2)
"""Standard deviations of the box' velocity [m/s] and angular velocity [rad/s]."""
NOISE = np.array([*(1e-4,) * 7, *PLACE_NOISE, *(2e-3,) * 7, *SPEED_NOISE])
"""Standard deviation of the noise on every signal, a turn counting 3 numbers."""
OFFSETS = (0.055, 0.0, 0.06, 0.01, 0.045, -0.01)
"""Where the box is pushed while data are collected, beside its middle [m]."""
GUIDED = 0.06  # [m/s] forward while data are collected
PUSHED = 0.1  # [m/s] forward by a policy
GOAL = 0.24  # [m] ahead


def pushing_spec() -> mujoco.MjSpec:
    """A Panda in primitives with a pin for a hand, a box and a table: `pushing.xml`.

    Returns
    -------
    MjSpec
        Of `pushing.xml`.
    """
    with as_file(files("dropo.problems.panda") / "pushing.xml") as path:
        return mujoco.MjSpec.from_file(str(path))


def pushing_simulator(threads: int = 0) -> MujocoSimulator:
    """The simulator of pushing with five parameters, as in table 6.6.

    The centre of mass is searched within 5 cm of the middle, so that no bound is near 3 cm. It
    moves alone: the inertia about it stays, and MuJoCo's derived constants follow.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    MujocoSimulator
    """
    parameters = [
        FieldParameter("box_mass", 0.08, 2.0, "kg", field="body_mass", element="box"),
        FieldParameter("friction_x", 0.2, 2.0, field="pair_friction", element="drag", index=1),
        FieldParameter("friction_y", 0.2, 2.0, field="pair_friction", element="drag", index=0),
        _centre_of_mass("com_x", 0),
        _centre_of_mass("com_y", 1),
    ]
    return MujocoSimulator(pushing_spec(), parameters, frame_skip=FRAME_SKIP, threads=threads)


def _centre_of_mass(name: str, index: int) -> FieldParameter:
    """One coordinate of the box' centre of mass as a parameter."""
    return FieldParameter(
        name,
        -0.05,
        0.05,
        "m",
        lower=-0.09,
        upper=0.09,
        field="body_ipos",
        element="box",
        index=index,
    )


@cache
def target_model() -> mujoco.MjModel:
    """Compile the model of the target.

    The bolts move the box' centre of mass by 3 cm.

    Returns
    -------
    MjModel
        A light box with bolts at one side, and an arm with other gains.
    """
    spec = pushing_spec()
    spec.geom("box").mass = SHELL
    bolts = TRUTH["box_mass"] - SHELL
    beside = TRUTH["com_y"] * TRUTH["box_mass"] / bolts
    spec.body("box").add_geom(
        name="bolts",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[0.06, 0.02, 0.02],
        pos=[0, beside, HEIGHT],
        mass=bolts,
    )
    for number, friction in enumerate((TRUTH["friction_y"], TRUTH["friction_x"])):
        spec.pair("drag").friction[number] = friction
    for i, factor in enumerate(GAINS, 1):
        servo = spec.actuator(f"servo{i}")
        servo.gainprm[0] *= factor
        servo.biasprm[1:3] *= factor
    return load_model(spec)


def pushing(threads: int = 0, seed: int = 0) -> Problem:
    """Mass, two frictions and centre of mass of a box, from ten seconds of pushing it about.

    The box alone is reset to its measured state every 10 control steps (`partial` resets).

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.
    seed : int
        Seed of the data.

    Returns
    -------
    Problem
        With its truth.
    """
    simulator = pushing_simulator(threads)
    box = simulator.layout.places_of(["qpos.box", "qvel.box"], simulator.model)
    data = record(np.random.default_rng([66, seed]))
    return Problem(
        "pushing",
        simulator,
        data,
        horizon=HORIZON,
        reset="partial",
        set_columns=box,
        truth=TRUTH,
        settings=SETTINGS,
    )


# The data


def guided(boxes: Array, pins: Array, ids: Ints, step: int) -> Array:
    """The pushing policy that collects the data.

    It pushes the box forward six times at `OFFSETS` beside its middle, going back in between.

    Parameters
    ----------
    boxes : (m, 3) array
        x [m], y [m] and turn [rad] of the boxes.
    pins : (m, 2) array
        Places of the pins [m].
    ids : (m,) int array
        Which arms these are; all are guided alike.
    step : int
        Number of the control step, from 0.

    Returns
    -------
    (m, 2) array
        Wanted velocities of the pins [m/s].
    """
    duration = STEPS // len(OFFSETS)
    push, elapsed = divmod(step, duration)
    ahead, aside = _axes(boxes)
    to_place = boxes[:, :2] + OFFSETS[push] * aside - pins
    if 0.35 <= elapsed / duration <= 0.85:
        return GUIDED * ahead + 2.0 * np.sum(to_place * aside, axis=1, keepdims=True) * aside
    return 4.0 * (to_place - 0.14 * ahead)


def _axes(boxes: Array) -> tuple[Array, Array]:
    """The boxes' own x and y axes (m, 2)."""
    cos = np.cos(boxes[:, 2])
    sin = np.sin(boxes[:, 2])
    return np.stack([cos, sin], axis=1), np.stack([-sin, cos], axis=1)


def record(rng: np.random.Generator) -> Trajectories:
    """What the target's sensors measure while its box is pushed about.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the sensors' noise.

    Returns
    -------
    Trajectories
        One trajectory of 1050 transitions; its actions are the joint angles commanded [rad].
    """
    runs = drive(target_model(), guided, np.zeros((1, 3)), STEPS, frame_skip=FRAME_SKIP, rng=rng)
    rows = measured(runs.states[0], rng)
    return Trajectories(rows[:-1], runs.actions[0], rows[1:], np.arange(STEPS) == STEPS - 1)


def measured(states: Array, rng: np.random.Generator) -> Array:
    """States with the sensors' noise.

    Parameters
    ----------
    states : (n, nq + nv) array
        True states.
    rng : numpy.random.Generator
        Source of the noise.

    Returns
    -------
    (n, nq + nv) array
        Measured states; the box' quaternion is turned, so that it stays a unit one.
    """
    noise = NOISE * rng.standard_normal((len(states), len(NOISE)))
    turn = slice(BOX + 3, BOX + 6)
    quaternion = slice(BOX + 3, BOX + 7)
    plain = np.delete(np.arange(states.shape[1]), quaternion)
    out = states.copy()
    out[:, plain] += np.delete(noise, turn, axis=1)
    out[:, quaternion] = multiply(states[:, quaternion], exponential(noise[:, turn]))
    return out


# Policies


@dataclass(frozen=True, eq=False)
class Pusher:
    """n pushing policies of four numbers, one an arm: where to push, and when to stop.

    The pin goes forward along the box' side, at `aim` [m] beside its middle + `by_turn` [m] times
    the box' turn [rad] + `by_side` times how far the box has moved aside [m]. It slows down as the
    box comes near a point `short` [m] before the goal.

    Attributes
    ----------
    numbers : (n, 4) array
        `aim`, `by_turn`, `by_side` and `short` of each arm's policy.
    start : (2,) array
        Where the box stands in the model [m].
    """

    numbers: Array
    start: Array

    def __call__(self, boxes: Array, pins: Array, ids: Ints, step: int) -> Array:
        """Wanted velocities (m, 2) [m/s] of the pins, as a `PushingPolicy`."""
        aim, by_turn, by_side, short = self.numbers[ids].T
        ahead, aside = _axes(boxes)
        place = aim + by_turn * boxes[:, 2] + by_side * (boxes[:, 1] - self.start[1])
        off = np.sum((boxes[:, :2] - pins) * aside, axis=1) + np.clip(place, -0.08, 0.08)
        forward = np.clip(3.0 * (self.start[0] + GOAL - short - boxes[:, 0]), 0.0, PUSHED)
        return forward[:, None] * ahead + 4.0 * off[:, None] * aside
