"""Fisher scoring finds what textbooks say, on bounds too."""

import numpy as np
import pytest
import scipy.optimize

from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.contracts.support.fisher_scoring import FisherScoringSettings, maximize_locally
from dropo.core.records.parameters import Parameter, ParameterSpace


class Textbook(LocalLogLikelihood):
    """A log-likelihood from a function to its value, score and information."""

    def __init__(self, value_score_information, *parameters):
        self.unknowns = ParameterSpace(parameters)
        self._expand = value_score_information

    def value_score_information(self, phi):
        value, score, information = self._expand(phi)
        return value, score[None], information

    def predict(self, values):
        raise NotImplementedError

    def _rows(self, phi):
        return np.array([self._expand(phi)[0]])

    def epsilon(self, phi):
        return np.zeros(0)

    def mean(self, phi):
        return np.zeros((1, 0))


def regression(low, high):
    """Normal linear regression: a concave quadratic with correlated unknowns."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(40, 3)) @ np.array([[1, 0.8, 0], [0, 1, 0.5], [0, 0, 1]])
    y = x @ [1.0, -2.0, 0.5] + rng.normal(size=40)
    value_score_information = lambda b: (
        -0.5 * float(np.sum((y - x @ b) ** 2)),
        x.T @ (y - x @ b),
        x.T @ x,
    )
    return Textbook(
        value_score_information, *(Parameter(f"b{i}", low, high) for i in range(3))
    ), scipy.optimize.lsq_linear(x, y, (low, high), tol=1e-14).x


def logistic(low, high):
    """Logistic regression; the answer by scipy's bounded quasi-Newton method."""
    rng = np.random.default_rng(1)
    x = np.column_stack([np.ones(200), rng.normal(size=(200, 2))])
    y = rng.random(200) < 1 / (1 + np.exp(-x @ [0.3, 1.0, -1.5]))

    def value_score_information(b):
        chance = 1 / (1 + np.exp(-x @ b))
        value = float(np.sum(np.where(y, np.log(chance), np.log1p(-chance))))
        return value, x.T @ (y - chance), (x * (chance * (1 - chance))[:, None]).T @ x

    cost = lambda b: (-value_score_information(b)[0], -value_score_information(b)[1])
    answer = scipy.optimize.minimize(
        cost, np.zeros(3), jac=True, bounds=[(low, high)] * 3, options={"ftol": 1e-15, "gtol": 1e-9}
    ).x
    return Textbook(
        value_score_information, *(Parameter(f"b{i}", low, high) for i in range(3))
    ), answer


def schools(effects):
    """Random effects y_i ~ N(mean, error_i^2 + scale^2), Rubin's (1981) eight schools' standard
    errors; the answer by profiling.
    """
    error = np.array([15.0, 10, 16, 11, 9, 11, 10, 18])
    y = np.array(effects, dtype=float)

    def value_score_information(phi):
        variance = error**2 + phi[1] ** 2
        score = np.array(
            [
                np.sum((y - phi[0]) / variance),
                phi[1] * np.sum((y - phi[0]) ** 2 / variance**2 - 1 / variance),
            ]
        )
        information = np.diag([np.sum(1 / variance), 2 * phi[1] ** 2 * np.sum(1 / variance**2)])
        return (
            -0.5 * float(np.sum((y - phi[0]) ** 2 / variance + np.log(variance))),
            score,
            information,
        )

    def best_mean(scale):
        weight = 1 / (error**2 + scale**2)
        return weight @ y / weight.sum()

    profile = scipy.optimize.minimize_scalar(
        lambda s: -value_score_information(np.array([best_mean(s), s]))[0],
        bounds=(0, 60),
        method="bounded",
        options={"xatol": 1e-10},
    )
    scale = max(1e-5, profile.x)
    if value_score_information(np.array([best_mean(1e-5), 1e-5]))[0] >= -profile.fun:
        scale = 1e-5
    space = Parameter("mean.effect", -100, 100), Parameter("scale.effect", 1e-5, 60, scale="log")
    return Textbook(value_score_information, *space), np.array([best_mean(scale), scale])


def noise_variance():
    """A normal variance, searched in logarithms: the answer is the mean square."""
    y = np.random.default_rng(2).normal(0.0, 0.02, 300)
    value_score_information = lambda v: (
        -0.5 * float(np.sum(y**2) / v[0] + len(y) * np.log(v[0])),
        np.array([0.5 * (np.sum(y**2) / v[0] ** 2 - len(y) / v[0])]),
        np.array([[0.5 * len(y) / v[0] ** 2]]),
    )
    return Textbook(
        value_score_information, Parameter("epsilon", 1e-8, 1e4, scale="log")
    ), np.array([np.mean(y**2)])


PROBLEMS = {
    "regression, inside": lambda: regression(-5.0, 5.0),
    "regression, on bounds": lambda: regression(-1.5, 0.2),
    "logistic, inside": lambda: logistic(-5.0, 5.0),
    "logistic, on bounds": lambda: logistic(-1.0, 0.5),
    "eight schools, no spread": lambda: schools([28, 8, -3, 7, -1, 1, 18, 12]),
    "eight schools, tripled": lambda: schools([84, 24, -9, 21, -3, 3, 54, 36]),
    "variance": noise_variance,
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_scoring_finds_the_textbook_answer(name):
    """From the middle, both corners and five random starts; the same answer as scipy's, inside and
    on bounds.
    """
    problem, answer = PROBLEMS[name]()
    width = problem.unknowns.high - problem.unknowns.low
    units = [np.full(len(answer), u) for u in (0.5, 0.0, 1.0)] + list(
        np.random.default_rng(0).random((5, len(answer)))
    )
    for unit in units:
        start = problem.unknowns.from_unit(unit)
        found = maximize_locally(problem, start)
        assert found.converged, (name, start)
        assert found.value >= problem.value_score_information(answer)[0] - 1e-8
        np.testing.assert_allclose(
            found.phi,
            answer,
            atol=2e-5 * width.max(),
            rtol=2e-3 if "schools" in name or name == "variance" else 0,
        )


def test_eight_schools_have_a_certified_spread_of_zero():
    """The published effects have their maximum at scale 0 with the weighted mean 7.686; tripled, at
    a positive one.
    """
    problem, answer = PROBLEMS["eight schools, no spread"]()
    found = maximize_locally(problem, np.array([0.0, 20.0]))
    assert found.phi[0] == pytest.approx(7.686, abs=5e-4)
    assert found.phi[1] == problem.unknowns.low[1] == answer[1]
    assert found.score[1] < 0  # in the variance: the likelihood falls as it leaves 0
    assert PROBLEMS["eight schools, tripled"]()[1][1] > 10


def test_scoring_without_rounds_says_so():
    problem, _ = PROBLEMS["logistic, inside"]()
    assert not maximize_locally(
        problem, np.full(3, 4.0), FisherScoringSettings(evaluations=2)
    ).converged
