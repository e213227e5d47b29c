"""Which effects are accepted, one after another: refitted on the windows to fit, confirmed on the
windows held out.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.evaluation_log import EvaluationLog
from dropo.core.services.registry import BUILT_IN
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import (
    Library,
    LinearizedWindows,
    estimate_noise,
    linearize,
    shift_linearization,
)
from dropo.diagnosis.search.record import Sides, recorded_sides
from dropo.diagnosis.search.refit import DEFAULTS as REFIT
from dropo.diagnosis.search.refit import RefitSettings, refit, settle, with_noise
from dropo.diagnosis.search.screening import (
    Candidate,
    Screening,
    ScreeningSettings,
    shortlist,
    with_constant,
)
from dropo.diagnosis.search.single_steps import absent_in_single_steps
from dropo.diagnosis.search.whitening import Noise
from dropo.diagnosis.search.windows import Windows

Progress = Callable[[float, str], None]
"""Called with the fraction of the work that is done (0 to 1), and with a text."""
STOPPING = "stopping after the figures of what was found so far"
"""What is shown when a search is interrupted."""


@dataclass(frozen=True)
class SelectionSettings:
    """When an effect is accepted, and when another one is as good.

    Attributes
    ----------
    false_alarm : float
        Level of the split likelihood-ratio test: the held-out gain must be above
        log(effects / false_alarm) [1]_.
    window_z : float
        Standard errors by window by which the held-out gain, or its signed ranks, must exceed 0.
    block_z : float
        Standard errors by block by which the held-out gain must exceed 0.
    fitted_gain : float
        Gain on the windows to fit below which a candidate is not considered [nats].
    response : float
        Gain or loss from which a window responds to an effect [nats].
    few_windows : int
        Windows that must respond, and gain, of an effect that acts seldom.
    negligible : float
        A later effect must gain this fraction of what the earlier ones gained together.
    batch : int
        Candidates that are refitted at a time.
    batches : int
        How many batches a step tries at most.
    effects : int
        Effects that are accepted at most.
    polished : int
        Candidates of a batch that are fitted to the end, at most, if those before are then not
        confirmed.
    similarity : float
        Cosine of two whitened responses from which two effects do the same to the data.
    equal : float
        Penalized gains that differ by less are equal [nats].
    deficit : float
        Held-out loss below which an effect with fewer magnitudes is as good [nats].
    first_noise : int
        The first estimate of the noise takes one window of so many.
    diverging : float
        Fraction of diverging windows beyond which the model is refused.
    indistinguishable_z : float
        An alternative within so many standard errors, or within `deficit`, cannot be distinguished.
    alternative : float
        Alternatives have at least this fraction of the accepted effect's penalized gain.
    alternatives : int
        Alternatives that are tried in the place of an accepted effect.
    nearly : float
        Fraction of an effect's gain from which an alternative to it is fitted to the end.
    screening : ScreeningSettings
        How effects are screened.
    refit : RefitSettings
        How theta and the noise are fitted.

    References
    ----------
    .. [1] Wasserman, Ramdas and Balakrishnan, Universal inference, PNAS 117, 2020.
    """

    false_alarm: float = 0.01
    window_z: float = 3.0
    block_z: float = 1.5
    fitted_gain: float = 5.0
    response: float = 1.0
    few_windows: int = 5
    negligible: float = 0.01
    batch: int = 6
    batches: int = 3
    effects: int = 12
    polished: int = 3
    similarity: float = 0.98
    equal: float = 2.0
    deficit: float = 4.0
    first_noise: int = 3
    diverging: float = 0.3
    indistinguishable_z: float = 2.0
    alternative: float = 0.5
    alternatives: int = 2
    nearly: float = 0.9
    screening: ScreeningSettings = field(default_factory=ScreeningSettings)
    refit: RefitSettings = REFIT

    def needed_gain(self, effects: int) -> float:
        """Return the held-out gain [nats] that confirms one of so many effects."""
        return float(np.log(max(effects, 1) / self.false_alarm))


SETTINGS = SelectionSettings()


@dataclass(frozen=True, eq=False)
class State:
    """A model in the search: how it explains the data, and which effects it has.

    Attributes
    ----------
    train, test : LinearizedWindows
        The windows to fit, and those held out.
    free : (f,) int array
        The numbers of theta that are fitted.
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


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate refitted.

    Attributes
    ----------
    candidate : Candidate
        As it was screened.
    sizes : (q,) array
        Its fitted magnitudes.
    state : State
        The model with it.
    trained : float
        Gain on the windows to fit [nats].
    held_out : float
        Gain on the windows held out [nats].
    z : float
        The held-out gain in standard errors by block.
    """

    candidate: Candidate
    sizes: Array
    state: State
    trained: float
    held_out: float
    z: float

    @property
    def sized(self) -> Candidate:
        """The candidate with the fitted magnitudes."""
        return replace(self.candidate, sizes=self.sizes)

    @property
    def penalized_gain(self) -> float:
        """Gain in all, less the BIC penalty for each magnitude beyond the first [nats]."""
        further = len(self.candidate.sizes) - 1
        penalty = 0.5 * further * np.log(self.state.train.windows.steps)
        return self.trained + self.held_out - float(penalty)


@dataclass(frozen=True, eq=False)
class Round:
    """One batch of refitted candidates.

    Attributes
    ----------
    before : State
        The model before it.
    screened : sequence of Candidate
        All candidates, the one that promises most first.
    trials : sequence of Trial
        Those refitted, the one with the largest penalized gain first.
    """

    before: State
    screened: Sequence[Candidate]
    trials: Sequence[Trial]


@dataclass(eq=False)
class Selection:
    """The search for effects, one after another.

    Attributes
    ----------
    library : Library
        The simulator with every effect.
    floor : (p,) array
        Lower bound of the noise.
    progress : callable
        Called with the fraction done and a text.
    settings : SelectionSettings
        When an effect is accepted.
    log : EvaluationLog
        Where fits are recorded, for a search that can be resumed.
    rounds : list of Round
        Every batch that was refitted.
    origins : dict of str to Round
        By an accepted effect's label, the batch that it was accepted from.
    screening : Screening
        What the rounds begin with.
    latest : State or None
        How far the search has come.
    """

    library: Library
    floor: Array
    progress: Progress = lambda share, text: None
    settings: SelectionSettings = SETTINGS
    log: EvaluationLog = field(default_factory=EvaluationLog)
    rounds: list[Round] = field(default_factory=list)
    origins: dict[str, Round] = field(default_factory=dict)
    screening: Screening = field(init=False)
    latest: State | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.screening = Screening(self.library, self.floor, self.settings.screening, self.log)

    def begin(
        self, train: Windows, test: Windows, theta: Array, noise: Noise, free: np.ndarray
    ) -> State:
        """Fit the model as it is: its declared parameters and the noise.

        Parameters
        ----------
        train, test : Windows
            The windows to fit, and those held out.
        theta : (m,) array
            The first parameters, without effects.
        noise : Noise
            First guess.
        free : (f,) int array
            The declared parameters that are fitted.

        Returns
        -------
        State

        Raises
        ------
        SimulationFailed
            If the simulation diverges in too many windows.
        """
        library = self.library
        some = train.take(np.arange(0, len(train), self.settings.first_noise))
        rough = linearize(library, some, theta, noise)
        if rough.lost.mean() > self.settings.diverging:
            raise SimulationFailed(
                f"The simulation diverges in {rough.lost.mean():.0%} of the windows, with the"
                " parameters at their nominal values. Check the model, the time step and the"
                " units of the data."
            )
        noise = estimate_noise(rough, noise, self.floor)
        first = linearize(library, train, theta, noise)
        first = with_noise(library, first, self.floor, self.settings.refit)

        def fit() -> Sides:
            fitted = self._refit(first, free, rounds=2, renewals=1)
            return fitted, self._held_out(fitted, test)

        key = np.concatenate([theta, noise.numbers])
        sides = recorded_sides(self.log, library, key, (train, test), fit)
        self.latest = State(*sides, free)
        return self.latest

    def as_it_is(
        self,
        train: Windows,
        test: Windows,
        theta: Array,
        noise: Noise,
        free: np.ndarray,
        accepted: tuple[EffectInstance, ...],
    ) -> State:
        """Take a model as it is, and estimate the noise.

        Parameters
        ----------
        train, test, noise
            As of `begin`.
        theta : (m,) array
            All numbers.
        free : (f,) int array
            Those of them that were fitted elsewhere.
        accepted : tuple of EffectInstance
            The effects that it has.

        Returns
        -------
        State
            Where the simulation diverges in too many windows, the noise is the first guess.
        """
        first = linearize(self.library, train, theta, noise)
        if first.lost.mean() <= self.settings.diverging:
            first = with_noise(self.library, first, self.floor, self.settings.refit)
        return State(first, self._held_out(first, test), free, accepted)

    def run(self, first: State, state: State, instances: Sequence[EffectInstance]) -> State:
        """Accept effects until none is confirmed.

        Parameters
        ----------
        first : State
            The model as it is.
        state : State
            Where the search begins.
        instances : sequence of EffectInstance
            The effects that may be accepted.

        Returns
        -------
        State
            `state` itself if none was accepted.
        """
        while len(state.accepted) < self.settings.effects:
            found = self.step(state, instances, first)
            if found is None:
                break
            self.latest = state = found
        return state

    def step(self, state: State, instances: Sequence[EffectInstance], first: State) -> State | None:
        """Accept one more effect.

        Parameters
        ----------
        state : State
            The model without it.
        instances : sequence of EffectInstance
            The effects that may be accepted.
        first : State
            The model as it is.

        Returns
        -------
        State or None
            None where no effect is confirmed.
        """
        settings = self.settings
        accepted = {instance.label for instance in state.accepted}
        others = [instance for instance in instances if instance.label not in accepted]

        # What the residuals suggest.
        count = len(state.accepted)
        self.progress(_fraction_done(count, 0.0), f"screening {len(others)} effects")
        screened = self.screening(state.train, state.free, others)
        maximum = settings.batches * settings.batch
        listed = shortlist(screened, maximum, settings.fitted_gain)
        listed = with_constant(listed, others)
        needed = self._needed_gain(state, first, len(instances))

        # Refit batch after batch, until one of a batch is confirmed.
        too_noisy: list[Trial] = []
        for begin in range(0, max(len(listed), 1), settings.batch):
            trials = self.try_candidates(state, listed[begin : begin + settings.batch])
            self.rounds.append(Round(state, screened, trials))
            sure: list[Trial] = []
            for trial in trials:
                if trial.trained <= settings.fitted_gain:
                    continue
                if is_confirmed(state.test, trial.state.test, needed, settings):
                    sure.append(trial)
                elif has_less_noise(state.train, trial.state.train, settings):
                    too_noisy.append(trial)
            found = self._accept_first(state, sure, needed)
            if found is not None:
                return found

        # A trial keeps the noise's loadings; where the noise fell, they are renewed first.
        renewed = (replace(trial, state=self.polish(trial.state)) for trial in too_noisy)
        return self._accept_first(state, renewed, needed)

    def _needed_gain(self, state: State, first: State, effects: int) -> float:
        """The held-out gain [nats] that one more effect needs."""
        needed = self.settings.needed_gain(effects)
        if not state.accepted:
            return max(needed, 0.0)
        gained = float((state.test.log_likelihood - first.test.log_likelihood).sum())
        return max(needed, self.settings.negligible * gained)

    def _accept_first(self, state: State, trials: Iterable[Trial], needed: float) -> State | None:
        """The first of a few trials that windows held out confirm when it is fitted to the end."""
        for trial in islice(trials, self.settings.polished):
            if self.only_by_feedback(trial.state):
                continue
            polished = self.polish(trial.state)
            if is_confirmed(state.test, polished.test, needed, self.settings):
                self.origins[trial.candidate.instance.label] = self._origin(trial.candidate)
                return polished
        return None

    def _origin(self, candidate: Candidate) -> Round:
        """The last round that refitted the candidate."""
        for batch in reversed(self.rounds):
            if any(trial.candidate is candidate for trial in batch.trials):
                return batch
        raise AssertionError("no round has refitted this candidate")

    def try_candidates(self, state: State, candidates: Sequence[Candidate]) -> list[Trial]:
        """Refit a model with each candidate in turn.

        Parameters
        ----------
        state : State
            The model without them.
        candidates : sequence of Candidate
            The effects and their first magnitudes.

        Returns
        -------
        list of Trial
            The one with the largest penalized gain first, as `commonest_first` orders them.
        """
        known: Array | None = None
        if len(state.free) and candidates:
            known = self.library.jacobian(state.theta, state.free, state.train.windows)
        trials = []
        for i, candidate in enumerate(candidates):
            part = (1 + i) / (1 + len(candidates))
            done = _fraction_done(len(state.accepted), part)
            self.progress(done, f"fitting {candidate.instance.label}")
            trials.append(self._try(state, candidate, known))
        trials.sort(key=lambda trial: -trial.penalized_gain)
        return commonest_first(trials, self.settings)

    def only_by_feedback(self, state: State) -> bool:
        """Whether the state's last effect is there only because commands respond to chance."""
        sides = (state.train, state.test)
        return absent_in_single_steps(self.library, sides, state.accepted[-1], self.floor)

    def polish(self, state: State) -> State:
        """Fit a model to the end.

        Parameters
        ----------
        state : State
            Any.

        Returns
        -------
        State
            With the same effects.
        """
        rough = rough_numbers(self.library, state.accepted)
        train, test = self._recorded(state, state.theta, lambda: self._polish(state, rough))
        return replace(state, train=train, test=test)

    def _polish(self, state: State, rough: Ints) -> Sides:
        """Both sides of a state fitted to the end, with a line scan of rough numbers."""
        library = self.library
        fitted = self._refit(state.train, state.free, rough=rough)
        theta = fitted.theta
        noise = fitted.whiten.noise
        # Did the new linearization change anything? If not, the windows held out keep theirs.
        shifted = shift_linearization(library, state.train, theta, noise)
        change = abs(float(shifted.log_likelihood.sum() - fitted.log_likelihood.sum()))
        if change < self.settings.refit.renewal_gain:
            return fitted, shift_linearization(library, state.test, theta, noise)
        return fitted, self._held_out(fitted, state.test.windows)

    def _try(self, state: State, candidate: Candidate, known: Array | None) -> Trial:
        """The candidate added to the state and fitted with the rest.

        known: (f, W, n) the Jacobian by the state's free numbers.
        """
        instance = candidate.instance
        place = self.library.places[instance.label]
        theta = state.theta.copy()
        theta[place] = candidate.sizes
        free = np.concatenate([state.free, place]).astype(np.int64)
        fitted, held_out = self._recorded(
            state, theta, lambda: self._fit_with(state, instance, theta, free, known)
        )
        gains = fitted.log_likelihood - state.train.log_likelihood
        held_out_gain, z = gain_of(state.test, held_out)
        return Trial(
            candidate=candidate,
            sizes=fitted.theta[place],
            state=State(fitted, held_out, free, (*state.accepted, instance)),
            trained=float(gains.sum()),
            held_out=held_out_gain,
            z=z,
        )

    def _fit_with(
        self,
        state: State,
        instance: EffectInstance,
        theta: Array,
        free: Ints,
        known: Array | None,
    ) -> Sides:
        """Both sides of a state fitted with one more effect, from theta (m,) on."""
        library = self.library
        rough = rough_numbers(library, (instance,))
        start = shift_linearization(library, state.train, theta, state.train.whiten.noise)
        if instance.sensor_delay is not None:
            # Without the delay noise stands for it: the noise with it is a very different one.
            noise = estimate_noise(start, start.whiten.noise, self.floor)
            start = linearize(library, start.windows, theta, noise)
            fitted = self._refit(start, free, rough=rough, renewals=1)
            return fitted, self._held_out(fitted, state.test.windows)
        fitted = settle(
            library,
            start,
            free,
            self.floor,
            rough=rough,
            known=known,
            settings=self.settings.refit,
        )
        noise = fitted.whiten.noise
        return fitted, shift_linearization(library, state.test, fitted.theta, noise)

    def _recorded(self, state: State, theta: Array, fit: Callable[[], Sides]) -> Sides:
        """What a fit from a state makes of its sides, or its record."""
        sides = (state.train, state.test)
        windows = (state.train.windows, state.test.windows)
        key = np.concatenate([theta, state.train.whiten.noise.numbers])
        return recorded_sides(self.log, self.library, key, windows, fit, sides)

    def _refit(
        self,
        start: LinearizedWindows,
        free: np.ndarray,
        *,
        rounds: int = 4,
        rough: Ints | None = None,
        renewals: int | None = None,
    ) -> LinearizedWindows:
        """Windows fitted as the settings say."""
        return refit(
            self.library,
            start,
            free,
            self.floor,
            rounds=rounds,
            rough=np.zeros(0, dtype=np.int64) if rough is None else rough,
            renewals=renewals,
            settings=self.settings.refit,
        )

    def _held_out(self, fitted: LinearizedWindows, test: Windows) -> LinearizedWindows:
        """The windows held out under what was fitted."""
        return linearize(self.library, test, fitted.theta, fitted.whiten.noise)


def _fraction_done(accepted: int, part: float) -> float:
    """The fraction of the search that is done, in a part of a round (0 to 1).

    Each round counts as half of what is left.
    """
    return 0.9 * (1 - 0.5**accepted * (1 - 0.5 * part))


def commonest_first(trials: list[Trial], settings: SelectionSettings = SETTINGS) -> list[Trial]:
    """Put the simplest and commonest of equally good trials first.

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
        that stands earliest in the registry. The others stay in their order.
    """
    if not trials:
        return []
    best = trials[0]
    as_good = [
        trial
        for trial in trials
        if gain_of(trial.state.test, best.state.test)[0] < settings.deficit
    ]
    simplest = min(as_good, key=lambda trial: len(trial.sizes))
    same = []
    for trial in trials:
        cosine = abs(float(trial.candidate.signature @ simplest.candidate.signature))
        difference = simplest.penalized_gain - trial.penalized_gain
        if difference < settings.equal and cosine > settings.similarity:
            same.append(trial)
    first = min(same, key=lambda trial: _rarity(trial.candidate.instance.effect))
    return [first, *(trial for trial in trials if trial is not first)]


def _rarity(effect: str) -> int:
    """The place of an effect in the registry, where common ones come first."""
    names = list(BUILT_IN["effects"])
    return names.index(effect) if effect in names else len(names)


def rough_numbers(library: Library, instances: Sequence[EffectInstance]) -> Ints:
    """Return the numbers of theta in which predictions are not smooth.

    Parameters
    ----------
    library : Library
        Where the effects' magnitudes stand in theta.
    instances : sequence of EffectInstance
        The effects.

    Returns
    -------
    int array
        Indices into theta.
    """
    found = []
    for instance in instances:
        place = library.places[instance.label]
        for index, quantity in zip(place, instance.quantities, strict=True):
            if not quantity.smooth:
                found.append(index)
    return np.array(found, dtype=np.int64)


def gain_by_block(before: LinearizedWindows, after: LinearizedWindows) -> Array:
    """Sum what windows gain over each of their blocks.

    Parameters
    ----------
    before, after : LinearizedWindows
        The same windows under two models.

    Returns
    -------
    (B,) array
        [nats].
    """
    gains = after.log_likelihood - before.log_likelihood
    block = np.unique(before.windows.block, return_inverse=True)[1]
    return np.asarray(np.bincount(block, gains), dtype=float)


def is_confirmed(
    before: LinearizedWindows,
    after: LinearizedWindows,
    needed: float,
    settings: SelectionSettings = SETTINGS,
) -> bool:
    """Decide whether windows held out confirm a model.

    Neither a single block nor a few windows may make the gain alone: the mean gain is certain, or
    most windows gain. Of an effect that acts seldom, such as a joint's limit, a few windows are
    enough if none loses.

    Parameters
    ----------
    before, after : LinearizedWindows
        The windows held out without and with the effect.
    needed : float
        Gain that is needed [nats].
    settings : SelectionSettings
        How sure the gain must be.

    Returns
    -------
    bool
    """
    gain, z = gain_of(before, after)
    if not (gain > needed and z > settings.block_z):
        return False
    gains = after.log_likelihood - before.log_likelihood
    error = float(gains.std(ddof=1)) * np.sqrt(len(gains))
    if float(gains.sum()) > settings.window_z * error:
        return True
    if signed_rank_score(gains) > settings.window_z:
        return True
    responding = gains[np.abs(gains) > settings.response]
    return len(responding) >= settings.few_windows and bool(responding.min() > 0)


def has_less_noise(
    before: LinearizedWindows, after: LinearizedWindows, settings: SelectionSettings = SETTINGS
) -> bool:
    """Decide whether some signal's noise has fallen much.

    Then the loadings of the start's noise, which a trial keeps, are not right any more. This is so
    where an error of a sensor was taken for noise: the trial of its cause goes only part of the
    way.

    Parameters
    ----------
    before, after : LinearizedWindows
        The same windows under two models.
    settings : SelectionSettings
        Its `refit.other_noise` is the ratio of noises that counts.

    Returns
    -------
    bool
    """
    limit = before.whiten.sigma / settings.refit.other_noise
    return bool(np.any(after.whiten.sigma < limit))


def signed_rank_score(gains: Array) -> float:
    """Return the normal score of the signed-rank test that most windows gain.

    Parameters
    ----------
    gains : (W,) array
        Of the windows [nats].

    Returns
    -------
    float
        Standard errors above chance.

    References
    ----------
    Wilcoxon, Individual comparisons by ranking methods, Biometrics Bulletin 1, 1945.
    """
    from scipy.stats import rankdata  # slow to import

    n = len(gains)
    ranks = rankdata(np.abs(gains))
    error = np.sqrt(n * (n + 1) * (2 * n + 1) / 6)
    return float(np.sum(np.sign(gains) * ranks) / error)


def gain_of(before: LinearizedWindows, after: LinearizedWindows) -> tuple[float, float]:
    """Compare two models on the same windows.

    Parameters
    ----------
    before, after : LinearizedWindows
        The windows under both.

    Returns
    -------
    gain : float
        Of the second model [nats].
    z : float
        The gain in standard errors by block; 0 where there is no standard error.
    """
    blocks = gain_by_block(before, after)
    gain = float(blocks.sum())
    if len(blocks) < 2:
        return gain, 0.0
    error = blocks.std(ddof=1) * np.sqrt(len(blocks))
    return gain, float(blocks.sum() / error) if error > 0 else 0.0
