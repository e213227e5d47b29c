"""What a model that is far off lacks: regression, whole motions, what else these ask for."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.estimator import Progress
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.validation import Array
from dropo.diagnosis.far_off.added_mass import (
    as_payloads,
    for_gain,
    for_payload,
    is_mass_for_gain,
)
from dropo.diagnosis.far_off.families import ALONG_TENDONS, late_otherwise, with_families
from dropo.diagnosis.far_off.model import GAIN, PAYLOAD, FarOffModel, reaching
from dropo.diagnosis.far_off.motions import LongWindowSettings, Motions, motions_of, outer_spread
from dropo.diagnosis.far_off.output_error import Fitted, Known, OutputError, OutputErrorSettings
from dropo.diagnosis.far_off.payloads import promised_payload
from dropo.diagnosis.far_off.ties import ties_of
from dropo.diagnosis.search.arithmetic import Arithmetic, ArithmeticSettings, alternatives_of
from dropo.diagnosis.search.bounds import at_bounds, totals_of
from dropo.diagnosis.search.library import robot_of
from dropo.diagnosis.search.linearization import DIVERGED, Library
from dropo.diagnosis.search.selection import STOPPING
from dropo.mjmodel.dynamics.dry_friction import FrictionKind
from dropo.mjmodel.robot_simulator import RobotSimulator

KNOWN = 1e-4
"""Standard deviation of a scale that is known."""

FEWEST = 8
"""Windows that any fit takes, where there are so many."""

ROUGH = OutputErrorSettings(jacobians=4, tolerance=0.003)
"""Enough to begin with."""


@dataclass(frozen=True)
class FarOffSettings:
    """Numbers that decide where a model lacks much.

    Attributes
    ----------
    laws : tuple of str
        Effects that every joint has: those that regression leaves out are not certain to be none,
        and without them the scale of all forces would seem known.
    usual : tuple of str
        Effects that a machine usually has: they are left out only where the others make up for them
        by a linear step. Without any other kind, all numbers are fitted anew before it is kept.
    families : tuple of tuple of str
        Effects that are tried at every joint or drive where motions are not explained, one group
        after another, then all that were refused together.
    misfit : float
        Multiple of the sensors' noise from which motions are not explained.
    share : float
        Fraction of the cost on data held out that a group must take away.
    z : float
        Number of standard errors, by piece of all data, that a group's gain must be above 0.
    needless : float
        Number of standard errors up to which what is lost without a kind of effect is no reason to
        keep it.
    first : float
        Largest length of the windows of the very first fit [s]: from far off, numbers that follow
        long motions may end where only the slow ones are followed.
    rough : int
        The first fits take one window of this many.
    looked_at : int
        So many windows are simulated to see whether the model diverges in its own steps ...
    finite : float
        ... which it does where no more than this fraction of them ends.
    simulated : int
        About how many physics steps in all windows, times numbers, the last fit takes.
    certain : float
        Number of standard errors, on a scale of all forces that is known, that a number must be
        away from 0.
    scale : float
        Standard deviation of what is known of that scale, and of each drive's gain beside it, where
        motions do not tell it, as where a payload and rotors take up whatever the gain gives.
    made_up : float
        By how much more a gain differs from the model's where it makes up for a mass that was left
        out.
    accuracy : float
        Fraction of every number, with what the model has of it, that is added to its error: forces
        are known on the scale of the model's masses and inertias, which are not known better.
    decisive : float
        Fraction of the cost that more exact steps must promise to take away, to be taken before
        what else motions ask for is known: simulations are several times as slow with them.
    steps : ArithmeticSettings
        Which physics steps are tried beside the model's own.
    motions : LongWindowSettings
        Which windows are compared.
    rough_fit : OutputErrorSettings
        How the first fits are done.
    fit : OutputErrorSettings
        How numbers are fitted to all windows.

    References
    ----------
    Breiman, Friedman, Olshen and Stone, Classification and Regression Trees (1984), section 3.4.3:
    the simplest model within one standard error of the best.
    """

    laws: tuple[str, ...] = ("joint_friction", "joint_damping", "joint_armature")
    usual: tuple[str, ...] = (PAYLOAD, "actuator_delay")
    families: tuple[tuple[str, ...], ...] = (
        ("actuator_gain",),
        ("actuator_bias", "joint_friction", "joint_damping", "joint_armature"),
        ("actuator_lag",),
    )
    misfit: float = 3.0
    share: float = 0.005
    z: float = 2.0
    needless: float = 1.0
    first: float = 5.0
    rough: int = 2
    looked_at: int = 4
    finite: float = 0.5
    simulated: int = 5_000_000
    certain: float = 3.0
    scale: float = 0.2
    made_up: float = 0.05
    accuracy: float = 0.02
    decisive: float = 0.2
    steps: ArithmeticSettings = field(default_factory=ArithmeticSettings)
    motions: LongWindowSettings = field(default_factory=LongWindowSettings)
    rough_fit: OutputErrorSettings = field(default_factory=lambda: ROUGH)
    fit: OutputErrorSettings = field(default_factory=OutputErrorSettings)


@dataclass(frozen=True, eq=False)
class Explained:
    """What a model lacked, fitted to whole motions.

    Attributes
    ----------
    model : FarOffModel
        With all numbers.
    errors : (m,) array
        Their standard errors; 0 of what was not fitted.
    certain : frozenset of str
        The labels of effects that are distinguished from nothing.
    without : dict of str to (m,) array
        By effect's label, the numbers without it, the others moved to make up for it.
    length : int
        Control steps of the windows.
    simulator_steps : int
        What all of it took.
    ties : tuple of str
        What motions tell only together, a sentence each.
    fits : bool
        Whether errors are no larger than sensors' noise and the physics step explain.
    own_steps : bool
        Whether the model's physics steps are those it came with; else more exact ones.
    interrupted : bool
        Whether the search ended before its end.
    alike : dict of str to list of (EffectInstance, str)
        By effect's label, what motions bear out as well in its place, and why.
    """

    model: FarOffModel
    errors: Array
    certain: frozenset[str]
    without: dict[str, Array]
    length: int
    simulator_steps: int
    ties: tuple[str, ...]
    fits: bool
    own_steps: bool = True
    interrupted: bool = False
    alike: Mapping[str, list[tuple[EffectInstance, str]]] = field(default_factory=dict)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Numbers at a bound that is not nothing, a sentence each."""
        model = self.model
        effects = [instance for instance, _ in model.numbers]
        return at_bounds(model.library, model.theta, model.fitted, effects)


@dataclass(frozen=True, eq=False)
class _Sides:
    """Motions: those to fit, the few of them that first fits take, and those held out."""

    fitted: Motions
    few: Motions
    held_out: Motions


class FarOffSearch:
    """The search for what a model lacks that is far off.

    Parameters
    ----------
    settings : FarOffSettings
        Numbers that decide.
    progress : callable
        Called with the fraction done and a text.
    log : EvaluationLog, optional
        Where fits are recorded, for a search that can be resumed.
    """

    def __init__(
        self, settings: FarOffSettings, progress: Progress, log: EvaluationLog | None = None
    ) -> None:
        self.settings = settings
        self.progress = progress
        self.log = log or EvaluationLog()
        self._simulators: list[Simulator] = []
        self._simulated: dict[tuple[FarOffModel, Motions], Array] = {}
        # By what model which effects, their sizes and steps were refused beside.
        self._refused: dict[FarOffModel, list[FarOffModel]] = {}
        self._latest: tuple[FarOffModel, Motions] | None = None
        self._alike: dict[str, list[tuple[EffectInstance, str]]] = {}
        # About what the drives' gains are: as the model has them, until all are fitted by one.
        self._gain = 0.0

    @property
    def simulator_steps(self) -> int:
        """What has been simulated so far."""
        return sum(simulator.steps for simulator in self._simulators)

    def run(self, model: FarOffModel, whole: Problem | None = None) -> Explained:
        """Fit a model's numbers to whole motions, with what else these ask for.

        Parameters
        ----------
        model : FarOffModel
            With what regression finds, and data divided into those that are fitted and those by
            which it is decided what is.
        whole : Problem, optional
            With the data that the last fit takes, and others that nothing is decided by. If None,
            the model's own.

        Returns
        -------
        Explained
            Of the numbers so far, if the search is interrupted by Ctrl-C.

        Raises
        ------
        BadArgument
            If the data are too few for the shortest windows.
        KeyboardInterrupt
            If the search is interrupted before any numbers are fitted.
        """
        interrupted = False
        try:
            self._search(model, whole or model.problem)
        except KeyboardInterrupt:
            interrupted = self._latest is not None
            if not interrupted:
                raise
            self.progress(0.7, STOPPING)
        assert self._latest is not None
        model, fitted = self._latest
        model = model.with_data_of(whole or model.problem)
        if interrupted:  # what the errors are asks for a Jacobian: that of the fewest windows
            fitted = _first(fitted, 0)
        error = self._error(model, fitted)
        end = error.linearize(model.theta, model.fitted, central=True)
        if not interrupted:
            end = error.settle(end)
            model = model.at(end.theta)
        covariance = error.covariance(end, self._prior(model, end, np.inf))
        errors = self._bounded_errors(model, error, end, covariance)
        # What a number is beside the others does not depend on the scale of all forces.
        beside = self._errors(model, error, end, self._prior(model, end, KNOWN))
        without = {
            instance.label: _theta_without(model, end, [instance.label])
            for instance, _ in model.numbers
        }
        certain = self._certain(model, errors, beside) | self._carried(model, error, end)
        length = fitted.windows.length
        fits = not self._is_misfit(model, fitted)
        steps = self.simulator_steps
        ties = ties_of(model, covariance, end.free, self.settings.scale)
        return Explained(
            model.in_exact_steps(),
            errors,
            certain,
            without,
            length,
            steps,
            ties,
            fits,
            own_steps=model.arithmetic is None,
            interrupted=interrupted,
            alike=self._alike,
        )

    def _search(self, model: FarOffModel, whole: Problem) -> None:
        """Fit numbers to longer and longer motions, and add families where these ask for them."""
        settings = self.settings
        model = as_payloads(with_families(model, settings.laws))
        every = settings.motions.seconds
        short = tuple(seconds for seconds in every if seconds <= settings.first)
        for at, seconds in ((0.1, short), (0.2, every)):
            if not seconds:
                continue
            chosen = replace(settings.motions, seconds=seconds)
            model, fitted, held_out = self._cut(model, chosen)
            few = -(-len(fitted.windows) // settings.rough)
            sides = _Sides(fitted, _first(fitted, few), held_out)
            length = fitted.windows.length
            if self._latest is None:
                model = self._begun(model, sides)
            self.progress(at, f"fitting {len(model.fitted)} numbers to windows of {length} steps")
            model = self._fit(model, sides.few, settings.rough_fit)
            self._latest = model, fitted
        model = self._with_exact_steps(model, sides, self.settings.decisive)
        if self._is_misfit(model, fitted):
            model = self._with_holding_friction(model, sides)
        model = self._late_otherwise(model, sides)
        model = self._with_own_gains(model, sides)
        model = self._with_payload_for_gain(model, sides)
        model = self._with_payload(model, sides)
        model = self._with_families(model, sides)
        model = self._with_spring_for_payload(model, sides)
        model = self._with_exact_steps(model, sides)
        model = self._without_needless(model, sides)
        model = self._with_steps_that_last(model, sides)
        creeping = model.friction is FrictionKind.CREEPING
        if creeping and self._is_promised(model, model.with_friction(FrictionKind.HOLDING), sides):
            model = self._with_holding_friction(model, sides)
        if whole.trajectories is not model.problem.trajectories:
            model = model.with_data_of(whole)
            chosen = settings.motions
            fitted, _ = motions_of(model.problem, self._library(model), model.theta, chosen)
        fitted = _first(fitted, self._affordable(model, fitted))
        windows = len(fitted.windows)
        self.progress(0.7, f"fitting {len(model.fitted)} numbers to {windows} windows")
        self._latest = self._fit(model, fitted, settings.fit), fitted

    def _begun(self, model: FarOffModel, sides: _Sides) -> FarOffModel:
        """Where numbers begin: at those of regression, or at 0 if that predicts motions better.

        Of drives so stiff that joints hardly leave their commands, regression sees noise alone.
        """
        nothing = model.as_it_came()
        gains, _ = self._gains(nothing, model, sides.few)
        return nothing if gains.sum() > 0 else model

    def _cut(
        self, model: FarOffModel, chosen: LongWindowSettings
    ) -> tuple[FarOffModel, Motions, Motions]:
        """A model with its motions, to fit and held out.

        One that diverges in its own steps is the same in the cheapest more exact ones in which it
        does not.
        """
        others: Sequence[Arithmetic] = ()
        simulator = model.library.simulator
        if model.arithmetic is None and isinstance(simulator, RobotSimulator):
            others = alternatives_of(simulator, self.settings.steps)
        exact = [replace(model, arithmetic=one).in_exact_steps() for one in others]
        tried = []
        for other in (model, *exact):
            motions = motions_of(other.problem, self._library(other), other.theta, chosen)
            tried.append((other, *motions))
            few = _first(motions[0], self.settings.looked_at)
            residuals = self._error(other, few).residuals(other.theta[None])[0]
            if np.isfinite(residuals).all(axis=1).mean() > self.settings.finite:
                return tried[-1]
        return tried[0]

    def _with_exact_steps(
        self, model: FarOffModel, sides: _Sides, least: float = 0.0
    ) -> FarOffModel:
        """More exact physics steps, where motions are clearly better predicted by them.

        least: the fraction of the cost that they must promise to take away, if that is more than
        what any group of numbers must take away.
        """
        simulator = model.library.simulator
        if model.arithmetic is not None or not isinstance(simulator, RobotSimulator):
            return model
        alternatives = alternatives_of(simulator, self.settings.steps)
        if not alternatives:
            return model
        self.progress(0.22, "more exact physics steps")
        error = self._error(model, sides.few)
        end = error.linearize(model.theta, model.fitted)
        left = []
        for arithmetic in alternatives:
            other = self._error(replace(model, arithmetic=arithmetic), sides.few)
            left.append((error.left_after_step(end, other.evaluated(model.theta)), arithmetic))
        # The cheapest of those that promise nearly as much as any.
        best = min(cost for cost, _ in left)
        as_it_is = error.left_after_step(end, end.residuals)
        if best > (1 - max(least, self.settings.share)) * as_it_is:
            return model
        enough = best + (1 - self.settings.steps.nearly) * abs(as_it_is - best)
        chosen = next(arithmetic for cost, arithmetic in left if cost <= enough)
        return self._better(model, replace(model, arithmetic=chosen), sides)

    def _with_steps_that_last(self, model: FarOffModel, sides: _Sides) -> FarOffModel:
        """More exact steps where motions ask for them beside all that was found, and only there.

        What a model still lacked when steps were compared first may have looked like them.
        """
        if model.arithmetic is None:
            return self._with_exact_steps(model, sides)
        own = self._fit(replace(model, arithmetic=None), sides.few, self.settings.rough_fit)
        if self._is_better(model, own, sides):
            return model
        self._latest = own, sides.fitted
        return own

    def _with_holding_friction(self, model: FarOffModel, sides: _Sides) -> FarOffModel:
        """Dry friction that holds what rests, where motions are clearly better predicted by it."""
        if model.friction is not FrictionKind.CREEPING:
            return model
        self.progress(0.25, "fitting dry friction that holds what rests")
        return self._better(model, model.with_friction(FrictionKind.HOLDING), sides)

    def _is_promised(self, model: FarOffModel, other: FarOffModel, sides: _Sides) -> bool:
        """Whether numbers that are moved by a linear step would predict motions clearly better in
        another model that has the same.
        """
        error = self._error(model, sides.few)
        residuals = self._error(other, sides.few).evaluated(model.theta)
        end = error.linearize(model.theta, model.fitted)
        as_it_is = error.left_after_step(end, end.residuals)
        gain = as_it_is - error.left_after_step(end, residuals)
        return gain > self.settings.share * end.cost

    def _late_otherwise(self, model: FarOffModel, sides: _Sides) -> FarOffModel:
        """Lags in the place of delays, or the reverse, where motions are clearly better predicted:
        regression may have smoothed what tells them apart.
        """
        other = late_otherwise(model)
        if other is model:
            return model
        self.progress(0.25, "fitting a lag in the place of a delay, or the reverse")
        return self._better(model, other, sides)

    def _with_own_gains(self, model: FarOffModel, sides: _Sides) -> FarOffModel:
        """A gain for each drive, where that is better than one for all, or as good as a payload.

        One gain for all drives that differ shows as a payload: without it, gains have a say, and
        where it stays, they have it beside it.
        """
        payloads = [instance.label for instance, _ in model.numbers if instance.effect == PAYLOAD]
        apart = with_families(model.without(payloads), (GAIN,))
        if len(apart.numbers) == len(model.without(payloads).numbers):
            return model
        self.progress(0.25, f"fitting {len(apart.fitted)} numbers: {GAIN}")
        self._gain = float(np.mean(model.theta[_gains(model)])) if _gains(model).any() else 0.0
        if payloads:
            apart = self._fit(apart, sides.few, self.settings.rough_fit)
            if not self._is_better(model, apart, sides):
                self._latest = apart, sides.fitted
                return apart
            apart = with_families(model, (GAIN,))
        return self._better(model, apart, sides)

    def _with_payload_for_gain(self, model: FarOffModel, sides: _Sides) -> FarOffModel:
        """A payload in the place of a weak drive, where motions are predicted as well with it.

        Of both, it is the more usual.
        """
        other = for_gain(model)
        if other is None:
            return model
        self.progress(0.27, "fitting a payload in the place of a gain")
        other = self._fit(other, sides.few, self.settings.rough_fit)
        if self._lost(model, other, sides) > 0:
            return model
        self._latest = other, sides.fitted
        return other

    def _with_payload(self, model: FarOffModel, sides: _Sides) -> FarOffModel:
        """A payload where it promises most, if motions are not explained without one."""
        if any(instance.effect == PAYLOAD for instance, _ in model.numbers):
            return model
        if not self._is_misfit(model, sides.fitted):
            return model
        promised = promised_payload(model, self._error(model, sides.few))
        if promised is None:
            return model
        instance, sizes = promised
        self.progress(0.28, f"fitting a payload of {instance.target}")
        wider = model.with_numbers([(reaching(instance, sizes), sizes)])
        return self._better(model, wider, sides)

    def _with_families(self, model: FarOffModel, sides: _Sides) -> FarOffModel:
        """Effects at every joint or drive, where motions are not explained without them.

        Each kind alone may explain little, so those that were refused are tried together.
        """
        refused: list[str] = []
        latest: list[str] = []
        for number, names in enumerate(self.settings.families):
            if not self._is_misfit(model, sides.fitted):
                return model
            wider = with_families(model, names)
            if wider is model:
                continue
            self.progress(0.3 + 0.1 * number, f"fitting more numbers: {', '.join(names)}")
            better = self._better(model, wider, sides)
            latest = list(names) if better is model else []
            refused += latest
            model = better
        # The last group alone has just been refused.
        if refused != latest and self._is_misfit(model, sides.fitted):
            self.progress(0.6, f"fitting more numbers: {', '.join(refused)}")
            model = self._better(model, with_families(model, refused), sides)
        return model

    def _with_spring_for_payload(self, model: FarOffModel, sides: _Sides) -> FarOffModel:
        """A spring in the place of a payload whose mass motions do not tell, where these are
        predicted as well with it: it is fewer numbers. No gain may make up for the rest.
        """
        if not any(instance.effect == PAYLOAD for instance, _ in model.numbers):
            return model
        error = self._error(model, sides.few)
        end = error.linearize(model.theta, model.fitted)
        errors = self._errors(model, error, end, self._prior(model, end, KNOWN))
        other = for_payload(model, errors, self.settings.certain)
        if other is None:
            return model
        self.progress(0.63, "fitting a spring in the place of a payload")
        other = self._fit(other, sides.few, self.settings.rough_fit)
        by_gain = is_mass_for_gain(model, other, PAYLOAD, self.settings.made_up)
        if by_gain or self._lost(model, other, sides) > 0:
            return model
        if self._lost(other, model, sides) <= 0:
            why = "motions are predicted as well with it, of a mass that they do not tell"
            before = {instance.label for instance, _ in model.numbers}
            after = {instance.label for instance, _ in other.numbers}
            carried = [(one, why) for one, _ in model.numbers if one.label not in after]
            self._alike.update(dict.fromkeys(after - before, carried))
        self._latest = other, sides.fitted
        return other

    def _without_needless(self, model: FarOffModel, sides: _Sides) -> FarOffModel:
        """Drop the kinds of effects that data held out do not ask for, one after another.

        The laws and gains stay: without them, the scale of all forces would seem known. So does a
        mass that only a gain makes up for, as of a single link: of both, it is the more usual.
        """
        kept = {*self.settings.laws, *ALONG_TENDONS.values(), GAIN}
        while True:
            names = {instance.effect for instance, _ in model.numbers} - kept
            if not names:
                return model
            self.progress(0.65, "leaving out what data held out do not ask for")
            end = self._error(model, sides.few).linearize(model.theta, model.fitted)
            needless = []
            for name in sorted(names):
                labels = [one.label for one, _ in model.numbers if one.effect == name]
                theta = _theta_without(model, end, labels)
                moved = model.at(theta).without(labels)
                needed = self._lost(model, moved, sides) > 0
                if needed and name not in self.settings.usual:
                    moved = self._made_up_for(model, moved, sides)
                    needed = self._lost(model, moved, sides) > 0
                made_up = self.settings.made_up
                if not needed and not is_mass_for_gain(model, moved, name, made_up):
                    loss = self._gains(model, moved, sides.held_out)[0].sum()
                    needless.append((loss, name, moved))
            if not needless:
                return model
            least = min(needless, key=lambda one: one[:2])[2]
            model = self._fit(least, sides.few, self.settings.rough_fit)
            self._latest = model, sides.fitted

    def _made_up_for(self, model: FarOffModel, fewer: FarOffModel, sides: _Sides) -> FarOffModel:
        """A model with fewer numbers than another, fitted roughly as long as these may make up for
        the others: far from where they are, they may do so where a linear step says they do not.
        """

        def margin(one: FarOffModel) -> float:
            return -self._lost(model, one, sides)

        return self._fit_toward(fewer, sides, margin)

    def _error(
        self, model: FarOffModel, motions: Motions, settings: OutputErrorSettings | None = None
    ) -> OutputError:
        """The output error of a model, with what is known of its drives' gains and payloads."""
        gains = _gains(model)
        width = self.settings.scale * (1 + self._gain)
        information = np.where(gains, 1 / width**2, _of_places(model))
        known = Known(np.where(gains, self._gain, 0.0), information)
        chosen = settings or self.settings.fit
        return OutputError(self._library(model), motions, chosen, known, model.exact)

    def _library(self, model: FarOffModel) -> Library:
        """A model's library, whose simulator's steps are counted."""
        library = model.library
        if library.simulator not in self._simulators:
            self._simulators.append(library.simulator)
        return library

    def _fit(
        self, model: FarOffModel, motions: Motions, settings: OutputErrorSettings
    ) -> FarOffModel:
        """A model with its numbers, if there are any, fitted to motions."""
        if not len(model.fitted):
            return model
        error = self._error(model, motions, settings)
        found: list[Array] = []
        try:
            return model.at(error.fit(model.theta, model.fitted, self.log, found.append))
        except KeyboardInterrupt:
            if found and self._latest is None:
                self._latest = model.at(found[-1]), motions
            raise

    def _fit_toward(
        self, model: FarOffModel, sides: _Sides, margin: Callable[[FarOffModel], float]
    ) -> FarOffModel:
        """A model fitted roughly, as long as its margin is above 0 or may still come to be.

        It may not where all Jacobians that are left, each gaining as much as the last, are not
        enough: later ones gain less.

        margin: by how much a model predicts better than it must [nats].
        """
        settings = self.settings.rough_fit
        before = margin(model)
        for left in reversed(range(settings.jacobians)):
            model = self._fit(model, sides.few, replace(settings, jacobians=1))
            now = margin(model)
            if now > 0:
                return self._fit(model, sides.few, replace(settings, jacobians=left))
            if now + left * (now - before) <= 0:
                break
            before = now
        return model

    def _better(self, model: FarOffModel, other: FarOffModel, sides: _Sides) -> FarOffModel:
        """Another model, fitted roughly, where it predicts clearly better; else the model."""
        refused = self._refused.setdefault(model, [])
        if other is model or any(_is_same(other, one) for one in refused):
            return model

        def margin(one: FarOffModel) -> float:
            return self._margin(one, model, sides, self.settings.z)

        begun = other
        other = self._fit_toward(other, sides, margin)
        if margin(other) <= 0:
            refused.append(begun)
            return model
        self._latest = other, sides.fitted
        return other

    def _affordable(self, model: FarOffModel, motions: Motions) -> int:
        """So many windows are as much as may be simulated for all of a model's numbers."""
        steps = motions.windows.length * robot_of(model.problem).steps_per_action
        return self.settings.simulated // (steps * len(model.fitted))

    def _prior(
        self, model: FarOffModel, end: Fitted, scale: float, own: float | None = None
    ) -> Array:
        """What is known of the fitted numbers beside the motions, as information (f, f).

        scale: standard deviation of what is known of the drives' mean gain, beside what is known of
        each.
        own: of each; the settings' if None.
        """
        gains = _gains(model)
        relative = np.divide(1.0, _totals(model), out=np.zeros(len(gains)), where=gains)[end.free]
        mean = relative / max(1, gains.sum())
        of_each = np.diag((relative / (own or self.settings.scale)) ** 2)
        of_places = np.diag(_of_places(model)[end.free])
        return np.asarray(of_each + of_places + np.outer(mean, mean) / scale**2)

    def _bounded_errors(
        self, model: FarOffModel, error: OutputError, end: Fitted, covariance: Array
    ) -> Array:
        """Standard errors (m,), no larger than what is known of the gains makes of them.

        Where motions hardly tell the scale of all forces, small misfits seem to move it far.
        """
        errors = self._errors(model, error, end, self._prior(model, end, np.inf))
        gains = _gains(model)[end.free] & np.isfinite(np.diag(covariance))
        if not gains.any():
            return errors
        known = self._errors(model, error, end, self._prior(model, end, np.inf, KNOWN))
        of_gains = np.linalg.pinv(covariance[np.ix_(gains, gains)], hermitian=True)
        slopes = covariance[:, gains] @ of_gains
        known_to = self.settings.scale * _totals(model)[end.free][gains]
        by_gains = np.linalg.norm(slopes * known_to, axis=1)
        errors[end.free] = np.minimum(errors[end.free], np.hypot(known[end.free], by_gains))
        return errors

    def _errors(self, model: FarOffModel, error: OutputError, end: Fitted, prior: Array) -> Array:
        """Standard errors (m,): of the data, of the physics step, and of the model's own scale.

        prior: (f, f) what is known of the numbers beside the motions.
        """
        totals = _totals(model)
        found = np.zeros(len(totals))
        variance = np.maximum(np.diag(error.covariance(end, prior)), 0.0)
        found[end.free] = np.hypot(np.sqrt(variance), error.change_by_step(end, prior))
        found[end.free] = np.hypot(found[end.free], self.settings.accuracy * totals[end.free])
        # What the data do not tell is anywhere within its bounds.
        space = model.library.simulator.space
        return np.minimum(np.nan_to_num(found, nan=np.inf), space.high - space.low)

    def _certain(self, model: FarOffModel, errors: Array, beside: Array) -> frozenset[str]:
        """The labels of the effects that are distinguished from nothing."""
        found = set()
        for instance, sizes in model.numbers:
            first = model.library.indices_of[instance.label][0]
            own = errors if instance.effect == GAIN else beside
            if abs(sizes[0]) > self.settings.certain * own[first]:
                found.add(instance.label)
        return frozenset(found)

    def _carried(self, model: FarOffModel, error: OutputError, end: Fitted) -> frozenset[str]:
        """The labels of payloads whose mass times place is distinguished from nothing.

        Where motions tell neither alone, as beside a rotor.
        """
        covariance = error.covariance(end, self._prior(model, end, KNOWN))
        covariance = np.nan_to_num(covariance)  # a variance that is infinite, times 0
        found = set()
        for instance, sizes in model.numbers:
            own = model.library.indices_of[instance.label]
            if instance.effect != PAYLOAD or len(own) < 4:
                continue
            place = np.searchsorted(end.free, own)
            # Of mass times place (3,) by mass and place (4,).
            slopes = np.column_stack([sizes[1:], sizes[0] * np.eye(3)])
            variance = np.diag(slopes @ covariance[np.ix_(place, place)] @ slopes.T)
            moments = np.abs(sizes[0] * sizes[1:])
            if np.any(moments > self.settings.certain * np.sqrt(np.maximum(variance, 0.0))):
                found.add(instance.label)
        return frozenset(found)

    def _is_misfit(self, model: FarOffModel, motions: Motions) -> bool:
        """Whether errors are beyond what the sensors' noise and the physics step explain."""
        residuals = self._residuals(model, motions)
        count = len(motions.noise)
        size = np.nan_to_num(outer_spread(residuals.reshape(-1, count)))  # inf where it diverges
        noise = self.settings.misfit * motions.noise
        if np.median(size / np.hypot(noise, size / 2)) > 1:  # whatever the physics step makes
            return True
        # Errors fall with the step: what halving it takes away is half of what it makes.
        change = self._error(model, motions).halved(model.theta, residuals)
        by_step = 2 * outer_spread(change.reshape(-1, count))
        limit = np.hypot(noise, np.minimum(by_step, size / 2))
        return bool(np.median(size / limit) > 1)

    def _is_better(self, more: FarOffModel, model: FarOffModel, sides: _Sides) -> bool:
        """Whether windows are predicted clearly better with more numbers."""
        return self._margin(more, model, sides, self.settings.z) > 0

    def _lost(self, model: FarOffModel, other: FarOffModel, sides: _Sides) -> float:
        """By how much another model predicts windows worse than what is no reason to refuse it."""
        return self._margin(model, other, sides, self.settings.needless)

    def _margin(self, more: FarOffModel, model: FarOffModel, sides: _Sides, z: float) -> float:
        """By how much windows are predicted better with more numbers than what is certain [nats].

        Those held out by a part that counts; all of them for certain, less what numbers gain by
        being fitted.

        z: how many standard errors are certain.
        """
        gains, cost = self._gains(more, model, sides.held_out)
        of_held_out = gains.sum() - self.settings.share * cost
        of_fitted, _ = self._gains(more, model, sides.few)
        every = np.concatenate([gains, of_fitted])
        error = every.std(ddof=1) * np.sqrt(len(every)) if len(every) > 1 else np.inf
        added = max(0, len(more.fitted) - len(model.fitted))
        return float(min(of_held_out, every.sum() - added - z * error))

    def _gains(
        self, more: FarOffModel, model: FarOffModel, motions: Motions
    ) -> tuple[Array, float]:
        """What more numbers gain in each piece of the windows, and the cost without them [nats].

        No error counts more than where a simulation has diverged.
        """
        error = self._error(model, motions)
        before = self._residuals(model, motions)
        after = self._residuals(more, motions)
        scale = error.scale_of(before)
        most = DIVERGED * np.tile(scale, motions.windows.length)
        old = error.cost_by_piece(error.whitened(np.clip(before, -most, most), scale))
        new = error.cost_by_piece(error.whitened(np.clip(after, -most, most), scale))
        return (old - new).ravel(), float(old.sum())

    def _residuals(self, model: FarOffModel, motions: Motions) -> Array:
        """A model's errors (W, n) in some motions, simulated once."""
        found = self._simulated.get((model, motions))
        if found is None:
            found = self._error(model, motions).evaluated(model.theta)
            self._simulated[model, motions] = found
        return found


def _first(motions: Motions, count: int) -> Motions:
    """So many windows, but no fewer than eight: the first, which tell the most."""
    if len(motions.windows) <= max(count, FEWEST):
        return motions
    index = np.arange(max(count, FEWEST))
    return replace(motions, windows=motions.windows.take(index), loadings=motions.loadings[index])


def _is_same(model: FarOffModel, other: FarOffModel) -> bool:
    """Whether two models have the same numbers in the same simulator."""
    labels = [instance.label for instance, _ in model.numbers]
    return (
        labels == [instance.label for instance, _ in other.numbers]
        and model.problem is other.problem
        and model.arithmetic == other.arithmetic
        and np.array_equal(model.theta, other.theta)
    )


def _totals(model: FarOffModel) -> Array:
    """(m,) the numbers with what the model has of them; of fractions, what they leave of 1."""
    effects = [instance for instance, _ in model.numbers]
    return totals_of(model.library, model.theta, effects)


def _gains(model: FarOffModel) -> NDArray[np.bool_]:
    """(m,) which numbers are gains of drives."""
    found = np.zeros(len(model.theta), dtype=bool)
    for instance, _ in model.numbers:
        if instance.effect == GAIN:
            found[model.library.indices_of[instance.label]] = True
    return found


def _of_places(model: FarOffModel) -> Array:
    """(m,) what is known of payloads' places, which are near their bodies' origins, as information.

    The bounds of a place are two standard deviations away.
    """
    found = np.zeros(len(model.theta))
    for instance, _ in model.numbers:
        if instance.effect == PAYLOAD:
            places = model.library.indices_of[instance.label][1:]
            high = np.array([quantity.high for quantity in instance.quantities[1:]])
            found[places] = (2 / high) ** 2
    return found


def _theta_without(model: FarOffModel, end: Fitted, labels: Sequence[str]) -> Array:
    """The numbers (m,) without some effects, the others moved to make up for them."""
    space = model.library.simulator.space
    indices = np.concatenate([model.library.indices_of[label] for label in labels])
    own = np.isin(end.free, indices)
    others = end.free[~own]
    # Scaled to a diagonal of ones, so that the least squares' cutoff means the same for all.
    size = np.sqrt(np.maximum(np.diag(end.gram)[~own], 1e-300))
    scaled = end.gram[np.ix_(~own, ~own)] / np.outer(size, size)
    moment = end.gram[np.ix_(~own, own)] @ end.theta[end.free[own]] / size
    theta = end.theta.copy()
    theta[indices] = 0.0
    moved = theta[others] + np.linalg.lstsq(scaled, moment, rcond=1e-8)[0] / size
    theta[others] = np.clip(moved, space.low[others], space.high[others])
    return theta
