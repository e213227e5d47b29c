"""The checks given to plug-in authors catch optimizers and samplers that are broken on purpose."""

from dataclasses import dataclass

import numpy as np
import pytest

from dropo.core.contracts.optimizer import CallbackOptimizer, Optimizer
from dropo.core.contracts.sampler import first_positions
from dropo.optimizers.cma_es import CMAES
from dropo.optimizers.samplers.emcee import Emcee
from dropo.testing import check_optimizer, check_sampler


class Shrinking(Optimizer):
    """A valid optimizer: normal points around the best one, ever closer."""

    width = 0.3

    def _ask(self):
        self.width *= 0.97
        return np.clip(
            self.best[0] + self.width * self.rng.standard_normal((20, self.dimension)), 0, 1
        )

    def _tell(self, points, costs, gradients):
        pass

    def _stop(self):
        return "The steps became too small." if self.width < 1e-5 else None


class Outside(Shrinking):
    def ask(self):
        return super().ask() + 1.0


class GlobalStream(Shrinking):
    def _ask(self):
        return np.random.random((5, self.dimension))  # noqa: NPY002


class Fickle(Shrinking):
    def _ask(self):
        return np.random.default_rng().random((5, self.dimension))


class Shared(Shrinking):
    """State in the class: two optimizers at once disturb each other."""

    count = 0

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        Shared.count = 0

    def _ask(self):
        Shared.count += 1
        return np.clip(super()._ask() * (0.9 + 0.01 * Shared.count), 0.0, 1.0)


class ForgetsTheBest(Shrinking):
    def tell(self, points, costs, gradients=None):
        self.best = (np.asarray(points)[0], float(costs[0]))


class WrongWay(Shrinking):
    def tell(self, points, costs, gradients=None):
        self.best = (self.best[0], min(self.best[1], min(costs)))


class Stuck(Shrinking):
    def _ask(self):
        return np.tile(self.start, (4, 1))


class Lazy(Shrinking):
    def _ask(self):
        return self.rng.random((2, self.dimension))


class Impatient(Shrinking):
    asked = 0

    def _stop(self):
        self.asked += 1
        return "It was asked once too often." if self.asked % 2 == 0 else None


class Wordless(Shrinking):
    def _stop(self):
        return True if self.width < 0.28 else None


class LeavesItsThread(CallbackOptimizer):
    def _minimise(self, cost):
        while True:
            cost(self.rng.random(self.dimension))

    def close(self):
        pass


class SaysNothing(CallbackOptimizer):
    """Forgets to say why it stopped."""

    reason: object = None

    def _minimise(self, cost):
        for width in 0.3 * 0.97 ** np.arange(60):
            cost(np.clip(self.start + width * self.rng.standard_normal(self.dimension), 0, 1))
        return self.reason


class SaysALine(SaysNothing):
    """Says it in too few words."""

    reason = "done"


class AsksNothing(SaysNothing):
    """Stops before it has asked."""

    def _minimise(self, cost):
        return "There is nothing to do."


def test_a_valid_optimizer_passes():
    check_optimizer(Shrinking, tolerance=0.02)


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (Outside, "leaves the unit box"),
        (GlobalStream, "global random stream"),
        (Fickle, "not deterministic"),
        (Shared, "when a second one runs beside it"),
        (ForgetsTheBest, "the lowest cost given was"),
        (WrongWay, "the lowest cost was given at"),
        (Stuck, "the same point all the time"),
        (Lazy, "away from the minimum of a sphere"),
        (Impatient, "changes its mind"),
        (Wordless, "None or a sentence"),
        (LeavesItsThread, "leaves threads behind"),
        (
            SaysNothing,
            "SaysNothing._minimise must be a sentence that says why it stopped. Got None",
        ),
        (SaysALine, "SaysALine._minimise must return a sentence .*, not 'done'"),
        (AsksNothing, "AsksNothing stops before it has asked for a point"),
    ],
)
def test_broken_optimizers_are_caught(broken, words):
    with pytest.raises(AssertionError, match=words):
        check_optimizer(broken)


def test_a_seed_in_the_global_stream_is_caught():
    """What a plain use of pycma does."""

    class Plain(CMAES):
        def _new_strategy(self, start):
            import cma

            return cma.CMAEvolutionStrategy(
                4 * start, 1, {"seed": 3, "verbose": -10, "verb_log": 0, "bounds": [0, 4]}
            )

    with pytest.raises(AssertionError, match="global random stream"):
        check_optimizer(Plain)


@dataclass(frozen=True)
class Metropolis(Emcee):
    """Random walks of 60 walkers.

    temper: the power of the density that they really draw from; fold: fraction of the proposals
    that are scaled down, so that they are no longer symmetric; stream: whether they use numpy's
    global stream.
    """

    temper: float = 1.0
    fold: float = 0.0
    stream: bool = False

    def _sample(self, density, rng, start, spread):
        points, values = first_positions(density, rng, start, spread, 60)
        chain = []
        logs = []
        for _ in range(3000):
            normal = np.random.standard_normal if self.stream else rng.standard_normal
            step = normal(points.shape)
            proposed = points + 0.07 * step
            proposed = np.where(rng.random((60, 1)) < self.fold, proposed * 0.9, proposed)
            new = density(proposed)
            yes = np.log(rng.random(60)) < self.temper * (new - values)
            points = np.where(yes[:, None], proposed, points)
            values = np.where(yes, new, values)
            chain.append(points)
            logs.append(values)
        return np.array(chain)[500:], np.array(logs)[500:]


@dataclass(frozen=True)
class Misreports(Emcee):
    def _sample(self, density, rng, start, spread):
        found = super()._sample(density, rng, start, spread)
        return found._replace(log_density=found.log_density[::-1])


@dataclass(frozen=True)
class Squeezes(Emcee):
    """Draws that keep off the ends of the box."""

    def _sample(self, density, rng, start, spread):
        def squeezed(points):
            inside = ((points > 0.03) & (points < 0.97)).all(axis=1)
            return np.where(inside, density(np.clip(points, 0, 1)), -np.inf)

        return super()._sample(squeezed, rng, start, spread)


def test_a_valid_sampler_passes():
    check_sampler(Metropolis())


@pytest.mark.parametrize(("moves", "steps"), [("differential", 700), ("stretch", 1000)])
def test_emcee_keeps_the_contract(moves, steps):
    check_sampler(Emcee(steps=steps, burn_in=200, moves=moves))


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (Metropolis(temper=1.1), "the variance of draws from a Gaussian"),
        (Metropolis(fold=0.02), "the mean of draws from a Gaussian"),
        (Metropolis(stream=True), "global random stream"),
        (Misreports(steps=300, burn_in=100), "not those at its draws"),
        (Emcee(steps=20, burn_in=0), "R-hat is"),
        (Squeezes(steps=500, burn_in=100), "the variance of draws from a uniform distribution"),
    ],
)
def test_broken_samplers_are_caught(broken, words):
    with pytest.raises(AssertionError, match=words):
        check_sampler(broken)
