"""Which effects the residuals suggest: a score test at finite probes, with everything that is
fitted anyway projected out.

Each effect is simulated at a few magnitudes (its probes). How far the residuals follow the change
of the predictions gives the gain in log-likelihood that the effect promises. Below there are W
windows of n measurements of p signals each, and theta (m,) holds the declared parameters, then the
magnitudes of all effects.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.numerics.closing_grid import best_place
from dropo.core.records.trajectories import Ints
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import (
    Library,
    LinearizedWindows,
    estimate_noise,
    whitener,
)
from dropo.diagnosis.search.plausibility import Plausibility
from dropo.diagnosis.search.record import recorded
from dropo.diagnosis.search.windows import Windows

Probe = tuple[tuple[float, ...], ...]
"""t vectors of changes of an effect's q magnitudes, along which one score test is made together."""
ProbedEffect = tuple[EffectInstance, Probe]
"""An effect and one of its probes."""
ResponseKey = tuple[str, Probe]
"""An effect's label and one of its probes."""
Responses = dict[ResponseKey, Array]
"""By an effect's label and the probe, the change (t, W, n) of the predictions."""

SMALLEST_LENGTH = 1e-300  # stands for the length of a response that is 0
NEGLIGIBLE_RESPONSE = 1e-9  # length of a response, in that of the residuals, that counts as none
RANK_TOLERANCE = 1e-8  # relative singular value below which responses count as dependent


@dataclass(frozen=True)
class ScreeningSettings:
    """How effects are screened.

    Attributes
    ----------
    batch : int
        Probes that are simulated at once.
    finalists : int
        Effects that are screened on all windows, after a first choice on some.
    coarse_stride : int
        A first choice takes one window of so many.
    coarse_windows : int
        There is a first choice only where it has at least so many windows.
    kept_screenings : int
        So many screenings keep the responses of all windows.
    noise_rounds : int
        Iterations in which the noise is learned for one promise.
    minimum_variance : float
        Lower bound of the whitened residuals' variance, which is about 1 unless the noise is at its
        lower bound.
    """

    batch: int = 64
    finalists: int = 18
    coarse_stride: int = 4
    coarse_windows: int = 12
    kept_screenings: int = 3
    noise_rounds: int = 4
    minimum_variance: float = 0.5


SETTINGS = ScreeningSettings()


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect, and what the score test promises of it.

    Attributes
    ----------
    instance : EffectInstance
        The effect.
    magnitudes : (q,) array
        The magnitudes that the residuals suggest, in the units of its quantities.
    gain : float
        In the windows' log-likelihood [nats].
    signature : (W (n + r),) array
        The change of the predictions, whitened and weighted as by `LinearizedWindows.flat`, of
        length 1.
    """

    instance: EffectInstance
    magnitudes: Array
    gain: float
    signature: Array

    def penalized_gain(self, steps: int) -> float:
        """Return the gain less the BIC penalty for each magnitude beyond the first [nats].

        Parameters
        ----------
        steps : int
            Transitions in the windows.

        Returns
        -------
        float
        """
        return self.gain - 0.5 * (len(self.magnitudes) - 1) * float(np.log(steps))


Scored = dict[str, tuple[Candidate, Probe]]
"""By an effect's label, what it promises along the probe that promises most."""


@dataclass(eq=False)
class Screening:
    """The score tests of a search, which keep the responses that its first choice was made with.

    Effects that are accepted later hardly change them.

    Attributes
    ----------
    library : Library
        The simulator with every effect.
    floor : (p,) array
        Lower bound of the noise's standard deviations, in the signals' units.
    settings : ScreeningSettings
        How effects are screened.
    log : EvaluationLog
        Where choices on some of the windows are recorded.
    first_windows : LinearizedWindows or None
        Some of the windows, as the very first choice found them; None before it.
    first_responses : dict
        Their responses, by effect and probe, which all later choices take too.
    counted : set
        The effects and probes whose responses have been counted as simulator steps, also those of
        a choice that a resumed search read from the log.
    recent_responses : list
        All windows that were screened last, and their responses as they were first found.
    best : dict
        By an effect's label, the probe along which it promised most on all windows.
    """

    library: Library
    floor: Array
    settings: ScreeningSettings = SETTINGS
    log: EvaluationLog = field(default_factory=EvaluationLog)
    first_windows: LinearizedWindows | None = None
    first_responses: Responses = field(default_factory=dict)
    counted: set[ResponseKey] = field(default_factory=set)
    recent_responses: list[tuple[Windows, Responses]] = field(default_factory=list)
    best: dict[str, Probe] = field(default_factory=dict)

    def __call__(
        self, linearized: LinearizedWindows, free: np.ndarray, instances: Sequence[EffectInstance]
    ) -> list[Candidate]:
        """Order effects by what they promise.

        All are screened on some of the windows, the best of these on all windows along the probe
        that promises most there.

        Parameters
        ----------
        linearized : LinearizedWindows
            The windows to fit, as the model without the effects explains them.
        free : (f,) int array
            Indices of the numbers of theta that are fitted with any of the effects.
        instances : sequence of EffectInstance
            The effects.

        Returns
        -------
        list of Candidate
            The one that promises most comes first.
        """
        settings = self.settings
        probed = _every_probe(instances)
        # Where effects are many, only those that promise most on some of the windows go on.
        count = len(linearized.windows)
        enough_windows = count >= settings.coarse_stride * settings.coarse_windows
        if len(instances) > settings.finalists and enough_windows:
            some = linearized.take(np.arange(0, count, settings.coarse_stride))
            probed = self._first_choice(some, free, instances)
        # These are scored on all windows.
        inside = _inside_bounds(self.library, linearized.theta, free)
        jacobian = self.library.kept_jacobian(linearized.theta, inside, linearized.windows)
        responses = self._responses_of(linearized.windows)
        scored = self._score_all(linearized, jacobian, probed, responses)
        self.best.update({label: probe for label, (_, probe) in scored.items()})
        return _by_gain(scored)

    def by_part(
        self,
        linearized: LinearizedWindows,
        free: np.ndarray,
        instances: Sequence[EffectInstance],
        parts: Sequence[Ints],
    ) -> list[list[Candidate]]:
        """Order effects by what they promise on parts of the windows; each is simulated once.

        Parameters
        ----------
        linearized, free, instances
            As of a call; all instances are screened on all windows, each along the probe that
            promised most when it was screened before.
        parts : sequence of int array
            The windows of each part.

        Returns
        -------
        list of list of Candidate
            For each part, the one that promises most first.
        """
        responses = self._responses_of(linearized.windows)
        probed: list[ProbedEffect] = []
        for instance in instances:
            best = self.best.get(instance.label)
            probes = all_probes(instance) if best is None else [best]
            probed += [(instance, probe) for probe in probes]
        self._add_responses(linearized, probed, responses)
        inside = _inside_bounds(self.library, linearized.theta, free)
        jacobian = self.library.kept_jacobian(linearized.theta, inside, linearized.windows)
        found = []
        for part in parts:
            of_part = {key: changes[:, part] for key, changes in responses.items()}
            own = linearized.take(part)
            found.append(_by_gain(self._score_all(own, jacobian[:, part], probed, of_part)))
        return found

    def _responses_of(self, windows: Windows) -> Responses:
        """The responses of all windows that are known by now; what is added to them is kept."""
        responses = self._recent_responses_of(windows)
        if responses is None:
            responses = {}
            before = self.recent_responses[: self.settings.kept_screenings - 1]
            self.recent_responses = [(windows, responses), *before]
        return responses

    def _recent_responses_of(self, windows: Windows) -> Responses | None:
        """The responses of windows; None where these were not screened lately."""
        for screened, responses in self.recent_responses:
            if screened is windows:
                return responses
        return None

    def slopes(self, windows: Windows, instance: EffectInstance) -> Array | None:
        """Return the derivatives of predictions by an effect's magnitudes, as screening saw them.

        Parameters
        ----------
        windows : Windows
            W windows of n measurements.
        instance : EffectInstance
            The effect.

        Returns
        -------
        (q, W, n) array or None
            None where predictions are not smooth in the magnitudes, or not all were probed there.
        """
        smooth = all(quantity.smooth for quantity in instance.quantities)
        probe = self.best.get(instance.label)
        if probe is None or not smooth or instance.time_profile or instance.linear_in:
            return None
        responses = self._recent_responses_of(windows) or {}
        changes = responses.get((instance.label, probe))
        if changes is None or len(probe) != len(instance.quantities):
            return None
        return np.asarray(np.tensordot(np.linalg.pinv(np.array(probe)), changes, axes=1))

    def _first_choice(
        self, some: LinearizedWindows, free: np.ndarray, instances: Sequence[EffectInstance]
    ) -> list[ProbedEffect]:
        """The effects that promise most on some of the windows, each with its best probe, or those
        that are recorded.

        Their responses are those that the very first choice was made with.
        """
        if self.first_windows is None:
            self.first_windows = some
        coarse = [(instance, probe) for instance in instances for probe in coarse_probes(instance)]

        def choose() -> list[ProbedEffect]:
            return self._choose(some, free, coarse)

        # A choice is recorded by the positions of the chosen among all, and of their probes.
        def pack(chosen: list[ProbedEffect]) -> Array:
            positions = [
                (instances.index(instance), all_probes(instance).index(probe))
                for instance, probe in chosen
            ]
            return np.array(positions, dtype=float).ravel()

        def unpack(record: Array) -> list[ProbedEffect]:
            chosen = []
            for position, which in record.reshape(-1, 2).astype(int).tolist():
                instance = instances[position]
                chosen.append((instance, all_probes(instance)[which]))
            return chosen

        key = np.concatenate([some.theta, some.whiten.sigma])
        chosen = recorded(self.log, self.library.simulator, key, choose, pack, unpack)
        counted = [*coarse, *_every_probe([instance for instance, _ in chosen])]
        self.counted.update(_key(instance, probe) for instance, probe in counted)
        return chosen

    def _choose(
        self, some: LinearizedWindows, free: np.ndarray, coarse: Sequence[ProbedEffect]
    ) -> list[ProbedEffect]:
        """The effects that promise most on some of the windows, each with its best probe: all along
        the coarse probes, then the best of them along every probe.
        """
        inside = _inside_bounds(self.library, some.theta, free)
        jacobian = self.library.jacobian(some.theta, inside, some.windows)
        self._add_first_responses(coarse)
        scored = self._score_all(some, jacobian, coarse, self.first_responses)
        # By chance alone, effects of several numbers promise more than others.
        steps = some.windows.steps
        ranked = sorted(_by_gain(scored), key=lambda one: -one.penalized_gain(steps))
        finalists = [candidate.instance for candidate in ranked[: self.settings.finalists]]
        every = _every_probe(finalists)
        self._add_first_responses(every)
        scored = self._score_all(some, jacobian, every, self.first_responses)
        probes = {label: probe for label, (_, probe) in scored.items()}
        ordered = [candidate.instance for candidate in _by_gain(scored)]
        return [(instance, probes[instance.label]) for instance in ordered]

    def _add_first_responses(self, probed: Sequence[ProbedEffect]) -> None:
        """Simulate what is missing of the first windows' responses.

        A search that was resumed reads its choices from the log, with the steps that their
        responses took, but has not the responses: these it simulates again.
        """
        first = self.first_windows
        assert first is not None
        simulator = self.library.simulator
        counted = [one for one in probed if _key(*one) in self.counted]
        # Their steps were counted when the choice was read: put the counter back, so that a resumed
        # search ends with as many steps as one that was never interrupted.
        steps_before = simulator.steps
        self._add_responses(first, counted, self.first_responses)
        simulator.steps = steps_before
        self._add_responses(first, probed, self.first_responses)

    def _score_all(
        self,
        linearized: LinearizedWindows,
        jacobian: Array,
        probed: Sequence[ProbedEffect],
        responses: Responses,
    ) -> Scored:
        """The best candidate of each effect to which the windows respond, with its probe.

        jacobian: (f, W, n) by the free numbers of theta. Responses that are missing are simulated
        and added.
        """
        library = self.library
        theta = linearized.theta
        # Whatever the free numbers of theta explain is no evidence of an effect: project it out of
        # the whitened residuals, and below out of the whitened responses.
        basis = _explained_by(linearized, jacobian)
        unexplained = project_out(linearized.flat(linearized.residuals), basis)
        measurements = max(linearized.residuals[~linearized.lost].size, 1)
        mean_square = float(unexplained @ unexplained) / measurements
        variance = max(mean_square, self.settings.minimum_variance)

        # Of all probes of an effect, the one that promises most stands for it.
        self._add_responses(linearized, probed, responses)
        best: Scored = {}
        for instance, probe in probed:
            changes = responses[instance.label, probe]
            whitened = project_out(linearized.flat(changes), basis)
            scored = [_score(library, theta, instance, probe, whitened, unexplained, variance)]
            if instance.sensor_delay is not None:
                for magnitudes, change in zip(probe, changes, strict=True):
                    scored.append(self._with_new_noise(linearized, instance, magnitudes, change))
            for candidate in scored:
                _keep_better(best, candidate, probe)
        return best

    def _with_new_noise(
        self,
        linearized: LinearizedWindows,
        instance: EffectInstance,
        magnitudes: Sequence[float],
        change: Array,
    ) -> Candidate:
        """The promise of a sensor's delay, with the noise learned anew: without it, noise stands
        for the delay.

        change: (W, n) of the predictions under the magnitudes (q,).
        """
        library = self.library
        windows = linearized.windows
        loadings = linearized.loadings
        # The magnitudes are those that were simulated; a delay's probes lie within its bounds.
        theta = linearized.theta.copy()
        indices = library.indices_of[instance.label]
        theta[indices] += np.array(magnitudes)
        # The windows with the delay, under the noise as it is.
        noise_before = linearized.whiten.noise
        whiten = whitener(library, windows, theta, noise_before, loadings)
        delayed = replace(linearized, residuals=linearized.residuals - change, whiten=whiten)
        # The same under the noise that is then left.
        rounds = self.settings.noise_rounds
        noise_left = estimate_noise(delayed, noise_before, self.floor, rounds=rounds)
        whiten = whitener(library, windows, theta, noise_left, loadings)
        with_noise_left = replace(delayed, whiten=whiten)
        # What both together gain, in windows that do not diverge.
        gains = with_noise_left.log_likelihood - linearized.log_likelihood
        gain = float(gains[~linearized.lost].sum())
        # This gain counts all that the delay explains, also what the free numbers of theta could:
        # so the signature is the whole change, with nothing projected out.
        whitened = linearized.flat(change)
        signature = whitened / max(float(np.linalg.norm(whitened)), SMALLEST_LENGTH)
        return Candidate(instance, theta[indices], gain, signature)

    def _add_responses(
        self,
        linearized: LinearizedWindows,
        probed: Sequence[ProbedEffect],
        responses: Responses,
    ) -> None:
        """Simulate the responses that are missing, and add them.

        Of an effect that sets in, the effect that always holds is simulated.
        """
        missing: dict[ResponseKey, ProbedEffect] = {}
        derived: list[_DerivedResponse] = []
        for instance, probe in probed:
            if _key(instance, probe) in responses:
                continue
            simulated = (instance, probe)
            from_constant = self._from_constant(linearized.windows, instance, probe)
            if from_constant is not None:
                derived.append(from_constant)
                simulated = from_constant.constant_probe
            if _key(*simulated) not in responses:
                missing[_key(*simulated)] = simulated
        self._simulate(linearized, list(missing.values()), responses)
        for one in derived:
            constant = responses[_key(*one.constant_probe)]
            responses[_key(*one.probed)] = one.factors[:, :, None] * constant

    def _from_constant(
        self, windows: Windows, instance: EffectInstance, probe: Probe
    ) -> "_DerivedResponse | None":
        """How the response to an effect that sets in follows from that to the constant effect; None
        where it must be simulated itself.
        """
        constant = self._constant(instance)
        if constant is None:
            return None
        factors = _profile_factors(windows, instance, probe)
        if not np.isin(factors, (0.0, 1.0)).all():
            return None
        # The constant effect's magnitudes come first, those of the time profile behind them.
        count = len(constant.quantities)
        constant_probe = tuple(magnitudes[:count] for magnitudes in probe)
        return _DerivedResponse((instance, probe), (constant, constant_probe), factors)

    def _constant(self, instance: EffectInstance) -> EffectInstance | None:
        """The effect that always holds of one with a time profile; None where there is none."""
        if instance.time_profile is None:
            return None
        labels = (one for one in self.library.instances if one.label == instance.target)
        return next(labels, None)

    def _simulate(
        self,
        linearized: LinearizedWindows,
        missing: Sequence[ProbedEffect],
        responses: Responses,
    ) -> None:
        """Simulate responses, and add them."""
        for start in range(0, len(missing), self.settings.batch):
            batch = missing[start : start + self.settings.batch]
            predicted = self._predictions(linearized, batch)
            # A window whose simulation diverges counts as one without response.
            changes = np.nan_to_num(predicted - linearized.predicted)
            # The rows of all probes stand behind each other: cut them apart.
            ends = np.cumsum([len(probe) for _, probe in batch])
            by_probe = np.split(changes, ends[:-1])
            for (instance, probe), own_changes in zip(batch, by_probe, strict=True):
                responses[instance.label, probe] = own_changes

    def _predictions(self, linearized: LinearizedWindows, probed: Sequence[ProbedEffect]) -> Array:
        """(T, W, n) the predictions under each of the T vectors of magnitudes of the probes."""
        space = self.library.simulator.space
        thetas = []
        for instance, probe in probed:
            indices = self.library.indices_of[instance.label]
            for magnitudes in probe:
                theta = linearized.theta.copy()
                theta[indices] += magnitudes
                thetas.append(theta)
        within_bounds = np.clip(np.stack(thetas), space.low, space.high)
        return self.library.predict(within_bounds, linearized.windows)


@dataclass(frozen=True, eq=False)
class _DerivedResponse:
    """A probe of an effect that sets in, and that of the constant effect whose response it has,
    times factors (t, W): 1 in a window where the effect holds, 0 where it does not.
    """

    probed: ProbedEffect
    constant_probe: ProbedEffect
    factors: Array


def _key(instance: EffectInstance, probe: Probe) -> ResponseKey:
    """By what responses to a probe are found."""
    return instance.label, probe


def _profile_factors(windows: Windows, instance: EffectInstance, probe: Probe) -> Array:
    """(t, W) the factors of a probe's magnitudes in each window, as the time profile has them."""
    profile: Any = instance.time_profile
    return np.stack([profile(windows.segments, np.array(magnitudes)) for magnitudes in probe])


def _by_gain(scored: Scored) -> list[Candidate]:
    """The candidates, the one that promises most first."""
    candidates = [candidate for candidate, _ in scored.values()]
    return sorted(candidates, key=lambda candidate: -candidate.gain)


def _explained_by(linearized: LinearizedWindows, jacobian: Array) -> Array | None:
    """An orthonormal basis (N, f) of what a Jacobian (f, W, n) explains; None if nothing.

    The N rows are those of `LinearizedWindows.flat`.
    """
    if not len(jacobian):
        return None
    basis, _ = np.linalg.qr(linearized.flat(jacobian).T)
    return np.asarray(basis)


def _keep_better(best: Scored, candidate: Candidate | None, probe: Probe) -> None:
    """Note a candidate and its probe as the best of its effect, if none promises as much."""
    if candidate is None:
        return
    label = candidate.instance.label
    if label not in best or candidate.gain > best[label][0].gain:
        best[label] = (candidate, probe)


def _inside_bounds(library: Library, theta: Array, free: np.ndarray) -> np.ndarray:
    """Those of the free numbers (f,) of theta that are on no bound: the others cannot move."""
    space = library.simulator.space
    inside = (theta[free] > space.low[free]) & (theta[free] < space.high[free])
    return free[inside]


def coarse_probes(instance: EffectInstance) -> list[Probe]:
    """Return the probes of an effect for a first choice.

    Parameters
    ----------
    instance : EffectInstance
        The effect.

    Returns
    -------
    list of tuple
        The smallest probe where predictions are smooth in the magnitudes; else the largest of each
        sign, or several magnitudes. As many vectors as there are magnitudes where predictions are
        linear in more numbers.
    """
    if instance.linear_in is not None:
        return [instance.trials[0][: len(instance.quantities)]]
    probes = sorted(instance.trials, key=_size)
    if all(quantity.smooth for quantity in instance.quantities):
        return probes[:1]
    if instance.sensor_delay is not None:
        # Each is evaluated with the noise learned anew, so that none stands for another.
        return probes
    if instance.time_profile is not None:
        # The three largest, or all of an effect that grows.
        return probes[-3:]
    upwards = [probe for probe in probes if probe[0][0] > 0]
    downwards = [probe for probe in probes if probe[0][0] < 0]
    if upwards and downwards:
        return [upwards[-1], downwards[-1]]
    every_second = probes[1::2]
    return every_second or probes


def all_probes(instance: EffectInstance) -> list[Probe]:
    """Return the probes of an effect that is among the best.

    Parameters
    ----------
    instance : EffectInstance
        The effect.

    Returns
    -------
    list of tuple
        Every probe; of a single magnitude in which predictions are smooth, the smallest alone.
    """
    if len(instance.quantities) == 1 and instance.quantities[0].smooth:
        return coarse_probes(instance)
    return list(instance.trials)


def _every_probe(instances: Sequence[EffectInstance]) -> list[ProbedEffect]:
    """Effects that are among the best, with each of their probes."""
    return [(instance, probe) for instance in instances for probe in all_probes(instance)]


def _size(probe: Probe) -> float:
    """The sum of a probe's absolute magnitudes, whatever their units: it only orders probes."""
    return float(np.abs(probe).sum())


def project_out(rows: Array, basis: Array | None) -> Array:
    """Take the projections of rows on a basis away.

    Parameters
    ----------
    rows : (..., N) array
        Whitened residuals or responses.
    basis : (N, f) array or None
        Orthonormal.

    Returns
    -------
    (..., N) array
        The rows as they are where there is no basis.
    """
    if basis is None:
        return rows
    return rows - (rows @ basis) @ basis.T


def _score(
    library: Library,
    theta: Array,
    instance: EffectInstance,
    probe: Probe,
    whitened_responses: Array,
    unexplained: Array,
    variance: float,
) -> Candidate | None:
    """The score test of residuals (N,) along the responses (t, N) to a probe, all whitened and with
    what is fitted anyway projected out.

    None where the windows do not respond, or where the residuals ask for magnitudes out of bounds.
    """
    # Predictions may be linear not in the magnitudes, but in coefficients that these stand for.
    if instance.linear_in is not None and probe in instance.trials:
        return _score_on_grid(library, instance, probe, whitened_responses, unexplained, variance)
    lengths = np.linalg.norm(whitened_responses, axis=1)
    negligible = NEGLIGIBLE_RESPONSE * np.sqrt(variance * len(unexplained))
    if not np.all(lengths > negligible):
        return None
    # The multiples of the probe's t vectors that explain the residuals best, by least squares, and
    # the change of the magnitudes (q,) that they make together.
    multiples = np.linalg.lstsq(whitened_responses.T, unexplained, rcond=RANK_TOLERANCE)[0]
    wanted_change = multiples @ np.array(probe)
    # The magnitudes that come nearest to that within the bounds; at least one must move that way.
    indices = library.indices_of[instance.label]
    space = library.simulator.space
    before = theta[indices]
    magnitudes = np.clip(before + wanted_change, space.low[indices], space.high[indices])
    possible_change = magnitudes - before
    if not np.any(possible_change * wanted_change > 0):
        return None
    # What is fitted takes `fitted @ unexplained` from the sum of squares: half of that, in units of
    # the variance, is the gain in log-likelihood.
    fitted = multiples @ whitened_responses
    gain = float(fitted @ unexplained) / (2 * variance)
    signature = fitted / np.linalg.norm(fitted)
    return Candidate(instance, magnitudes, gain, signature)


def _score_on_grid(
    library: Library,
    instance: EffectInstance,
    probe: Probe,
    whitened_responses: Array,
    unexplained: Array,
    variance: float,
) -> Candidate | None:
    """The score test of an effect like a payload: its response is linear in coefficients (k,), such
    as mass and mass times place, that are in proportion to its first magnitude.

    The responses to the probe's t vectors give that to each coefficient. With it, the further
    magnitudes are tried on a grid, each with the best first one, without any simulation. Arguments
    as of `_score`; None where no first magnitude above 0 explains anything.
    """
    linear_in = instance.linear_in
    if linear_in is None:
        raise AssertionError("predictions are linear in the magnitudes")
    tried = np.array(probe)
    by_coefficient = np.linalg.pinv(linear_in(tried), rcond=RANK_TOLERANCE) @ whitened_responses

    def coefficients(further_magnitudes: Array) -> Array:
        """(K, k) of a first magnitude of 1 with each of K further ones (K, q - 1)."""
        return linear_in(np.insert(further_magnitudes, 0, 1.0, axis=1))

    high = library.simulator.space.high[library.indices_of[instance.label]]
    best = best_place(
        coefficients,
        by_coefficient @ by_coefficient.T,
        by_coefficient @ unexplained,
        tried[0, 1:],
        high[1:],
    )
    if best is None:
        return None
    further_magnitudes = best.place
    magnitudes = np.append(min(best.size, float(high[0])), further_magnitudes)
    fitted = linear_in(np.append(best.size, further_magnitudes)) @ by_coefficient
    signature = fitted / max(float(np.linalg.norm(fitted)), SMALLEST_LENGTH)
    return Candidate(instance, magnitudes, best.gain / (2 * variance), signature)


def shortlist(
    candidates: Sequence[Candidate], maximum: int, minimum_gain: float, each: int = 2
) -> list[Candidate]:
    """Return the first candidates that promise enough.

    Parameters
    ----------
    candidates : sequence of Candidate
        Those that promise most come first.
    maximum : int
        How many are returned at most.
    minimum_gain : float
        The gain that each must promise more than [nats].
    each : int
        How many instances of one effect are returned at most.

    Returns
    -------
    list of Candidate
        Without effects that set in or grow, if the same effect without a time profile promises
        more.
    """
    chosen: list[Candidate] = []
    for candidate in candidates:
        instance = candidate.instance
        if len(chosen) >= maximum or not candidate.gain > minimum_gain:
            continue
        chosen_of_effect = [one for one in chosen if one.instance.effect == instance.effect]
        # The target of an effect with a time profile is the label of the one without.
        constant_is_chosen = any(one.instance.label == instance.target for one in chosen)
        if len(chosen_of_effect) < each and not constant_is_chosen:
            chosen.append(candidate)
    return chosen


def with_constant(
    candidates: Sequence[Candidate], instances: Sequence[EffectInstance]
) -> list[Candidate]:
    """Put the constant effect before each candidate that sets in or grows.

    A large constant effect that declared parameters compensate in part may promise nothing at the
    small magnitudes at which it is screened.

    Parameters
    ----------
    candidates : sequence of Candidate
        Some of them with a time profile.
    instances : sequence of EffectInstance
        The effects that may be added, among them constant ones.

    Returns
    -------
    list of Candidate
        Each effect once; a constant one has the magnitudes of the candidate that it precedes.
    """
    by_label = {instance.label: instance for instance in instances}
    chosen: dict[str, Candidate] = {}
    for candidate in candidates:
        # The target of an effect with a time profile is the label of the one without.
        instance = candidate.instance
        constant = by_label.get(str(instance.target))
        if constant is not None and instance.time_profile is not None:
            # Its magnitudes come first, those of the time profile behind them.
            magnitudes = candidate.magnitudes[: len(constant.quantities)]
            as_constant = replace(candidate, instance=constant, magnitudes=magnitudes)
            chosen.setdefault(constant.label, as_constant)
        chosen.setdefault(instance.label, candidate)
    return list(chosen.values())


def most_usual_of_twins_first(
    candidates: Sequence[Candidate], similarity: float, plausibility: Plausibility
) -> list[Candidate]:
    """Put the most usual of candidates that do the same to the data in the place of the first.

    So that it is among the few that are refitted.

    Parameters
    ----------
    candidates : sequence of Candidate
        Those that promise most come first.
    similarity : float
        Cosine of two signatures above which candidates do the same.
    plausibility : Plausibility
        How usual each effect is.

    Returns
    -------
    list of Candidate
        Each once; the others stay in their order.
    """
    left = list(candidates)
    found = []
    while left:
        twins = [one for one in left if abs(one.signature @ left[0].signature) > similarity]
        usual = max([left[0], *twins], key=lambda one: plausibility.of(one.instance.effect))
        found.append(usual)
        left.remove(usual)
    return found
