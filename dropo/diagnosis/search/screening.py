"""Which effects the residuals look like: a score test at finite probes, with what is fitted anyway
projected out.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library, LinearizedWindows, estimate_noise, whitener

BATCH = 64  # probes simulated at once
FINALISTS = 18  # atoms that are looked at on all windows
# a first choice takes one window in so many, where that leaves at least so many
COARSE = 4
LEAST = 12

ROUNDS = 4  # in which noise is learned for a promise
LEAST_NOISE = (
    0.5  # variance of whitened residuals: about 1 but where the noise is held at its least
)

Trial = tuple[EffectInstance, tuple[tuple[float, ...], ...]]
"""An atom with sizes that are tried together."""
Known = dict[tuple[str, tuple[tuple[float, ...], ...]], Array]


@dataclass(frozen=True, eq=False)
class Candidate:
    """An atom with the sizes (q,) that the residuals suggest, and what the score test promises.

    gain: [nats] of the windows' log-likelihood; signature: the whitened, weighted response (W (n +
    m),), of length 1.
    """

    instance: EffectInstance
    sizes: Array
    gain: float
    signature: Array


@dataclass(eq=False)
class Screening:
    """A screening that remembers how the first choice's windows answered to each probe: a later
    effect changes that little.

    floor: (p,) the least noise; free: the numbers of theta that are fitted with any of the atoms.
    """

    library: Library
    floor: Array
    remembered: Known = field(default_factory=dict)

    def __call__(
        self, linearized: LinearizedWindows, free: np.ndarray, instances: Sequence[EffectInstance]
    ) -> list[Candidate]:
        """The atoms by what they promise, most first: all of them on a quarter of the windows, the
        best of these on all windows.
        """
        if len(instances) > FINALISTS and len(linearized.windows) >= COARSE * LEAST:
            some = linearized.take(np.arange(0, len(linearized.windows), COARSE))
            first = self._score(
                some,
                free,
                [(instance, trial) for instance in instances for trial in coarse_probes(instance)],
                self.remembered,
            )
            instances = [candidate.instance for candidate in first[:FINALISTS]]
        return self._score(
            linearized,
            free,
            [(instance, trial) for instance in instances for trial in all_probes(instance)],
            {},
        )

    def _score(
        self, linearized: LinearizedWindows, free: np.ndarray, trials: Sequence[Trial], known: Known
    ) -> list[Candidate]:
        """The atoms that the windows answer to, by what the score test promises, most first."""
        free = _within(self.library, linearized.theta, free)
        basis = (
            np.linalg.qr(linearized.flat(self.library.jacobian(linearized.theta, free, linearized.windows)).T)[0]
            if len(free)
            else None
        )
        target = _rest(linearized.flat(linearized.residuals), basis)
        size = max(float(target @ target) / max(linearized.residuals[~linearized.lost].size, 1), LEAST_NOISE)
        best: dict[str, Candidate] = {}
        for (instance, trial), response in self._responses(linearized, trials, known):
            promises = [
                _score(
                    self.library,
                    linearized,
                    instance,
                    np.array(trial),
                    _rest(linearized.flat(response), basis),
                    target,
                    size,
                )
            ]
            if instance.sensor_delay is not None:
                promises += [
                    self._with_other_noise(linearized, instance, np.array(sizes), one)
                    for sizes, one in zip(trial, response, strict=True)
                ]
            for found in promises:
                if found is not None and (
                    instance.label not in best or found.gain > best[instance.label].gain
                ):
                    best[instance.label] = found
        return sorted(best.values(), key=lambda candidate: -candidate.gain)

    def _with_other_noise(
        self, linearized: LinearizedWindows, instance: EffectInstance, sizes: Array, response: Array
    ) -> Candidate:
        """An atom of sensors with sizes under which starts are in doubt, and the noise learned
        anew: without it, noise stands for it.
        """
        theta = linearized.theta.copy()
        place = self.library.places[instance.label]
        theta[place] += sizes
        way = whitener(self.library, linearized.windows, theta, linearized.whiten.sigma, linearized.loadings)
        there = replace(linearized, residuals=linearized.residuals - response, whiten=way)
        sigma = estimate_noise(there, linearized.whiten.sigma, self.floor, rounds=ROUNDS)
        learned = replace(
            there, whiten=whitener(self.library, linearized.windows, theta, sigma, linearized.loadings)
        )
        moves = linearized.flat(response)
        gain = float((learned.log_likelihood - linearized.log_likelihood)[~linearized.lost].sum())
        return Candidate(
            instance, theta[place], gain, moves / max(float(np.linalg.norm(moves)), 1e-300)
        )

    def _responses(
        self, linearized: LinearizedWindows, trials: Sequence[Trial], known: Known
    ) -> Iterator[tuple[Trial, Array]]:
        """Each trial with how far its sizes move the predictions (t, W, n); `known` is taken where
        it has them, and filled.
        """
        missing = [
            (instance, trial) for instance, trial in trials if (instance.label, trial) not in known
        ]
        for first in range(0, len(missing), BATCH):
            part = missing[first : first + BATCH]
            moved = np.nan_to_num(self._predictions(linearized, part) - linearized.predicted)
            ends = np.cumsum([len(trial) for _, trial in part])
            for (instance, trial), response in zip(part, np.split(moved, ends[:-1]), strict=True):
                known[instance.label, trial] = response
        for instance, trial in trials:
            yield (instance, trial), known[instance.label, trial]

    def _predictions(self, linearized: LinearizedWindows, trials: Sequence[Trial]) -> Array:
        """(sum of sizes tried, W, n)."""
        rows = np.repeat(linearized.theta[None], sum(len(trial) for _, trial in trials), axis=0)
        tried = [
            (self.library.places[instance.label], sizes)
            for instance, trial in trials
            for sizes in trial
        ]
        for row, (place, sizes) in zip(rows, tried, strict=True):
            row[place] += sizes
        return self.library.predict(
            np.clip(rows, self.library.simulator.space.low, self.library.simulator.space.high),
            linearized.windows,
        )


def _within(library: Library, theta: Array, free: np.ndarray) -> np.ndarray:
    """The free numbers that are on none of their bounds: the others will not make room for an
    effect.
    """
    space = library.simulator.space
    return free[(theta[free] > space.low[free]) & (theta[free] < space.high[free])]


def coarse_probes(instance: EffectInstance) -> list[tuple[tuple[float, ...], ...]]:
    """What a first choice tries: where predictions are smooth, the smallest probe; else one of each
    sign, or several sizes.
    """
    tried = sorted(instance.trials, key=_length)
    if all(quantity.smooth for quantity in instance.quantities):
        return tried[:1]
    if (
        instance.sensor_delay is not None
    ):  # judged with the noise learned anew, which no size stands for
        return tried
    if instance.time_profile is not None:  # the largest size, from every moment on that is tried
        return tried[-3:]
    upwards = [trial for trial in tried if trial[0][0] > 0]
    downwards = [trial for trial in tried if trial[0][0] < 0]
    return [upwards[-1], downwards[-1]] if upwards and downwards else tried[1::2] or tried


def all_probes(instance: EffectInstance) -> list[tuple[tuple[float, ...], ...]]:
    """What the best are tried at: every probe, but a single smooth number at its smallest alone."""
    return (
        coarse_probes(instance)
        if len(instance.quantities) == 1 and instance.quantities[0].smooth
        else list(instance.trials)
    )


def _length(trial: tuple[tuple[float, ...], ...]) -> float:
    return float(np.abs(trial).sum())


def _rest(rows: Array, basis: Array | None) -> Array:
    """Rows (..., N) without what an orthonormal basis (N, f) explains."""
    return rows if basis is None else rows - (rows @ basis) @ basis.T


def _score(
    library: Library,
    linearized: LinearizedWindows,
    instance: EffectInstance,
    trials: Array,
    responses: Array,
    target: Array,
    size: float,
) -> Candidate | None:
    """The score test along the trials' responses (t, ...); None where they answer nothing, or point
    out of bounds.
    """
    lengths = np.linalg.norm(responses, axis=1)
    if not np.all(lengths > 1e-9 * np.sqrt(size * len(target))):
        return None
    share = np.linalg.lstsq(responses.T, target, rcond=1e-8)[0]
    place = library.places[instance.label]
    space = library.simulator.space
    wanted = linearized.theta[place] + share @ trials
    sizes = np.clip(wanted, space.low[place], space.high[place])
    moves = sizes - linearized.theta[place]
    if not np.any(moves * (share @ trials) > 0):  # it would have to leave its bounds
        return None
    fitted = share @ responses
    return Candidate(
        instance, sizes, float(fitted @ target) / (2 * size), fitted / np.linalg.norm(fitted)
    )


def shortlist(
    candidates: Sequence[Candidate], most: int, least: float, each: int = 2
) -> list[Candidate]:
    """The first few that promise at least so many nats, no more than `each` of one effect; none
    that sets in or grows where the effect that is always there promises more.
    """
    chosen: list[Candidate] = []
    for candidate in candidates:
        same = sum(other.instance.effect == candidate.instance.effect for other in chosen)
        always = any(other.instance.label == candidate.instance.target for other in chosen)
        if candidate.gain > least and same < each and len(chosen) < most and not always:
            chosen.append(candidate)
    return chosen


def with_constant(
    candidates: Sequence[Candidate], instances: Sequence[EffectInstance]
) -> list[Candidate]:
    """Before each candidate that sets in or grows, the one of `atoms` that is always there, with
    its size: a large effect that declared parameters make up for in part may promise nothing at
    the small sizes that it is screened at.
    """
    always = {instance.label: instance for instance in instances}
    chosen = dict[str, Candidate]()
    for candidate in candidates:
        instance = (
            always.get(str(candidate.instance.target))
            if candidate.instance.time_profile is not None
            else None
        )
        if instance is not None:
            chosen.setdefault(
                instance.label,
                replace(
                    candidate, instance=instance, sizes=candidate.sizes[: len(instance.quantities)]
                ),
            )
        chosen.setdefault(candidate.instance.label, candidate)
    return list(chosen.values())
