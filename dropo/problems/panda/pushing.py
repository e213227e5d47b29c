"""Pushing, simulation against simulation: an arm pushes a box whose centre of mass is beside its
middle (thesis, section 6.3.3).
"""

from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import FieldParameter
from dropo.mjmodel.loading import load_model
from dropo.mjmodel.observation import exponential, multiply
from dropo.problems.panda.pusher import BOX, drive
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.simulators.mujoco.worker import Worker

FRAME_SKIP = 2  # physics steps of 5 ms
STEPS = 1050  # transitions of 10 ms, as in the thesis
LENGTH = 10
DRAWS = 50
EPSILON = 1e-4
"""lambda, K and epsilon of the thesis."""
SETTINGS = {
    "likelihood": "linear",
    "draws": DRAWS,
}  # of a fit: a quarter of the steps of the emulated one, and K for those that draw
NAMES = ("box_mass", "friction_x", "friction_y", "com_x", "com_y")
TRUTH = dict(zip(NAMES, (1.1, 0.45, 0.6, 0.0, 0.03), strict=True))
"""The target's own numbers; its box has another inertia besides, and its arm other gains."""
# [kg] of the box without its bolts, [m] of the bolts above its middle
SHELL = 0.3
HEIGHT = -0.02
GAINS = (0.85, 1.1, 0.9, 1.15, 0.9, 1.1, 0.85)  # the target's, as shares of the model's
PLACE_NOISE = (
    5e-4,
    5e-4,
    2e-5,
    5e-5,
    5e-5,
    2e-3,
)  # sd [m, rad]; a box on a table hardly tilts, so that is averaged
SPEED_NOISE = (5e-3, 5e-3, 5e-4, 1e-3, 1e-3, 2e-2)  # [m/s, rad/s]
NOISE = np.array([*(1e-4,) * 7, *PLACE_NOISE, *(2e-3,) * 7, *SPEED_NOISE])  # sd of every signal
OFFSETS = (
    0.055,
    0.0,
    0.06,
    0.01,
    0.045,
    -0.01,
)  # [m] beside the box' middle, where it is pushed while the data are collected
# [m/s] forward, by hand and by a policy
GUIDED = 0.06
PUSHED = 0.1
GOAL = 0.24  # [m] ahead


def pushing_spec() -> mujoco.MjSpec:
    """A Panda in primitives with a pin for a hand, a box and a table: `pushing.xml`."""
    with as_file(files("dropo.problems.panda") / "pushing.xml") as path:
        return mujoco.MjSpec.from_file(str(path))


def pushing_simulator(threads: int = 0) -> MujocoSimulator:
    """Five parameters, as in table 6.6; the centre of mass is looked for within 5 cm of the middle,
    so that no bound is near 3 cm.

    It moves alone: the inertia about it stays, and MuJoCo's derived constants follow.
    """
    parameters = [
        FieldParameter("box_mass", 0.08, 2.0, "kg", field="body_mass", element="box"),
        FieldParameter("friction_x", 0.2, 2.0, field="pair_friction", element="drag", index=1),
        FieldParameter("friction_y", 0.2, 2.0, field="pair_friction", element="drag", index=0),
        *(
            FieldParameter(
                f"com_{axis}",
                -0.05,
                0.05,
                "m",
                lower=-0.09,
                upper=0.09,
                field="body_ipos",
                element="box",
                index=i,
            )
            for i, axis in enumerate("xy")
        ),
    ]
    return MujocoSimulator(pushing_spec(), parameters, frame_skip=FRAME_SKIP, threads=threads)


@cache
def target_model() -> mujoco.MjModel:
    """The other side: a light box with bolts at one side, which move its centre of mass by 3 cm,
    and an arm with other gains.
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
    for i, share in enumerate(GAINS, 1):
        servo = spec.actuator(f"servo{i}")
        servo.gainprm[0] *= share
        servo.biasprm[1:3] *= share
    return load_model(spec)


def pushing(threads: int = 0, seed: int = 0) -> Problem:
    """Mass, two frictions and the centre of mass of a box, from ten seconds of pushing it about;
    `partial` resets of the box, lambda 10.
    """
    simulator = pushing_simulator(threads)
    box = simulator.layout.places_of(["qpos.box", "qvel.box"], simulator.model)
    data = record(np.random.default_rng([66, seed]))
    return Problem(
        "pushing",
        simulator,
        data,
        length=LENGTH,
        reset="partial",
        set_columns=box,
        truth=TRUTH,
        settings=SETTINGS,
    )


# The data


def guided(boxes: Array, pins: Array, ids: Ints, step: int) -> Array:
    """A hand that pushes the box forward six times at OFFSETS beside its middle, going back
    between.
    """
    push, gone = divmod(step, STEPS // len(OFFSETS))
    ahead, aside = _axes(boxes)
    to_place = boxes[:, :2] + OFFSETS[push] * aside - pins
    if 0.35 <= gone / (STEPS // len(OFFSETS)) <= 0.85:
        return GUIDED * ahead + 2.0 * np.sum(to_place * aside, axis=1, keepdims=True) * aside
    return 4.0 * (to_place - 0.14 * ahead)


def _axes(boxes: Array) -> tuple[Array, Array]:
    """The boxes' own x and y axes (m, 2)."""
    cos = np.cos(boxes[:, 2])
    sin = np.sin(boxes[:, 2])
    return np.stack([cos, sin], axis=1), np.stack([-sin, cos], axis=1)


def record(rng: np.random.Generator) -> Trajectories:
    """1050 transitions of the target, one trajectory: what its sensors say while its box is pushed
    about, and the angles commanded.
    """
    runs = drive(target_model(), guided, np.zeros((1, 3)), STEPS, frame_skip=FRAME_SKIP, rng=rng)
    seen = measured(runs.states[0], rng)
    return Trajectories(seen[:-1], runs.actions[0], seen[1:], np.arange(STEPS) == STEPS - 1)


def measured(states: Array, rng: np.random.Generator) -> Array:
    """States (n, nq + nv) with the sensors' noise; a turned quaternion stays one."""
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
    """n policies of four numbers (n, 4), one an arm: where to push, and when to stop.

    The pin goes forward, along the box' side to `aim` [m] beside its middle + `by_turn` [m] times
    its turn [rad] + `by_side` times how far it has moved aside [m]; it slows down as the box comes
    within reach of a point `short` [m] before the goal.
    """

    numbers: Array
    start: Array

    def __call__(self, boxes: Array, pins: Array, ids: Ints, step: int) -> Array:
        aim, by_turn, by_side, short = self.numbers[ids].T
        ahead, aside = _axes(boxes)
        place = aim + by_turn * boxes[:, 2] + by_side * (boxes[:, 1] - self.start[1])
        off = np.sum((boxes[:, :2] - pins) * aside, axis=1) + np.clip(place, -0.08, 0.08)
        forward = np.clip(3.0 * (self.start[0] + GOAL - short - boxes[:, 0]), 0.0, PUSHED)
        return forward[:, None] * ahead + 4.0 * off[:, None] * aside


def fields_of(simulator: MujocoSimulator, values: Array) -> tuple[mujoco.MjModel, dict[str, Array]]:
    """Parameter vectors (n, d) for `closed_loop`: a model, and every field (n, 1, ...) of it that
    they change, derived ones too.
    """
    worker = Worker(simulator.model, simulator.bindings)
    made: dict[str, list[Array]] = {
        name: []
        for name in sorted(MODEL_FIELDS)
        if isinstance(getattr(simulator.model, name, None), np.ndarray)
    }
    for value in values:
        worker.set(value)
        for name, arrays in made.items():
            arrays.append(getattr(worker.model, name).copy())
    fields = {name: np.stack(arrays)[:, None] for name, arrays in made.items()}
    return worker.model, {
        name: array
        for name, array in fields.items()
        if (array != getattr(worker.model, name)).any()
    }
