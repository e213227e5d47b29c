"""An interruption after a search has ended, in its errors and checks, costs those alone."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.records.fits.fit import Status
from dropo.estimators.droid import DROID
from dropo.estimators.dropo import DROPO
from dropo.estimators.epopt import EPOpt
from dropo.estimators.least_squares import LeastSquares
from dropo.estimators.posterior import Posterior
from dropo.estimators.random_effects import RandomEffects
from dropo.estimators.uniform_randomization import UniformRandomization
from dropo.optimizers.samplers.emcee import Emcee
from tests.models.interrupted_block import InterruptedBlock
from tests.reference.pushes import pushes

METHODS = {
    "dropo": DROPO(),
    "sampled": DROPO(likelihood="monte-carlo", draws=5, budget=60),
    "random-effects": RandomEffects(),
    "least-squares": LeastSquares(),
    "droid": DROID(budget=60),
    "epopt": EPOpt(particles=50, rounds=2),
    "posterior": Posterior(over="parameters", sampler=Emcee(steps=20, burn_in=10)),
    "uniform-randomization": UniformRandomization(draws=10),
}


@pytest.mark.parametrize("method", METHODS)
def test_the_fit_is_kept(method):
    """The same means and spreads, marked as interrupted, at the last simulation."""
    problem = pushes(3, epsilon=1e-6, count=6)
    counting = InterruptedBlock()
    whole = METHODS[method].fit(replace(problem, simulator=counting))
    assert whole.status is not Status.INTERRUPTED
    simulator = InterruptedBlock(at=counting.calls)
    fit = METHODS[method].fit(replace(problem, simulator=simulator))
    assert simulator.calls == counting.calls
    assert fit.status is Status.INTERRUPTED
    assert "Interrupted at the end" in fit.message
    np.testing.assert_array_equal(fit.mean, whole.mean)
    np.testing.assert_array_equal(fit.sd, whole.sd)
