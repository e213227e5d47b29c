"""The related methods on the hopper, and what policies trained under their fits are worth: the
tasks of that study.
"""

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.random import Generator

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.interactive_estimator import Answer, distribution
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.estimators.adr import ADR
from dropo.estimators.bayrn import BayRn
from dropo.estimators.epopt import EPOpt
from dropo.estimators.npe import NPE
from dropo.estimators.simopt import SimOpt
from dropo.estimators.uniform_randomization import UniformRandomization
from dropo.families.full_gaussian import FullGaussian
from dropo.problems.hopper.data import hopper_policy, simulate
from dropo.problems.hopper.model import FRAME_SKIP
from dropo.problems.hopper.problem import NOISE
from dropo.studies.tiboni_2021 import hopper_fits
from dropo.studies.tiboni_2021.hopper_sets import BLOCK, MEAN, SPREAD, data_set, every
from dropo.studies.tiboni_2021.hopper_sets import Size as Sets

OFFLINE = ("dropo", "dropo, published", "random effects", "droid", "least squares", "epopt", "npe")
ONLINE = ("simopt", "bayrn", "adr")
METHODS = (*OFFLINE, *ONLINE, "uniform randomization")
TRUTH = "the truth"
SMALLEST = 1e-9  # [kg] the spread of masses that do not vary
SETTINGS: dict[str, dict[str, Any]] = {
    "npe": {"simulations": 300},
    "bayrn": {"budget": 12},
    "adr": {"budget": 1200, "step": 0.04},
}
"""Fewer simulations than the methods' own defaults, so that the study takes an hour."""


@dataclass(frozen=True)
class Size:
    """How large the study is.

    transitions: of a data set, in two trajectories; seeds: data sets; methods: those compared.
    published: K, evaluations and the stride between transitions of the published method; droid: its
    evaluations; settings: those of the other methods, by their names, where they are not the
    methods' own. updates: of the search for a policy, 0 for none, and then no bayrn; steps: control
    steps of an episode; episodes: in which a policy is judged; probe: control steps of adr's single
    episodes.
    """

    transitions: int = 1000
    seeds: int = 2
    methods: tuple[str, ...] = METHODS
    published: tuple[int, int, int] = (10, 2000, 10)
    droid: int = 1000
    settings: dict[str, dict[str, Any]] = field(default_factory=lambda: dict(SETTINGS))
    updates: int = 40
    steps: int = 500
    episodes: int = 50
    probe: int = 250


Item = dict[str, Any]


def item(table: str, seed: int, size: Size, **more: Any) -> Item:
    """What the tasks below take."""
    return {"table": table, "seed": seed, "size": asdict(size), **more}


class Machine:
    """The hopper that the data come from, for callbacks: masses that vary as in a table of the
    thesis, noise on what is measured.
    """

    def __init__(self, table: str, problem: Problem, size: Size):
        self.problem = problem
        self.size = size
        self.spread = SPREAD[table]
        covariance = np.diag(np.maximum(self.spread, SMALLEST) ** 2)
        self.distribution = distribution(
            problem, "truth", "full", FullGaussian(problem.space).phi_of(MEAN, covariance)
        )

    def collect(self, transitions: int) -> Any:
        """The callback of SimOpt: so many transitions under the stored policy, whatever the law."""

        def collect(fit: Fit, rng: Generator) -> Trajectories:
            masses = lambda rng, blocks: (
                MEAN + self.spread * rng.standard_normal((blocks, len(MEAN)))
            )
            block = BLOCK if self.spread.any() else None
            return simulate(
                transitions, 1, rng=rng, masses=masses, block=block, noise_variance=NOISE
            )[0]

        return collect

    def evaluate(self, fit: Fit, rng: Generator) -> Answer[float]:
        """The callback of BayRn: the return here of a policy that a short search finds under the
        fit.
        """
        returns, control_steps, lengths = self.returns(fit, rng)
        return Answer(
            float(np.mean(returns)), transitions=sum(lengths), steps=control_steps * FRAME_SKIP
        )

    def returns(self, fit: Fit, rng: Generator) -> tuple[list[float], int, list[int]]:
        """Returns here of a policy trained under the fit; the control steps of its training,
        without its trials; the episodes' lengths.
        """
        from dropo.training.ars import ARS
        from dropo.training.evaluate import evaluate
        from dropo.training.train import train

        size = self.size
        (training, playing) = rng.spawn(2)
        policy = train(
            self.problem, fit, ARS(updates=size.updates), noise=0.0, steps=size.steps, rng=training
        )
        played = evaluate(
            policy,
            self.problem,
            distribution=self.distribution,
            episodes=size.episodes,
            steps=size.steps,
            noise=0.0,
            rng=playing,
        )
        return played.returns.tolist(), int(policy.about["control_steps"]), played.lengths.tolist()

    def performance(self, values: Array, rng: Generator) -> Answer[float]:
        """The callback of ADR: 1 where the stored policy does not fall in an episode in simulation,
        else 0.
        """
        from dropo.training.distributions import Point
        from dropo.training.evaluate import evaluate
        from dropo.training.policy import LinearPolicy

        kept = hopper_policy()
        limits = np.array([[-1.0] * 3, [1.0] * 3])
        policy = LinearPolicy(kept.weights, kept.mean, kept.deviation, limits)
        point = Point(self.problem.space, values)
        played = evaluate(
            policy,
            self.problem,
            distribution=point,
            episodes=1,
            steps=self.size.probe,
            noise=0.0,
            rng=rng,
        )
        return Answer(
            float(played.lengths[0] == self.size.probe),
            steps=int(played.lengths.sum()) * FRAME_SKIP,
        )


def _size(item: Item) -> Size:
    return Size(**item["size"])


def estimator(method: str, machine: Machine, size: Size) -> Estimator:
    """The method of that name with its callbacks."""
    given = size.settings.get(method, {})
    if method == "simopt":
        rounds = given.get("iterations", SimOpt.iterations)
        return SimOpt(collect=machine.collect(size.transitions // rounds), **given)
    if method == "bayrn":
        return BayRn(evaluate=machine.evaluate, **given)
    if method == "adr":
        return ADR(performance=machine.performance, **given)
    if method in ("epopt", "npe"):
        return {"epopt": EPOpt, "npe": NPE}[method](**given)
    if method == "uniform randomization":
        return UniformRandomization(**given)
    return hopper_fits.estimator(method, Sets(droid=size.droid, published=size.published))


def fitted(item: Item) -> dict[str, Any]:
    """The item's method on its data: the law that it finds, and its cost."""
    size = _size(item)
    method = item["method"]
    problem, _ = data_set(item["table"], "noisy", item["seed"], size.transitions)
    if method == "dropo, published":
        problem = every(size.published[2], problem)
    fit = estimator(method, Machine(item["table"], problem, size), size).fit(
        problem, rng=item["seed"]
    )
    record = fit.search_record
    used = fit.transitions
    if record is not None and record.target_transitions is not None:
        used = record.target_transitions
    if method == "uniform randomization":
        used = 0
    return {
        "family": fit.family,
        "phi": fit.phi.tolist(),
        "mean": fit.mean.tolist(),
        "sd": fit.sd.tolist(),
        "steps": fit.simulator_steps,
        "transitions": used,
        "status": fit.status.value,
        "message": fit.message,
    }


def returned(item: Item) -> dict[str, Any]:
    """Returns on the machine of a policy trained under the item's `law` [family, phi], or the
    machine's own where it has none.
    """
    size = _size(item)
    problem, _ = data_set(item["table"], "noisy", item["seed"], size.transitions)
    machine = Machine(item["table"], problem, size)
    given = item["law"]
    fit = (
        machine.distribution
        if given is None
        else distribution(problem, "related", given[0], np.array(given[1]))
    )
    return {"returns": machine.returns(fit, np.random.default_rng(item["seed"]))[0]}
