"""A run with another payload is named; runs that agree, or all differ, are not."""

import mujoco
import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument
from dropo.data.outliers.outlier_runs import compare_runs
from tests.data.test_disturbances import NOISE, STEP, XML, simulator  # noqa: F401 - a fixture


def recorded(payloads, seed=0):
    """A run of 3 s for each mass [kg]."""
    rng = np.random.default_rng(seed)
    parts = []
    for mass in payloads:
        model = mujoco.MjModel.from_xml_string(XML)
        model.body_mass[1] = mass
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        command = 1.2 * np.sin(2 * np.pi * np.cumsum(rng.uniform(0.1, 1.5, 300)) * STEP)
        states = [np.concatenate([data.qpos, data.qvel])]
        for torque in command:
            data.ctrl[0] = torque
            mujoco.mj_step(model, data, 2)
            states.append(np.concatenate([data.qpos, data.qvel]))
        states = np.array(states) + NOISE * rng.normal(size=(301, 2))
        parts.append((states[:-1], command[:, None], states[1:]))
    ends = np.arange(300 * len(payloads)) % 300 == 299
    return Trajectories(
        *(np.concatenate(part) for part in zip(*parts, strict=True)), terminals=ends
    )


def test_another_payload_is_named(simulator):  # noqa: F811
    """Of six runs the one with a heavier link is named, in its inertia and weight, and it alone;
    the control agrees.
    """
    heavy = compare_runs(
        simulator, recorded([0.6, 0.6, 0.6, 0.8, 0.6, 0.6]), simulator.nominal, STEP
    )
    assert [one.run for one in heavy.outliers] == [3]
    assert heavy.outliers[0].parameter == "mass"
    assert "run 3 disagrees" in str(heavy)
    assert compare_runs(simulator, recorded([0.6] * 6), simulator.nominal, STEP).outliers == ()


def test_runs_that_all_differ_have_no_odd_one(simulator):  # noqa: F811
    """Masses spread over a third of their mean are a spread, not an odd run."""
    assert (
        compare_runs(
            simulator, recorded([0.5, 0.55, 0.6, 0.65, 0.7, 0.62]), simulator.nominal, STEP
        ).outliers
        == ()
    )


def test_each_runs_errors_hold(simulator):  # noqa: F811
    """Values of 12 equal runs scatter as their standard errors say."""
    runs = compare_runs(simulator, recorded([0.6] * 12, seed=1), simulator.nominal, STEP)
    scores = (runs.values - simulator.nominal) / runs.errors
    assert np.abs(scores.mean(axis=0)).max() < 4.5 / np.sqrt(12)
    assert ((scores**2).mean(axis=0) < 1 + 4.5 * np.sqrt(2 / 12)).all()
    assert ((scores**2).mean(axis=0) > 0.2).all()


def test_few_runs_are_refused(simulator):  # noqa: F811
    """Of three, none can be called odd."""
    with pytest.raises(BadArgument, match="at least 4 runs"):
        compare_runs(simulator, recorded([0.6] * 3), simulator.nominal, STEP)
