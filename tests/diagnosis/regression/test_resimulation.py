"""Motions simulated anew with what regression found, so that its own bias is part of its errors."""

import numpy as np
import pytest

from dropo.core.contracts.effect import instances_of
from dropo.diagnosis.regression.quick import (
    QuickSettings,
    _with_bias,
    estimate_missing,
    fixed_numbers,
    sides,
)
from dropo.diagnosis.regression.resimulation import resimulated
from tests.models.first_models import problem_with


@pytest.fixture(scope="module")
def arm():
    """An arm on servos, the data that are fitted, and what regression finds."""
    problem = problem_with("arm, 3 joints", np.random.default_rng(14), runs=1)[1]
    fitted = sides(problem, 0.2)[0]
    return problem, fitted, estimate_missing(problem, fitted, QuickSettings())


def test_runs_begin_as_measured_and_go_on_by_commands_alone(arm):
    """They stay near the measured ones, are no copy of them, and have the same commands."""
    problem, fitted, estimate = arm
    extended = problem.simulator.with_effects((), fixed_numbers(problem.simulator, estimate))
    again = resimulated(extended, fitted)
    begins = [start for start, _ in fitted.spans]
    np.testing.assert_array_equal(again.observations[begins], fitted.observations[begins])
    np.testing.assert_array_equal(again.actions, fitted.actions)
    following = np.delete(np.arange(len(fitted)), begins)
    np.testing.assert_array_equal(
        again.observations[following], again.next_observations[following - 1]
    )
    error = np.abs(again.next_observations - fitted.next_observations)[:, :3].mean(axis=0)
    assert (error > 0).all()
    assert (error < 0.1 * fitted.next_observations.std(axis=0)[:3]).all()


def test_motions_that_are_others_say_nothing(arm):
    """Servos of a tenth of their gain sag far from what was measured."""
    problem, fitted, _ = arm
    gain = next(iter(instances_of(problem.simulator.effect_context, "actuator_gain")))
    weak = problem.simulator.with_effects((), [(gain, np.array([-0.9]))])
    assert resimulated(weak, fitted) is None


def test_errors_have_what_is_found_otherwise_there(arm):
    """No number becomes more certain, and some less."""
    problem, fitted, estimate = arm
    errors = _with_bias(problem, fitted, estimate, QuickSettings()).errors
    told = np.isfinite(estimate.errors)
    assert (errors[told] >= estimate.errors[told]).all()
    assert (errors[told] > 1.01 * estimate.errors[told]).any()
