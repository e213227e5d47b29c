"""What a search in trust regions says of its own cost."""

import numpy as np
import pytest

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.noise import Noise
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
