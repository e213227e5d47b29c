"""The related methods on the hopper, and returns of policies trained under their fits.

These are the tasks of the study.
"""

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.random import Generator

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.interactive_estimator import Answer, distribution
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit
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
from dropo.studies.tiboni_2021.hopper_sets import HopperStudySize as Sets

OFFLINE = ("dropo", "dropo, published", "random effects", "droid", "least squares", "epopt", "npe")
ONLINE = ("simopt", "bayrn", "adr")
METHODS = (*OFFLINE, *ONLINE, "uniform randomization")
TRUTH = "the truth"
SMALLEST = 1e-9  # [kg] the standard deviation of masses that do not vary
SETTINGS: dict[str, dict[str, Any]] = {
    "npe": {"simulations": 300},
    "bayrn": {"budget": 12},
    "adr": {"budget": 1200, "step": 0.04},
}
"""Fewer simulations than the methods' own defaults, so that the study takes an hour."""


@dataclass(frozen=True)
class RelatedStudySize:
    """How large the study is.

    Attributes
    ----------
    transitions : int
        Transitions of a data set, in two trajectories.
    seeds : int
        Number of data sets.
    methods : tuple of str
        Methods that are compared.
    published : (int, int, int)
        K, evaluations, and the stride between transitions, of the published method.
    droid : int
        Evaluations of DROID.
    settings : dict
        Settings of the other methods by their names, if they are not the methods' own.
    updates : int
        Updates of the search for a policy; 0 for no policies, and then no BayRn.
    steps : int
        Control steps of an episode.
    episodes : int
        Episodes in which a policy is evaluated.
    probe : int
        Control steps of ADR's single episodes.
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
"""What a task takes: table, seed and size of the data, and more."""


def item(table: str, seed: int, size: RelatedStudySize, **more: Any) -> Item:
    """The item of a task.

    Parameters
    ----------
    table : str
        Number of the thesis' table whose masses the data have.
    seed : int
        Seed of the data.
    size : RelatedStudySize
        How large the study is.
    **more
        What else the task takes, such as `method`.

    Returns
    -------
    dict
        Plain values, which name the task in the list of finished ones.
    """
    return {"table": table, "seed": seed, "size": asdict(size), **more}


class TargetRobot:
    """The hopper that the data come from, as callbacks of interactive estimators see it.

    Its masses vary as in a table of the thesis, and its measurements have noise.

    Parameters
    ----------
    table : str
        Number of the table.
    problem : Problem
        The problem that the methods fit.
    size : RelatedStudySize
        How large the study is.

    Attributes
    ----------
    spread : (4,) array
        Standard deviations of its masses [kg].
    distribution : Fit
        The distribution of its masses.
    """

    def __init__(self, table: str, problem: Problem, size: RelatedStudySize):
        self.problem = problem
        self.size = size
        self.spread = SPREAD[table]
        covariance = np.diag(np.maximum(self.spread, SMALLEST) ** 2)
        phi = FullGaussian(problem.space).phi_of(MEAN, covariance)
        self.distribution = distribution(problem, "truth", "full", phi)

    def collect(self, transitions: int) -> Any:
        """The callback of SimOpt that collects data under the stored policy.

        Parameters
        ----------
        transitions : int
            Number of transitions.

        Returns
        -------
        callable
            `collect(fit, rng)` gives Trajectories, whatever the fit.
        """

        def masses(rng: Generator, blocks: int) -> Array:
            return MEAN + self.spread * rng.standard_normal((blocks, len(MEAN)))

        def collect(fit: Fit, rng: Generator) -> Trajectories:
            block = BLOCK if self.spread.any() else None
            data, _ = simulate(
                transitions, 1, rng=rng, masses=masses, block=block, noise_variance=NOISE
            )
            return data

        return collect

    def evaluate(self, fit: Fit, rng: Generator) -> Answer[float]:
        """The callback of BayRn: the return here of a policy trained under a fit.

        Parameters
        ----------
        fit : Fit
            The distribution of the masses in training.
        rng : Generator
            Source of training and episodes.

        Returns
        -------
        Answer
            The mean return, with the transitions and the simulator steps that it took.
        """
        returns, control_steps, lengths = self.returns(fit, rng)
        steps = control_steps * FRAME_SKIP
        return Answer(float(np.mean(returns)), transitions=sum(lengths), steps=steps)

    def returns(self, fit: Fit, rng: Generator) -> tuple[list[float], int, list[int]]:
        """Returns here of a policy trained under a fit by a short search.

        Parameters
        ----------
        fit : Fit
            The distribution of the masses in training.
        rng : Generator
            Source of training and episodes.

        Returns
        -------
        returns : list of float
            Return of each episode.
        control_steps : int
            Control steps of its training, without its trials.
        lengths : list of int
            Control steps of each episode.
        """
        from dropo.training.ars import ARS
        from dropo.training.evaluate import evaluate
        from dropo.training.train import train

        size = self.size
        training_rng, episodes_rng = rng.spawn(2)
        search = ARS(updates=size.updates)
        policy = train(self.problem, fit, search, noise=0.0, steps=size.steps, rng=training_rng)
        rollouts = evaluate(
            policy,
            self.problem,
            distribution=self.distribution,
            episodes=size.episodes,
            steps=size.steps,
            noise=0.0,
            rng=episodes_rng,
        )
        control_steps = int(policy.about["control_steps"])
        return rollouts.returns.tolist(), control_steps, rollouts.lengths.tolist()

    def performance(self, values: Array, rng: Generator) -> Answer[float]:
        """The callback of ADR: whether the stored policy does not fall in a simulated episode.

        Parameters
        ----------
        values : (d,) array
            Parameters of the episode.
        rng : Generator
            Source of the episode.

        Returns
        -------
        Answer
            1 if it does not fall, else 0, with the simulator steps that it took.
        """
        from dropo.training.distributions import Point
        from dropo.training.evaluate import evaluate
        from dropo.training.policy import LinearPolicy

        stored = hopper_policy()
        limits = np.array([[-1.0] * 3, [1.0] * 3])
        policy = LinearPolicy(stored.weights, stored.mean, stored.deviation, limits)
        rollouts = evaluate(
            policy,
            self.problem,
            distribution=Point(self.problem.space, values),
            episodes=1,
            steps=self.size.probe,
            noise=0.0,
            rng=rng,
        )
        is_upright = float(rollouts.lengths[0] == self.size.probe)
        return Answer(is_upright, steps=int(rollouts.lengths.sum()) * FRAME_SKIP)


def _size(item: Item) -> RelatedStudySize:
    """The item's size."""
    return RelatedStudySize(**item["size"])


def estimator(method: str, target: TargetRobot, size: RelatedStudySize) -> Estimator:
    """Build a method with its callbacks.

    Parameters
    ----------
    method : str
        One of `METHODS`.
    target : TargetRobot
        Where interactive methods collect data and evaluate.
    size : RelatedStudySize
        Settings of the methods.

    Returns
    -------
    Estimator
    """
    settings = size.settings.get(method, {})
    if method == "simopt":
        iterations = settings.get("iterations", SimOpt.iterations)
        return SimOpt(collect=target.collect(size.transitions // iterations), **settings)
    if method == "bayrn":
        return BayRn(evaluate=target.evaluate, **settings)
    if method == "adr":
        return ADR(performance=target.performance, **settings)
    if method == "epopt":
        return EPOpt(**settings)
    if method == "npe":
        return NPE(**settings)
    if method == "uniform randomization":
        return UniformRandomization(**settings)
    return hopper_fits.estimator(method, Sets(droid=size.droid, published=size.published))


def fitted(item: Item) -> dict[str, Any]:
    """Fit the item's data by its `method`.

    Parameters
    ----------
    item : dict
        As `item` gives it, with `method`.

    Returns
    -------
    dict
        The distribution found, and its cost.
    """
    size = _size(item)
    method = item["method"]
    problem, _ = data_set(item["table"], "noisy", item["seed"], size.transitions)
    if method == "dropo, published":
        problem = every(size.published[2], problem)
    target = TargetRobot(item["table"], problem, size)
    fit = estimator(method, target, size).fit(problem, rng=item["seed"])
    record = fit.search_record
    transitions = fit.transitions
    if record is not None and record.target_transitions is not None:
        transitions = record.target_transitions
    return {
        "family": fit.family,
        "phi": fit.phi.tolist(),
        "mean": fit.mean.tolist(),
        "sd": fit.sd.tolist(),
        "steps": fit.simulator_steps,
        "transitions": 0 if method == "uniform randomization" else transitions,
        "status": fit.status.value,
        "message": fit.message,
    }


def returned(item: Item) -> dict[str, Any]:
    """Returns on the target of a policy trained under the item's `distribution`.

    Parameters
    ----------
    item : dict
        As `item` gives it, with `distribution`: [family, phi], or None for the target's own.

    Returns
    -------
    dict
        returns: of each episode.
    """
    size = _size(item)
    problem, _ = data_set(item["table"], "noisy", item["seed"], size.transitions)
    target = TargetRobot(item["table"], problem, size)
    fit = target.distribution
    if item["distribution"] is not None:
        family, phi = item["distribution"]
        fit = distribution(problem, "related", family, np.array(phi))
    returns, _, _ = target.returns(fit, np.random.default_rng(item["seed"]))
    return {"returns": returns}
