"""Sliding, simulation against simulation: an arm hits a puck so that it stops at a goal (thesis,
section 6.3.2).
"""

from functools import cache
from importlib.resources import as_file, files

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.effect import EffectInstance, Quantity, StepState
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, check_shape
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.panda.strikes import hits, rest
from dropo.simulators.mujoco.simulator import MujocoSimulator

# control steps of 4 ms: 1.5 s, in which every puck comes to rest
STEPS = 375
FRAME_SKIP = 2
TRAJECTORIES = 5
DRAWS = 60
EPSILON = 1e-2
"""K and epsilon of the thesis."""
SETTINGS = {
    "likelihood": "linear",
    "draws": DRAWS,
}  # of a fit: for 18 parameters, and K for likelihoods that draw
JOINTS = range(1, 8)
SEARCHED = (0.5, 2.0)  # of the model's own gains
TRUTH = {
    "puck_mass": 0.165,
    "friction_x": 0.35,
    "friction_y": 0.25,
    "contact_time": 0.015,
    **dict(
        zip(
            (f"kp{i}" for i in JOINTS),
            (3200.0, 2000.0, 1900.0, 1150.0, 1000.0, 400.0, 380.0),
            strict=True,
        )
    ),
    **dict(
        zip((f"kd{i}" for i in JOINTS), (95.0, 150.0, 55.0, 90.0, 28.0, 26.0, 9.0), strict=True)
    ),
}
"""The target's own numbers. It is besides uneven, and its puck is seen late and with noise."""
DELAY = 0.012  # [s] of the motion capture
NOISE = np.concatenate(
    [np.full(7, 1e-4), np.full(2, 1e-3), np.full(7, 5e-3), np.full(2, 2e-2)]
)  # sd: [rad], [m], [rad/s], [m/s]
WAVES = (
    (19.0, 7.0, 0.3),
    (-11.0, 17.0, 2.1),
    (5.0, -23.0, 4.4),
    (14.0, 15.0, 5.2),
)  # [rad/m, rad/m, rad] of the board's surface
SLOPE = 0.015  # the largest slope of each wave
GOALS = np.stack(
    np.meshgrid(np.array([-0.06, 0.0, 0.06]), np.linspace(0.16, 0.4, 4), indexing="ij"), axis=2
).reshape(12, 2)
"""(12, 2) [m] from where the puck lies, x and y."""
PUCK = slice(7, 9)  # its place among the signals


def sliding_spec() -> mujoco.MjSpec:
    """An LWR4+ in primitives with a stick, a puck, and a board: `sliding.xml`."""
    with as_file(files("dropo.problems.panda") / "sliding.xml") as path:
        return mujoco.MjSpec.from_file(str(path))


def sliding_simulator(threads: int = 0) -> MujocoSimulator:
    """18 parameters: the puck's mass, two frictions, the time constant of the hit, and 14 gains of
    the joint position controller.

    Searched in the intervals of table 6.5, but the time constant, which MuJoCo holds above two time
    steps; gains in half to twice the model's own.
    """
    parameters = [
        FieldParameter("puck_mass", 0.08, 0.2, "kg", field="body_mass", element="puck"),
        FieldParameter("friction_x", 0.2, 0.75, field="pair_friction", element="slide", index=1),
        FieldParameter("friction_y", 0.2, 0.75, field="pair_friction", element="slide", index=0),
        FieldParameter(
            "contact_time",
            0.004,
            0.02,
            "s",
            lower=0.004,
            field="pair_solref",
            element="hit",
            index=0,
        ),
        *(_gain("kp", i, "N m/rad") for i in JOINTS),
        *(_gain("kd", i, "N m s/rad") for i in JOINTS),
    ]
    observation = ["qpos[:9]", "qvel[:9]"]
    return MujocoSimulator(
        sliding_spec(), parameters, observation=observation, frame_skip=FRAME_SKIP, threads=threads
    )


def _gain(kind: str, joint: int, unit: str) -> FieldParameter:
    servo = _model().actuator(f"servo{joint}")
    own = float(servo.gainprm[0] if kind == "kp" else -servo.biasprm[2])
    field = {"kp": "actuator_kp", "kd": "actuator_kv"}[kind]
    low, high = (share * own for share in SEARCHED)
    return FieldParameter(f"{kind}{joint}", low, high, unit, field=field, element=f"servo{joint}")


@cache
def _model() -> mujoco.MjModel:
    return sliding_spec().compile()


def sliding_target(simulator: MujocoSimulator) -> MujocoSimulator:
    """The other side: the same arm over a board that is not even, its puck seen 12 ms late."""
    uneven = EffectInstance(
        "uneven_board", None, (Quantity("slope", "1", 0, 1, (SLOPE,)),), force=_downhill
    )
    delays = {
        instance.target: instance
        for instance in find("effects", "sensor_delay")(simulator.effect_context)
    }
    late = [
        (delays[signal.name], np.array([DELAY]))
        for signal in simulator.signals
        if "puck" in signal.name
    ]
    return simulator.with_effects((), [(uneven, np.array([SLOPE])), *late])


def _downhill(moment: StepState, sizes: Array) -> Array:
    """The puck's weight along the board, where the board's height is a sum of waves."""
    out = np.zeros_like(moment.qvel)
    weight = moment.model.body("puck").mass[0] * 9.81
    place = moment.qpos[:, PUCK] + moment.model.body("puck").pos[:2]
    for x, y, phase in WAVES:
        slope = sizes[0] * np.cos(place @ [x, y] + phase) / np.hypot(x, y)
        out[:, PUCK] -= weight * slope[:, None] * [x, y]
    return out


def commanded(latents: ArrayLike) -> Trajectories:
    """Hits (n, 2) as trajectories to be replayed: their commands and the start, and no
    measurements.
    """
    actions = hits(_model(), latents, STEPS, FRAME_SKIP * float(_model().opt.timestep))
    start = np.concatenate([rest(_model()), np.zeros(11)])
    rows = np.tile(start, (actions.shape[0] * STEPS, 1))
    ends = np.tile(np.arange(STEPS) == STEPS - 1, len(actions))
    return Trajectories(rows, actions.reshape(-1, 7), rows, ends)


def stops(simulator: MujocoSimulator, values: ArrayLike, latents: ArrayLike) -> Array:
    """(K, n, 2) [m] where the puck has come after n hits (n, 2), from where it lay, under K
    parameter vectors (K, d).
    """
    segments = commanded(latents).segments(STEPS)
    return simulator.predict(values, segments)[:, :, PUCK]


def record(latents: ArrayLike, rng: np.random.Generator, threads: int = 1) -> Trajectories:
    """What the target's sensors say of hits (n, 2): the start as it is known, every later row with
    noise.
    """
    simulator = sliding_simulator(threads)
    data = commanded(latents)
    check_shape("latents", latents, (None, 2), "record")
    seen = sliding_target(simulator).predict(
        [simulator.space.vector(TRUTH)], data.segments(reset="start")
    )[0]
    seen = seen + NOISE * rng.standard_normal(seen.shape)
    before = np.concatenate([data.observations[:1], seen[:-1]])
    before[np.concatenate([[True], data.terminals[:-1]])] = data.observations[0]
    return Trajectories(before, data.actions, seen, data.terminals)


def reward(distance: Array) -> Array:
    """-d^2 - log(d^2 + 0.001) of the distances [m] between puck and goal (section 6.3.1)."""
    return -(distance**2) - np.log(distance**2 + 0.001)


def sliding(threads: int = 0, seed: int = 0) -> Problem:
    """18 parameters of an arm with a stick and a puck, from five hits whose latents are standard
    normal numbers; `start` resets.
    """
    latents, noise = np.random.default_rng([65, seed]).spawn(2)
    data = record(latents.standard_normal((TRAJECTORIES, 2)), noise, threads)
    return Problem(
        "sliding", sliding_simulator(threads), data, reset="start", truth=TRUTH, settings=SETTINGS
    )
