"""What is still wrong once all that was found is there: in which joints and signals, and in which
regime.
"""

from collections.abc import Sequence

import numpy as np
from scipy.stats import norm

from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array
from dropo.diagnosis.findings.omnibus import omnibus
from dropo.diagnosis.findings.unexplained_forces import Unexplained, unexplained_force
from dropo.diagnosis.parts import Remaining
from dropo.diagnosis.search.invariance import drifting, standing_out
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.selection import State, gain_of

# times the stated noise, as a standard deviation, from which learned noise stands for something
# else
SURPRISE = 3.5


def remaining(
    problem: Problem, library: Library, last: State, floor: Array, rng: np.random.Generator
) -> tuple[Remaining, Unexplained]:
    """Test what a search left unexplained.

    Tested are random forces in every step, structure in state and command, noise beyond what was
    stated, and declared parameters that change.

    Parameters
    ----------
    problem : Problem
    library : Library
    last : State
        The model with all that was found.
    floor : (p,) array
        The least noise of each signal.
    rng : numpy.random.Generator

    Returns
    -------
    Remaining
        What is still wrong, in words.
    Unexplained
        The forces that nothing explains.
    """
    force = unexplained_force(library, last.train, last.test, floor, gain_of)
    rest = omnibus(last.train, last.test, rng)
    where = [f"noise of {name} beyond what was stated" for name in _surprise(problem, last)]
    where += [
        f"{name}, which changes with time"
        for name in drifting(library, last.test, problem.space.names)
    ]
    names = force_names(library)
    regime = None
    if force.present:
        worst = int(np.argmax(force.sd * force.scale))
        regime = standing_out(last.test.windows, library, force.excess)
        where.append(
            f"forces of {force.sd[worst]:.3g} {names[worst][1]} at {names[worst][0]} that "
            "nothing explains"
        )
    if rest.present:
        where.append(
            f"{library.simulator.signals[int(np.argmax(rest.signals))].name}, which state "
            "and command predict"
        )
    if regime:
        where.append(f"mostly {regime}")
    z = max(force.z if force.present else 0.0, rest.z)
    p_value = float(max(norm.sf(z), np.finfo(float).tiny))
    forces = (
        {f"{name} [{unit}]": float(sd) for (name, unit), sd in zip(names, force.sd, strict=True)}
        if force.present
        else {}
    )
    return Remaining(not where, p_value, tuple(where), forces), force


def force_names(library: Library) -> Sequence[tuple[str, str]]:
    """(name, unit) of each degree of freedom: its joint's."""
    instances = [
        instance
        for instance in library.instances
        if instance.effect == "unexplained_force" and instance.variant == "0"
    ]
    return [(str(instance.target), instance.quantities[0].unit) for instance in instances]


def _surprise(problem: Problem, state: State) -> list[str]:
    """Signals whose learned noise is far beyond what the problem states."""
    if problem.epsilon is None:
        return []
    sigma = state.train.whiten.sigma
    stated = np.sqrt(np.broadcast_to(np.asarray(problem.epsilon, dtype=float), sigma.shape))
    return [
        s.name
        for s, one, told in zip(problem.simulator.signals, sigma, stated, strict=True)
        if one > SURPRISE * max(told, 1e-300)
    ]
