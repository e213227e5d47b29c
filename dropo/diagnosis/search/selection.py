"""Which effects are accepted, one after another: refitted on the windows to fit, confirmed on the
windows held out.

Each step of the search screens all effects (`screening`), refits the most promising ones in batches
(`trials`), and accepts the first that the windows held out confirm (`confirmation`). Below, theta
(m,) holds the declared parameters, then the magnitudes of all effects, 0 where an effect is absent;
`free` (f,) has the indices of those that are fitted. The two sides of a model are the windows to
fit and the windows held out, linearized under its theta and noise.

What is done with windows, from cheap to dear (p signals, f free numbers):

- `with_other_noise` fits nothing and simulates nothing, unless the windows are as `linearize` left
  them: then it is `shift_linearization`.
- `shift_linearization` fits nothing. It simulates each window once, under another theta, and keeps
  how the noise of the start states carries into the predictions.
- `linearize` fits nothing. It simulates each window 2 p + 1 times and finds that anew.
- `with_noise` fits the noise at a fixed theta; it linearizes where the noise is quite another.
- `settle` fits theta and the noise in turn, by 2 f simulations of each window for a Jacobian and a
  few for each step, without linearizing.
- `refit` settles, linearizes where theta has gone, and does so again, a few times at most, until
  that changes nothing.
- `Selection.polish` refits the windows to fit, then simulates those held out, linearized anew
  where that changed the fit; its result is recorded.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.estimator import Progress, silent
from dropo.core.contracts.support.time_profile import sets_in_at_an_end
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.validation import Array
from dropo.diagnosis.search.confirmation import (
    SETTINGS,
    SelectionSettings,
    gain_of,
    has_less_noise,
    is_confirmed,
)
from dropo.diagnosis.search.library import partner_of
from dropo.diagnosis.search.linearization import (
    Library,
    LinearizedWindows,
    estimate_noise,
    linearize,
    shift_linearization,
    with_other_noise,
)
from dropo.diagnosis.search.record import Sides, recorded_sides
from dropo.diagnosis.search.refit import NO_INDICES, refit, settle, with_noise
from dropo.diagnosis.search.screening import (
    Candidate,
    Screening,
    most_usual_of_twins_first,
    shortlist,
    with_constant,
)
from dropo.diagnosis.search.single_steps import absent_in_single_steps
from dropo.diagnosis.search.trials import (
    Batch,
    State,
    Trial,
    most_plausible_first,
    penalized_log_likelihood,
)
from dropo.diagnosis.search.whitening import WindowNoise
from dropo.diagnosis.search.windows import Windows

STOPPING = "stopping after the figures of what was found so far"
"""What is shown when a search is interrupted."""


@dataclass(eq=False)
class Selection:
    """The search for effects, one after another.

    Attributes
    ----------
    library : Library
        The simulator with every effect.
    floor : (p,) array
        Lower bound of the noise's standard deviations, in the signals' units.
    progress : callable
        Called with the fraction done and a text.
    settings : SelectionSettings
        When an effect is accepted.
    log : EvaluationLog
        Where fits are recorded, for a search that can be resumed.
    batches : list of Batch
        Every batch that was refitted.
    origins : dict of str to Batch
        By an accepted effect's label, the batch that it was accepted from.
    screening : Screening
        What each step begins with.
    latest : State or None
        How far the search has come, for one that is interrupted.
    """

    # what it works with
    library: Library
    floor: Array
    progress: Progress = silent
    settings: SelectionSettings = SETTINGS
    log: EvaluationLog = field(default_factory=EvaluationLog)
    # what it has done so far
    batches: list[Batch] = field(default_factory=list)
    origins: dict[str, Batch] = field(default_factory=dict)
    screening: Screening = field(init=False)
    latest: State | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.screening = Screening(self.library, self.floor, self.settings.screening, self.log)

    # --- the first model

    def begin(
        self,
        windows_to_fit: Windows,
        windows_held_out: Windows,
        theta: Array,
        noise: WindowNoise,
        free: np.ndarray,
    ) -> State:
        """Fit the model without effects: its declared parameters and the noise.

        Parameters
        ----------
        windows_to_fit, windows_held_out : Windows
            The two sides.
        theta : (m,) array
            The first parameters, without effects.
        noise : WindowNoise
            A first guess.
        free : (f,) int array
            Indices of the declared parameters that are fitted.

        Returns
        -------
        State

        Raises
        ------
        SimulationFailed
            If the simulation diverges in too many windows.
        """
        library = self.library
        settings = self.settings

        # Some of the windows are enough for a first estimate of the noise.
        every_few = np.arange(0, len(windows_to_fit), settings.first_noise_stride)
        some = windows_to_fit.take(every_few)
        some_linearized = linearize(library, some, theta, noise)
        diverging = some_linearized.lost.mean()
        if diverging > settings.maximum_diverging:
            raise SimulationFailed(
                f"The simulation diverges in {diverging:.0%} of the windows, with the"
                " parameters at their nominal values. Check the model, the time step and the"
                " units of the data."
            )
        some_linearized = with_noise(library, some_linearized, self.floor, settings.refit)
        estimated = estimate_noise(some_linearized, some_linearized.whiten.noise, self.floor)

        # All windows, with the noise that these have.
        linearized = linearize(library, windows_to_fit, theta, estimated)
        linearized = with_noise(library, linearized, self.floor, settings.refit)

        # The declared parameters and the noise are fitted in turn, unless that is recorded.
        def fit() -> Sides:
            fitted = self._refit(linearized, free, rounds=2, renewals=1)
            return fitted, self._linearize_held_out(fitted, windows_held_out)

        # A record is known by the numbers that the fit began with.
        key = np.concatenate([theta, estimated.numbers])
        windows = (windows_to_fit, windows_held_out)
        train, test = recorded_sides(self.log, library, key, windows, fit)
        self.latest = State(train, test, free)
        return self.latest

    def without_fitting(
        self,
        windows_to_fit: Windows,
        windows_held_out: Windows,
        theta: Array,
        noise: WindowNoise,
        free: np.ndarray,
        accepted: tuple[EffectInstance, ...],
    ) -> State:
        """Take a model whose theta was fitted elsewhere, and estimate the noise alone.

        Parameters
        ----------
        windows_to_fit, windows_held_out, noise
            As of `begin`.
        theta : (m,) array
            The declared parameters and all magnitudes.
        free : (f,) int array
            Indices of those of them that were fitted elsewhere.
        accepted : tuple of EffectInstance
            The effects that it has.

        Returns
        -------
        State
            Where the simulation diverges in too many windows, the noise is the first guess.
        """
        linearized = linearize(self.library, windows_to_fit, theta, noise)
        if linearized.lost.mean() <= self.settings.maximum_diverging:
            linearized = with_noise(self.library, linearized, self.floor, self.settings.refit)
        held_out = self._linearize_held_out(linearized, windows_held_out)
        return State(linearized, held_out, free, accepted)

    # --- one effect after another

    def run(
        self,
        without_effects: State,
        state: State,
        instances: Sequence[EffectInstance],
        stop: Callable[[State, State | None], bool] | None = None,
    ) -> State:
        """Accept effects until none is confirmed.

        Parameters
        ----------
        without_effects : State
            The model without any effect.
        state : State
            Where the search begins.
        instances : sequence of EffectInstance
            The effects that may be accepted.
        stop : callable, optional
            Called with a model, and with the one that has one more effect or None; where it is
            true, that effect is not accepted, and the search ends.

        Returns
        -------
        State
            `state` itself if none was accepted.
        """
        while len(state.accepted) < self.settings.maximum_effects:
            found = self.step(state, instances, without_effects)
            if (stop is not None and stop(state, found)) or found is None:
                break
            state = found
            self.latest = state
        return state

    def step(
        self, state: State, instances: Sequence[EffectInstance], without_effects: State
    ) -> State | None:
        """Accept one more effect.

        Parameters
        ----------
        state : State
            The model without it.
        instances : sequence of EffectInstance
            The effects that may be accepted.
        without_effects : State
            The model without any effect.

        Returns
        -------
        State or None
            None where no effect is confirmed.
        """
        screened, promising = self.screen(state, instances)
        needed_gain = self._needed_gain(state, without_effects, len(instances))

        # Refit batch after batch, until windows held out confirm an effect of a batch.
        unconfirmed: list[Trial] = []
        for candidates in _batches(promising, self.settings.batch_size):
            trials = self.try_candidates(state, candidates)
            self.batches.append(Batch(state, screened, trials))
            confirmed, with_less_noise = self._confirm(state, trials, needed_gain)
            found = self._accept_first(state, confirmed, needed_gain)
            if found is not None:
                return self._with_partner(found, instances, needed_gain)
            unconfirmed += with_less_noise

        # None was confirmed as it was tried, linearized under the noise before. Where the noise has
        # fallen much, linearize anew.
        found = self._accept_first(state, self._polished(unconfirmed), needed_gain)
        return None if found is None else self._with_partner(found, instances, needed_gain)

    def screen(
        self, state: State, instances: Sequence[EffectInstance]
    ) -> tuple[list[Candidate], list[Candidate]]:
        """Screen the effects that are not in a model.

        Parameters
        ----------
        state : State
            The model.
        instances : sequence of EffectInstance
            The effects that may be accepted.

        Returns
        -------
        screened, promising : list of Candidate
            All of them, by what the residuals promise; and the few of them that are refitted.
        """
        settings = self.settings
        accepted = {instance.label for instance in state.accepted}
        others = [instance for instance in instances if instance.label not in accepted]
        done = _fraction_done(len(state.accepted), 0.0)
        self.progress(done, f"screening {len(others)} effects")
        screened = self.screening(state.train, state.free, others)
        maximum = settings.maximum_batches * settings.batch_size
        promising = most_usual_of_twins_first(
            shortlist(screened, maximum, settings.minimum_fitted_gain),
            settings.similarity,
            settings.plausibility,
        )
        return screened, with_constant(promising, others)

    def _confirm(
        self, state: State, trials: Sequence[Trial], needed_gain: float
    ) -> tuple[list[Trial], list[Trial]]:
        """The trials that windows held out confirm, and of the others those with much less noise.

        needed_gain: on the windows held out [nats].
        """
        settings = self.settings
        confirmed: list[Trial] = []
        with_less_noise: list[Trial] = []
        for trial in trials:
            if trial.fitted_gain <= settings.minimum_fitted_gain:
                continue
            if is_confirmed(state.test, trial.state.test, needed_gain, settings):
                confirmed.append(trial)
            elif has_less_noise(state.train, trial.state.train, settings):
                with_less_noise.append(trial)
        return confirmed, with_less_noise

    def _polished(self, trials: Sequence[Trial]) -> Iterator[Trial]:
        """Trials fitted to the end, each only when `_accept_first` asks for it."""
        for trial in trials:
            yield replace(trial, state=self.polish(trial.state))

    def _needed_gain(self, state: State, without_effects: State, effects: int) -> float:
        """The held-out gain [nats] that one more effect needs, of so many that are looked for."""
        needed_gain = self.settings.needed_gain(effects)
        if not state.accepted:
            return max(needed_gain, 0.0)
        gained = float((state.test.log_likelihood - without_effects.test.log_likelihood).sum())
        return max(needed_gain, self.settings.minimum_fraction * gained)

    def _accept_first(
        self, state: State, trials: Iterable[Trial], needed_gain: float
    ) -> State | None:
        """The first of a few trials that windows held out confirm when it is fitted to the end.

        Where fitting to the end gains more than what lets it be the first, the next ones are fitted
        so, too, and the best of them is taken.
        """
        accepted: State | None = None
        least = -np.inf
        for trial in islice(trials, self.settings.maximum_polished):
            if trial.penalized_gain < least:
                break
            if self.only_by_feedback(trial.state):
                continue
            polished = self.polish(trial.state)
            instance = trial.candidate.instance
            magnitudes = polished.theta[self.library.indices_of[instance.label]]
            if sets_in_at_an_end(instance, magnitudes):
                continue
            if not is_confirmed(state.test, polished.test, needed_gain, self.settings):
                continue
            gain = penalized_log_likelihood(polished)
            if accepted is None:
                least = trial.penalized_gain - (gain - penalized_log_likelihood(trial.state))
            else:
                others = [accepted.accepted[-1].effect]
                margin = self.settings.margin_in_place_of([instance.effect], others)
                if gain < penalized_log_likelihood(accepted) + margin:
                    continue
            accepted = polished
            self.origins[instance.label] = self._last_batch_with(trial.candidate)
        return accepted

    def _with_partner(
        self, state: State, instances: Sequence[EffectInstance], needed_gain: float
    ) -> State:
        """The state with what often comes with its last effect, where windows held out confirm it.

        So the two are one candidate of several numbers: what one of them stands for at first is
        shared.
        """
        last = state.accepted[-1]
        partner = partner_of(last, instances)
        if partner is None or partner in state.accepted:
            return state
        own = self.library.indices_of[last.label]
        others = self.library.indices_of[partner.label]
        theta = state.theta.copy()
        theta[own] = theta[others] = 0.5 * state.theta[own]
        self.progress(_fraction_done(len(state.accepted), 1.0), f"fitting {partner.label} as well")
        both = self.try_set(state, theta, (), (partner,), scanned=(last, partner))
        if not is_confirmed(state.test, both.test, needed_gain, self.settings):
            return state
        both = self.polish(both)
        if not is_confirmed(state.test, both.test, needed_gain, self.settings):
            return state
        self.set_origin_to_first_batch(partner)
        return both

    def try_set(
        self,
        state: State,
        theta: Array,
        removed: Sequence[EffectInstance],
        added: Sequence[EffectInstance],
        scanned: Sequence[EffectInstance] | None = None,
    ) -> State:
        """Fit a model with other effects in the place of some of its own.

        Parameters
        ----------
        state : State
            The model as it is.
        theta : (m,) array
            Where the fit begins: with the added effects, and 0 for those removed.
        removed, added : sequence of EffectInstance
            The effects that go, and those that come.
        scanned : sequence of EffectInstance, optional
            The effects whose magnitudes are scanned first where predictions are not smooth in them;
            those added if None.

        Returns
        -------
        State
            Fitted enough to compare it with others, linearized as `state` is.
        """
        library = self.library
        without = [library.indices_of[instance.label] for instance in removed]
        further = [library.indices_of[instance.label] for instance in added]
        free = np.setdiff1d(state.free, np.concatenate([NO_INDICES, *without]))
        free = np.concatenate([free, *further]).astype(np.int64)
        nonsmooth = nonsmooth_magnitudes(library, added if scanned is None else scanned)
        settings = self.settings.refit

        def fit() -> Sides:
            initial = shift_linearization(library, state.train, theta, state.train.whiten.noise)
            train = settle(
                library, initial, free, self.floor, nonsmooth=nonsmooth, settings=settings
            )
            noise = train.whiten.noise
            return train, shift_linearization(library, state.test, train.theta, noise)

        train, test = self._recorded(state, theta, fit)
        kept = tuple(instance for instance in state.accepted if instance not in removed)
        return State(train, test, free, (*kept, *added))

    def set_origin_to_first_batch(self, instance: EffectInstance) -> None:
        """Take the first batch in which an effect was tried as the one that it was accepted from.

        Parameters
        ----------
        instance : EffectInstance
            An accepted effect; one that no batch has tried has no origin.
        """
        for batch in self.batches:
            if any(trial.candidate.instance.label == instance.label for trial in batch.trials):
                self.origins[instance.label] = batch
                return

    def try_in_place_of(
        self,
        without: State,
        instance: EffectInstance,
        magnitudes: Array,
        instances: Sequence[EffectInstance],
    ) -> None:
        """Try what may stand in the place of an effect that no batch has tried.

        That batch becomes its origin. It has none where it promises too little by itself.

        Parameters
        ----------
        without : State
            The model without the effect.
        instance : EffectInstance
            The effect ...
        magnitudes : (q,) array
            ... as it was fitted beside the others.
        instances : sequence of EffectInstance
            The effects that may be accepted.
        """
        screened, promising = self.screen(without, instances)
        own = next((one for one in screened if one.instance.label == instance.label), None)
        if own is None:
            return
        others = [one for one in promising if one is not own][: self.settings.batch_size - 1]
        candidates = [replace(own, magnitudes=magnitudes), *others]
        batch = Batch(without, screened, self.try_candidates(without, candidates))
        self.batches.append(batch)
        # Where its simulation diverges by itself, it is not among what was tried.
        if any(trial.candidate.instance.label == instance.label for trial in batch.trials):
            self.origins[instance.label] = batch

    def _last_batch_with(self, candidate: Candidate) -> Batch:
        """The last batch in which a candidate was refitted."""
        for batch in reversed(self.batches):
            if any(trial.candidate is candidate for trial in batch.trials):
                return batch
        raise AssertionError("no batch has refitted this candidate")

    # --- fits of one model

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
            The one with the largest penalized gain first, as `most_plausible_first` orders them.
        """
        # The Jacobian by what is fitted already serves all candidates.
        jacobian: Array | None = None
        if len(state.free) and candidates:
            jacobian = self.library.kept_jacobian(state.theta, state.free, state.train.windows)
        trials = []
        for i, candidate in enumerate(candidates):
            part_of_batch = (1 + i) / (1 + len(candidates))
            done = _fraction_done(len(state.accepted), part_of_batch)
            self.progress(done, f"fitting {candidate.instance.label}")
            trials.append(self._try_candidate(state, candidate, jacobian))
        trials.sort(key=lambda trial: -trial.penalized_gain)
        return most_plausible_first(trials, self.settings)

    def only_by_feedback(self, state: State) -> bool:
        """Whether its last effect is there only because commands respond to random forces.

        Parameters
        ----------
        state : State
            A model with effects.

        Returns
        -------
        bool
        """
        sides = (state.train, state.test)
        return absent_in_single_steps(self.library, sides, state.accepted[-1], self.floor)

    def polish(self, state: State) -> State:
        """Fit a model to the end: linearized anew until that changes nothing any more.

        Parameters
        ----------
        state : State
            Any.

        Returns
        -------
        State
            With the same effects.
        """
        train, test = self._recorded(state, state.theta, lambda: self._polish(state))
        return replace(state, train=train, test=test)

    def _polish(self, state: State) -> Sides:
        """Both sides of a state fitted to the end."""
        library = self.library
        nonsmooth = nonsmooth_magnitudes(library, state.accepted)
        fitted = self._refit(state.train, state.free, nonsmooth=nonsmooth)
        theta = fitted.theta
        noise = fitted.whiten.noise
        # Did it matter to linearize anew? If not, the windows held out keep their linearization.
        shifted = shift_linearization(library, state.train, theta, noise)
        change = abs(float(shifted.log_likelihood.sum() - fitted.log_likelihood.sum()))
        if change < self.settings.refit.renewal_gain:
            return fitted, shift_linearization(library, state.test, theta, noise)
        return fitted, self._linearize_held_out(fitted, state.test.windows)

    def _try_candidate(self, state: State, candidate: Candidate, jacobian: Array | None) -> Trial:
        """The candidate added to the state and fitted with the rest.

        jacobian: (f, W, n) by the state's free numbers.
        """
        instance = candidate.instance
        indices = self.library.indices_of[instance.label]
        theta = state.theta.copy()
        theta[indices] = candidate.magnitudes
        free = np.concatenate([state.free, indices]).astype(np.int64)
        train, test = self._recorded(
            state, theta, lambda: self._fit_with(state, instance, theta, free, jacobian)
        )
        fitted_gains = train.log_likelihood - state.train.log_likelihood
        held_out_gain, z = gain_of(state.test, test)
        return Trial(
            candidate=candidate,
            magnitudes=train.theta[indices],
            state=State(train, test, free, (*state.accepted, instance)),
            fitted_gain=float(fitted_gains.sum()),
            held_out_gain=held_out_gain,
            z=z,
        )

    def _fit_with(
        self,
        state: State,
        instance: EffectInstance,
        theta: Array,
        free: Ints,
        jacobian: Array | None,
    ) -> Sides:
        """Both sides of a state fitted with one more effect, from theta (m,) on.

        jacobian: (f, W, n) by the state's free numbers.
        """
        library = self.library
        nonsmooth = nonsmooth_magnitudes(library, (instance,))
        initial = shift_linearization(library, state.train, theta, state.train.whiten.noise)
        if instance.sensor_delay is not None:
            # Without the delay, noise stands for it: the noise with it may be a very different one.
            noise = estimate_noise(initial, initial.whiten.noise, self.floor)
            initial = with_other_noise(library, initial, noise)
            if has_less_noise(state.train, initial, self.settings):
                initial = linearize(library, initial.windows, theta, noise)
                fitted = self._refit(initial, free, nonsmooth=nonsmooth, renewals=1)
                return fitted, self._linearize_held_out(fitted, state.test.windows)
        # Any other effect is tried with the linearization in the noise of the windows' start states
        # as it is.
        fitted = settle(
            library,
            initial,
            free,
            self.floor,
            nonsmooth=nonsmooth,
            known=jacobian,
            slopes=self.screening.slopes(initial.windows, instance),
            settings=self.settings.refit,
        )
        noise = fitted.whiten.noise
        return fitted, shift_linearization(library, state.test, fitted.theta, noise)

    def _recorded(self, state: State, theta: Array, fit: Callable[[], Sides]) -> Sides:
        """Both sides of a state fitted from theta (m,) on, or made again from their record."""
        sides = (state.train, state.test)
        windows = (state.train.windows, state.test.windows)
        key = np.concatenate([theta, state.train.whiten.noise.numbers])
        return recorded_sides(self.log, self.library, key, windows, fit, sides)

    def _refit(
        self,
        initial: LinearizedWindows,
        free: np.ndarray,
        *,
        rounds: int = 4,
        nonsmooth: Ints = NO_INDICES,
        renewals: int | None = None,
    ) -> LinearizedWindows:
        """Windows fitted as the settings say."""
        return refit(
            self.library,
            initial,
            free,
            self.floor,
            rounds=rounds,
            nonsmooth=nonsmooth,
            renewals=renewals,
            settings=self.settings.refit,
        )

    def _linearize_held_out(self, fitted: LinearizedWindows, test: Windows) -> LinearizedWindows:
        """The windows held out under what was fitted."""
        return linearize(self.library, test, fitted.theta, fitted.whiten.noise)


def _batches(candidates: Sequence[Candidate], size: int) -> Iterator[Sequence[Candidate]]:
    """The candidates, so many at a time; without any, one empty batch, which says so in records."""
    for start in range(0, max(len(candidates), 1), size):
        yield candidates[start : start + size]


def _fraction_done(accepted: int, part: float) -> float:
    """The fraction of the search that is done, after a part (0 to 1) of the next effect's step.

    Each step counts as half of what is left; the last tenth is left to what follows the search.
    """
    return 0.9 * (1 - 0.5**accepted * (1 - 0.5 * part))


def nonsmooth_magnitudes(library: Library, instances: Sequence[EffectInstance]) -> Ints:
    """Return the magnitudes of effects in which predictions are not smooth where they are now.

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
    nonsmooth = []
    for instance in instances:
        if instance.linear_in is not None:
            continue  # smooth wherever it is present
        indices = library.indices_of[instance.label]
        for index, quantity in zip(indices, instance.quantities, strict=True):
            if not quantity.smooth:
                nonsmooth.append(index)
    return np.array(nonsmooth, dtype=np.int64)
