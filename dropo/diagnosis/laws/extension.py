"""A search, its states and its library, with places for laws that are found on the way."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.diagnosis.search.linearization import Library, LinearizedWindows
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.trials import Batch, State


def with_laws(library: Library, laws: Sequence[EffectInstance]) -> Library:
    """Put laws, or other effects, into a library.

    Parameters
    ----------
    library : Library
        Around a MuJoCo model.
    laws : sequence of EffectInstance
        Effects that it does not have.

    Returns
    -------
    Library
        Their magnitudes stand behind all other numbers.
    """
    simulator = library.simulator.with_effects(laws)  # type: ignore[attr-defined]
    simulator.steps = library.simulator.steps
    coarse = library.coarse
    if coarse is not None:
        coarse = coarse.with_effects(laws)  # type: ignore[attr-defined]
    instances = [*library.instances, *laws]
    return Library(simulator, instances, library.declared, library.differences, coarse)


def places_of_laws(library: Library) -> set[str | None]:
    """Return where a library has laws, one each: those that were taken out again, too.

    Parameters
    ----------
    library : Library
        Of a search.

    Returns
    -------
    set of str or None
        Joints.
    """
    return {instance.target for instance in library.instances if instance.formula}


def extended(selection: Selection, library: Library) -> Selection:
    """Return a search in a larger library, its batches with places for what is new there.

    Parameters
    ----------
    selection : Selection
        The search.
    library : Library
        As `with_laws` makes it of the search's own.

    Returns
    -------
    Selection
    """
    known = {id(one): one for one in (*selection.batches, *selection.origins.values())}
    padded_ones = {key: _padded_batch(one, library) for key, one in known.items()}
    batches = [padded_ones[id(one)] for one in selection.batches]
    origins = {label: padded_ones[id(one)] for label, one in selection.origins.items()}
    own = replace(selection, library=library, batches=batches, origins=origins)
    own.screening.first_responses.update(selection.screening.first_responses)
    own.screening.counted.update(selection.screening.counted)
    own.screening.first_windows = (
        None
        if selection.screening.first_windows is None
        else padded_side(selection.screening.first_windows, library)
    )
    return own


def _padded_batch(one: Batch, library: Library) -> Batch:
    """A batch with places for what is new in a library."""
    trials = [replace(trial, state=padded(trial.state, library)) for trial in one.trials]
    return Batch(padded(one.before, library), one.screened, trials)


def padded(state: State, library: Library) -> State:
    """Return a state with places for what is new in a library, which it does not have.

    Parameters
    ----------
    state : State
        In a library that was smaller.
    library : Library
        The larger one.

    Returns
    -------
    State
    """
    return replace(
        state,
        train=padded_side(state.train, library),
        test=padded_side(state.test, library),
    )


def padded_side(side: LinearizedWindows, library: Library) -> LinearizedWindows:
    """Return windows with places for what is new in a library.

    Parameters
    ----------
    side : LinearizedWindows
        Under the numbers of a library that was smaller.
    library : Library
        The larger one.

    Returns
    -------
    LinearizedWindows
    """
    new = len(library.simulator.space) - len(side.theta)
    theta = np.append(side.theta, np.zeros(new))
    at, noise = side.linearized_at
    return replace(side, theta=theta, linearized_at=(np.append(at, np.zeros(new)), noise))
