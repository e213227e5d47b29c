"""Do the statistical tests of `dropo.testing` reject what is wrong, and pass what is right?

Truths are two numbers from N(0, 1), each measured once with noise of variance 1, so the posterior
is known: N(y / 2, 1 / 2). The exact posterior is tested, and ones that are biased or too narrow.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest, norm

from dropo.core.services.tables import number
from dropo.core.services.validation import Array, require
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.testing.statistics import coverage, expected_coverage, simulation_based_calibration

TESTS = ("coverage", "ranks", "expected coverage")
"""The tests, by their names in the table."""


@dataclass(frozen=True)
class ControlSettings:
    """How large the study is, and what counts as rejected.

    Attributes
    ----------
    repeats : int
        Of every test of every control.
    replications : int
        Data sets in each.
    rejected : float
        A control is to have a p-value below this.
    level : float
        Right posteriors have a p-value below this as often as it says, or less.
    """

    repeats: int = 100
    replications: int = 400
    rejected: float = 1e-3
    level: float = 0.05


DEFAULT = ControlSettings()


@dataclass(frozen=True)
class Gaussians:
    """A posterior N(y / 2 + bias, factor^2 / 2) of both numbers.

    Attributes
    ----------
    bias : float
        Of its mean.
    factor : float
        On its standard deviation.
    """

    bias: float = 0.0
    factor: float = 1.0

    def fit(self, problem: Any, rng: np.random.Generator) -> Any:
        """Draw from it.

        Parameters
        ----------
        problem : (2,) array
            What was measured.
        rng : numpy.random.Generator
            For 200 draws.

        Returns
        -------
        mean : (2,) array
            Of the posterior.
        sd : float
            Its standard deviation.
        draws : (200, 2) array
        """
        mean = np.asarray(problem) / 2 + self.bias
        sd = self.factor * np.sqrt(0.5)
        return mean, sd, rng.normal(mean, sd, (200, 2))


CONTROLS = {
    "right": Gaussians(),
    "half the spread": Gaussians(factor=0.5),
    "20 % too narrow": Gaussians(factor=0.8),
    "biased by half an sd": Gaussians(bias=0.35),
    "biased by an sd": Gaussians(bias=0.7),
}
"""The posteriors that are tested."""


def controls(work: Work, seeds: int | None = None, *, settings: ControlSettings = DEFAULT) -> Study:
    """How often the statistical tests reject posteriors that are wrong, and one that is right.

    Parameters
    ----------
    work : Work
        Runs the tests.
    seeds : int or None
        Repeats of each test; None for the settings' number.
    settings : ControlSettings
        The number of data sets, and what counts as rejected.

    Returns
    -------
    Study
        Shares of rejections and largest p-values, by control and test.

    Raises
    ------
    BadArgument
        If there are fewer than 50 replications, five for each bin of ranks.
    """
    repeats = settings.repeats if seeds is None else seeds
    count = settings.replications
    require(count >= 50, "replications", "at least 50, for five in a bin", count, "controls")
    rows = []
    data = {}
    for name in CONTROLS:
        answers = work.map(p_values_of, [[name, count, seed] for seed in range(repeats)])
        p_values = np.array([answer["p"] for answer in answers])
        data[name] = {"p": p_values}
        for test, own in zip(TESTS, p_values.T, strict=True):
            rows.append((name, test, *_cells(own, settings)))
    header = (
        "posterior",
        "test",
        f"p < {settings.level:g}",
        "95 %",
        f"p < {settings.rejected:g}",
        "median p",
        "largest p",
    )
    remarks = (
        f"{repeats} repeats of {count} data sets each, of two numbers whose posterior is known. The"
        f" p-value of a test is Bonferroni's over both. Of right ones {settings.level:.0%} or less"
        f" are to be below {settings.level:g}; the interval is Clopper and Pearson's.",
        "Expected coverage, by distances to random points, sees a bias less well than ranks do:"
        " what points on one side see too near, others see too far.",
    )
    title = f"Controls of the statistical tests, {repeats} repeats"
    table = Table("How often a test rejects", header, tuple(rows))
    return Study("controls", title, (table,), remarks, data)


def p_values_of(item: list[Any]) -> dict[str, Any]:
    """All three tests of one posterior.

    Parameters
    ----------
    item : list
        The control's name, the number of data sets, and the seed.

    Returns
    -------
    dict
        p: p-values, in the order of `TESTS`.
    """
    name, replications, seed = item
    posterior = CONTROLS[name]
    held = coverage(posterior, _draw, intervals=_interval, replications=replications, rng=seed)
    ranked = simulation_based_calibration(
        posterior, _draw, draws=_drawn, replications=replications, rng=seed
    )
    expected = expected_coverage(
        posterior, _draw, draws=_drawn, replications=replications, rng=seed
    )
    return {"p": [held.p_value, ranked.p_value, expected.p_value]}


def _cells(p_values: Array, settings: ControlSettings) -> tuple[str, ...]:
    """Shares of small p-values, the interval of the first, and how large they are."""
    small = int((p_values < settings.level).sum())
    interval = binomtest(small, len(p_values)).proportion_ci(0.95)
    return (
        f"{small / len(p_values):.0%}",
        f"{interval.low:.0%}-{interval.high:.0%}",
        f"{np.mean(p_values < settings.rejected):.0%}",
        number(float(np.median(p_values)), 2),
        number(float(p_values.max()), 2),
    )


def _draw(rng: np.random.Generator) -> tuple[Any, Array]:
    """What was measured (2,), and the truth (2,) from its prior."""
    truth = rng.standard_normal(2)
    return truth + rng.standard_normal(2), truth


def _interval(fit: Any, level: float) -> Array:
    """(2, 2) central intervals of the posterior."""
    mean, sd, _ = fit
    half = norm.ppf(0.5 + level / 2) * sd
    return np.stack([mean - half, mean + half], axis=1)


def _drawn(fit: Any) -> Array:
    """(200, 2) draws of the posterior."""
    return np.asarray(fit[2])
