"""Trains a policy under a distribution of the simulator's parameters."""

import dataclasses
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from dropo.core.contracts.effect import ActiveEffects
from dropo.core.records.fits.fit import Fit
from dropo.training.ars import ARS
from dropo.training.distributions import Curriculum, ParameterDistribution, Predictive
from dropo.training.environments import Target, resolve
from dropo.training.networks import refuse_untrusted_training
from dropo.training.policy import Policy
from dropo.training.setup import Progress, TrainingSetup


@runtime_checkable
class Algorithm(Protocol):
    """A training algorithm: a frozen dataclass of its settings, with a name."""

    @property
    def name(self) -> str:
        """The name on the command line."""

    def train(
        self, setup: TrainingSetup, rng: Generator, folder: Path | None, progress: Progress
    ) -> Policy:
        """Train a policy.

        Parameters
        ----------
        setup : TrainingSetup
            The environments.
        rng : numpy.random.Generator
            Source of all random numbers.
        folder : Path or None
            Where the training is saved, and goes on after an interruption.
        progress : callable
            Called with the fraction done and a text.

        Returns
        -------
        Policy
            The policy; `about` holds its `control_steps` and `failed_simulations`.
        """


def train(
    target: Target,
    distribution: ParameterDistribution | None = None,
    algorithm: Algorithm | None = None,
    *,
    noise: ArrayLike | None = None,
    effects: ActiveEffects = (),
    steps: int | None = None,
    rng: Generator | int = 0,
    threads: int = 1,
    out: str | Path | None = None,
    progress: Progress | None = None,
    trusted: bool = True,
) -> Policy:
    """Train a policy under a distribution of the target's parameters, drawn for every episode.

    Parameters
    ----------
    target : Problem, str or Path
        A problem with a task, its name or file, or the id of a Gymnasium MuJoCo environment.
    distribution : ParameterDistribution, optional
        A Fit, Uniform or Point, or a Curriculum of one of them; None for the model as it is.
    algorithm : ARS, PPO or SAC, optional
        The algorithm with its settings, by default ARS().
    noise : float or (p,) array, optional
        Variances of the measurement noise, one or one a signal; by default those that the fit
        learned, 0 for none.
    effects : sequence of (EffectInstance, array)
        Effects of a Gymnasium environment's robot beside its model, as `problem.simulator.fixed` of
        an extended problem. A problem brings its own.
    steps : int, optional
        Steps of an episode, by default the target's.
    rng : numpy.random.Generator or int
        Source of all random numbers, or its seed.
    threads : int
        Number of threads, 0 for all cores. The policy of ARS does not depend on it.
    out : str or Path, optional
        A folder that keeps the training. The same call goes on after an interruption, ARS to the
        same policy; `rng` must then be the same seed or a new generator of that seed.
    progress : callable, optional
        Called with the fraction done and a text.
    trusted : bool
        Go on with networks too: the files of stable-baselines3 in `out` may hold code that runs as
        they are read.

    Returns
    -------
    Policy
        The policy; `about` says how it was trained.

    Raises
    ------
    UnknownName
        If there is no such target.
    Incompatible
        If the distribution does not fit the target, the target has no task, or `out` holds a
        network that is not trusted.
    BadArgument
        If `noise`, `effects` or `steps` cannot be used.
    BadFile
        If the training in `out` cannot be read.
    MissingPackage
        If stable-baselines3 is not installed, for PPO and SAC.
    SimulationFailed
        If the simulation diverges under draw after draw.
    """
    algorithm = ARS() if algorithm is None else algorithm
    target = resolve(target)
    folder = None if out is None else Path(out)
    if folder is not None:
        if not trusted:
            refuse_untrusted_training(folder)
        folder.mkdir(parents=True, exist_ok=True)
    setup = TrainingSetup(target, distribution, noise, effects, steps, threads)
    report = progress or (lambda fraction, text: None)
    policy = algorithm.train(setup, np.random.default_rng(rng), folder, report)
    policy.about.update(about(setup, algorithm))
    return policy


def about(setup: TrainingSetup, algorithm: Algorithm) -> dict[str, Any]:
    """Return what a policy's file says about its training, as JSON.

    Parameters
    ----------
    setup : TrainingSetup
        The environments.
    algorithm : Algorithm
        The algorithm with its settings.

    Returns
    -------
    dict
        Algorithm, settings, target, distribution (as "law"), steps of an episode and version.
    """
    from dropo._version import __version__

    env = setup.batched_env(1)
    env.close()
    return {
        "algorithm": algorithm.name,
        "settings": settings(algorithm),
        "target": env.name,
        "law": distribution_name(setup.distribution),
        "steps": env.length,
        "version": __version__,
    }


def settings(algorithm: Algorithm) -> dict[str, Any]:
    """Write an algorithm's settings as JSON.

    Parameters
    ----------
    algorithm : Algorithm
        A dataclass.

    Returns
    -------
    dict
        Plain values by field.
    """
    assert dataclasses.is_dataclass(algorithm)
    assert not isinstance(algorithm, type)
    return asdict(algorithm)


def distribution_name(distribution: ParameterDistribution | None) -> str:
    """Describe a distribution in a few words.

    Parameters
    ----------
    distribution : ParameterDistribution or None
        What parameters are drawn from; None for the model's own.

    Returns
    -------
    str
        Words for the middle of a sentence.
    """
    if distribution is None:
        return "the model as it is"
    if isinstance(distribution, Curriculum):
        full = distribution_name(distribution.distribution)
        return f"{full}, widening over {distribution.steps} steps"
    if isinstance(distribution, Predictive):
        return f"{distribution_name(distribution.fit)}, with the uncertainty of its means"
    if isinstance(distribution, Fit):
        return f"{distribution.method} fit of {distribution.problem}"
    return type(distribution).__name__.lower()
