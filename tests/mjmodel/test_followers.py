"""Joints that follow others start where these have them, without a column of their own."""

import mujoco
import numpy as np
import pytest

from dropo.mjmodel.followers import followers_of
from dropo.mjmodel.observation import Layout

HAND = """
<mujoco>
  <worldbody>
    <body><joint name="arm" axis="0 1 0"/><geom size="0.05" mass="1"/>
      <body pos="0.2 0.1 0"><joint name="left" type="slide" axis="0 1 0"/>
        <geom size="0.02" mass="0.1"/></body>
      <body pos="0.2 -0.1 0"><joint name="right" type="slide" axis="0 -1 0"/>
        <geom size="0.02" mass="0.1"/></body></body>
  </worldbody>
  <equality><joint joint1="right" joint2="left" polycoef="0.01 2 0 0 0"/></equality>
</mujoco>
"""


@pytest.mark.parametrize(
    ("logged", "place", "position", "speed"),
    [("left", 2, 0.01 + 2 * 0.03, 2 * 0.4), ("right", 1, (0.03 - 0.01) / 2, 0.4 / 2)],
)
def test_a_finger_follows_the_other(logged: str, place: int, position: float, speed: float) -> None:
    """By the polynomial of the coupling, and where it is linear the other way round."""
    model = mujoco.MjModel.from_xml_string(HAND)
    layout = Layout(model, ["qpos.arm", f"qpos.{logged}", "qvel.arm", f"qvel.{logged}"])
    states = layout.full_states(np.array([[0.1, 0.03, 0.2, 0.4]]), model)
    assert states[0, 1 + place] == pytest.approx(position)
    assert states[0, 1 + model.nq + place] == pytest.approx(speed)
    assert layout.missing_state(model) == []


def test_what_does_not_follow() -> None:
    """An observed joint keeps its column; one whose leader is not observed is missing."""
    model = mujoco.MjModel.from_xml_string(HAND)
    assert [(one.name, one.leader) for one in followers_of(model)] == [
        ("right", "left"),
        ("left", "right"),
    ]
    whole = Layout(model, ["qpos", "qvel"])
    row = np.array([[0.1, 0.03, 0.5, 0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(whole.full_states(row, model)[0, 1:], row[0])
    blind = Layout(model, ["qpos.arm", "qvel.arm"])
    assert len(blind.missing_state(model)) == 4
    model.eq_active0[0] = 0
    assert followers_of(model) == []
