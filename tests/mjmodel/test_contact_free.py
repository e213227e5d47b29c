"""Contact forces, and nothing else, are projected out of the forces of a machine on legs."""

import mujoco
import numpy as np
import pytest

from dropo.mjmodel.dynamics.contact_free import projectors
from dropo.problems.simulated.example_quadruped import MODEL, STANCE


@pytest.fixture(scope="module")
def standing() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A quadruped without dry friction that steps on the ground, one foot lifted."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    model.dof_frictionloss[:] = 0
    data = mujoco.MjData(model)
    data.qpos[7:] = np.tile(STANCE, 4)
    data.ctrl[:] = data.qpos[7:]
    mujoco.mj_step(model, data, 400)
    data.ctrl[1:3] += [0.4, -0.8]
    mujoco.mj_step(model, data, 150)
    mujoco.mj_forward(model, data)
    assert 2 <= data.ncon <= 3
    return model, data


def test_contact_forces_are_gone(standing: tuple[mujoco.MjModel, mujoco.MjData]) -> None:
    """The equation of motion holds without them, though each foot carries a part of the weight;
    forces of the lifted leg's joints stay.
    """
    model, data = standing
    held = np.zeros((1, model.nv), dtype=bool)
    (free,) = projectors(model, data.qpos[None], data.qvel[None], held, 0.0)
    forces = data.qfrc_constraint
    assert np.abs(forces[6:]).max() > 1.0
    np.testing.assert_allclose(free @ forces, 0.0, atol=1e-9)
    np.testing.assert_allclose(free @ free, free, atol=1e-9)
    assert np.linalg.matrix_rank(free) == model.nv - 3 * data.ncon
    inertia = np.empty(model.nv)
    mujoco.mj_mulM(model, data, inertia, data.qacc)
    known = data.qfrc_actuator + data.qfrc_passive - data.qfrc_bias
    np.testing.assert_allclose(free @ inertia, free @ known, atol=1e-6)
    assert np.abs(inertia - known).max() > 1.0


def test_held_joints_and_coming_contacts(standing: tuple[mujoco.MjModel, mujoco.MjData]) -> None:
    """A joint that rests takes one more direction away, and a foot that comes down soon three."""
    model, data = standing
    held = np.zeros((1, model.nv), dtype=bool)
    held[0, 6] = True
    (free,) = projectors(model, data.qpos[None], data.qvel[None], held, 0.0)
    rank = model.nv - 3 * data.ncon
    assert np.linalg.matrix_rank(free) == rank - 1
    np.testing.assert_allclose(free[:, 6], 0.0, atol=1e-12)
    falling = data.qvel.copy()
    falling[2] = -1.0
    (free,) = projectors(model, data.qpos[None], falling[None], ~held & held, 0.1)
    assert np.linalg.matrix_rank(free) == model.nv - 12
