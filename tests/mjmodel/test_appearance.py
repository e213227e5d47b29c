"""What a model looks like in a pose, and where its elements are."""

import mujoco
import numpy as np
import pytest

from dropo.mjmodel.appearance import (
    element_places,
    floats,
    part_places,
    part_sizes,
    posed,
    shapes,
)

ARM = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <geom name="stand" type="box" size=".1 .1 .1"/>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0"/>
      <geom name="bone" type="capsule" fromto="0 0 0 0 0 -.4" size=".03"/>
      <geom name="hull" type="sphere" size="5" group="3"/>
      <body name="fore" pos="0 0 -.4">
        <joint name="elbow" axis="0 1 0"/>
        <geom name="ball" type="sphere" size=".05" pos="0 0 -.3"/>
        <site name="tip" pos="0 0 -.3"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="belt"><joint joint="shoulder" coef="1"/><joint joint="elbow" coef="-1"/></fixed>
  </tendon>
  <actuator><motor name="drive" joint="elbow"/><motor name="elbow" tendon="belt"/></actuator>
  <sensor><jointpos name="encoder" joint="elbow"/></sensor>
</mujoco>
"""
BENT = np.array([0.0, -np.pi / 2])


@pytest.fixture(scope="module")
def arm():
    """The model, its forearm along x."""
    model = mujoco.MjModel.from_xml_string(ARM)
    return model, posed(model, BENT)


@pytest.mark.parametrize(
    ("effect", "target", "place"),
    [
        ("joint_friction", "elbow", (0, 0, 0.6)),
        ("body_mass", "fore", (0.3, 0, 0.6)),
        ("contact_friction", "ball", (0.3, 0, 0.6)),
        ("actuator_delay", "drive", (0, 0, 0.6)),
        ("actuator_gain", "elbow", (0, 0, 0.8)),
        ("tendon_friction", "belt", (0, 0, 0.8)),
        ("sensor_bias", "qvel.shoulder", (0, 0, 1)),
        ("sensor_delay", "sensordata.encoder", (0, 0, 0.6)),
        ("payload", "tip", (0.3, 0, 0.6)),
    ],
)
def test_where_an_effect_acts(arm, effect, target, place):
    """By the kind that the effect's name says first: an actuator may be called as a joint is."""
    (found,) = element_places(*arm, effect, target)
    np.testing.assert_allclose(found, place, atol=1e-12)


def test_several_places_and_none(arm):
    """Two joints of a tendon; a name that nothing has."""
    found = element_places(*arm, "tendon_damping", "shoulder+elbow")
    np.testing.assert_allclose(found, [(0, 0, 1), (0, 0, 0.6)], atol=1e-12)
    assert element_places(*arm, "parameter_drift", "some_mass") == []


def test_shapes_are_the_geoms_that_a_viewer_shows(arm):
    """No floor, no collision geoms; the stand is ground; ends of a capsule where they are."""
    stand, bone, ball = shapes(*arm)
    assert (stand.ground, bone.ground, ball.ground) == (True, False, False)
    assert (len(stand.points), ball.radius) == (8, 0.05)
    np.testing.assert_allclose(sorted(bone.points[:, 2]), [0.6, 1.0], atol=1e-12)
    model, _ = arm
    places = part_places(model, np.stack([np.zeros(2), BENT]))
    np.testing.assert_allclose(places[:, 1], [(0, 0, 0.3), (0.3, 0, 0.6)], atol=1e-12)
    assert len(part_sizes(model)) == places.shape[1] == 2


def test_bodies_without_geoms_are_lines():
    """From body to body, and to the last one's centre of mass."""
    text = """
    <mujoco><worldbody>
      <body pos="0 0 1">
        <joint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <body pos="0 0 -.4">
          <joint/><inertial pos="0 0 -.2" mass="1" diaginertia="1 1 1"/>
        </body>
      </body>
    </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    link, end = shapes(model, posed(model))
    np.testing.assert_allclose(link.points[:, 2], [1.0, 0.6])
    np.testing.assert_allclose(end.points[:, 2], [0.6, 0.4])
    assert part_places(model, np.zeros((3, 2))).shape == (3, 4, 3)
    assert len(part_sizes(model)) == 4


def test_what_may_go_away(arm):
    """A free joint, or two slides of one body; an arm and a cart do not."""
    free = '<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    planar = free.replace(
        "<freejoint/>", '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
    )
    cart = free.replace("<freejoint/>", '<joint type="slide"/>')
    found = [floats(mujoco.MjModel.from_xml_string(text)) for text in (free, planar, cart)]
    assert found == [True, True, False]
    assert not floats(arm[0])
