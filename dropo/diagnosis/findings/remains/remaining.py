"""What is still wrong with everything that was found: in which joints and signals, and in which
regime.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.tails import normal_tail
from dropo.core.services.validation import Array
from dropo.diagnosis.findings.remains.omnibus import omnibus
from dropo.diagnosis.findings.remains.unexplained_forces import (
    Unexplained,
    impulses_of,
    unexplained_force,
)
from dropo.diagnosis.parts import Remaining
from dropo.diagnosis.search.confirmation import gain_of
from dropo.diagnosis.search.invariance import drifting, standing_out
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.trials import State


@dataclass(frozen=True)
class RemainingSettings:
    """When learned noise is reported as an error of the model.

    Attributes
    ----------
    surprising : float
        Multiple of the stated noise, as a standard deviation, above which the learned noise stands
        for something else.
    """

    surprising: float = 3.5


SETTINGS = RemainingSettings()


def remaining(
    problem: Problem,
    library: Library,
    last: State,
    floor: Array,
    rng: np.random.Generator,
    settings: RemainingSettings = SETTINGS,
    *,
    by_motions: bool = False,
) -> tuple[Remaining, Unexplained]:
    """Test what a search left unexplained.

    Tested are random forces in every step, structure in state and command, noise beyond what was
    stated, and declared parameters that change.

    Parameters
    ----------
    problem : Problem
        That is diagnosed.
    library : Library
        The simulator with every effect.
    last : State
        The model with all that was found.
    floor : (p,) array
        The least noise of each signal.
    rng : numpy.random.Generator
        Draws the random features of the test for structure.
    settings : RemainingSettings
        When learned noise is an error of the model.
    by_motions : bool
        Whether whole motions say if forces remain. Random forces then count only where velocities
        were measured: the errors of estimated ones follow each other as if such forces acted.

    Returns
    -------
    remaining : Remaining
        What is still wrong, in words.
    forces : Unexplained
        The forces that nothing explains.
    """
    forces = unexplained_force(library, last.train, last.test, floor, gain_of)
    present = forces.present and not (by_motions and problem.estimated)
    structure = omnibus(last.train, last.test, rng, measured=are_measured(problem))
    names = force_names(library)
    signals = library.simulator.signals

    where = []
    for name in _noisier_than_stated(problem, last, settings):
        where.append(f"noise of {name} beyond what was stated")
    for name in drifting(library, last.test, problem.space.names):
        where.append(f"{name}, which changes with time")
    regime = None
    sd_by_joint: dict[str, float] = {}
    if present:
        worst = int(np.argmax(forces.sd * forces.scale))
        joint, unit = names[worst]
        size = f"{forces.sd[worst]:.3g} {unit}"
        where.append(f"forces of {size} at {joint} that nothing explains")
        regime = standing_out(last.test.windows, library, forces.excess)
        for (name, own_unit), sd in zip(names, forces.sd, strict=True):
            sd_by_joint[f"{name} [{own_unit}]"] = float(sd)
    if structure.present:
        strongest = signals[int(np.argmax(structure.signals))]
        where.append(f"{strongest.name}, which state and command predict")
    if regime:
        where.append(f"mostly {regime}")

    z = max(forces.z if present else 0.0, structure.z)
    p_value = float(max(normal_tail(z), np.finfo(float).tiny))
    return Remaining(not where, p_value, tuple(where), sd_by_joint), forces


def are_measured(problem: Problem) -> NDArray[np.bool_]:
    """Return which signals are measured.

    What was estimated from others is off in its own way, and says nothing against a model that they
    do not.

    Parameters
    ----------
    problem : Problem
        That is diagnosed.

    Returns
    -------
    (p,) bool array
        All where none is.
    """
    names = [signal.name for signal in problem.simulator.signals]
    measured = np.array([name not in problem.estimated for name in names])
    return measured if measured.any() else np.ones(len(names), dtype=bool)


def force_names(library: Library) -> Sequence[tuple[str, str]]:
    """Return the names of the degrees of freedom.

    Parameters
    ----------
    library : Library
        With impulses among its effects.

    Returns
    -------
    sequence of tuple of str
        The joint of each, and the unit of its force.
    """
    first_piece = [instance for instance in impulses_of(library) if instance.variant == "0"]
    return [(str(instance.target), instance.quantities[0].unit) for instance in first_piece]


def _noisier_than_stated(problem: Problem, state: State, settings: RemainingSettings) -> list[str]:
    """Signals whose learned noise is far beyond what the problem states."""
    if problem.epsilon is None:
        return []
    sigma = state.train.whiten.sigma
    stated = np.sqrt(np.broadcast_to(np.asarray(problem.epsilon, dtype=float), sigma.shape))
    limit = settings.surprising * np.maximum(stated, 1e-300)
    signals = zip(problem.simulator.signals, sigma, limit, strict=True)
    return [signal.name for signal, learned, largest in signals if learned > largest]
