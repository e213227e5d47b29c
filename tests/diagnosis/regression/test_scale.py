"""One hinge with a load that is not known: no motion tells the scale of all forces."""

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.effect import instances_of
from dropo.diagnosis.regression.quick import QuickDiagnose, QuickSettings
from dropo.diagnosis.search.library import robot_of
from dropo.mjmodel.bodies import extent
from dropo.studies.first_models.machines import CONTROL, measured, problem_of

XML = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="beam" pos="0 0 1">
      <joint name="swing" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="1.5"/>
    </body>
  </worldbody>
  <actuator><velocity name="drive" joint="swing" kv="9"/></actuator>
</mujoco>
"""
FRICTION = 0.5
"""[N m]."""
LOAD = 0.6
"""[kg], on the beam."""
PLACE = (0.06, 0.0, -0.35)
"""[m], where the load is."""
DELAY = 0.008
"""Of the commands [s]."""


def pendulum(rng, gain=1.0, rotor=0.0):
    """Two runs of 12 s under a velocity servo with a gain of its own, positions alone."""
    spec = mujoco.MjSpec.from_string(XML)
    spec.option.timestep = 0.0005
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.joint("swing").armature = rotor
    spec.joint("swing").frictionloss = FRICTION
    spec.body("beam").add_geom(size=[0.004, 0, 0], pos=PLACE, mass=LOAD, contype=0, conaffinity=0)
    drive = spec.actuators[0]
    drive.gainprm[0] *= gain
    drive.biasprm[2] *= gain
    time = CONTROL * np.arange(1200)
    phases = 2 * np.pi * rng.uniform(0.2, 1.5, (2, 4, 1)) * time + rng.uniform(0, 6, (2, 4, 1))
    commands = (1.2 * np.sin(phases)).sum(axis=1)
    commands -= commands[:, :1]
    data = measured(spec, commands[:, :, None], DELAY, rng)
    return problem_of("pendulum", mujoco.MjSpec.from_string(XML), data)


@pytest.mark.parametrize(("gain", "rotor"), [(1.0, 0.0), (0.85, 0.05)])
def test_numbers_are_in_proportion_to_the_models_own_gain(gain, rotor):
    """Friction, the load and the delay are found; what the data cannot tell beside them is said:
    a rotor is a load farther out, and any gain would do.
    """
    found = QuickDiagnose().run(pendulum(np.random.default_rng(5), gain, rotor))
    causes = {(cause.effect, cause.target): cause for cause in found.causes}
    assert set(causes) == {
        ("payload", "beam"),
        ("joint_friction", "swing"),
        ("actuator_delay", "drive"),
    }
    assert found.verdict == "explained"
    friction = causes["joint_friction", "swing"].estimate["frictionloss"]
    assert friction.value == pytest.approx(FRICTION / gain, rel=0.03)
    assert abs(friction.value - FRICTION) < 3 * friction.se < 0.75 * FRICTION
    load = causes["payload", "beam"]
    sizes = load.estimate
    assert sizes["mass"].value * sizes["x"].value == pytest.approx(LOAD * PLACE[0] / gain, rel=0.1)
    assert ("joint_armature", "swing") in {(one.effect, one.target) for one in load.confused_with}
    delay = causes["actuator_delay", "drive"].estimate["delay"]
    assert abs(delay.value - DELAY) < 3 * delay.se < DELAY
    assert any("scale of all forces" in text for text in found.warnings)


def test_a_search_may_carry_a_load_as_far_out():
    """As the regression may, beyond the body's own end, which a rotor that is missing asks for."""
    simulator = robot_of(pendulum(np.random.default_rng(5)))
    (load,) = (
        one
        for one in instances_of(simulator.effect_context, "payload")
        if one.target == "beam" and not one.variant
    )
    reach = QuickSettings().reach * extent(simulator.model, 1)
    assert [place.high for place in load.quantities[1:]] == pytest.approx([reach] * 3)
    assert reach > 0.7
