"""Segments whose simulation blows up are named and left out, and the fit ends in a result."""

import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Signal, Trajectories
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.estimators.dropo import DROPO
from dropo.simulators.function import FunctionSimulator
from dropo.simulators.toy import SlidingBlock, simulate

TRUTH = np.array([1.5, 0.8])
PUSHES, STEPS = 10, 20


def explode(how, out, third, marked, value):
    """What becomes of predictions (n, L, 2) and (n, L, 1) of marked starts."""
    if how == "not finite":
        out[marked] = np.nan
    elif how == "signal that does not vary":
        third[marked] = 1e34 * value[0]
    elif how == "velocity":
        out[marked, :, 1] = 1e34 * value[0]
    elif how == "beside the truth":
        out[marked, :, 1] += 1e30 * (value[0] > TRUTH[0])


def pushes(how, marked):
    """A block with a third signal that is always 0; marked rows' starts make it explode."""
    block = SlidingBlock()
    rng = np.random.default_rng(0)
    forces = np.repeat(rng.normal(0, 3, (PUSHES, STEPS // 5, 1)), 5, axis=1)
    values = np.tile(TRUTH, (PUSHES, 1))
    data = simulate(block, values, forces, np.zeros(2), noise_variance=1e-6, rng=rng)
    mark = np.zeros((len(data), 1))
    mark[marked] = 1e-3

    def function(value, starts, actions):
        out = block._replay(value, starts[:, :2], actions)
        third = np.zeros((*out.shape[:2], 1))
        explode(how, out, third, starts[:, 2] > 0, value)
        return np.concatenate([out, third], axis=2)

    signals = [*block.signals, Signal("stuck", "rad")]
    simulator = FunctionSimulator(function, block.space.parameters, signals)
    simulator.control_step = block.dt
    measured = Trajectories(
        np.hstack([data.observations, mark]),
        data.actions,
        np.hstack([data.next_observations, 0 * mark]),
        data.terminals,
    )
    return Problem("pushes", simulator, measured)


@pytest.mark.parametrize(
    ("how", "signal"),
    [
        ("not finite", "all signals"),
        ("signal that does not vary", "stuck"),
        ("velocity", "velocity"),
        ("beside the truth", ""),
    ],
)
def test_it_is_named_and_left_out(how, signal):
    """By segment, time and signal; the result is that of the other segments, to a tenth se."""
    rows = [37, 191]
    fit = DROPO(family="point").fit(pushes(how, rows), rng=0)
    sound = pushes("not at all", rows)
    kept = np.setdiff1d(np.arange(len(sound.trajectories)), rows)
    rest = Problem("rest", sound.simulator, sound.trajectories.rows(kept))
    expected = DROPO(family="point").fit(rest, rng=0)
    assert np.all(np.abs(fit.mean - expected.mean) < 0.1 * expected.mean_se)
    np.testing.assert_allclose(fit.epsilon[:2], expected.epsilon[:2], rtol=0.05)
    (sentence,) = (text for text in fit.warnings if "blows up" in text)
    assert "2 of 200 segments" in sentence
    assert "segment 37 (trajectory 1, 0.85 s)" in sentence
    assert f"in {signal} after 1 step" in sentence if signal else "step" not in sentence


def test_where_most_blow_up_the_model_is_wrong():
    """Nothing is left out, and the refusal says which row."""
    with pytest.raises(SimulationFailed, match="row"):
        DROPO(family="point").fit(pushes("not finite", np.arange(0, 200, 3)), rng=0)


def test_an_interrupted_run_goes_the_same_way(tmp_path):
    """A resumed run meets the designs that failed in their places, and ends alike, bit for bit."""
    path = tmp_path / "log.jsonl"
    whole = DROPO(family="point").fit(
        pushes("not finite", [37]), rng=0, evaluation_log=EvaluationLog(path, {})
    )
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-1]))
    again = DROPO(family="point").fit(
        pushes("not finite", [37]), rng=0, evaluation_log=EvaluationLog(path, {})
    )
    np.testing.assert_array_equal(again.mean, whole.mean)
    assert again.warnings == whole.warnings
