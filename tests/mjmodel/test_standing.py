"""Machines with a free base, and the ground on which they stand."""

import mujoco
import numpy as np
import pytest

from dropo.core.services.errors import Incompatible
from dropo.mjmodel.standing import (
    floating_base,
    footing,
    level_ground,
    refuse_unknown_base,
    site_in_body,
    site_of,
)

MACHINE = """
<body name="trunk" pos="0 0 1"><freejoint name="base"/>
  <geom type="box" size="0.2 0.1 0.05" mass="4" contype="0" conaffinity="0"/>
  <site name="imu" pos="0.1 0 0" euler="0 0 90"/>
  <body pos="0 0 -0.1"><joint name="hip" axis="0 1 0"/>
    <geom name="foot" type="sphere" pos="0 0 -0.3" size="0.05" mass="0.3"/></body></body>"""
CUBE = '<body pos="1 0 1"><freejoint name="cube"/><geom size="0.05" mass="0.1"/></body>'
FLOOR = '<geom name="floor" type="plane" size="5 5 0.1" {}/>'


def model_of(machine: str = MACHINE, ground: str = FLOOR.format("")) -> mujoco.MjModel:
    """The machine, driven at its hip, on a ground."""
    actuator = '<motor joint="hip"/>' if "hip" in machine else ""
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody>{ground}{machine}</worldbody><actuator>{actuator}</actuator>
        <sensor><gyro name="gyro" site="imu"/></sensor></mujoco>"""
    )


def test_the_base_is_what_carries_driven_joints() -> None:
    """A cube that lies about is none, and does not count."""
    base = floating_base(model_of(CUBE + MACHINE))
    assert base is not None
    assert base.name == "base"


@pytest.mark.parametrize(
    "ground",
    [
        FLOOR.format('euler="10 0 0"'),
        FLOOR.format("") + '<geom type="box" size="1 1 0.1" pos="2 0 0"/>',
        FLOOR.format('contype="0" conaffinity="0"'),
    ],
)
def test_what_is_no_level_ground(ground: str) -> None:
    """A slope, a step beside the plane, and a plane that is only seen."""
    assert level_ground(model_of(ground=ground)) is None
    assert level_ground(model_of()) == 0


def test_feet_in_the_bases_axes() -> None:
    """Places and speeds of the foot's lowest point are those of the geometry."""
    model = model_of()
    site = site_of(model, 0)
    assert site is not None
    place, turn = site_in_body(model, site)
    np.testing.assert_allclose(place, [0.1, 0, 0])
    np.testing.assert_allclose(turn @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    positions = np.zeros((1, model.nq))
    velocities = np.zeros((1, model.nv))
    velocities[0, :6] = 7.0  # of the base, which does not count
    velocities[0, 6] = 2.0
    feet = footing(model, 0, site, np.array([[1.0, 0, 0, 0]]), positions, velocities)
    np.testing.assert_allclose(feet.places[0, 0], [-0.1, 0, -0.45], atol=1e-9)
    np.testing.assert_allclose(feet.speeds[0, 0], [-0.7, 0, 0], atol=1e-9)
    assert feet.heights[0, 0] == 0.0


PLANAR = MACHINE.replace(
    '<freejoint name="base"/>',
    '<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>',
)


def test_data_without_the_pose_are_refused() -> None:
    """Where the machine may touch the ground, and not where it floats or the pose is there."""
    model = model_of()
    planar = model_of(PLANAR)
    with pytest.raises(Incompatible, match="base 'trunk' is not in the data"):
        refuse_unknown_base(planar, {2})
    refuse_unknown_base(planar, {1, 2})
    with pytest.raises(Incompatible, match="base 'base' is not in the data"):
        refuse_unknown_base(model, {7})
    refuse_unknown_base(model, {0, 1, 2})
    refuse_unknown_base(model_of(ground=""), {7})
