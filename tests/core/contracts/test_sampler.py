"""Draws and their diagnostics, against processes whose answers are known in closed form."""

import numpy as np
import pytest

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.sampler import Sampler, first_positions
from dropo.core.records.draws import ChainTooShort, Draws
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.optimizers.samplers.emcee import Emcee
from dropo.simulators.toy import LinearSimulator, simulate

SPACE = ParameterSpace((Parameter("a", -1.0, 3.0), Parameter("b", 0.1, 10.0, scale="log")))


def autoregressive(rho, steps, walkers, rng):
    """(S, W) x_t = rho x_{t-1} + sqrt(1 - rho^2) e_t, stationary: autocorrelation time (1 + rho) /
    (1 - rho).
    """
    noise = rng.standard_normal((steps, walkers))
    out = np.empty_like(noise)
    out[0] = noise[0]
    for t in range(1, steps):
        out[t] = rho * out[t - 1] + np.sqrt(1 - rho**2) * noise[t]
    return out


def draws(*columns):
    chain = np.stack(columns, axis=2)
    return Draws(chain, np.zeros(chain.shape[:2]), tuple(f"x{i}" for i in range(len(columns))))


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_autocorrelation_time_of_autoregressive_walkers(rho):
    """Within 4.5 standard errors, tau sqrt((4 M + 2) / n) with window M = 5 tau (Sokal 1989, eq.
    3.19); the control fails.
    """
    true = (1 + rho) / (1 - rho)
    n = 4000 * 20
    found = draws(autoregressive(rho, 4000, 20, np.random.default_rng(1))).autocorrelation_time()[0]
    error = true * np.sqrt((4 * 5 * true + 2) / n)
    assert abs(found - true) < 4.5 * error + 0.02 * true  # the window leaves exp(-5) of the sum out
    assert abs(found - 2 * true) > 4.5 * error + 0.02 * true


def test_effective_sample_size_predicts_the_error_of_the_mean():
    """The spread of 200 means agrees with sd / sqrt(ESS) within 4.5 standard errors of a spread;
    with S W instead it does not.
    """
    rng = np.random.default_rng(2)
    means = []
    sizes = []
    for _ in range(200):
        one = draws(autoregressive(0.8, 600, 8, rng))
        means.append(one.flat().mean())
        sizes.append(one.effective_sample_size()[0])
    ratio = np.std(means) * np.sqrt(np.mean(sizes))
    error = 1 / np.sqrt(2 * 200)
    assert abs(ratio - 1) < 4.5 * error
    assert abs(np.std(means) * np.sqrt(600 * 8) - 1) > 4.5 * error


def test_r_hat_of_mixed_walkers_is_one_and_of_others_is_not():
    """Independent draws give R-hat 1 to within 0.01; walkers in two places, a drift, or two widths
    do not.
    """
    rng = np.random.default_rng(3)
    x = rng.standard_normal((1000, 8))
    apart = x + np.where(np.arange(8) < 4, 0.0, 1.0)
    drift = x + np.linspace(0, 3, 1000)[:, None]
    widths = x * np.where(np.arange(8) < 4, 1.0, 2.0)
    r_hat = draws(x, apart, drift, widths).split_r_hat()
    assert abs(r_hat[0] - 1) < 0.01
    assert (r_hat[1:] > 1.05).all()


def test_r_hat_by_hand():
    """Chains (0, 1), (0, 1) in each half: equal chains have R-hat sqrt((n - 1) / n)."""
    x = np.tile([0.0, 1.0, 2.0, 3.0], 2)[:, None].repeat(2, axis=1)  # halves 0 1 2 3 and 0 1 2 3
    assert draws(x).split_r_hat()[0] == pytest.approx(np.sqrt(3 / 4))


def test_walkers_that_do_not_mix_have_a_long_time():
    rng = np.random.default_rng(4)
    x = rng.standard_normal((500, 10)) + 10 * np.arange(10)
    assert draws(x).autocorrelation_time(minimum=0)[0] > 100


def test_constant_draws_are_no_independent_draws():
    x = np.ones((100, 4))
    stuck = draws(x)
    assert stuck.effective_sample_size()[0] == pytest.approx(4)
    assert stuck.split_r_hat()[0] == np.inf


def test_too_short_a_chain_raises_with_its_estimate():
    short = draws(autoregressive(0.9, 200, 20, np.random.default_rng(5)))
    with pytest.raises(
        ChainTooShort, match=r"200 steps are fewer than 50 autocorrelation times of 'x0'"
    ) as caught:
        short.autocorrelation_time()
    assert caught.value.estimate == pytest.approx(short.autocorrelation_time(minimum=0))
    assert 8 < caught.value.estimate[0] < 30  # 19 in truth


def test_flat_discards_and_thins():
    x = np.arange(20.0).reshape(10, 2)
    assert draws(x).flat(discard=4, thin=3)[:, 0].tolist() == [8.0, 9.0, 14.0, 15.0]
    assert draws(x).flat().shape == (20, 1)
    with pytest.raises(BadArgument, match=r"'discard' of Draws\.flat must be in 0 \.\.\. 9"):
        draws(x).flat(discard=10)


def test_summary_is_a_table():
    rng = np.random.default_rng(6)
    lines = (
        draws(rng.normal(3.0, 0.1, (500, 8)), rng.normal(-1.0, 2.0, (500, 8)))
        .summary()
        .splitlines()
    )
    assert lines[0].split() == [
        "parameter",
        "mean",
        "sd",
        "5",
        "%",
        "median",
        "95",
        "%",
        "autocorr.",
        "ESS",
        "R-hat",
    ]
    assert [line.split()[0] for line in lines[2:]] == ["x0", "x1"]
    assert float(lines[2].split()[1]) == pytest.approx(3.0, abs=0.01)


def test_draws_refuse_other_shapes_and_infinite_densities():
    with pytest.raises(BadArgument, match="'log_density' of Draws must be of shape"):
        Draws(np.zeros((10, 4, 1)), np.zeros((10, 3)), ("a",))
    with pytest.raises(BadArgument, match="'log_density' of Draws must be finite"):
        Draws(np.zeros((10, 4, 1)), np.full((10, 4), -np.inf), ("a",))


def test_a_flat_density_is_flat_in_the_logarithm():
    """ "b" is on a log scale, so its logarithm is uniform: the median is 1 = sqrt(0.1 * 10), not
    5.05.
    """
    found = Emcee(steps=2000, burn_in=200).sample(
        lambda x: np.zeros(len(x)), SPACE, rng=np.random.default_rng(1)
    )
    share = (found.flat()[:, 1] < 1.0).mean()
    error = 0.5 / np.sqrt(found.effective_sample_size()[1])
    assert abs(share - 0.5) < 4.5 * error < 0.1


class Walk(Sampler):
    """Hands out the first positions for ever; records what it was given."""

    def evaluations(self, dimension):
        return 10

    def _sample(self, density, rng, start, spread):
        points, values = first_positions(density, rng, start, spread, 10)
        return np.tile(points, (5, 1, 1)), np.tile(values, (5, 1))


def test_first_positions_avoid_what_has_no_density():
    """Half of the box fails with NaN; all walkers begin in the other half."""
    half = lambda x: np.where(x[:, 0] < 1.0, 0.0, np.nan)
    found = Walk().sample(
        half, SPACE, rng=np.random.default_rng(1), start=[0.4, 1.0], spread=[0.5, 0.3]
    )
    assert (found.chain[..., 0] < 1.0).all()
    assert (found.chain[..., 1] <= 10.0).all()
    with pytest.raises(
        BadArgument, match="'start' of first_positions must be where the density is positive"
    ):
        Walk().sample(lambda x: np.full(len(x), -np.inf), SPACE, rng=np.random.default_rng(1))


def test_density_is_never_asked_outside_the_box():
    seen = []

    def density(x):
        seen.append(x)
        return np.zeros(len(x))

    Emcee(steps=100, burn_in=0).sample(
        density, SPACE, rng=np.random.default_rng(1), start=[0.0, 1.0], spread=0.3
    )
    points = np.concatenate(seen)
    assert (points >= SPACE.low).all()
    assert (points <= SPACE.high).all()


def test_bad_densities_and_starts_are_refused():
    rng = np.random.default_rng(1)
    with pytest.raises(BadArgument, match=r"'log density' of Walk\.sample must be below infinity"):
        Walk().sample(lambda x: np.full(len(x), np.inf), SPACE, rng=rng)
    with pytest.raises(
        BadArgument, match=r"'log density' of Walk\.sample must be of shape \(10,\)"
    ):
        Walk().sample(lambda x: np.zeros((len(x), 1)), SPACE, rng=rng)
    with pytest.raises(BadArgument, match=r"'start' of Walk\.sample must be inside \[0, 1\]"):
        Walk().sample(lambda x: np.zeros(len(x)), SPACE, rng=rng, start=[0.5, 2.0])
    space = ParameterSpace(tuple(Parameter(n, 0.0, 1.0) for n in "abc"))
    with pytest.raises(
        BadArgument, match=r"'walkers' of Emcee must be at least 6, twice the 3 parameters"
    ):
        Emcee(walkers=5).sample(lambda x: np.zeros(len(x)), space, rng=rng)


def test_killed_sampling_resumes(tmp_path):
    """Through an evaluation log: killed at the 700th point and taken up again, the same draws, and
    no point evaluated twice.
    """

    def problem():
        simulator = LinearSimulator(np.ones((1, 1, 1)))
        return Problem(
            "none",
            simulator,
            simulate(simulator, np.array([[1.0]]), np.ones((1, 3, 1)), np.zeros(1)),
        )

    class Density:
        def __init__(self, dies_after=np.inf):
            self.calls = 0
            self.dies_after = dies_after

        def __call__(self, x):
            if self.calls > self.dies_after:
                raise RuntimeError("killed")
            self.calls += len(x)
            return -0.5 * ((x - 1.0) ** 2).sum(axis=1)

    def sample(density, evaluation_log):
        run = Run(problem(), np.random.default_rng(7), evaluation_log)
        return Emcee(steps=40, burn_in=10).sample(
            density, SPACE, rng=run.rng, evaluate=run.evaluate
        )

    whole = Density()
    straight = sample(whole, EvaluationLog())
    path = tmp_path / "journal"
    with pytest.raises(RuntimeError, match="killed"):
        sample(Density(dies_after=700), EvaluationLog(path))
    recorded = sum(len(entry["points"]) for entry in EvaluationLog(path)._known)
    again = Density()
    resumed = sample(again, EvaluationLog(path))
    assert recorded > 700
    assert again.calls == whole.calls - recorded
    assert np.array_equal(resumed.chain, straight.chain)
    assert np.array_equal(resumed.log_density, straight.log_density)
