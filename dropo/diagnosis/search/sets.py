"""Sets of effects in the place of the one that a search ended with.

Effects that were accepted one after another may stand for others that act together. So sets in
which some of them are exchanged for others, or others are added, are compared: all of them by the
Gram matrix of their whitened responses, which costs hardly any simulation, then the best of these
in simulation. The best models of a round begin the next, until no set is better.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.services.validation import Array
from dropo.diagnosis.search.confirmation import gain_of, is_confirmed
from dropo.diagnosis.search.library import partner_of
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.single_steps import absent_in_single_steps
from dropo.diagnosis.search.trials import State, penalized_log_likelihood


@dataclass(frozen=True)
class SetSettings:
    """Which sets are compared.

    Attributes
    ----------
    screened : int
        Effects of the pool that promise most beside the model ...
    tried : int
        ... and of those that were tried with each accepted one, ...
    pool : int
        ... at most, in all: sets grow with its third power.
    removed, added : int
        Effects that leave a model, and that join it, at most.
    refitted : int
        Sets that are refitted in simulation, each round.
    recovered : float
        Fraction of the loss without some effects that others must promise in their place.
    beam : int
        Models with which the next round begins.
    rounds : int
        At most.
    ridge : float
        Relative to each response, what keeps those apart that depend on each other.
    """

    screened: int = 8
    tried: int = 3
    pool: int = 14
    removed: int = 2
    added: int = 3
    refitted: int = 8
    recovered: float = 0.8
    beam: int = 2
    rounds: int = 3
    ridge: float = 1e-9


SETTINGS = SetSettings()
TINY = 1e-9
"""The least fraction of the residuals' variance that a set is taken to leave."""


@dataclass(frozen=True, eq=False)
class Exchange:
    """A set of effects in the place of another.

    Attributes
    ----------
    removed, added : tuple of EffectInstance
        The effects that go, and those that come.
    magnitudes : tuple of array
        Of those that come, as the Gram matrix says.
    promise : float
        What it promises on the windows to fit, less the BIC penalty of its numbers [nats].
    """

    removed: tuple[EffectInstance, ...]
    added: tuple[EffectInstance, ...]
    magnitudes: tuple[Array, ...]
    promise: float


@dataclass(frozen=True, eq=False)
class Gram:
    """Products of whitened responses at a model, and of what it leaves.

    Attributes
    ----------
    products : (1 + n + f + k,) square array
        Of the residuals, of what each of the n accepted effects does, of the f free numbers, and of
        k effects that may join.
    accepted : sequence of EffectInstance
        The n effects ...
    owner : (f,) int array
        ... and to which of them each free number belongs; -1 for a declared parameter.
    pool : sequence of EffectInstance
        The k effects, ...
    tried : sequence of array
        ... the magnitudes (q,) at which each was simulated ...
    multiples : (k, 2) array
        ... and the bounds of their multiples.
    variance : float
        Of the whitened residuals ...
    measurements : int
        ... and their number.
    steps : int
        Transitions in the windows.
    ridge : float
        As of `SetSettings`.
    """

    products: Array
    accepted: Sequence[EffectInstance]
    owner: Array
    pool: Sequence[EffectInstance]
    tried: Sequence[Array]
    multiples: Array
    variance: float
    measurements: int
    steps: int
    ridge: float

    def exchange(self, removed: tuple[int, ...], added: tuple[int, ...]) -> Exchange | None:
        """Evaluate a set.

        Parameters
        ----------
        removed, added : tuple of int
            Places among the accepted effects, and in the pool.

        Returns
        -------
        Exchange or None
            None where it asks for magnitudes out of bounds.
        """
        n = len(self.accepted)
        f = len(self.owner)
        target = np.zeros(len(self.products))
        target[[0, *(1 + i for i in removed)]] = 1.0
        kept = 1 + n + np.flatnonzero(~np.isin(self.owner, removed))
        columns = np.concatenate([kept, 1 + n + f + np.array(added, dtype=int)]).astype(int)
        sizes, left = _solved(self.products, target, columns, self.ridge)
        multiples = sizes[len(kept) :]
        low, high = self.multiples[list(added)].T
        if np.any(multiples <= low) or np.any(multiples > high):
            return None
        magnitudes = tuple(
            _scaled(self.pool[i], self.tried[i], size)
            for i, size in zip(added, multiples.tolist(), strict=True)
        )
        numbers = sum(len(one) for one in magnitudes)
        numbers -= int(np.isin(self.owner, removed).sum())
        # The variance is what is then left: linear in the squares, hardly anything would count
        # beside effects that are worth thousands of nats.
        more = (left - float(self.products[0, 0])) / (self.measurements * self.variance)
        gain = -0.5 * self.measurements * float(np.log1p(max(more, TINY - 1)))
        promise = gain - 0.5 * numbers * float(np.log(self.steps))
        return Exchange(
            tuple(self.accepted[i] for i in removed),
            tuple(self.pool[i] for i in added),
            magnitudes,
            promise,
        )


def _solved(products: Array, target: Array, columns: Array, ridge: float) -> tuple[Array, float]:
    """The sizes of columns that explain a target best, and the sum of squares that is left."""
    own = products @ target
    total = float(target @ own)
    if not len(columns):
        return np.zeros(0), total
    gram = products[np.ix_(columns, columns)]
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(scale, scale) + ridge * np.eye(len(columns))
    sizes = np.linalg.solve(scaled, own[columns] / scale) / scale
    return sizes, total - float(sizes @ own[columns])


@dataclass(eq=False)
class SetSearch:
    """The comparison of sets.

    Attributes
    ----------
    selection : Selection
        The search that ended.
    first : State
        The model as it is.
    instances : sequence of EffectInstance
        The effects that may be in a set.
    settings : SetSettings
        Which are compared.
    seen : set of frozenset of str
        The sets that were fitted, by the labels of their effects.
    """

    selection: Selection
    first: State
    instances: Sequence[EffectInstance]
    settings: SetSettings = SETTINGS
    seen: set[frozenset[str]] = field(default_factory=set)

    def run(self, last: State) -> State:
        """Exchange effects of a model for others until no set is better.

        Parameters
        ----------
        last : State
            The model, fitted to the end.

        Returns
        -------
        State
            `last` itself if no set is better.
        """
        best = last
        self.seen.add(_labels(last.accepted))
        beam = [last]
        for _ in range(self.settings.rounds):
            tried = [trial for state in beam for trial in self._refitted(state)]
            tried.sort(key=lambda trial: -penalized_log_likelihood(trial))
            better = self._first_better(best, tried[: self.settings.beam])
            if better is None:
                break
            best = better
            beam = [best, *(trial for trial in tried if trial is not better)]
            beam = beam[: self.settings.beam]
        if best is not last:
            for instance in best.accepted:
                if instance not in last.accepted:
                    self.selection.set_origin_to_first_batch(instance)
        return best

    def _first_better(self, best: State, tried: Sequence[State]) -> State | None:
        """The first of some models that is better than the best, for certain, fitted to the end."""
        selection = self.selection
        before = penalized_log_likelihood(best)
        for trial in tried:
            if not penalized_log_likelihood(trial) > before + selection.settings.negligible_gain:
                return None
            needed = before + self._margin(best, trial)
            new = [one for one in trial.accepted if one not in best.accepted]
            if any(self._only_by_feedback(trial, one) for one in new):
                continue
            polished = selection.polish(trial)
            is_better = penalized_log_likelihood(polished) > needed
            if is_better and self._confirmed(best, polished):
                return polished
        return None

    def _margin(self, best: State, other: State) -> float:
        """By how many nats a model must be better: more where its effects are less usual than as
        many that they stand in the place of.
        """
        settings = self.selection.settings
        gone = [one.effect for one in best.accepted if one not in other.accepted]
        new = [one.effect for one in other.accepted if one not in best.accepted]
        if len(new) < len(gone):
            return settings.negligible_gain
        new.sort(key=settings.plausibility.of, reverse=True)
        return settings.margin_in_place_of(new[: len(gone)], gone)

    def _confirmed(self, best: State, other: State) -> bool:
        """Whether windows held out confirm a model in the place of another.

        As many effects must be better; more must gain what as many that are accepted one after
        another would have to.
        """
        selection = self.selection
        settings = selection.settings
        more = len(other.accepted) - len(best.accepted)
        needed = settings.negligible_gain
        if more > 0:
            gained, _ = gain_of(self.first.test, best.test)
            needed = more * settings.needed_gain(len(self.instances))
            needed = max(needed, settings.minimum_fraction * gained)
        elif more < 0:
            # Fewer effects need not be better on data held out: they must not be worse.
            loss, _ = gain_of(other.test, best.test)
            return loss < settings.negligible_gain
        return is_confirmed(best.test, other.test, needed, settings)

    def _only_by_feedback(self, state: State, instance: EffectInstance) -> bool:
        """Whether an effect is there only because commands respond to random forces."""
        selection = self.selection
        sides = (state.train, state.test)
        return absent_in_single_steps(selection.library, sides, instance, selection.floor)

    def _refitted(self, state: State) -> list[State]:
        """The sets that promise most in the place of a model's own, refitted in simulation."""
        selection = self.selection
        indices_of = selection.library.indices_of
        pool = self._pool(state)
        if not pool:
            return []
        gram = gram_of(selection.library, state, pool, self.settings)
        found: list[State] = []
        for exchange in self._exchanges(gram):
            if len(found) >= self.settings.refitted:
                break
            kept = [one for one in state.accepted if one not in exchange.removed]
            labels = _labels([*kept, *exchange.added])
            if labels in self.seen:
                continue
            self.seen.add(labels)
            theta = state.theta.copy()
            for instance in exchange.removed:
                theta[indices_of[instance.label]] = 0.0
            for instance, magnitudes in zip(exchange.added, exchange.magnitudes, strict=True):
                theta[indices_of[instance.label]] = magnitudes
            named = ", ".join(instance.label for instance in exchange.added)
            selection.progress(0.9, f"fitting {named} together")
            found.append(selection.try_set(state, theta, exchange.removed, exchange.added))
        return found

    def _pool(self, state: State) -> list[tuple[EffectInstance, Array]]:
        """Effects that may join a model, with the magnitudes at which they are simulated."""
        settings = self.settings
        selection = self.selection
        own = {instance.label for instance in state.accepted}
        others = [instance for instance in self.instances if instance.label not in own]
        found: dict[str, tuple[EffectInstance, Array]] = {}
        # What promises most beside the model.
        screened = selection.screening(state.train, state.free, others)
        for candidate in screened[: settings.screened]:
            found[candidate.instance.label] = (candidate.instance, candidate.magnitudes)
        # What was tried when an effect was accepted, as it was fitted then; and its partner.
        for instance in state.accepted:
            partner = partner_of(instance, others)
            if partner is not None:
                half = 0.5 * state.theta[selection.library.indices_of[instance.label]]
                found.setdefault(partner.label, (partner, half))
            origin = selection.origins.get(instance.label)
            trials = [] if origin is None else list(origin.trials)
            away = [t for t in trials if t.candidate.instance.label not in own]
            for trial in away[: settings.tried]:
                one = trial.candidate.instance
                found.setdefault(one.label, (one, trial.magnitudes))
        joining = [one for one in found.values() if np.any(one[1])]
        return joining[: settings.pool]

    def _exchanges(self, gram: Gram) -> Iterator[Exchange]:
        """Sets that promise enough, the one that promises most first."""
        settings = self.settings
        minimum = self.selection.settings.minimum_fitted_gain
        as_it_is = gram.exchange((), ())
        if as_it_is is None:
            raise AssertionError("a model as it is has no bounds")
        n = len(gram.accepted)
        k = len(gram.pool)
        promising = []
        for size in range(min(settings.removed, n) + 1):
            for removed in combinations(range(n), size):
                needed = as_it_is.promise + minimum
                if removed:
                    without = gram.exchange(removed, ())
                    lost = as_it_is.promise - (needed if without is None else without.promise)
                    needed = as_it_is.promise - (1 - settings.recovered) * max(lost, 0.0)
                # One effect alone was tried beside the model already.
                for count in range(1 if removed else 2, settings.added + 1):
                    for added in combinations(range(k), count):
                        one = gram.exchange(removed, added)
                        if one is not None and one.promise > needed:
                            promising.append(one)
        promising.sort(key=lambda one: -one.promise)
        yield from promising


def gram_of(
    library: Library,
    state: State,
    pool: Sequence[tuple[EffectInstance, Array]],
    settings: SetSettings = SETTINGS,
) -> Gram:
    """Return the products of all responses at a model.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    state : State
        The model.
    pool : sequence of (EffectInstance, (q,) array)
        The k effects that may join, with the magnitudes at which they are simulated.
    settings : SetSettings
        Of which the ridge is used.

    Returns
    -------
    Gram
        By 1 + n + k simulations of the windows to fit, and two for each free number.
    """
    train = state.train
    space = library.simulator.space
    thetas = []
    for instance in state.accepted:
        theta = state.theta.copy()
        theta[library.indices_of[instance.label]] = 0.0
        thetas.append(theta)
    multiples = []
    for instance, magnitudes in pool:
        indices = library.indices_of[instance.label]
        theta = state.theta.copy()
        theta[indices] = magnitudes
        thetas.append(theta)
        scaling = slice(1) if instance.scaled else slice(None)
        low = space.low[indices]
        high = space.high[indices]
        multiples.append(_bounds(magnitudes[scaling], low[scaling], high[scaling]))
    n = len(state.accepted)
    changes = np.nan_to_num(library.predict(np.array(thetas), train.windows) - train.predicted)
    # What an effect does is what is missing without it.
    changes[:n] *= -1.0
    jacobian = np.zeros((0, *train.residuals.shape))
    if len(state.free):
        jacobian = library.jacobian(state.theta, state.free, train.windows)
    rows = np.concatenate([train.residuals[None], changes[:n], jacobian, changes[n:]])
    flat = train.flat(rows)
    products = flat @ flat.T
    owner = np.full(len(state.free), -1)
    for i, instance in enumerate(state.accepted):
        owner[np.isin(state.free, library.indices_of[instance.label])] = i
    measurements = max(train.residuals[~train.lost].size, 1)
    variance = max(float(products[0, 0]) / measurements, 0.5)
    return Gram(
        products,
        state.accepted,
        owner,
        [instance for instance, _ in pool],
        [magnitudes for _, magnitudes in pool],
        np.array(multiples),
        variance,
        measurements,
        train.windows.steps,
        settings.ridge,
    )


def _scaled(instance: EffectInstance, magnitudes: Array, size: float) -> Array:
    """Magnitudes of which an effect does so many times as much."""
    if not instance.scaled:
        return magnitudes * size
    scaled = np.array(magnitudes)
    scaled[0] *= size
    return scaled


def _bounds(magnitudes: Array, low: Array, high: Array) -> tuple[float, float]:
    """The multiples of magnitudes (q,) that stay within bounds; of nothing there are none but 0."""
    ends = [
        (float(bottom / size), float(top / size))
        for size, bottom, top in zip(magnitudes, low, high, strict=True)
        if size
    ]
    lowest = max((min(one) for one in ends), default=0.0)
    highest = min((max(one) for one in ends), default=0.0)
    return lowest, highest


def _labels(instances: Sequence[EffectInstance]) -> frozenset[str]:
    """The labels of a set."""
    return frozenset(instance.label for instance in instances)
