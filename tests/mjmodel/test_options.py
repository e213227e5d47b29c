"""The options of a model, by the names that MJCF takes."""

import mujoco
import pytest

from dropo.mjmodel.options import gravity, integrator, physics_step


@pytest.mark.parametrize("name", ["Euler", "RK4", "implicit", "implicitfast"])
def test_an_integrator_is_called_as_in_mjcf(name):
    """What was written is what is read, with the step and gravity beside it."""
    option = f'<option integrator="{name}" timestep="0.003" gravity="0 1 -2"/>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{option}</mujoco>")
    assert integrator(model) == name
    assert physics_step(model) == 0.003
    assert gravity(model).tolist() == [0.0, 1.0, -2.0]
