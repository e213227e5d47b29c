"""Masses, places and inertias of bodies."""

import mujoco
import pytest

from dropo.mjmodel.bodies import (
    body_masses,
    body_place,
    contact_margin,
    mass_centre,
    moving_mass,
    principal_inertia,
    write_mass,
)
from dropo.mjmodel.names import element_id

MODEL = """<mujoco><worldbody>
  <body name="table"><geom size="0.1" mass="7"/></body>
  <body name="arm" pos="1 2 3"><joint axis="0 0 1"/>
    <inertial pos="0.1 0.2 0.3" mass="2" diaginertia="0.03 0.02 0.01"/>
    <geom name="foot" size="0.1" margin="0.01"/>
    <body name="hand"><joint axis="0 1 0"/><geom size="0.1" mass="0.5"/></body></body>
  </worldbody></mujoco>"""


@pytest.fixture
def model():
    return mujoco.MjModel.from_xml_string(MODEL)


def test_numbers_of_a_body(model):
    """As written; what is fixed to the world does not move."""
    arm = element_id(model, "body", "arm")
    assert body_masses(model).tolist() == [0.0, 7.0, 2.0, 0.5]
    assert moving_mass(model) == 2.5
    assert mass_centre(model, arm).tolist() == [0.1, 0.2, 0.3]
    assert body_place(model, arm).tolist() == [1.0, 2.0, 3.0]
    assert sorted(principal_inertia(model, arm)) == pytest.approx([0.01, 0.02, 0.03])
    assert contact_margin(model, element_id(model, "geom", "foot")) == 0.01


def test_a_written_mass_is_read_again(model):
    """And no other changes."""
    write_mass(model, element_id(model, "body", "hand"), 0.75)
    assert body_masses(model).tolist() == [0.0, 7.0, 2.0, 0.75]
