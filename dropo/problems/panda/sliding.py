"""Sliding, simulation against simulation: an arm strikes a puck so that it stops at a goal.

The problem of the thesis' section 6.3.2.
"""

from functools import cache, lru_cache, partial
from importlib.resources import as_file, files

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.effect import EffectInstance, Quantity, StepState, instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array, check_shape
from dropo.mjmodel.bodies import body_masses, body_place
from dropo.mjmodel.dynamics.drives import servo_of
from dropo.mjmodel.fields import FieldParameter
from dropo.mjmodel.names import element_id
from dropo.mjmodel.options import physics_step
from dropo.problems.panda.strikes import rest, strikes
from dropo.simulators.mujoco.simulator import MujocoSimulator

STEPS = 375
"""Control steps of 4 ms in a strike: 1.5 s, in which every puck comes to rest."""
FRAME_SKIP = 2
TRAJECTORIES = 5
DRAWS = 60
"""K of the thesis."""
EPSILON = 1e-2
"""epsilon of the thesis."""
SETTINGS = {"likelihood": "linear", "draws": DRAWS}
"""Settings of a fit: a likelihood for 18 parameters, and K for likelihoods that draw."""
JOINTS = range(1, 8)
SEARCHED = (0.5, 2.0)  # searched interval of the gains, in the model's own ones
STIFFNESS = (3200.0, 2000.0, 1900.0, 1150.0, 1000.0, 400.0, 380.0)  # [N m/rad] by joint
DAMPING = (95.0, 150.0, 55.0, 90.0, 28.0, 26.0, 9.0)  # [N m s/rad] by joint
TRUTH = {
    "puck_mass": 0.165,
    "friction_x": 0.35,
    "friction_y": 0.25,
    "contact_time": 0.015,
    **{f"kp{i}": gain for i, gain in zip(JOINTS, STIFFNESS, strict=True)},
    **{f"kd{i}": gain for i, gain in zip(JOINTS, DAMPING, strict=True)},
}
"""The target's own numbers. Besides, it is uneven, and its puck is measured late and with noise."""
DELAY = 0.012  # [s] of the motion capture
NOISE = np.concatenate([np.full(7, 1e-4), np.full(2, 1e-3), np.full(7, 5e-3), np.full(2, 2e-2)])
"""Standard deviations of the sensors' noise: 7 in rad, 2 in m, 7 in rad/s, 2 in m/s."""
WAVES = ((19.0, 7.0, 0.3), (-11.0, 17.0, 2.1), (5.0, -23.0, 4.4), (14.0, 15.0, 5.2))
"""Waves of the board's surface: wave numbers along x and y [rad/m], phase [rad]."""
SLOPE = 0.015  # the largest slope of each wave
_GOALS_X = np.array([-0.06, 0.0, 0.06])
_GOALS_Y = np.linspace(0.16, 0.4, 4)
GOALS = np.stack(np.meshgrid(_GOALS_X, _GOALS_Y, indexing="ij"), axis=2).reshape(12, 2)
"""Goals (12, 2) [m] from where the puck lies, x and y."""
PUCK = slice(7, 9)  # the puck's place among the signals


def sliding_spec() -> mujoco.MjSpec:
    """An LWR4+ in primitives with a stick, a puck, and a board: `sliding.xml`.

    Returns
    -------
    MjSpec
        Of `sliding.xml`.
    """
    with as_file(files("dropo.problems.panda") / "sliding.xml") as path:
        return mujoco.MjSpec.from_file(str(path))


def sliding_simulator(threads: int = 0) -> MujocoSimulator:
    """The simulator of sliding with its 18 parameters.

    They are the puck's mass, two frictions, the time constant of the contact with the blade, and 14
    gains of the joint position controller. The intervals are those of table 6.5, except for the
    time constant, which MuJoCo holds above two time steps; gains are searched in half to twice the
    model's own.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    MujocoSimulator
    """
    contact_time = FieldParameter(
        "contact_time", 0.004, 0.02, "s", lower=0.004, field="pair_solref", element="hit", index=0
    )
    parameters = [
        FieldParameter("puck_mass", 0.08, 0.2, "kg", field="body_mass", element="puck"),
        FieldParameter("friction_x", 0.2, 0.75, field="pair_friction", element="slide", index=1),
        FieldParameter("friction_y", 0.2, 0.75, field="pair_friction", element="slide", index=0),
        contact_time,
        *(_gain("kp", i, "N m/rad") for i in JOINTS),
        *(_gain("kd", i, "N m s/rad") for i in JOINTS),
    ]
    observation = ["qpos[:9]", "qvel[:9]"]
    return MujocoSimulator(
        sliding_spec(), parameters, observation=observation, frame_skip=FRAME_SKIP, threads=threads
    )


def _gain(kind: str, joint: int, unit: str) -> FieldParameter:
    """The gain "kp" or "kd" of a joint's controller as a parameter."""
    name = f"servo{joint}"
    servo = servo_of(_model(), element_id(_model(), "actuator", name))
    assert servo is not None
    own = servo.kp if kind == "kp" else servo.kv
    field = {"kp": "actuator_kp", "kd": "actuator_kv"}[kind]
    low = SEARCHED[0] * own
    high = SEARCHED[1] * own
    return FieldParameter(f"{kind}{joint}", low, high, unit, field=field, element=name)


@cache
def _model() -> mujoco.MjModel:
    """The compiled model of `sliding_spec`."""
    return sliding_spec().compile()


def sliding_target(simulator: MujocoSimulator) -> MujocoSimulator:
    """The target: the same arm over an uneven board, with its puck measured 12 ms late.

    Parameters
    ----------
    simulator : MujocoSimulator
        The simulator of sliding.

    Returns
    -------
    MujocoSimulator
        With the effects that no parameter stands for.
    """
    puck = element_id(simulator.model, "body", "puck")
    slope = Quantity("slope", "1", 0, 1, (SLOPE,))
    uneven = EffectInstance("uneven_board", None, (slope,), force=partial(_downhill, puck))
    effects = [(uneven, np.array([SLOPE]))]
    delays = {
        instance.target: instance
        for instance in instances_of(simulator.effect_context, "sensor_delay")
    }
    for signal in simulator.signals:
        if "puck" in signal.name:
            effects.append((delays[signal.name], np.array([DELAY])))
    return simulator.with_effects((), effects)


def _downhill(puck: int, state: StepState, magnitudes: Array) -> Array:
    """The puck's weight along the board, where the board's height is a sum of waves."""
    out = np.zeros_like(state.qvel)
    weight = body_masses(state.model)[puck] * 9.81
    place = state.qpos[:, PUCK] + body_place(state.model, puck)[:2]
    for x, y, phase in WAVES:
        slope = magnitudes[0] * np.cos(place @ [x, y] + phase) / np.hypot(x, y)
        out[:, PUCK] -= weight * slope[:, None] * [x, y]
    return out


def commanded(latents: ArrayLike) -> Trajectories:
    """Strikes as trajectories to be replayed: their commands and start, without measurements.

    Parameters
    ----------
    latents : (n, 2) array
        Latents of speed and direction.

    Returns
    -------
    Trajectories
        n trajectories of 375 control steps, whose observations all are the start.

    Raises
    ------
    BadArgument
        If `latents` are not of the shape (n, 2).
    """
    model = _model()
    actions = strikes(model, latents, STEPS, FRAME_SKIP * physics_step(model))
    start = np.concatenate([rest(model), np.zeros(11)])
    rows = np.tile(start, (actions.shape[0] * STEPS, 1))
    ends = np.tile(np.arange(STEPS) == STEPS - 1, len(actions))
    return Trajectories(rows, actions.reshape(-1, 7), rows, ends)


def stops(simulator: MujocoSimulator, values: ArrayLike, latents: ArrayLike) -> Array:
    """Where the puck has come after strikes.

    Parameters
    ----------
    simulator : MujocoSimulator
        A simulator of sliding.
    values : (K, d) array
        Parameter vectors.
    latents : (n, 2) array
        Latents of speed and direction.

    Returns
    -------
    (K, n, 2) array
        Places from where the puck lay [m].

    Raises
    ------
    BadArgument
        If `latents` are not of the shape (n, 2).
    """
    segments = commanded(latents).segments(STEPS)
    return simulator.predict(values, segments)[:, :, PUCK]


def record(latents: ArrayLike, rng: np.random.Generator, threads: int = 1) -> Trajectories:
    """What the target's sensors measure of strikes.

    Parameters
    ----------
    latents : (n, 2) array
        Latents of speed and direction.
    rng : numpy.random.Generator
        Source of the sensors' noise.
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Trajectories
        n trajectories: the start as it is known, every later row with noise.

    Raises
    ------
    BadArgument
        If `latents` are not of the shape (n, 2).
    """
    latents = np.asarray(latents, dtype=float)
    check_shape("latents", latents, (None, 2), "record")
    simulator = sliding_simulator(threads)
    data = commanded(latents)
    truth = simulator.space.vector(TRUTH)
    true_rows = sliding_target(simulator).predict([truth], data.segments(reset="start"))[0]
    measured = true_rows + NOISE * rng.standard_normal(true_rows.shape)
    # A row's observation is the end of the row before it, or the start of its trajectory.
    before = np.concatenate([data.observations[:1], measured[:-1]])
    firsts = np.concatenate([[True], data.terminals[:-1]])
    before[firsts] = data.observations[0]
    return Trajectories(before, data.actions, measured, data.terminals)


def reward(distance: Array) -> Array:
    """The thesis' reward of distances between puck and goal (section 6.3.1).

    Parameters
    ----------
    distance : array
        Distances d [m].

    Returns
    -------
    array
        -d^2 - log(d^2 + 0.001), of the same shape.
    """
    return -(distance**2) - np.log(distance**2 + 0.001)


def sliding(threads: int = 0, seed: int = 0) -> Problem:
    """18 parameters of an arm with a stick and a puck, from five strikes.

    The strikes' latents are standard normal numbers; whole trajectories are replayed from their
    start.

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
    return Problem(
        "sliding",
        sliding_simulator(threads),
        _data(seed),
        reset="start",
        truth=TRUTH,
        settings=SETTINGS,
    )


@lru_cache(maxsize=4)
def _data(seed: int) -> Trajectories:
    """The problem's data; a study asks for each set with every method."""
    latents_rng, noise_rng = np.random.default_rng([65, seed]).spawn(2)
    return record(latents_rng.standard_normal((TRAJECTORIES, 2)), noise_rng)
