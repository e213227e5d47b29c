"""Least squares: what it recovers, how sure it is, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.records.fits.fit import Status
from dropo.core.records.parameters import Parameter
from dropo.core.services.errors import BadArgument, SimulationFailed, UnknownName
from dropo.estimators.least_squares import LeastSquares
from dropo.problems.simulated.slide import MEAN, slide
from dropo.simulators.function import FunctionSimulator
from dropo.simulators.toy import LinearSimulator, SlidingBlock, simulate
from tests.models.interrupted_block import InterruptedBlock
from tests.reference.pushes import Problem, pushes, z_of_mean


@pytest.mark.parametrize("weights", ["noise", "equal", (2.0, 0.5)])
def test_slide_is_recovered(weights):
    """The means lie within 4.5 standard errors, themselves under 4 %; data of a mass of 1.7 kg are
    rejected.
    """
    fit = LeastSquares(weights=weights).fit(slide())
    assert fit.status is Status.CONVERGED
    assert (np.abs(z_of_mean(fit, MEAN)) < 4.5).all()
    assert (fit.mean_se < 0.04 * MEAN).all()
    other = LeastSquares(weights=weights).fit(pushes(50, mean=np.array([1.7, 0.8])))
    assert abs(z_of_mean(other, MEAN)[0]) > 4.5


def test_a_point_estimate_has_no_spread():
    """Family point, scales and sds 0, no standard error of a scale; its noise is the residuals'
    variance.
    """
    fit = LeastSquares().fit(slide())
    assert fit.family == "point"
    assert fit.scale.tolist() == fit.sd.tolist() == [0.0, 0.0]
    assert np.isnan(fit.scale_se).all()
    assert fit.mse == pytest.approx(fit.epsilon.mean(), rel=1e-12)
    assert fit.phi.tolist() == fit.mean.tolist()


BETWEEN = 16
"""The call with which the second pass begins."""


def test_an_interruption_leaves_the_best_so_far():
    """Nearer to the end the later it comes; before the first point there is none. Between both
    passes it leaves the end of the first one.
    """
    problem = slide()
    end = LeastSquares().fit(problem).mean
    away = []
    for at in (4, 6, BETWEEN):
        fit = LeastSquares().fit(replace(problem, simulator=InterruptedBlock(at)))
        assert fit.status is Status.INTERRUPTED
        assert "this is the best so far" in fit.message
        away.append(np.abs(fit.mean - end).max())
    assert away[0] > 2 * away[1] > 4 * away[2]
    with pytest.raises(KeyboardInterrupt):
        LeastSquares().fit(replace(problem, simulator=InterruptedBlock(at=1)))


@pytest.mark.parametrize("weights", ["equal", (4.0, 0.25, 1.0)])
def test_a_linear_simulator_has_the_normal_equations(weights):
    """(H' W H)^-1 H' W y in one step, to 1e-9."""
    rng = np.random.default_rng(0)
    simulator = LinearSimulator(rng.normal(size=(2, 3, 2)))
    actions = rng.normal(size=(30, 1, 2))
    data = simulate(
        simulator, np.tile([1.0, -2.0], (30, 1)), actions, np.zeros(3), noise_variance=0.1, rng=rng
    )
    fit = LeastSquares(weights=weights).fit(Problem("line", simulator, data))
    w = np.tile(np.ones(3) if weights == "equal" else weights, 30)
    design = np.concatenate([np.einsum("q,qpd->pd", a, simulator.matrices) for a in actions[:, 0]])
    change = (data.next_observations - data.observations).ravel()
    exact = np.linalg.solve(design.T @ (w[:, None] * design), design.T @ (w * change))
    np.testing.assert_allclose(fit.mean, exact, atol=1e-9)


def test_noise_weights_are_the_efficient_ones():
    """With 10,000 times more noise on the position, weighting by the residuals' variance errs less
    than equal weights, in 20 data sets.
    """
    errors = {"noise": [], "equal": []}
    for seed in range(20):
        problem = pushes(seed, sd=0.0, noise=[1e-4, 1e-8], count=5)
        for weights, found in errors.items():
            found.append(LeastSquares(weights=weights).fit(problem).mean - MEAN)
    rms = {weights: np.sqrt(np.mean(np.square(found), axis=0)) for weights, found in errors.items()}
    assert (rms["noise"] < 0.7 * rms["equal"]).all(), rms


def test_data_without_noise_give_the_truth():
    """Errors below 1e-8 of the means."""
    fit = LeastSquares().fit(pushes(0, sd=0.0, noise=0.0, count=5))
    np.testing.assert_allclose(fit.mean, MEAN, rtol=1e-8)


def test_a_budget_that_runs_out_is_told():
    fit = LeastSquares(budget=1).fit(slide())
    assert fit.status is Status.OUT_OF_BUDGET
    assert fit.message == "The budget of 1 evaluations ran out first."
    few = LeastSquares(budget=4).fit(slide())
    assert few.status is Status.OUT_OF_BUDGET
    assert few.objective_evaluations <= 4 + 2  # the first misfit, and the end's errors


def test_an_estimate_on_a_bound_is_told():
    """A true mass above the search interval ends on it, with the parameter's name, bound and what
    to do.
    """
    fit = LeastSquares().fit(pushes(0, mean=np.array([5.0, 0.8]), sd=0.0))
    assert fit.mean[0] == pytest.approx(4.0)
    assert (
        "mean.mass ends on its upper bound 4: widen it, or the model cannot explain the data"
        in fit.warnings
    )


class Breaks(SlidingBlock):
    """Diverges above a mass, or where the command is above a limit."""

    mass = force = np.inf

    def _replay(self, value, starts, actions):
        out = super()._replay(value, starts, actions)
        out[(actions[:, 0, 0] > self.force) | (value[0] > self.mass)] = np.nan
        return out


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (
            (2.0, np.inf),
            "In the middle of the box, 40 of 40 simulated rows diverged, the first at row "
            "0 with mass = 2.25, damping = 1.55."
            " Narrow the bounds.",
        ),
        (
            (np.inf, 1.0),
            "Least squares met a simulation that diverged: 75 of 200 simulated rows "
            "diverged, the first at row 0 with mass = 2.25,"
            " damping = 1.55. Narrow the bounds.",
        ),
    ],
)
def test_a_divergence_is_refused(limits, message):
    """How many rows, where, and what to do; whether all of them diverge or some."""
    problem = pushes(0, simulator=Breaks(), sd=0.0, count=2)
    problem.simulator.mass, problem.simulator.force = limits
    with pytest.raises(SimulationFailed) as refusal:
        LeastSquares().fit(problem)
    assert str(refusal.value) == message


def test_steps_of_differences():
    """Over a saw of 1e-4 kg, differences of a thousandth of the interval see the line and find its
    end; those of 3e-6 kg see the teeth.
    """

    def saw(value, starts, actions):
        return starts[:, None] + actions * (value[0] + 1e-4 * np.sin(value[0] / 1e-5))

    simulator = FunctionSimulator(saw, [Parameter("mass", 0.5, 4.0)], ["y"])
    rng = np.random.default_rng(0)
    data = simulate(
        simulator,
        np.full((100, 1), 1.7),
        rng.normal(size=(100, 1, 1)),
        np.zeros(1),
        noise_variance=1e-4,
        rng=rng,
    )
    fit = LeastSquares().fit(Problem("saw", simulator, data))
    assert abs(fit.mean[0] - 1.7) < 4.5 * fit.mean_se[0]
    assert fit.mean_se[0] == pytest.approx(1e-3, rel=0.35)
    assert (
        abs(LeastSquares(step=1e-6).fit(Problem("saw", simulator, data)).mean[0] - 1.7)
        > 4.5 * fit.mean_se[0]
    )


def test_refusals():
    with pytest.raises(
        BadArgument,
        match=r"'step' of LeastSquares must be a fraction of the interval in \(0, 0.5\]",
    ):
        LeastSquares(step=0.0)
    with pytest.raises(BadArgument) as refusal:
        LeastSquares(budget=0)
    assert str(refusal.value) == "The 'budget' of LeastSquares must be at least 1. Got 0 instead."
    with pytest.raises(UnknownName) as refusal:
        LeastSquares(weights="equally")
    assert str(refusal.value) == "No weights called 'equally'. Did you mean 'equal'?"
    with pytest.raises(BadArgument) as refusal:
        LeastSquares(weights=(1.0, 2.0, 3.0)).fit(slide())
    assert (
        str(refusal.value)
        == "The 'weights' of LeastSquares must be of shape (2,). Got (3,) instead."
    )
