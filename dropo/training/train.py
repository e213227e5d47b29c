"""Trains a policy under a distribution of the simulator's parameters."""

import dataclasses
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from dropo.core.contracts.effect import ActiveEffects
from dropo.training.ars import ARS
from dropo.training.distributions import Curriculum, ParameterDistribution
from dropo.training.environments import Target, resolve
from dropo.training.policy import Policy
from dropo.training.setup import Progress, TrainingSetup


@runtime_checkable
class Algorithm(Protocol):
    """Frozen settings with a name, and how they train."""

    @property
    def name(self) -> str:
        """What the command line calls it."""

    def train(
        self, setup: TrainingSetup, rng: Generator, folder: Path | None, progress: Progress
    ) -> Policy:
        """A policy for the stage; the folder is where an interrupted training is kept and goes on
        from.
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
) -> Policy:
    """Trains a policy for a target whose parameters are drawn from a law at the start of every
    episode.

    target: a Problem with a task, its name or file, or the id of a Gymnasium MuJoCo environment;
    law, noise, effects, steps: as for `randomize`. algorithm: ARS(...), PPO(...) or SAC(...); None:
    ARS(). threads: 0 for all cores; what ARS finds does not depend on them. out: a folder that
    keeps the training at every stage: the same call goes on after an interruption, ARS to the same
    policy; rng must be the same, as a seed or a new generator. progress: called with the share done
    and a text.
    """
    algorithm = ARS() if algorithm is None else algorithm
    target = resolve(target)
    folder = None if out is None else Path(out)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    setup = TrainingSetup(target, distribution, noise, effects, steps, threads)
    policy = algorithm.train(
        setup, np.random.default_rng(rng), folder, progress or (lambda share, text: None)
    )
    policy.about.update(about(setup, algorithm))
    return policy


def about(setup: TrainingSetup, algorithm: Algorithm) -> dict[str, Any]:
    """What a policy's file says of its training."""
    from dropo._version import __version__

    one = setup.batched_env(1)
    steps = one.length
    name = one.name
    one.close()
    return {
        "algorithm": algorithm.name,
        "settings": settings(algorithm),
        "target": name,
        "law": distribution_name(setup.distribution),
        "steps": steps,
        "version": __version__,
    }


def settings(algorithm: Algorithm) -> dict[str, Any]:
    """An algorithm's settings as JSON."""
    assert dataclasses.is_dataclass(algorithm)
    assert not isinstance(algorithm, type)
    return asdict(algorithm)


def distribution_name(distribution: ParameterDistribution | None) -> str:
    """A few words on a law."""
    if isinstance(distribution, Curriculum):
        return (
            f"{distribution_name(distribution.distribution)}, widening over "
            f"{distribution.steps} steps"
        )
    if distribution is None:
        return "the model as it is"
    method = getattr(distribution, "method", None)
    return (
        f"{method} fit of {getattr(distribution, 'problem', '?')}"
        if method
        else type(distribution).__name__.lower()
    )
