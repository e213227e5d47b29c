"""Errors on data held out: the same windows and the same number wherever a run shows them."""

from dataclasses import replace

import numpy as np
import pytest

from dropo import Diagnose, LeastSquares
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Signal, Trajectories
from dropo.core.services.errors import BadArgument
from dropo.evaluation.held_out import (
    OF_DIAGNOSIS,
    SETTINGS,
    errors_of,
    held_out_part,
    held_out_windows,
    horizon_segments,
    noise_free_spread,
    rms_by_unit,
    rms_of_motion,
    whole_part,
)
from dropo.evaluation.predictions import predict
from dropo.problems.simulated.slide import NOISE
from dropo.simulators.toy import SlidingBlock, simulate
from tests.models.hidden_in_arm import problem as arm

TRUTH = np.array([1.5, 0.8])


def data(trajectories=12, steps=30, seed=3):
    """Pushes of a block of one mass and damping, measured with noise."""
    rng = np.random.default_rng(seed)
    actions = np.repeat(rng.normal(0.0, 3.0, (trajectories, -(-steps // 5), 1)), 5, axis=1)[
        :, :steps
    ]
    values = np.repeat(TRUTH[None], trajectories, axis=0)
    return simulate(SlidingBlock(), values, actions, np.zeros(2), noise_variance=NOISE, rng=rng)


def block(**more):
    """The problem of the pushes, with others held out."""
    settings = {"held_out": data(seed=4), "epsilon": NOISE, **more}
    return Problem("block", SlidingBlock(), data(), **settings)


def test_over_signals_of_a_unit_the_mean_is_taken():
    """Root mean square, not the norm: two signals of one unit that are off by 3 and 4."""
    signals = [Signal("x", "m"), Signal("y", "m"), Signal("v", "m/s"), Signal("c")]
    found = rms_by_unit(signals, np.array([9.0, 16.0, 4.0, 1.0]))
    assert found == pytest.approx({"m": np.sqrt(12.5), "m/s": 2.0, "-": 1.0})
    assert rms_of_motion(np.array([4.0, 9.0, 1.0]), np.array([2.0, 1.0, 0.0])) == pytest.approx(
        np.sqrt(5)
    )
    assert np.isnan(rms_of_motion(np.ones(1), np.zeros(1)))


def test_a_fits_figures_agree():
    """fit.json at its lambda, the errors by signal, those by horizon, and a hand-written sum."""
    one = block(horizon=5)
    fit = LeastSquares().fit(one, rng=0)
    found = predict(one, fit)
    errors = fit.held_out
    assert (errors.steps, found.rows_after) == (5, 5)
    expected = dict(zip(("m", "m/s"), found.after.by_signal.tolist(), strict=True))
    assert errors.rmse == pytest.approx(expected, rel=1e-12)
    at = found.horizons.tolist().index(5)
    overall = np.sqrt(np.mean((found.after.by_signal / found.spread) ** 2))
    assert found.after.by_horizon[at] == pytest.approx(overall, rel=1e-12)
    windows = held_out_windows(whole_part(one.held_out), 5)
    assert len(windows) == errors.rows == 12 * 26
    off = one.simulator.targets(windows) - one.simulator.predict(fit.mean[None], windows)[0]
    assert errors.rmse["m"] == pytest.approx(np.sqrt(np.mean(off[:, 0] ** 2)), rel=1e-12)


def test_a_diagnosis_figures_agree():
    """Table, pictures and causes, after the horizon of its windows."""
    found = Diagnose(("joint_damping",), length=5, windows=24).run(
        arm([("joint_damping:elbow", [0.05])])
    )
    told = found.to_json()
    assert told["extended"]["horizons_s"] == [h.seconds for h in found.extended.horizons]
    assert list(told["baseline"]["rmse"]) == [str(h.steps) for h in found.baseline.horizons]
    at = next(h for h in found.extended.horizons if h.steps == 5)
    (cause,) = found.causes
    assert cause.rmse_after == pytest.approx(at.rmse, rel=1e-12)
    assert found.motion.horizons.tolist() == [h.steps for h in found.extended.horizons]
    np.testing.assert_array_equal(
        found.motion.after.by_horizon, [h.rmse for h in found.extended.horizons]
    )
    np.testing.assert_array_equal(found.motion.after.by_signal, at.by_signal)
    units = [signal.unit for signal in found.problem.simulator.signals]
    same = np.array([unit == "rad" for unit in units])
    assert same.sum() > 1
    assert at.units["rad"][0] == pytest.approx(np.sqrt(np.mean(at.by_signal[same] ** 2)), rel=1e-12)


@pytest.mark.parametrize("count", [1, 3, 8])
@pytest.mark.parametrize("horizon", [1, 7, 40])
def test_no_row_that_was_fitted_is_held_out(count, horizon):
    """At no horizon, with few trajectories or many; windows of a horizon are always the same."""
    one = block(held_out=None)
    one = replace(one, trajectories=data(count, 600 // count))
    fitted = held_out_part(one, 5, held_out=False)
    unseen = held_out_part(one, 5)
    windows = held_out_windows(unseen, horizon)
    assert len(windows) or horizon == 40
    assert not set(windows.steps.ravel().tolist()) & set(np.flatnonzero(fitted.chosen).tolist())
    assert len(windows) <= SETTINGS.count(horizon, int(unseen.chosen.sum()))
    np.testing.assert_array_equal(windows.steps, held_out_windows(unseen, horizon).steps)


def test_windows_of_a_diagnosis_overlap_little():
    """Of 600 rows those of 30 steps are 40, each row in two; those of a fit are 160."""
    assert OF_DIAGNOSIS.count(30, 600) == 40
    assert SETTINGS.count(30, 600) == 160
    assert OF_DIAGNOSIS.count(1, 10**6) == SETTINGS.count(1, 10**6) == SETTINGS.maximum


def test_failed_windows_are_left_out_and_counted():
    """And a fit says null where some simulation diverged."""
    one = block()
    part = whole_part(one.held_out)
    windows = held_out_windows(part, 5)
    predictions = np.repeat(one.simulator.targets(windows)[None], 3, axis=0) + 0.5
    predictions[1, :4] = np.nan
    predictions[2] = np.nan
    spread = noise_free_spread(one.simulator, part, np.zeros(2))
    whole, some, none = errors_of(one.simulator, predictions, windows, spread)
    assert whole.by_unit == pytest.approx({"m": 0.5, "m/s": 0.5})
    assert (some.by_unit, some.failed) == (pytest.approx(whole.by_unit), 4)
    assert (none.failed, np.isnan(none.overall)) == (len(windows), True)

    class Fragile(SlidingBlock):
        nominal = np.array([4.0, 0.8])

        def _replay(self, value, starts, actions):
            good = super()._replay(value, starts, actions)
            return good if value[0] < 2.5 else np.full((*actions.shape[:2], 2), np.nan)

    found = LeastSquares().fit(replace(one, simulator=Fragile()), rng=0).held_out
    assert found.to_json()["held_out"]["rmse_nominal"] == {"m": None, "m/s": None}
    assert found.rmse["m"] > 0


def test_starts_are_where_the_state_is_measured():
    """At every measurement, in the fit's own chains, or at the beginning of trajectories."""
    one = block()
    part = whole_part(one.held_out)
    assert len(horizon_segments(one, part, 3)) == 12 * 28
    columns = np.array([True, False])
    chained = horizon_segments(replace(one, reset="partial", set_columns=columns), part, 3)
    assert (len(chained), int(chained.previous.max())) == (12 * 10, 12 * 10 - 2)
    begun = horizon_segments(replace(one, reset="start"), part, 3)
    assert begun.steps[:, 0].tolist() == [start for start, _ in one.held_out.spans]
    whole = LeastSquares().fit(replace(one, reset="start"), rng=0).held_out
    assert (whole.rows, whole.steps) == (12 * 30, 30)


def test_a_lambda_longer_than_what_is_held_out_is_refused():
    """As it is for the data that are fitted."""
    with pytest.raises(BadArgument, match="lambda = 5 is longer than trajectory 0"):
        LeastSquares().fit(block(horizon=5, held_out=data(steps=4)), rng=0)


def test_noise_is_taken_off_the_spread():
    """The standard deviation of the motion; of a constant signal 0, and of mere noise what the
    settings leave.
    """
    rng = np.random.default_rng(0)
    rows = np.stack([rng.standard_normal(4000), np.ones(4000)], axis=1)
    rows[:, 0] *= np.sqrt(4.0 + 1.0)
    ends = np.arange(4000) == 3999
    part = whole_part(Trajectories(rows, np.zeros((4000, 1)), rows, ends))
    spread = noise_free_spread(SlidingBlock(), part, np.array([1.0, 1.0]))
    assert spread == pytest.approx([2.0, 0.0], rel=0.05)
    assert noise_free_spread(SlidingBlock(), part, np.array([9.0, 0.0]))[0] == pytest.approx(
        np.sqrt(5e-3), rel=0.05
    )
