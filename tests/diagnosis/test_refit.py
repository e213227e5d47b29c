"""Fits to windows where predictions bend."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from dropo.diagnosis.findings.causes import standard_errors
from dropo.diagnosis.search.linearization import Library, estimate_noise, linearize
from dropo.diagnosis.search.refit import DEFAULTS, RefitSettings, refit
from dropo.diagnosis.search.windows import split
from tests.models import hidden_in_arm as arms

TRUE = {"contact_stiffness.margin": -0.001, "body_mass:foot": -0.2, "body_inertia:foot": -0.1}


@cache
def fitted(off, settings=DEFAULTS):
    """The hopper's noise-free data fitted with three numbers, begun so far off: library, look, free
    numbers, and their errors (3,).
    """
    problem = arms.problem(
        [(label, [size]) for label, size in TRUE.items()], sigma=1e-9, name="hopper"
    )
    instances = [arms.instance(problem.simulator, label) for label in TRUE]
    library = Library(problem.simulator.with_effects(instances), instances, len(problem.space))
    declared = problem.simulator.nominal
    truth = np.array(list(TRUE.values()))
    free = len(declared) + np.arange(len(TRUE))
    train = split(problem, 5, 96)[0]
    floor = np.full(len(problem.simulator.signals), 1e-6)
    begun = linearize(library, train, np.concatenate([declared, (1 + off) * truth]), 1e3 * floor)
    begun = linearize(library, train, begun.theta, estimate_noise(begun, begun.whiten.sigma, floor))
    found = refit(library, begun, free, floor, settings=settings)
    return library, found, free, found.theta[free] - truth


@pytest.mark.parametrize("off", [0.1, pytest.param(-0.02, marks=pytest.mark.study)])
def test_where_predictions_bend(off):
    """A contact's margin, to which windows answer that an impact has only just reached: found to
    1e-6 of the truth, whatever is near, and within four standard errors.
    """
    library, found, free, errors = fitted(off)
    assert np.all(np.abs(errors) < 1e-6 * np.abs(list(TRUE.values())))
    assert np.all(
        np.abs(errors) < 4 * standard_errors(library, SimpleNamespace(free=free, train=found))
    )


@pytest.mark.study
def test_wide_differences_alone_stop_short():
    """The control: slopes over the usual widths take so small steps that the foot's mass stays 0.1
    % off and more; where the fit is right, as above, the margin's standard error by them is a
    hundredth of what it should be.
    """
    library, found, free, errors = fitted(0.1)
    wide = standard_errors(library, SimpleNamespace(free=free, train=found), close=1e-9)
    assert np.abs(errors / wide).max() > 100
    assert np.abs(fitted(-0.02, RefitSettings(close=1.0))[-1] / list(TRUE.values())).max() > 1e-3
