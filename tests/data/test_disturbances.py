"""Pushes that no command explains are found with their place and time, and nothing else is; a
robust fit survives them.
"""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.data.outliers import disturbances
from dropo.data.outliers.disturbances import find_disturbances, robust_values
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """<mujoco><option timestep="0.005"/><worldbody><body name="link">
<joint name="hinge" axis="0 1 0" frictionloss="0.15" damping="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="0.6"/></body></worldbody>
<actuator><motor name="m" joint="hinge"/></actuator></mujoco>"""
STEP = 0.01
NOISE = np.array([1e-3, 0.02])
PUSHES = {(0, 250, 290): 2.0, (2, 500, 540): -1.5}
"""Rows of trajectories, and the torque [N m] that acts there beside the command."""


@pytest.fixture(scope="module")
def simulator():
    friction = FieldParameter(
        "friction", 0.0, 0.6, "N m", field="dof_frictionloss", element="hinge"
    )
    mass = FieldParameter("mass", 0.3, 1.2, "kg", field="body_mass", element="link")
    return MujocoSimulator(
        mujoco.MjSpec.from_string(XML), [friction, mass], frame_skip=2, threads=1
    )


def recorded(simulator, pushes, spikes=0, seed=0):
    """Three runs of 8 s under random commands, with noise, and if asked some wild velocities."""
    rng = np.random.default_rng(seed)
    model = simulator.model
    rows = 800
    parts = []
    for run in range(3):
        data = mujoco.MjData(model)
        command = (
            1.5 * np.sin(2 * np.pi * np.cumsum(rng.uniform(0.1, 1.5, rows)) * STEP)
            + 0.5 * rng.normal()
        )
        states = [np.concatenate([data.qpos, data.qvel])]
        for t in range(rows):
            data.ctrl[0] = command[t]
            data.qfrc_applied[0] = sum(
                torque for (r, a, b), torque in pushes.items() if r == run and a <= t < b
            )
            mujoco.mj_step(model, data, 2)
            states.append(np.concatenate([data.qpos, data.qvel]))
        states = np.array(states) + NOISE * rng.normal(size=(rows + 1, 2))
        states[rng.integers(0, rows, spikes), 1] += 3.0
        parts.append((states[:-1], command[:, None], states[1:]))
    ends = np.arange(3 * rows) % rows == rows - 1
    return Trajectories(
        *(np.concatenate(part) for part in zip(*parts, strict=True)), terminals=ends
    )


def test_pushes_are_found_and_nothing_else(simulator):
    """Each push is one span of its run that covers it, within 0.3 s on either side; without pushes
    there is none; spikes are none.
    """
    value = simulator.nominal
    found = find_disturbances(simulator, recorded(simulator, PUSHES, spikes=5), value, STEP)
    assert [span.trajectory for span in found.spans] == [0, 2]
    for span, (_, first, last) in zip(found.spans, PUSHES, strict=True):
        assert span.start - 0.3 < first * STEP < span.start + 0.2
        assert span.end - 0.2 < last * STEP < span.end + 0.3
        assert span.signal == "qvel.hinge"
    assert np.sign([span.size for span in found.spans]).tolist() == [1, -1]
    assert "trajectory 0, 2." in str(found)
    kept = found.left_out()
    assert len(kept) == len(found.trajectories) - sum(
        span.last - span.first for span in found.spans
    )
    assert len(kept.spans) == 5
    assert find_disturbances(simulator, recorded(simulator, {}, spikes=5), value, STEP).spans == ()


def test_a_robust_fit_survives_pushes(simulator):
    """Friction and mass are found from the wrong start, with pushes in the data; a plain fit to the
    same windows is farther off.
    """
    data = recorded(simulator, {**PUSHES, (1, 100, 250): 1.5, (1, 500, 650): 1.5})
    found = robust_values(simulator, data, STEP, [0.4, 0.9])
    assert abs(found - [0.15, 0.6]).max() < 0.03
    spans = find_disturbances(simulator, data, found, STEP)
    assert {span.trajectory for span in spans.spans} == {0, 1, 2}


def test_a_model_that_lacks_something_is_called_so(simulator):
    """Where much of the data stands out, the sentence says that it is rather the model; the control
    is a push alone.
    """
    wrong = find_disturbances(simulator, recorded(simulator, PUSHES), simulator.nominal, STEP)
    assert "rather a model" not in str(wrong)
    many = replace(wrong, spans=tuple(replace(span, first=0, last=700) for span in wrong.spans))
    assert "rather a model" in str(many)


def test_rows_around_a_contact_are_left_out_on_both_sides(simulator, monkeypatch):
    """A contact in one row takes as many rows before it as after it."""
    trajectories = recorded(simulator, {})
    touching = np.zeros(len(trajectories), dtype=bool)
    touching[100] = True
    monkeypatch.setattr(simulator, "in_contact", lambda segments: touching)
    free = disturbances._away_from_contacts(simulator, trajectories, 2)
    assert list(np.flatnonzero(~free)) == [98, 99, 100, 101, 102]
