"""What whole motions do not tell from a rotor is listed: what else its joint and body may have."""

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.effect import instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.diagnosis.far_off.same_place import alike_in_motions
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.refit import NO_INDICES
from dropo.diagnosis.search.review import Review
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.whitening import white
from dropo.diagnosis.search.windows import split
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="arm">
      <joint name="pivot" damping="0.02"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="pivot"/></actuator>
</mujoco>
"""
NOISE = np.array([2e-4, 2e-3])  # [rad, rad/s]
RUNS, STEPS = 12, 60


def arm(axis, armature=0.0):
    """One link, of which a motor turns the end about an axis."""
    spec = mujoco.MjSpec.from_string(XML)
    spec.joints[0].axis = axis
    spec.joints[0].armature = armature
    return MujocoSimulator(spec, [], frame_skip=2, threads=1)


@pytest.mark.parametrize(("axis", "heavier"), [((0, 0, 1), True), ((0, 1, 0), False)])
def test_a_heavier_body_is_a_rotor_about_an_upright_joint(axis, heavier):
    """Friction and offsets are not; the control: about a level joint a body has weight."""
    rng = np.random.default_rng(1)
    torque = 0.3 * np.sin(0.2 * np.arange(STEPS) + rng.uniform(0, 6, (RUNS, 1))).reshape(-1, 1)
    rest = np.zeros((len(torque), 2))
    ends = np.arange(len(torque)) % STEPS == STEPS - 1
    segments = Trajectories(rest, torque, rest, ends).segments(STEPS, every_step=True)
    after = arm(axis, 0.01).predict(np.zeros((1, 0)), segments)[0].reshape(RUNS, STEPS, 2)
    exact = np.concatenate([np.zeros((RUNS, 1, 2)), after], axis=1)
    measured = exact + NOISE * rng.normal(size=exact.shape)
    before, later = measured[:, :-1].reshape(-1, 2), measured[:, 1:].reshape(-1, 2)
    problem = Problem("arm", arm(axis), Trajectories(before, torque, later, ends))

    (rotor,) = instances_of(problem.simulator.effect_context, "joint_armature")
    library = Library(problem.simulator.with_effects([rotor]), [rotor], 0)
    search = Selection(library, 1e-3 * NOISE)
    train, test = split(problem, 10, 20)
    first = search.begin(train, test, np.zeros(1), white(NOISE), NO_INDICES)
    last = search.try_set(first, np.array([0.01]), (), (rotor,), scanned=())
    reviews = {rotor.label: Review(first, None, ())}
    named = {rotor.label}
    found = alike_in_motions(problem.simulator, library, last, reviews, named, 0.98)
    others = {one.effect for one, _ in found[rotor.label].others}
    assert others >= {"body_inertia"}
    assert ("payload" in others) is heavier
    assert ("body_mass" in others) is heavier
    assert others.isdisjoint({"joint_damping", "joint_friction", "actuator_bias"})
