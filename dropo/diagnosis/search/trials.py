"""What a search for effects goes through: models, trials of candidates, and batches of trials."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.services.validation import Array
from dropo.diagnosis.search.confirmation import SETTINGS, SelectionSettings, gain_of
from dropo.diagnosis.search.linearization import LinearizedWindows
from dropo.diagnosis.search.screening import Candidate


@dataclass(frozen=True, eq=False)
class State:
    """A model in the search: how it explains the data, and which effects it has.

    Attributes
    ----------
    train, test : LinearizedWindows
        The windows to fit, and those held out.
    free : (f,) int array
        Indices of the numbers of theta that are fitted.
    accepted : tuple of EffectInstance
        The effects, in the order in which they were accepted.
    """

    train: LinearizedWindows
    test: LinearizedWindows
    free: np.ndarray
    accepted: tuple[EffectInstance, ...] = ()

    @property
    def theta(self) -> Array:
        """(m,) the declared parameters, then the magnitudes of all effects."""
        return self.train.theta


def penalized_log_likelihood(state: State) -> float:
    """Return the log-likelihood of all windows less the BIC penalty.

    Parameters
    ----------
    state : State
        A model.

    Returns
    -------
    float
        [nats].

    References
    ----------
    Schwarz, Estimating the dimension of a model, Annals of Statistics 6, 1978.
    """
    sides = (state.train, state.test)
    steps = sum(side.windows.steps for side in sides)
    total = float(sum(side.log_likelihood.sum() for side in sides))
    return total - 0.5 * len(state.free) * float(np.log(steps))


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate refitted.

    Attributes
    ----------
    candidate : Candidate
        As it was screened.
    magnitudes : (q,) array
        Its fitted magnitudes.
    state : State
        The model with it.
    fitted_gain : float
        Gain on the windows to fit [nats].
    held_out_gain : float
        Gain on the windows held out [nats].
    z : float
        The held-out gain in standard errors by block.
    """

    candidate: Candidate
    magnitudes: Array
    state: State
    fitted_gain: float
    held_out_gain: float
    z: float

    @property
    def fitted_candidate(self) -> Candidate:
        """The candidate with the fitted magnitudes in the place of those screened."""
        return replace(self.candidate, magnitudes=self.magnitudes)

    @property
    def penalized_gain(self) -> float:
        """Gain in all, less the BIC penalty for each magnitude beyond the first [nats]."""
        further = len(self.candidate.magnitudes) - 1
        penalty = 0.5 * further * np.log(self.state.train.windows.steps)
        return self.fitted_gain + self.held_out_gain - float(penalty)


@dataclass(frozen=True, eq=False)
class Batch:
    """Candidates that were refitted together.

    Attributes
    ----------
    before : State
        The model without any of them.
    screened : sequence of Candidate
        All candidates of the screening, the one that promises most first.
    trials : sequence of Trial
        Those that were refitted, in the order of `most_plausible_first`.
    """

    before: State
    screened: Sequence[Candidate]
    trials: Sequence[Trial]


def most_plausible_first(
    trials: list[Trial], settings: SelectionSettings = SETTINGS
) -> list[Trial]:
    """Put the simplest and most usual of equally good trials first.

    Parameters
    ----------
    trials : list of Trial
        The one with the largest penalized gain first.
    settings : SelectionSettings
        When two trials are equally good.

    Returns
    -------
    list of Trial
        First comes the one with the fewest magnitudes among those that windows held out cannot
        distinguish from the best; if several effects do the same to the data as it, then the one
        with the largest sum of its penalized gain and its log odds (`Plausibility`). The others
        stay in their order.
    """
    if not trials:
        return []
    # The one with the fewest magnitudes among those as good on windows held out as the best.
    best = trials[0]
    as_good = []
    for trial in trials:
        loss, _ = gain_of(trial.state.test, best.state.test)
        if loss < settings.negligible_gain:
            as_good.append(trial)
    simplest = min(as_good, key=lambda trial: len(trial.magnitudes))

    # Of those that do the same to the data as that one, what is gained and usual decides.
    alike = []
    for trial in trials:
        cosine = abs(float(trial.candidate.signature @ simplest.candidate.signature))
        if trial is simplest or cosine > settings.similarity:
            alike.append(trial)
    first = max(alike, key=lambda trial: _posterior(trial, settings))

    others = [trial for trial in trials if trial is not first]
    return [first, *others]


def _posterior(trial: Trial, settings: SelectionSettings) -> float:
    """What a trial gains, with the log odds of its effect [nats]."""
    return trial.penalized_gain + settings.plausibility.of(trial.candidate.instance.effect)
