"""Which joints' loads are offsets of a command."""

import mujoco
import pytest

from dropo.diagnosis.regression.terms import _linear_in_command

XML = """
<mujoco>
  <worldbody>
    <body>
      <joint name="first" axis="0 1 0"/>
      <geom size="0.1"/>
      <body pos="0.3 0 0">
        <joint name="second" axis="0 1 0"/>
        <geom size="0.1"/>
        <body pos="0.3 0 0">
          <joint name="third" axis="0 1 0"/>
          <geom size="0.1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="belt"><joint joint="first" coef="1"/><joint joint="second" coef="1"/></fixed>
  </tendon>
  <actuator>
    <motor name="shoulder" joint="first" gear="2"/>
    {belt}
    <position name="wrist" joint="third" kp="5" gear="-3"/>
  </actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    ("belt", "names"),
    [("", {"shoulder": 2.0, "wrist": -15.0}), ('<motor tendon="belt"/>', {"wrist": -15.0})],
)
def test_drives_that_act_alone(belt, names):
    """With their force per command; a joint that a tendon pulls, too, has none."""
    model = mujoco.MjModel.from_xml_string(XML.format(belt=belt))
    found = _linear_in_command(model).values()
    assert {drive.name: drive.per_command for drive in found} == names
