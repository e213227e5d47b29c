"""Numbers of the equation of motion are fitted within their bounds, and never for the worse."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.diagnosis.regression.fit import Payload
from dropo.diagnosis.regression.quick import QuickSettings, estimate_missing
from dropo.diagnosis.regression.readings import sides
from tests.models.first_models import problem_with


@pytest.fixture(scope="module")
def estimate():
    """What an arm of three joints lacks, a payload among it."""
    settings = QuickSettings()
    _, problem = problem_with("arm, 3 joints", np.random.default_rng(11))
    fitted, _ = sides(problem, settings.checked)
    return estimate_missing(problem, fitted, settings)


def test_no_step_leaves_more_than_before(estimate):
    """From payloads of any weight anywhere on any body, by the weights that rows have then."""
    fitter = estimate.fitter
    one = replace(fitter, settings=replace(fitter.settings, steps=1))
    none = replace(fitter, settings=replace(fitter.settings, steps=0))
    rng = np.random.default_rng(0)
    for _ in range(30):
        body = int(rng.integers(len(fitter.reaches)))
        place = fitter.reaches[body] * rng.uniform(-1, 1, 3)
        payload = Payload(body, float(rng.uniform(0.02, 2.0)), place)
        before = none.refined(fitter.delayed(replace(estimate.solution, payload=payload)))
        after = one.refined(before)
        squares = [(fitter.residuals(side) * before.weights) ** 2 for side in (before, after)]
        assert squares[1].sum() <= 1.01 * squares[0].sum()
        assert np.all(np.abs(after.payload.place) <= fitter.reaches[body])
        assert after.payload.mass >= 0


def test_the_best_place_is_found_from_places_beside_it(estimate):
    """From up to 0.1 m beside it along each axis."""
    fitter = estimate.fitter
    rng = np.random.default_rng(2)
    best = estimate.solution.payload
    found = []
    for _ in range(10):
        begun = replace(best, place=best.place + rng.uniform(-0.1, 0.1, 3))
        found.append(fitter.refined(replace(estimate.solution, payload=begun)))
    places = np.array([one.payload.place for one in found])
    assert np.sum(np.abs(places - best.place).max(axis=1) < 0.005) >= 9
