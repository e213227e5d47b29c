"""Commands that flip from row to row are told, and no cause is named from what they hide."""

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.diagnosis.diagnose import Diagnose
from dropo.diagnosis.findings.premises.chattering import chattering_drives
from dropo.diagnosis.regression.quick import QuickDiagnose
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.1" frictionloss="0.05"/>
      <geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.3" mass="0.8" contype="0"/>
      <body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="0.05"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.25" mass="0.4" contype="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder_motor" joint="shoulder" gear="4"/>
    <motor name="elbow_motor" joint="elbow" gear="1.5"/>
  </actuator>
</mujoco>
"""
ROWS = 600
SKIP = 5


def logged(slowing: float, noise: float = 0.0, seed: int = 0) -> Problem:
    """A log of the arm under a controller that slows it down by a command per rad/s.

    noise: standard deviation of what is added to the commands, anew in each row.
    """
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec.from_string(XML)
    simulator = MujocoSimulator(spec, [], observation=["qpos"], frame_skip=SKIP, threads=1)
    machine = spec.copy()
    machine.option.timestep = 0.0004
    model = machine.compile()
    data = mujoco.MjData(model)
    positions = [data.qpos.copy()]
    commands = []
    for k in range(ROWS):
        wanted = 0.6 * np.sin(0.01 * k * np.array([2.1, 3.3]) + np.array([0.0, 1.0]))
        command = 2.0 * (wanted - data.qpos) - slowing * data.qvel + noise * rng.normal(size=2)
        data.ctrl[:] = np.clip(command, -1.0, 1.0)
        commands.append(data.ctrl.copy())
        for _ in range(SKIP * 5):
            mujoco.mj_step(model, data)
        positions.append(data.qpos.copy())
    read = np.array(positions) + 1e-4 * rng.normal(size=(ROWS + 1, 2))
    ends = np.arange(ROWS) == ROWS - 1
    return Problem("arm", simulator, Trajectories(read[:-1], np.array(commands), read[1:], ends))


@pytest.fixture(scope="module")
def shaken():
    """A controller that slows down by more than a row of its own command takes away."""
    return logged(6.0)


def test_drives_that_chatter_are_named(shaken):
    """Both of a controller that is too strong for its rate; none of a calm one or of noise."""
    assert chattering_drives(shaken) == ("shoulder_motor", "elbow_motor")
    assert chattering_drives(logged(0.1)) == ()
    assert chattering_drives(logged(0.1, noise=0.5)) == ()


def test_no_cause_is_named_from_what_chatter_hides(shaken):
    """The quick diagnosis says so in a sentence, which a calm log of the same machine lacks."""
    found = QuickDiagnose().run(shaken)
    assert found.causes == ()
    assert found.verdict == "unexplained"
    assert any("flip from row to row" in text for text in found.warnings)
    calm = QuickDiagnose().run(logged(0.1))
    assert not any("flip from row to row" in text for text in calm.warnings)


def test_the_search_by_simulation_warns_too(shaken):
    """The same sentence stands among its warnings."""
    effects = ("joint_damping", "actuator_gain")
    found = Diagnose(effects, windows=16, disturbances=False).run(shaken)
    assert any("flip from row to row" in text for text in found.warnings)
