"""Which effects are accepted: refitted on the windows to fit, confirmed on the windows held out,
one after another.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
from scipy.stats import rankdata

from dropo.core.contracts.effect import EffectInstance
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.registry import BUILT_IN
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import (
    Library,
    LinearizedWindows,
    linearize,
    shift_linearization,
    estimate_noise,
)
from dropo.diagnosis.search.refit import DEFAULTS as REFIT
from dropo.diagnosis.search.refit import refit, settle, with_noise
from dropo.diagnosis.search.screening import Candidate, Screening, shortlist, with_constant
from dropo.diagnosis.search.single_steps import absent_in_single_steps
from dropo.diagnosis.search.windows import Windows

# of the split likelihood-ratio test: gain > log(atoms / FALSE_ALARM) (Wasserman, Ramdas,
# Balakrishnan 2020)
FALSE_ALARM = 0.01
# standard errors of the held-out gain by window and by block; nats on the windows to fit
CERTAIN = 3.0
SPREAD = 1.5
TRAINED = 5.0
# nats from which a window answers to an effect; windows that must, where all of those gain
ANSWERS = 1.0
SELDOM = 5
NEGLIGIBLE = 0.01  # of what earlier effects gained together: a later one must bring more
# candidates refitted at a time, and how often in a round; effects accepted in all
TRIED = 6
BATCHES = 3
MOST = 12
# of the candidates refitted at a time, how many are fitted to the end where those before are then
# not confirmed
POLISHED = 3
# cosine of whitened responses from which, and nats within which, two effects do the same
ALIKE = 0.98
EQUAL = 2.0
DEFICIT = 4.0  # nats held out below which more numbers are not called for
FEWER = 3  # one window in so many tells the first noise
DIVERGES = 0.3  # share of the windows beyond which a diverging simulation is refused

Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class State:
    """Where the model stands: the windows to fit and those held out as it explains them, and what
    has been accepted.
    """

    train: LinearizedWindows
    test: LinearizedWindows
    free: np.ndarray
    accepted: tuple[EffectInstance, ...] = ()

    @property
    def theta(self) -> Array:
        """(m,) the declared parameters, then all sizes."""
        return self.train.theta


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate refitted: the sizes (q,) that it has now, the state with it, and what it gains on
    windows to fit and on windows held out, with the latter's z.
    """

    candidate: Candidate
    sizes: Array
    state: State
    trained: float
    held_out: float
    z: float

    @property
    def sized(self) -> Candidate:
        """The candidate with the sizes that were fitted."""
        return replace(self.candidate, sizes=self.sizes)

    @property
    def penalized_gain(self) -> float:
        """[nats] gained in all, less what each number beyond the first gains by chance (Schwarz
        1978).
        """
        return (
            self.trained
            + self.held_out
            - 0.5 * (len(self.candidate.sizes) - 1) * np.log(self.state.train.windows.steps)
        )


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the search: the state before it, what the screening promised, most first, and
    what was refitted, by worth.
    """

    before: State
    screened: Sequence[Candidate]
    trials: Sequence[Trial]


@dataclass(eq=False)
class Selection:
    """The search. floor: (p,) the least noise; progress(share, text)."""

    library: Library
    floor: Array
    progress: Progress = lambda share, text: None
    rounds: list[Round] = field(default_factory=list)
    origins: dict[str, Round] = field(
        default_factory=dict
    )  # an accepted effect's label -> the round that it was accepted from
    screening: Screening = field(init=False)

    def __post_init__(self) -> None:
        self.screening = Screening(self.library, self.floor)

    def begin(
        self, train: Windows, test: Windows, theta: Array, sigma: Array, free: np.ndarray
    ) -> State:
        """The model as it is, with its declared parameters and the noise fitted."""
        rough = linearize(self.library, train.take(np.arange(0, len(train), FEWER)), theta, sigma)
        if rough.lost.mean() > DIVERGES:
            raise SimulationFailed(
                f"The simulation diverges in {rough.lost.mean():.0%} of the windows, with "
                "the parameters at their nominal values. Check"
                " the model, the time step and the units of the data."
            )
        first = linearize(self.library, train, theta, estimate_noise(rough, sigma, self.floor))
        fitted = refit(
            self.library,
            with_noise(self.library, first, self.floor),
            free,
            self.floor,
            rounds=2,
            renewals=1,
        )
        return State(fitted, self._held_out(fitted, test), free)

    def run(self, first: State, state: State, instances: Sequence[EffectInstance]) -> State:
        """The state that accepted effects lead to, one after another; first: the model as it is."""
        while len(state.accepted) < MOST:
            found = self.step(state, instances, first)
            if found is None:
                break
            state = found
        return state

    def step(self, state: State, instances: Sequence[EffectInstance], first: State) -> State | None:
        """The state with one more effect; None where none is confirmed."""
        taken = {instance.label for instance in state.accepted}
        rest = [instance for instance in instances if instance.label not in taken]
        done = len(state.accepted)
        self.progress(_share(done, 0.0), f"screening {len(rest)} effects")
        screened = self.screening(state.train, state.free, rest)
        least = np.log(len(instances) / FALSE_ALARM)
        gained = (
            float((state.test.log_likelihood - first.test.log_likelihood).sum()) if done else 0.0
        )
        least = max(least, NEGLIGIBLE * gained)
        listed = with_constant(shortlist(screened, BATCHES * TRIED, TRAINED), rest)
        held_up = list[Trial]()
        for begin in range(
            0, max(len(listed), 1), TRIED
        ):  # the next ones only where none of those before is confirmed
            trials = self.try_candidates(state, listed[begin : begin + TRIED])
            self.rounds.append(Round(state, screened, trials))
            promising = [t for t in trials if t.trained > TRAINED]
            sure = [t for t in promising if is_confirmed(state.test, t.state.test, least)]
            found = self._accepted(state, sure, least)
            if found is not None:
                return found
            held_up += [
                t for t in promising if t not in sure and has_less_noise(state.train, t.state.train)
            ]
        return self._accepted(
            state, (replace(t, state=self.polish(t.state)) for t in held_up), least
        )

    def _accepted(self, state: State, trials: Iterable[Trial], least: float) -> State | None:
        """The first of so many trials that windows held out confirm when it is fitted to the end."""
        for trial in islice(trials, POLISHED):
            polished = None if self._of_feedback(trial.state) else self.polish(trial.state)
            if polished is not None and is_confirmed(state.test, polished.test, least):
                self.origins[trial.candidate.instance.label] = self._origin(trial.candidate)
                return polished
        return None

    def _origin(self, candidate: Candidate) -> Round:
        return next(
            r
            for r in reversed(self.rounds)
            if any(trial.candidate is candidate for trial in r.trials)
        )

    def try_candidates(self, state: State, candidates: Sequence[Candidate]) -> list[Trial]:
        """Each candidate added to the state and fitted with the rest, by what it is worth, most
        first.
        """
        known = (
            self.library.jacobian(state.theta, state.free, state.train.windows)
            if len(state.free) and candidates
            else None
        )
        trials = []
        for i, candidate in enumerate(candidates):
            self.progress(
                _share(len(state.accepted), (1 + i) / (1 + len(candidates))),
                f"fitting {candidate.instance.label}",
            )
            trials.append(self._try(state, candidate, known))
        return commonest_first(sorted(trials, key=lambda trial: -trial.penalized_gain))

    def _of_feedback(self, state: State) -> bool:
        """Whether the state's last effect is in the windows only because commands answer to chance."""
        return absent_in_single_steps(
            self.library, (state.train, state.test), state.accepted[-1], self.floor
        )

    def polish(self, state: State) -> State:
        """The same effects with everything fitted to the end."""
        rough = rough_numbers(self.library, state.accepted)
        fitted = refit(self.library, state.train, state.free, self.floor, rough=rough)
        known = shift_linearization(self.library, state.train, fitted.theta, fitted.whiten.sigma)
        if (
            abs(float(known.log_likelihood.sum() - fitted.log_likelihood.sum()))
            < REFIT.renewal_gain
        ):  # the start noise's way is as it was
            return replace(
                state,
                train=fitted,
                test=shift_linearization(self.library, state.test, fitted.theta, fitted.whiten.sigma),
            )
        return replace(state, train=fitted, test=self._held_out(fitted, state.test.windows))

    def _try(self, state: State, candidate: Candidate, known: Array | None) -> Trial:
        theta = state.theta.copy()
        place = self.library.places[candidate.instance.label]
        theta[place] = candidate.sizes
        free = np.concatenate([state.free, place]).astype(np.int64)
        rough = rough_numbers(self.library, (candidate.instance,))
        begun = shift_linearization(self.library, state.train, theta, state.train.whiten.sigma)
        if candidate.instance.sensor_delay is None:
            fitted = settle(self.library, begun, free, self.floor, rough=rough, known=known)
            held_out = shift_linearization(self.library, state.test, fitted.theta, fitted.whiten.sigma)
        else:  # without it noise stands for it, which is then far from what it is with it
            begun = linearize(
                self.library, begun.windows, theta, estimate_noise(begun, begun.whiten.sigma, self.floor)
            )
            fitted = refit(self.library, begun, free, self.floor, rough=rough, renewals=1)
            held_out = self._held_out(fitted, state.test.windows)
        new = State(fitted, held_out, free, (*state.accepted, candidate.instance))
        gain, z = gain_of(state.test, new.test)
        return Trial(
            candidate,
            fitted.theta[place],
            new,
            float((fitted.log_likelihood - state.train.log_likelihood).sum()),
            gain,
            z,
        )

    def _held_out(self, fitted: LinearizedWindows, test: Windows) -> LinearizedWindows:
        return linearize(self.library, test, fitted.theta, fitted.whiten.sigma)


def _share(accepted: int, part: float) -> float:
    """Of the search done, in a round's part: each round is taken for half of what is left."""
    return 0.9 * (1 - 0.5**accepted * (1 - 0.5 * part))


def commonest_first(trials: list[Trial]) -> list[Trial]:
    """Trials, the best first, whose place goes to one of fewer numbers that windows held out do not
    tell from it, then to the commonest effect of those that do the same to the data: the
    catalogue's earliest.
    """
    if not trials:
        return []
    best = min(
        (trial for trial in trials if _untold(trial, trials[0])), key=lambda trial: len(trial.sizes)
    )
    near = [trial for trial in trials if best.penalized_gain - trial.penalized_gain < EQUAL]
    same = [
        trial
        for trial in near
        if abs(float(trial.candidate.signature @ best.candidate.signature)) > ALIKE
    ]
    first = min(same, key=lambda trial: _rarity(trial.candidate.instance.effect))
    return [first, *(trial for trial in trials if trial is not first)]


def _untold(trial: Trial, best: Trial) -> bool:
    """Whether windows held out do not tell a trial from the best one."""
    return gain_of(trial.state.test, best.state.test)[0] < DEFICIT


def _rarity(effect: str) -> int:
    names = list(BUILT_IN["effects"])
    return names.index(effect) if effect in names else len(names)


def rough_numbers(library: Library, instances: Sequence[EffectInstance]) -> Ints:
    """The numbers of theta in which predictions are not smooth."""
    found = [
        library.places[a.label][i]
        for a in instances
        for i, q in enumerate(a.quantities)
        if not q.smooth
    ]
    return np.array(found, dtype=np.int64)


def gain_by_block(before: LinearizedWindows, after: LinearizedWindows) -> Array:
    """(B,) nats gained in each block of the windows."""
    gain = after.log_likelihood - before.log_likelihood
    block = before.windows.block
    return np.asarray(np.bincount(np.unique(block, return_inverse=True)[1], gain), dtype=float)


def is_confirmed(before: LinearizedWindows, after: LinearizedWindows, least: float) -> bool:
    """Whether windows held out gain at least so many nats, and not a few of them or a single block
    alone: their mean is certain, or most of them gain; of what acts seldom (a joint's limit) a
    few windows will do where none loses.
    """
    gain, z = gain_of(before, after)
    windows = after.log_likelihood - before.log_likelihood
    many = (
        float(windows.sum()) > CERTAIN * float(windows.std(ddof=1)) * np.sqrt(len(windows))
        or signed_rank_score(windows) > CERTAIN
    )
    answers = windows[np.abs(windows) > ANSWERS]
    return (
        gain > least
        and z > SPREAD
        and (many or (len(answers) >= SELDOM and bool(answers.min() > 0)))
    )


def has_less_noise(before: LinearizedWindows, after: LinearizedWindows) -> bool:
    """Whether some signal's noise is far less, so that the start noise's way, which a trial keeps,
    is no longer right: where an error of a sensor is taken for noise, the trial of its cause
    goes a part of the way only.
    """
    return bool(np.any(after.whiten.sigma < before.whiten.sigma / REFIT.other_noise))


def signed_rank_score(windows: Array) -> float:
    """How many standard errors the signed ranks of windows' gains are above chance: that most of
    them gain (Wilcoxon 1945).
    """
    n = len(windows)
    ranks = rankdata(np.abs(windows))
    return float(np.sum(np.sign(windows) * ranks) / np.sqrt(n * (n + 1) * (2 * n + 1) / 6))


def gain_of(before: LinearizedWindows, after: LinearizedWindows) -> tuple[float, float]:
    """Nats gained on the windows, and how many of its standard errors by block that is."""
    blocks = gain_by_block(before, after)
    error = blocks.std(ddof=1) * np.sqrt(len(blocks)) if len(blocks) > 1 else np.inf
    return float(blocks.sum()), float(blocks.sum() / error) if error > 0 else 0.0
