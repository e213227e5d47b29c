"""All numbers of a model by their fields."""

import copy

import mujoco
import numpy as np
import pytest

from dropo.mjmodel.numbers import array_of, changed_numbers, derive_constants, set_number

MODEL = """<mujoco><worldbody><body name="arm"><joint axis="0 1 0"/><geom size="0.1" mass="2"/>
  <body pos="1 0 0"><joint axis="0 1 0"/><geom size="0.1" mass="1"/></body></body></worldbody>
  </mujoco>"""


def test_what_is_set_is_what_has_changed():
    """Numbers of the model and of its options; equal models have none; constants follow later."""
    plain = mujoco.MjModel.from_xml_string(MODEL)
    whole = copy.copy(plain)
    assert changed_numbers(plain, whole) == {}
    set_number(whole, "body_mass", (2,), 4.0)
    set_number(whole, "opt.timestep", (), 0.001)
    set_number(whole, "opt.gravity", (1,), 0.5)
    found = changed_numbers(plain, whole)
    assert sorted(found) == ["body_mass", "opt.gravity", "opt.timestep"]
    assert found["body_mass"].tolist() == [0.0, 2.0, 4.0]
    assert array_of(whole, "opt.gravity")[1] == 0.5
    assert whole.body_subtreemass[1] == 3.0
    derive_constants(whole)
    assert np.asarray(whole.body_subtreemass)[1] == pytest.approx(6.0)
    assert {"body_subtreemass", "dof_M0"} <= set(changed_numbers(plain, whole))
