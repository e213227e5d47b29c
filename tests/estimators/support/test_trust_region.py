"""What a search in trust regions says of its own cost."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.noise import Noise
from dropo.core.records.fits.fit import Status
from dropo.estimators.support.trust_region import (
    OuterIterations,
    Stage,
    TrustRegion,
    TrustRegionSettings,
)
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.emulated import Emulated
from dropo.likelihoods.linear import Linear
from dropo.problems.simulated.slide import slide


def search(likelihood, settings, said):
    """Outer iterations on the sliding block, and what they say."""
    problem = slide()
    noise = Noise(np.full(len(problem.simulator.signals), 1e-4), None)
    rng = np.random.default_rng(0)
    run = Run(problem, rng, progress=lambda fraction, text: said.append(text))
    family = TruncatedGaussian(problem.space)
    return OuterIterations(problem, run, family, likelihood, noise, rng, settings=settings)


@pytest.mark.parametrize(
    ("likelihood", "slow", "told"),
    [
        (Emulated(), 0.0, ["an iteration takes 1 s; --likelihood linear would take about 1 s"]),
        (Linear(), 0.0, ["an iteration takes 1 s"]),
        (Emulated(), 3600.0, []),
    ],
)
def test_slow_iterations_are_told_once(likelihood, slow, told):
    """With what linear ones would take, where these are others; quick ones say nothing."""
    said = []
    outer = search(likelihood, TrustRegionSettings(slow_iteration=slow), said)
    space = outer.problem.space
    outer.fit((space.low + space.high) / 2)
    assert len(said) > len(told)
    assert [text for text in said if text.startswith("an iteration takes")] == told


def test_no_round_begins_once_the_budget_is_spent():
    """And the search did not converge, then; a control with enough."""
    outer = search(Emulated(), TrustRegionSettings(budget=1), [])
    middle = outer.problem.space.from_unit(np.full(2, 0.5))
    _, found = outer.fit(middle)
    assert found.status is Status.OUT_OF_BUDGET
    assert found.reason == "The budget of 1 evaluations ran out in round 1: raise it."
    enough = search(Emulated(), TrustRegionSettings(budget=100), [])
    assert enough.fit(middle)[1].status is Status.CONVERGED


def test_what_begins_a_run_is_a_share_of_its_progress():
    """Half of the beginning is half of its share; the rest of the run shows its own."""
    shown = []
    outer = search(Emulated(), TrustRegionSettings(), [])
    run = replace(outer.run, progress=lambda fraction, text: shown.append(fraction))
    with run.beginning(0.1):
        run.progress(0.5, "first")
    run.progress(0.5, "then")
    assert shown == [0.05, 0.5]


def test_the_forecast_counts_simulations():
    """A twelfth of the steps takes a twelfth of the time; no forecast where it would take more."""
    said = []
    outer = search(Emulated(), TrustRegionSettings(), said)
    region = TrustRegion(np.ones(2), np.ones(2), Stage.ALL)
    segments = outer.problem.segments
    linear = 5 * int(segments.lengths.sum()) * outer.problem.simulator.steps_per_action
    outer._show_cost(region, 29.0, 12 * linear)
    outer._show_cost(region, 240.0, 12 * linear)
    outer._show_cost(region, 240.0, 12 * linear)
    assert said == ["an iteration takes 4 minutes; --likelihood linear would take about 20 s"]
    outer._cost_is_shown = False
    outer._show_cost(region, 60.0, linear // 2)
    assert said[1:] == ["an iteration takes 60 s"]
