"""A problem file, its model and data, and files that are refused."""

import mujoco
import numpy as np

from dropo.core.records.trajectories import Trajectories
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" damping="0.5"/>
      <geom name="box" type="box" size="0.1 0.1 0.1" mass="2"/>
      <body name="pole" pos="0 0 0.1">
        <joint name="hinge" axis="0 1 0" damping="0.1"/>
        <geom name="rod" type="capsule" size="0.02" fromto="0 0 0 0 0 0.5" mass="0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="slide" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
TEXT = """
model: robot.xml
frame_skip: 2
data: data.npz
observation: [qpos, qvel]
action: [ctrl]
parameters:
  cart_mass: {field: body_mass, name: cart, low: 1, high: 4, unit: kg}
  damping: {field: dof_damping, name: slide, low: 0.1, high: 1.0}
"""


def simulate(
    xml: str, *, trajectories: int = 3, steps: int = 20, frame_skip: int = 1
) -> Trajectories:
    """Motion that the model itself makes under random actions in [-1, 1]."""
    gravity = FieldParameter("gravity", -11, -9, field="gravity", index=2)
    simulator = MujocoSimulator(
        mujoco.MjSpec.from_string(xml), [gravity], threads=1, frame_skip=frame_skip
    )
    rng = np.random.default_rng(0)
    n = trajectories * steps
    start = np.zeros((n, len(simulator.layout)))
    for quaternion in simulator.layout.quaternions:
        start[:, quaternion[0]] = 1.0
    actions = rng.uniform(-1, 1, (n, len(simulator.controls)))
    terminals = np.arange(n) % steps == steps - 1
    blank = Trajectories(start, actions, start, terminals)
    if simulator.layout.quaternions:
        return blank
    following = simulator.predict([[-9.81]], blank.segments(reset="start"))[0]
    observations = np.where(np.roll(terminals, 1)[:, None], start, np.roll(following, 1, axis=0))
    return Trajectories(observations, actions, following, terminals)


REFUSALS = {
    "unknown key": (
        "frame_skip: 2",
        "frame_skp: 2",
        "frame_skp: expected a known key (the nearest is 'frame_skip'), got 'frame_skp'.",
    ),
    "unknown parameter key": (
        "low: 1,",
        "lo: 1,",
        "parameters.cart_mass.lo: expected a known key (the nearest is 'low'), got 'lo'.",
    ),
    "wrong type": (
        "frame_skip: 2",
        "frame_skip: four",
        "frame_skip: expected a whole number from 1 to 100000, got 'four'.",
    ),
    "true is no number": (
        "frame_skip: 2",
        "frame_skip: true",
        "frame_skip: expected a whole number from 1 to 100000, got True.",
    ),
    "a float is not whole": (
        "frame_skip: 2",
        "frame_skip: 2.5",
        "frame_skip: expected a whole number from 1 to 100000, got 2.5.",
    ),
    "zero": (
        "frame_skip: 2",
        "frame_skip: 0",
        "frame_skip: expected a whole number from 1 to 100000, got 0.",
    ),
    "no low": ("low: 1, ", "", "parameters.cart_mass.low: expected a number, got nothing."),
    "low is text": (
        "low: 1,",
        "low: one,",
        "parameters.cart_mass.low: expected a number, got 'one'.",
    ),
    "low is infinite": (
        "low: 1,",
        "low: -.inf,",
        "parameters.cart_mass.low: expected a number, got -inf.",
    ),
    "low is NaN": (
        "low: 1,",
        "low: .nan,",
        "parameters.cart_mass.low: expected a number, got nan.",
    ),
    "reversed bounds": (
        "low: 1, high: 4",
        "low: 4, high: 1",
        "parameters.cart_mass.low: expected a number below high = 1, got 4.",
    ),
    "equal bounds": (
        "low: 1, high: 4",
        "low: 4, high: 4",
        "parameters.cart_mass.low: expected a number below high = 4, got 4.",
    ),
    "unknown field": (
        "body_mass",
        "body_mas",
        (
            "parameters.cart_mass.field: expected a field of MjModel or mjOption (the nearest "
            "is 'body_mass'), got 'body_mas'."
        ),
    ),
    "unknown element": (
        "name: cart",
        "name: crat",
        (
            "parameters.cart_mass.name: expected the name of a body (the nearest is 'cart'), "
            "got 'crat'."
        ),
    ),
    "no element": (
        "name: cart, ",
        "",
        (
            "parameters.cart_mass.name: expected the name of a body (there is cart, pole, "
            "world), got nothing."
        ),
    ),
    "element of a field without": (
        "field: body_mass, name: cart",
        "field: gravity, name: cart",
        (
            "parameters.cart_mass.name: expected no name, since the field 'gravity' has no "
            "elements, got 'cart'."
        ),
    ),
    "index out of the row": (
        "name: slide,",
        "name: slide, index: 1,",
        (
            "parameters.damping.index: The index of parameter 'damping' must be 0 to 0, the "
            "field 'dof_damping' has 1 numbers there. Got 1."
        ),
    ),
    "index missing": (
        "field: dof_damping, name: slide",
        "field: geom_friction, name: box",
        (
            "parameters.damping.index: The field 'geom_friction' of parameter 'damping' has 3 "
            "numbers: give the index, 0 to 2."
        ),
    ),
    "negative index": (
        "name: slide,",
        "name: slide, index: -1,",
        "parameters.damping.index: expected a whole number of at least 0, got -1.",
    ),
    "unknown target": (
        "name: slide,",
        "name: slide, target: relativ,",
        (
            "parameters.damping.target: expected a known target (the nearest is 'relative'), "
            "got 'relativ'."
        ),
    ),
    "unknown derived": (
        "name: slide,",
        "name: slide, derived: keeep,",
        (
            "parameters.damping.derived: expected what derived constants do (the nearest is "
            "'keep'), got 'keeep'."
        ),
    ),
    "a parameter that is no mapping": (
        "{field: dof_damping, name: slide, low: 0.1, high: 1.0}",
        "0.5",
        "parameters.damping: expected a mapping with field, low and high, got 0.5.",
    ),
    "the same number twice": (
        "field: dof_damping, name: slide",
        "field: body_mass, name: cart",
        (
            "parameters.damping.field: expected a number that no other parameter sets, got the "
            "one of 'cart_mass'."
        ),
    ),
    "a key twice": (
        "frame_skip: 2",
        "frame_skip: 2\nframe_skip: 4",
        "line 4: expected YAML, got the key 'frame_skip' twice.",
    ),
    "no YAML": (
        "[ctrl]",
        "[ctrl",
        "line 7: expected YAML, got what a parser refuses: expected ',' or ']', but got ':'.",
    ),
    "no model": (
        "model: robot.xml\n",
        "",
        "model: expected an MJCF file, or the name of a built-in model (hopper), got nothing.",
    ),
    "no such model": (
        "robot.xml",
        "robt.xml",
        "model: expected an MJCF file, or the name of a built-in model (hopper),"
        " got 'robt.xml', which is neither (no such file: robt.xml).",
    ),
    "no data": (
        "data: data.npz\n",
        "",
        "data: expected a file, a folder or a list of them, got nothing.",
    ),
    "observation outside": (
        "[qpos, qvel]",
        "['qpos[:5]']",
        "observation: The item 'qpos[:5]' is outside of qpos, which has 2 numbers.",
    ),
    "unknown observation field": (
        "[qpos, qvel]",
        "[qps, qvel]",
        "observation: No field called 'qps'. Did you mean 'qpos'?",
    ),
    "unknown observation element": (
        "[qpos, qvel]",
        "[qpos.slid, qvel]",
        "observation: No element of qpos called 'slid'. Did you mean 'slide'?",
    ),
    "observation is no list": (
        "[qpos, qvel]",
        "qpos",
        "observation: expected a list of items such as [qpos, qvel], got 'qpos'.",
    ),
    "a column twice": (
        "[qpos, qvel]",
        "[qpos, qvel, 'qpos[0]']",
        "observation: expected each column once, got 'qpos.slide' twice.",
    ),
    "unknown action": (
        "[ctrl]",
        "[ctrl.pus]",
        "action: No element of ctrl called 'pus'. Did you mean 'push'?",
    ),
    "other columns than the data": (
        "[qpos, qvel]",
        "[qpos]",
        "data: expected 2 observation columns, as the observation items give, got 4 in data.npz.",
    ),
}
