"""What is said of the end of a search."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.services.tables import steps_text
from dropo.diagnosis.findings.accuracy.every_horizon import Beyond
from dropo.diagnosis.findings.accuracy.horizons import (
    AfterHorizon,
    errors_after,
    signal_noise,
)
from dropo.diagnosis.findings.accuracy.replay import WholeRunReplay, replay
from dropo.diagnosis.findings.causes import leaders
from dropo.diagnosis.findings.limits.scale_of_forces import UntoldScale
from dropo.diagnosis.findings.premises.numerics import numerics
from dropo.diagnosis.findings.remains.unexplained_forces import Unexplained
from dropo.diagnosis.parts import Cause, Leader, Remaining
from dropo.diagnosis.search.library import robot_of
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.review import Review
from dropo.diagnosis.search.trials import State
from dropo.diagnosis.setup import DiagnosisTask, SearchedEffects, SearchSetup


@dataclass(frozen=True, eq=False)
class Findings:
    """What was found out of a search's end.

    Attributes
    ----------
    causes : tuple of Cause
        Its effects.
    worse : mapping of str to Leader
        By their labels, those with which errors after some horizon are larger.
    after : sequence of AfterHorizon
        The errors of three models: as it came, with its parameters fitted, and with everything.
    rest : Remaining
        What remains.
    forces : Unexplained
        The forces that nothing explains.
    draws : numpy.random.Generator
        For what is still to be asked.
    scales : sequence of UntoldScale
        What numbers are told only together.
    """

    causes: tuple[Cause, ...]
    worse: Mapping[str, Leader]
    after: Sequence[AfterHorizon]
    rest: Remaining
    forces: Unexplained
    draws: np.random.Generator
    scales: Sequence[UntoldScale] = ()


def per_step(state: State) -> float:
    """Return the log-likelihood of a state's windows held out.

    Parameters
    ----------
    state : State
        Any.

    Returns
    -------
    float
        In nats per transition.
    """
    return float(state.test.log_likelihood.sum() / state.test.windows.steps)


def leaders_of(setup: SearchSetup, last: State, worse: Mapping[str, Leader]) -> tuple[Leader, ...]:
    """Return what is not confirmed: what makes errors after some horizon larger first.

    Parameters
    ----------
    setup : SearchSetup
        What the search worked on.
    last : State
        What it ended with.
    worse : mapping of str to Leader
        By their labels, the effects with which errors after some horizon are larger.

    Returns
    -------
    tuple of Leader
    """
    certain = setup.certain(last)
    return (
        *setup.worse.values(),
        *(one for label, one in worse.items() if label in certain),
        *leaders(setup.selection, last, setup.count),
    )


def noise_by_signal(problem: Problem, last: State) -> dict[str, float]:
    """Return the standard deviation of each signal's noise, in its unit.

    Parameters
    ----------
    problem : Problem
        Whose signals they are.
    last : State
        What the search ended with.

    Returns
    -------
    dict of str to float
    """
    signals = robot_of(problem).signals
    sizes = signal_noise(problem, last)
    return {signal.name: float(size) for signal, size in zip(signals, sizes, strict=True)}


def arithmetic_of(
    task: DiagnosisTask,
    setup: SearchSetup,
    searched: SearchedEffects,
    found: Sequence[Cause],
    rest: Remaining,
) -> tuple[str, ...]:
    """Say what the integrator and its steps do, and which delays are not told from them.

    Parameters
    ----------
    task : DiagnosisTask
        What was diagnosed.
    setup : SearchSetup
        What the search worked on.
    searched : SearchedEffects
        What it ended with.
    found : sequence of Cause
        The causes.
    rest : Remaining
        What remains.

    Returns
    -------
    tuple of str
        A sentence each.
    """
    # Numbers of whole motions gain by being fitted to windows, whatever the steps.
    unexplained = not (rest.calibrated or setup.explained is not None)
    said = numerics(
        task.came,
        setup.problem,
        setup.library,
        searched.first,
        searched.last,
        found,
        setup.selection.floor,
        unexplained=unexplained,
    )
    return (*said, *setup.refused.values())


def errors_without_and_with(
    problem: Problem,
    library: Library,
    last: State,
    reviews: Mapping[str, Review],
    after: Sequence[AfterHorizon],
) -> list[tuple[float, float]]:
    """Return the errors on held-out data without each accepted effect, and with everything.

    Parameters
    ----------
    problem, library
        The data, and the simulator with every effect.
    last : State
        What the search ended with.
    reviews : mapping of str to Review
        By the labels of its effects, what it is without each.
    after : sequence of AfterHorizon
        Errors of the model as it came, with its parameters fitted, with everything, and without
        each effect; they are simulated where it lacks the windows' horizon.

    Returns
    -------
    list of (float, float)
    """
    for one in after:
        if one.steps == last.train.windows.length:
            _, _, everything, *without = (model.rmse for model in one.models)
            return [(error, everything) for error in without]
    thetas = [reviews[instance.label].without.theta for instance in last.accepted]
    *others, whole = errors_after(problem, library, [*thetas, last.theta], last)
    return [(errors.overall, whole.overall) for errors in others]


def replayed(setup: SearchSetup, searched: SearchedEffects) -> WholeRunReplay | None:
    """Replay whole runs held out by commands alone, where there are such.

    Parameters
    ----------
    setup : SearchSetup
        What the search worked on.
    searched : SearchedEffects
        What it ended with.

    Returns
    -------
    WholeRunReplay or None
    """
    data = setup.problem.held_out
    if data is None:
        return None
    return replay(setup.library.simulator, data, [searched.first.theta, searched.last.theta])


def not_white(library: Library, last: State, estimated: Collection[str]) -> tuple[str, ...]:
    """Say what noise was taken for, where it is not white: a wrong model may look like it.

    Parameters
    ----------
    library : Library
        The simulator, whose signals they are.
    last : State
        What the search ended with.
    estimated : collection of str
        Signals whose errors follow each other by the way they were estimated.

    Returns
    -------
    tuple of str
        A sentence each.
    """
    noise = last.train.whiten.noise
    sentences = []
    following = [
        f"{signal.name} ({rho:.2f} of each in the next)"
        for signal, rho in zip(library.simulator.signals, noise.rho, strict=True)
        if rho and signal.name not in estimated
    ]
    if following:
        sentences.append(
            f"errors follow each other in {', '.join(following)}: taken for the sensors'"
        )
    if noise.timing:
        sentences.append(
            f"control steps seem to differ in length by {noise.timing:.1%} (a standard deviation), "
            "and are taken to"
        )
    return tuple(sentences)


def beyond_windows(misfits: Sequence[Beyond], rest: Remaining, length: int) -> tuple[str, ...]:
    """Say what to do where nothing remains within the windows, but after longer horizons.

    Parameters
    ----------
    misfits : sequence of Beyond
        Errors that noise does not explain.
    rest : Remaining
        What remains within the windows.
    length : int
        Control steps of these.

    Returns
    -------
    tuple of str
        A sentence at most.
    """
    longer = [one.steps for one in misfits if one.steps > length]
    if not rest.calibrated or not longer:
        return ()
    return (
        f"within windows of {steps_text(length)} nothing remains, beyond them something does: "
        f"diagnose with --steps {longer[0]}",
    )


def verdict_of(found: Sequence[Cause], wrong: bool) -> str:
    """Return the finding in a word.

    Parameters
    ----------
    found : sequence of Cause
        The causes.
    wrong : bool
        Whether something remains.

    Returns
    -------
    str
        "explained", "partly", "unexplained" or "consistent".
    """
    wrong = wrong or any(cause.acts_like for cause in found)
    if found:
        return "partly" if wrong else "explained"
    return "unexplained" if wrong else "consistent"
