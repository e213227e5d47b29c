"""Problems of 4, 18 and 100 parameters, with any number of transitions: the hopper's masses, all of
the hopper, a chain of 20 links; a block on a spring, which is cheap to simulate; a humanoid of 29
joints; and a quadruped of 12.
"""

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.hopper.data import simulate
from dropo.problems.hopper.model import BODIES, FRAME_SKIP, hopper_spec
from dropo.problems.hopper.problem import NOISE, hopper_problem
from dropo.problems.simulated.example_quadruped import MODEL as QUADRUPED
from dropo.problems.simulated.example_quadruped import STANCE
from dropo.simulators.mujoco.simulator import MujocoSimulator

JOINTS = ("thigh", "leg", "foot")
LINKS = 20
SEEN = range(0, LINKS, 4)  # joints of the chain that have sensors; the others start at rest
# factors on the model's own numbers
LOW = 0.6
HIGH = 1.6


def problem_of(parameters: int, transitions: int, threads: int) -> Problem:
    """The problem of so many parameters, noise of variance 1e-5 on its next observations."""
    if parameters == 100:
        return chain_problem(transitions, threads)
    data, _ = simulate(
        min(500, transitions // 2),
        -(-transitions // min(500, transitions // 2)),
        rng=0,
        noise_variance=NOISE,
    )
    if parameters == 4:
        return hopper_problem("hopper, 4", data.head(transitions), NOISE, threads)
    return Problem(
        "hopper, 18",
        hopper_with_18(threads),
        data.head(transitions),
        epsilon=NOISE,
        truth=ones(hopper_with_18(1)),
    )


def ones(simulator: MujocoSimulator) -> dict[str, float]:
    """The truth of relative parameters."""
    return dict.fromkeys(simulator.space.names, 1.0)


def factor(field: str, element: str, index: int | None = None) -> FieldParameter:
    """A factor on a number of the model, or on a whole row."""
    return FieldParameter(
        f"{field}.{element}", LOW, HIGH, field=field, element=element, index=index, relative=True
    )


def hopper_with_18(threads: int) -> MujocoSimulator:
    """Masses and inertias of the four bodies, damping and armature of the three joints, gears of
    two (one is known, else all forces and inertias could be larger by one factor), the foot's
    sliding friction and the time constant of its contact.
    """
    bodies = [factor(field, body) for field in ("body_mass", "body_inertia") for body in BODIES]
    joints = [
        factor(field, f"{joint}_joint")
        for field in ("dof_damping", "dof_armature")
        for joint in JOINTS
    ]
    model = hopper_spec()
    for i, motor in enumerate(model.actuators):
        motor.name = motor.name or f"motor{i}"
    gears = [factor("actuator_gear", motor.name, 0) for motor in list(model.actuators)[1:]]
    contact = [factor("geom_friction", "foot_geom", 0), factor("geom_solref", "foot_geom", 0)]
    return MujocoSimulator(
        model,
        [*bodies, *joints, *gears, *contact],
        observation=["qpos[1:]", "qvel"],
        frame_skip=FRAME_SKIP,
        threads=threads,
    )


def chain_spec() -> mujoco.MjSpec:
    """A hanging chain of 20 links in a plane, with springs, dampers and a motor at every joint."""
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.002
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    body = spec.worldbody
    for i in range(LINKS):
        body = body.add_body(name=f"link{i}", pos=[0, 0, -0.1 if i else 0])
        body.add_joint(
            name=f"joint{i}", axis=[0, 1, 0], damping=0.05, armature=0.002, stiffness=0.5
        )
        shape = {
            "type": mujoco.mjtGeom.mjGEOM_CAPSULE,
            "fromto": [0, 0, 0, 0, 0, -0.1],
            "size": [0.02, 0, 0],
        }
        body.add_geom(mass=0.1 + 0.01 * i, contype=0, conaffinity=0, **shape)
        spec.add_actuator(name=f"motor{i}", target=f"joint{i}", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    return spec


def chain_simulator(threads: int) -> MujocoSimulator:
    """Mass and inertia of every link, damping, armature, stiffness of every joint: 100 factors."""
    places = (
        ("body_mass", "link"),
        ("body_inertia", "link"),
        ("dof_damping", "joint"),
        ("dof_armature", "joint"),
        ("jnt_stiffness", "joint"),
    )
    parameters = [factor(field, f"{element}{i}") for field, element in places for i in range(LINKS)]
    observation = [f"{field}.joint{i}" for field in ("qpos", "qvel") for i in SEEN]
    return MujocoSimulator(
        chain_spec(), parameters, observation=observation, frame_skip=FRAME_SKIP, threads=threads
    )


def chain_problem(transitions: int, threads: int) -> Problem:
    """Every transition from a state of its own, under torques of its own."""
    rng = np.random.default_rng(0)
    simulator = chain_simulator(threads)
    states = rng.normal(0, [0.3] * len(SEEN) + [2.0] * len(SEEN), (transitions, 2 * len(SEEN)))
    ends = np.ones(transitions, dtype=bool)
    blank = Trajectories(states, rng.normal(0, 0.5, (transitions, LINKS)), states, ends)
    after = simulator.predict(np.ones((1, 5 * LINKS)), blank.segments())[0]
    noisy = after + np.sqrt(NOISE) * rng.standard_normal(after.shape)
    data = Trajectories(states, blank.actions, noisy, ends)
    return Problem("chain, 100", simulator, data, epsilon=NOISE, truth=ones(simulator))


def block_simulator(threads: int) -> MujocoSimulator:
    """A block that slides on a rail, on a spring: mass, damping, stiffness, place of rest."""
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.01
    body = spec.worldbody.add_body(name="block")
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    body.add_joint(name="rail", type=slide, axis=[1, 0, 0], damping=1.0, stiffness=20.0)
    size = [0.1, 0.1, 0.1]
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size, mass=1.5, contype=0, conaffinity=0)
    spec.add_actuator(name="push", target="rail", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    fields = (("body_mass", "block"), ("dof_damping", "rail"), ("jnt_stiffness", "rail"))
    parameters = [factor(field, element) for field, element in fields]
    rest = FieldParameter("rest", -0.5, 0.5, field="qpos_spring", index=0, unit="m")
    return MujocoSimulator(
        spec, [*parameters, rest], observation=["qpos", "qvel"], frame_skip=2, threads=threads
    )


def block_problem(transitions: int, threads: int) -> Problem:
    """Transitions of the block from states all over, in 500 to a trajectory."""
    rng = np.random.default_rng(0)
    simulator = block_simulator(threads)
    truth = np.array([1.0, 1.0, 1.0, 0.1])
    states = rng.normal(0, [0.3, 1.0], (transitions, 2))
    ends = np.arange(transitions) % 500 == 499
    ends[-1] = True
    blank = Trajectories(states, rng.normal(0, 5.0, (transitions, 1)), states, ends)
    after = simulator.predict(truth[None], blank.segments())[0]
    after += np.sqrt(NOISE) * rng.standard_normal(after.shape)
    data = Trajectories(states, blank.actions, after, ends)
    names = simulator.space.names
    return Problem(
        "block, 4", simulator, data, epsilon=NOISE, truth=dict(zip(names, truth, strict=True))
    )


LIMB = ((0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 1, 0), (0, 0, 1), (0, 1, 0), (1, 0, 0))
"""Axes of the joints of an arm, from the shoulder on; a leg has the first six."""


def humanoid_spec() -> mujoco.MjSpec:
    """A body on the ground with a waist of 3 joints, two arms of 7 and two legs of 6, of capsules,
    with a servo at every joint.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.002
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(name="floor", type=plane, size=[10, 10, 1])
    pelvis = spec.worldbody.add_body(name="pelvis", pos=[0, 0, 0.85])
    pelvis.add_freejoint()
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    pelvis.add_geom(type=sphere, size=[0.1, 0, 0], mass=5.0)
    torso = _limb(spec, pelvis, "waist", LIMB[:3], [0, 0, 0.1], 0.12, 3.0)
    for side, y in (("left", 1), ("right", -1)):
        _limb(spec, torso, f"{side}_arm", LIMB, [0, 0.2 * y, 0.1], -0.08, 0.5)
        _limb(spec, pelvis, f"{side}_leg", LIMB[:6], [0, 0.1 * y, -0.1], -0.12, 1.0)
    return spec


def _limb(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    axes: tuple[tuple[int, int, int], ...],
    place: list[float],
    length: float,
    mass: float,
) -> mujoco.MjsBody:
    """Joints one after another, a link along z behind each; the last body. Only it touches."""
    for i, axis in enumerate(axes):
        last = i == len(axes) - 1
        body = body.add_body(name=f"{name}{i}", pos=place if i == 0 else [0, 0, length])
        joint = f"{name}{i}"
        body.add_joint(name=joint, axis=axis, damping=1.0, armature=0.02)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[0, 0, 0, 0, 0, length],
            size=[0.04, 0, 0],
            mass=mass,
            contype=int(last),
            conaffinity=0,
        )
        servo = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=100.0)
    return body


def humanoid_problem(transitions: int, threads: int) -> Problem:
    """The humanoid around its upright pose."""
    bodies = ("pelvis", "waist2", "left_leg2", "right_arm3")
    return _standing("humanoid, 29 joints", humanoid_spec(), bodies, 0.0, transitions, threads)


def quadruped_problem(transitions: int, threads: int) -> Problem:
    """The quadruped of docs/legged.md around its stance."""
    spec = mujoco.MjSpec.from_string(QUADRUPED)
    model = spec.compile()
    bodies = tuple(model.body(i).name for i in (1, 2, 3, 4))
    stance = np.tile(STANCE, 4)
    return _standing("quadruped, 12 joints", spec, bodies, stance, transitions, threads)


def _standing(
    name: str,
    spec: mujoco.MjSpec,
    bodies: tuple[str, ...],
    pose: float | np.ndarray,
    transitions: int,
    threads: int,
) -> Problem:
    """Transitions from states around a pose of the joints, under targets near by; 4 masses."""
    rng = np.random.default_rng(0)
    parameters = [factor("body_mass", body) for body in bodies]
    simulator = MujocoSimulator(spec, parameters, frame_skip=FRAME_SKIP, threads=threads)
    model = simulator.model
    still = np.concatenate([model.qpos0, np.zeros(model.nv)])
    still[7 : model.nq] = pose
    states = np.repeat(still[None], transitions, axis=0)
    states[:, 7:] += rng.normal(0, 0.1, (transitions, model.nq - 7 + model.nv))
    targets = pose + rng.normal(0, 0.2, (transitions, model.nu))
    data = Trajectories(states, targets, states, np.ones(transitions, dtype=bool))
    return Problem(name, simulator, data, epsilon=NOISE, truth=ones(simulator))
