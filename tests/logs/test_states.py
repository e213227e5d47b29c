"""States estimated with the model are nearer to the truth than without, and as near as their
covariance says.
"""

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, Incompatible, UnknownName
from dropo.logs.signals.states import estimate_states, with_states
from dropo.logs.signals.velocities import estimate_velocities
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.simulators.toy import SlidingBlock, simulate

XML = """<mujoco><option timestep="0.005"/><worldbody><body>
<joint name="shoulder" axis="0 1 0" damping="0.05"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
<body name="lower" pos="0 0 -0.3">
<joint name="elbow" axis="0 1 0" damping="0.05"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.4"/>
</body></body></worldbody>
<actuator><motor joint="shoulder"/></actuator></mujoco>"""
STEP = 0.01
SD = 5e-3
ROWS = 100  # of each run
KICKS = np.array([0.05, 0.02])  # N m in each step that the model knows nothing of


@pytest.fixture(scope="module")
def simulator():
    mass = FieldParameter("mass", 0.1, 1.0, "kg", field="body_mass", element="lower")
    return MujocoSimulator(mujoco.MjSpec.from_string(XML), [mass], frame_skip=2, threads=1)


@pytest.fixture(scope="module")
def log(simulator):
    """True states (202, 4) of two runs of 1 s, and trajectories of noisy positions with guessed
    velocities.
    """
    rng = np.random.default_rng(0)
    model = simulator.model
    truth = []
    parts = []
    for _ in range(2):
        data = mujoco.MjData(model)
        data.qpos = rng.uniform(-1, 1, 2)
        states = [np.concatenate([data.qpos, data.qvel])]
        commands = np.cumsum(rng.normal(0, 0.1, ROWS))
        for torque in commands:
            data.ctrl[0] = torque
            data.qfrc_applied = KICKS * rng.normal(size=2)
            mujoco.mj_step(model, data, 2)
            states.append(np.concatenate([data.qpos, data.qvel]))
        states = np.array(states)
        seen = states[:, :2] + SD * rng.normal(size=(ROWS + 1, 2))
        guess = np.concatenate(
            [seen, estimate_velocities(STEP * np.arange(ROWS + 1), seen).velocities], axis=1
        )
        truth.append(states)
        parts.append((guess[:-1], commands[:, None], guess[1:]))
    ends = np.arange(2 * ROWS) % ROWS == ROWS - 1
    return np.concatenate(truth), Trajectories(
        *(np.concatenate(part) for part in zip(*parts, strict=True)), terminals=ends
    )


MEASURED = [True, True, False, False]


def before(truth):
    return np.concatenate([truth[:ROWS], truth[ROWS + 1 : 2 * ROWS + 1]])


def rms(errors):
    return np.sqrt(np.mean(errors**2, axis=0))


@pytest.fixture(scope="module")
def estimates(simulator, log):
    """The smoother and the filter."""
    return [
        estimate_states(simulator, log[1], simulator.nominal, measured=MEASURED, causal=causal)
        for causal in (False, True)
    ]


def size(found, truth):
    """The mean squared error in the stated covariance."""
    errors = found.trajectories.observations - before(truth)
    return np.mean(np.einsum("ni,nij,nj->n", errors, np.linalg.inv(found.covariance), errors)[20:])


def test_the_model_makes_velocities_better(log, estimates):
    """From positions alone: positions and velocities nearer than measured and guessed; the filter,
    which knows the past alone, is worse; the sensors' noise is learned within 20 %.
    """
    truth, data = log
    smooth, causal = estimates
    errors = [rms(x.trajectories.observations - before(truth)) for x in estimates]
    guess = rms(data.observations - before(truth))
    assert (errors[0] < guess * [0.5, 0.5, 0.6, 0.85]).all()
    assert (errors[1] > errors[0]).all()
    assert (causal.causal, smooth.causal) == (True, False)
    np.testing.assert_allclose(np.sqrt(smooth.noise[:2]), SD, rtol=0.2)
    assert np.isinf(smooth.noise[2:]).all()


def test_covariances_hold(simulator, log, estimates):
    """Squared errors in the stated covariances have mean 4 within a factor of 2, for filter and
    smoother, and the stated variances are those of the errors; with noise stated three times too
    small they have not.
    """
    truth, data = log
    for found in estimates:
        assert 2 < size(found, truth) < 8
    np.testing.assert_allclose(
        np.sqrt(estimates[0].start_variance),
        rms(estimates[0].trajectories.observations - before(truth)),
        rtol=0.3,
    )
    assert (
        size(
            estimate_states(
                simulator, data, simulator.nominal, measured=MEASURED, noise=[SD / 3, SD / 3, 1, 1]
            ),
            truth,
        )
        > 8
    )


def test_a_wrong_model_is_trusted_less(simulator, log):
    """With twice the mass, what the model misses is learned to be larger, and positions stay with
    what was measured.
    """
    truth, data = log
    right, wrong = (
        estimate_states(simulator, data, [mass], measured=MEASURED, noise=[SD, SD, 1, 1])
        for mass in (0.4, 0.8)
    )
    assert np.trace(wrong.process) > 10 * np.trace(right.process)
    assert wrong.start_variance[2:].sum() > 2 * right.start_variance[2:].sum()
    assert (rms(wrong.trajectories.observations - before(truth))[:2] < 1.1 * SD).all()


def test_rows_without_a_simulator_for_them_are_refused(simulator, log):
    """Another number of columns, and a log in which nothing was measured."""
    _, data = log
    with pytest.raises(Incompatible, match="3 columns"):
        estimate_states(
            simulator,
            Trajectories(
                data.observations[:, :3],
                data.actions,
                data.next_observations[:, :3],
                data.terminals,
            ),
            [0.4],
        )
    with pytest.raises(BadArgument, match="at least one True"):
        estimate_states(simulator, data, [0.4], measured=[False] * 4)


def test_what_is_known_of_states_is_read_by_people(log, estimates):
    """A line for each signal, "-" where nothing was measured; a filter is called causal."""
    smooth, causal = estimates
    for found, how in ((smooth, "a smoother, not causal"), (causal, "a filter, causal")):
        sentence, table = found.parts()
        assert sentence.startswith(f"{2 * ROWS} states estimated with the model")
        assert how in sentence
        assert [row[0] for row in table.rows] == [signal.name for signal in found.signals]
        assert [row[2] == "-" for row in table.rows] == [not own for own in MEASURED]
        shown = [float(row[3]) for row in table.rows]
        np.testing.assert_allclose(shown, np.sqrt(found.start_variance), rtol=1e-2)


def test_a_problems_held_out_data_are_estimated_by_themselves(simulator, log):
    """Both sides have estimated states, the held-out side as if it were alone; a simulator without
    nominal parameters is refused.
    """
    one, other = (log[1].select(i).head(40) for i in range(2))
    names = [signal.name for signal in simulator.signals]
    problem = Problem("log", simulator, one, held_out=other)
    found, estimate = with_states(problem, names[2:], causal=True)
    np.testing.assert_array_equal(
        found.trajectories.observations, estimate.trajectories.observations
    )
    alone = estimate_states(simulator, other, simulator.nominal, measured=MEASURED, causal=True)
    np.testing.assert_array_equal(found.held_out.observations, alone.trajectories.observations)
    assert not np.array_equal(found.held_out.observations, other.observations)
    with pytest.raises(UnknownName, match="signal"):
        with_states(problem, ["speed"])
    block = SlidingBlock()
    assert block.nominal is None
    pushed = simulate(block, np.array([[1.0, 0.5]]), np.ones((1, 5, 1)), np.zeros(2))
    with pytest.raises(Incompatible, match="nominal parameters, which SlidingBlock has not"):
        with_states(Problem("block", block, pushed))
