"""Other physics steps and integrators as alternatives to the causes, on equal terms.

A model's own steps act like delays, inertia and damping. A search therefore begins with more exact
ones where these explain the data better; and before an effect is accepted, the model without it is
fitted with steps that are more exact, too: an alternative that costs no number. It is tried as an
effect is, with the linearization in the start's noise as it is, and only fitted to the end where
windows held out confirm that. So is dry friction that holds what rests, where a model has any.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.validation import Array
from dropo.diagnosis.search.confirmation import (
    SelectionSettings,
    gain_of,
    has_less_noise,
    is_confirmed,
)
from dropo.diagnosis.search.linearization import (
    Library,
    LinearizedWindows,
    linearize,
    shift_linearization,
)
from dropo.diagnosis.search.record import Sides, recorded_sides
from dropo.diagnosis.search.refit import refit, settle
from dropo.diagnosis.search.trials import State, penalized_log_likelihood
from dropo.mjmodel.dynamics.dry_friction import FrictionKind, friction_kind, rubs
from dropo.mjmodel.options import integrator, physics_step
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True)
class Arithmetic:
    """How a simulation is stepped, beside the model's own steps.

    Attributes
    ----------
    finer : int
        Physics steps in the place of one.
    integrator : str or None
        Its name in MJCF; the model's own if None.
    friction : FrictionKind or None
        What dry friction does near rest; what the model's own does if None.
    """

    finer: int
    integrator: str | None = None
    friction: FrictionKind | None = None

    @property
    def is_exact(self) -> bool:
        """Whether steps are more exact ones."""
        return self.finer > 1 or self.integrator is not None

    @property
    def cost(self) -> int:
        """Evaluations of the dynamics in the place of one."""
        return self.finer * (4 if self.integrator == "RK4" else 1)

    def of(self, simulator: RobotSimulator) -> RobotSimulator:
        """Return a simulator that is stepped so.

        Parameters
        ----------
        simulator : RobotSimulator
            Any.

        Returns
        -------
        RobotSimulator
            Its count of steps begins at 0.
        """
        changed = simulator.with_finer_steps(self.finer)
        if self.friction is not None:
            changed = changed.with_friction(self.friction)
        return changed if self.integrator is None else changed.with_integrator(self.integrator)

    def in_place_of(self, library: Library) -> Library:
        """Return a library whose simulator is stepped so.

        Parameters
        ----------
        library : Library
            Of a simulator of a robot.

        Returns
        -------
        Library
            Its counts of steps begin at 0. Where steps cost more, derivatives are taken in the
            library's own.
        """
        robot: RobotSimulator = library.simulator  # type: ignore[assignment]
        coarse: RobotSimulator | None = library.coarse  # type: ignore[assignment]
        if self.cost > 1:
            coarse = robot.with_finer_steps(1)
        elif coarse is not None:
            coarse = self.of(coarse)
        return replace(library, simulator=self.of(robot), coarse=coarse)


UNCHANGED = Arithmetic(1)
"""The model's own steps."""

HOLDING = replace(UNCHANGED, friction=FrictionKind.HOLDING)
"""Friction as gearboxes have it, in the model's own steps."""


@dataclass(frozen=True)
class ArithmeticSettings:
    """Which alternatives there are.

    Attributes
    ----------
    alternatives : tuple of Arithmetic
        The cheapest first. The last two are for machines too stiff for Runge and Kutta, and for
        data of another simulation, in shorter steps of the same kind.
    of_runge_kutta : tuple of Arithmetic
        Those of a model that is stepped by Runge and Kutta already.
    at_first : int
        A search may begin with those of no more than so many evaluations of the dynamics a step.
    nearly : float
        The cheapest is fitted that gains this fraction of what any gains ...
    stride : int
        ... on one window of so many ...
    fewest : int
        ... if these are so many at least.
    finest : int
        Steps are halved as long as that is likelier, down to this part.
    """

    alternatives: tuple[Arithmetic, ...] = (
        Arithmetic(1, "RK4"),
        Arithmetic(2, "RK4"),
        Arithmetic(4),
        Arithmetic(10),
    )
    of_runge_kutta: tuple[Arithmetic, ...] = (Arithmetic(2),)
    at_first: int = 4
    nearly: float = 0.95
    stride: int = 4
    fewest: int = 12
    finest: int = 8


SETTINGS = ArithmeticSettings()


def alternatives_of(
    simulator: RobotSimulator, settings: ArithmeticSettings = SETTINGS
) -> tuple[Arithmetic, ...]:
    """Return the more exact steps of a model with its integrator, the cheapest first.

    Parameters
    ----------
    simulator : RobotSimulator
        Of the model.
    settings : ArithmeticSettings
        Which there are.

    Returns
    -------
    tuple of Arithmetic
    """
    if integrator(simulator.model) == "RK4":
        return settings.of_runge_kutta
    return settings.alternatives


@dataclass(eq=False)
class ArithmeticAlternatives:
    """More exact steps, each time beside the effect that a search would accept next.

    Attributes
    ----------
    library : Library
        The simulator with every effect, in its own steps.
    floor : (p,) array
        Lower bound of the noise.
    selection : SelectionSettings
        How sure a gain must be.
    log : EvaluationLog
        Where fits are recorded.
    first : State
        The model as it is, in the steps that it has by now.
    exact : bool
        Whether these are more exact ones than the model's own already.
    settings : ArithmeticSettings
        Which alternatives there are.
    winner : Arithmetic or None
        What explained the data better than an effect.
    fitted : State or None
        The model with that, fitted.
    """

    library: Library
    floor: Array
    selection: SelectionSettings
    log: EvaluationLog
    first: State
    exact: bool = False
    settings: ArithmeticSettings = SETTINGS
    winner: Arithmetic | None = field(init=False, default=None)
    fitted: State | None = field(init=False, default=None)

    @property
    def reached(self) -> float:
        """How likely the model is in the winner's steps, penalized [nats]; inf if none won."""
        return np.inf if self.fitted is None else penalized_log_likelihood(self.fitted)

    @property
    def _robot(self) -> RobotSimulator | None:
        """The simulator, if its physics steps can be others."""
        simulator = self.library.simulator
        if not isinstance(simulator, RobotSimulator) or simulator.control_step is None:
            return None
        return simulator

    def __call__(self, state: State, found: State | None) -> bool:
        """Decide whether more exact steps are the better explanation.

        Parameters
        ----------
        state : State
            A model.
        found : State or None
            That model with one more effect; None where none is confirmed.

        Returns
        -------
        bool
            Whether windows held out confirm an alternative, which is then `winner`, and all windows
            are as likely under it as with the effect, or likelier. Of an effect that shifts signals
            or commands by less than a physics step, whether they do not confirm it in the place of
            the alternative: that is what the step itself looks like.
        """
        simulator = self._robot
        if simulator is None:
            return False
        there = self._alternatives(simulator)
        if not there:
            return False
        gained = float((state.test.log_likelihood - self.first.test.log_likelihood).sum())
        needed = self.selection.needed_gain(len(there))
        needed = max(needed, self.selection.minimum_fraction * gained)
        before = penalized_log_likelihood(state)
        more = self.selection.needed_gain(1)
        of_effect = 0.0 if found is None else penalized_log_likelihood(found) - before
        of_shift = np.inf
        shifting = found is not None and _shifts_within_a_step(self.library, found)
        if shifting:
            of_effect, of_shift = 0.0, of_effect - more
        # What promises too little on some of the windows to fit is not tried; both sides gain.
        arithmetic, promise = self._most_promising(simulator, state, there)
        if not promise > self.selection.alternative_fraction * max(needed, 0.5 * of_effect):
            return False

        def is_better(alternative: State, least: float) -> bool:
            """Whether windows held out confirm an alternative, and it gains enough on all.

            One that explains all windows as a shift within a step does, which was confirmed, need
            not be confirmed beside the model without either.
            """
            gain = penalized_log_likelihood(alternative) - before
            confirmed = is_confirmed(state.test, alternative.test, needed, self.selection)
            return (confirmed or gain > of_shift) and gain >= least

        # As of an effect: tried, and fitted to the end where that has a chance.
        tried = self._tried(simulator, arithmetic, state)
        has_chance = is_better(tried, self.selection.polished_fraction * of_effect)
        if not has_chance and not has_less_noise(state.train, tried.train, self.selection):
            return False
        alternative = self._fitted(simulator, arithmetic, state)
        if not is_better(alternative, of_effect):
            return False
        if (
            found is not None
            and shifting
            and is_confirmed(alternative.test, found.test, more, self.selection)
        ):
            return False
        if arithmetic.is_exact:
            arithmetic = self._refined(simulator, arithmetic, alternative, needed)
        self.winner = arithmetic
        self.fitted = alternative
        return True

    def is_preferred(self, state: State) -> bool:
        """Decide whether a search is to begin with more exact steps.

        A machine has no physics steps: the model's own are kept where data do not tell them from
        more exact ones, or speak for them.

        Parameters
        ----------
        state : State
            The model that a search begins with.

        Returns
        -------
        bool
            Whether an alternative gains what is needed on all windows, and anything on those held
            out; it is `winner` then.
        """
        simulator = self._robot
        if simulator is None:
            return False
        cheap = [
            one
            for one in alternatives_of(simulator, self.settings)
            if one.cost <= self.settings.at_first
        ]
        if not cheap:
            return False
        needed = self.selection.needed_gain(len(cheap))
        arithmetic, promise = self._most_promising(simulator, state, cheap)
        if not promise > self.selection.alternative_fraction * needed:
            return False
        if not _is_likelier(state, self._fitted(simulator, arithmetic, state), needed):
            return False
        self.winner = arithmetic
        return True

    def shorter(self, state: State) -> Arithmetic:
        """Return shorter steps that explain the data better than the ones there are.

        Parameters
        ----------
        state : State
            A model.

        Returns
        -------
        Arithmetic
            `UNCHANGED` where none are likelier, by as much as `is_preferred` asks for.
        """
        simulator = self._robot
        if simulator is None:
            return UNCHANGED
        return self._refined(simulator, UNCHANGED, state, self.selection.needed_gain(1))

    def _alternatives(self, simulator: RobotSimulator) -> tuple[Arithmetic, ...]:
        """What is tried beside an effect, the cheapest first."""
        stepped = () if self.exact else alternatives_of(simulator, self.settings)
        creeping = friction_kind(simulator.model) is FrictionKind.CREEPING
        return (HOLDING, *stepped) if creeping and rubs(simulator.model) else stepped

    def _most_promising(
        self, simulator: RobotSimulator, state: State, there: Sequence[Arithmetic]
    ) -> tuple[Arithmetic, float]:
        """The cheapest alternative that gains nearly as much as any on the windows to fit, and its
        gain.

        By some of the windows, with the Jacobian as it is. The gain is -inf where none is known.
        """
        train = state.train
        index = np.arange(len(train.windows))
        if len(index) >= self.settings.stride * self.settings.fewest:
            index = index[:: self.settings.stride]
        some = train.take(index)
        known = self._jacobian(state)[:, index]

        def fitted(library: Library, begun: LinearizedWindows) -> float:
            """The log-likelihood of these windows, fitted by what the model fits.

            -inf where all simulations diverge, as explicit steps may.
            """
            if begun.lost.all():
                return -np.inf
            settings = self.selection.refit
            free = state.free
            found = settle(library, begun, free, self.floor, known=known, settings=settings)
            return float(found.log_likelihood.sum())

        before = fitted(self.library, some)
        gains = []
        for arithmetic in there:
            library = self._library(arithmetic.of(simulator))
            begun = shift_linearization(library, some, state.theta, some.whiten.noise)
            gain = fitted(library, begun) - before
            gains.append((arithmetic, gain * len(train.windows) / len(index)))
            simulator.steps += library.simulator.steps
        # Where a model loses the motion there may be no likelihood at all.
        finite = [(one, gain) for one, gain in gains if np.isfinite(gain)]
        if not finite:
            return gains[0][0], -np.inf
        largest = max(gain for _, gain in finite)
        enough = largest - (1 - self.settings.nearly) * abs(largest)
        return next((one, gain) for one, gain in finite if gain >= enough)

    def _jacobian(self, state: State) -> Array:
        """By what a model fits, in its own steps: more exact ones hardly change it."""
        return self.library.kept_jacobian(state.theta, state.free, state.train.windows)

    def _tried(self, simulator: RobotSimulator, arithmetic: Arithmetic, state: State) -> State:
        """A model in other steps, the linearization in the start's noise as it is."""
        library = self._library(arithmetic.of(simulator))
        settings = self.selection.refit
        known = self._jacobian(state)

        def fit() -> Sides:
            noise = state.train.whiten.noise
            start = shift_linearization(library, state.train, state.theta, noise)
            train = settle(library, start, state.free, self.floor, known=known, settings=settings)
            noise = train.whiten.noise
            return train, shift_linearization(library, state.test, train.theta, noise)

        return self._recorded(simulator, library, state, fit, (state.train, state.test))

    def _fitted(self, simulator: RobotSimulator, arithmetic: Arithmetic, state: State) -> State:
        """A model in other steps, fitted as one with an effect more is."""
        library = arithmetic.in_place_of(self.library)

        def fit() -> Sides:
            start = linearize(library, state.train.windows, state.theta, state.train.whiten.noise)
            train = refit(library, start, state.free, self.floor, settings=self.selection.refit)
            noise = train.whiten.noise
            return train, linearize(library, state.test.windows, train.theta, noise)

        return self._recorded(simulator, library, state, fit)

    def _recorded(
        self,
        simulator: RobotSimulator,
        library: Library,
        state: State,
        fit: Callable[[], Sides],
        near: Sides | None = None,
    ) -> State:
        """A model fitted in the steps of a library, or made again from its record."""
        windows = (state.train.windows, state.test.windows)
        key = np.concatenate([state.theta, state.train.whiten.noise.numbers])
        train, test = recorded_sides(self.log, library, key, windows, fit, near)
        simulator.steps += library.simulator.steps
        return State(train, test, state.free, state.accepted)

    def _refined(
        self, simulator: RobotSimulator, arithmetic: Arithmetic, alternative: State, needed: float
    ) -> Arithmetic:
        """Steps that are halved as long as that is likelier."""
        while arithmetic.finer < self.settings.finest:
            finer = replace(arithmetic, finer=2 * arithmetic.finer)
            halved = self._tried(simulator, finer, alternative)
            if not _is_likelier(alternative, halved, needed):
                break
            arithmetic, alternative = finer, halved
        return arithmetic

    def _library(self, simulator: RobotSimulator) -> Library:
        """The same effects with another simulator."""
        library = self.library
        return Library(simulator, library.instances, library.declared, library.differences)


def _is_likelier(state: State, alternative: State, needed: float) -> bool:
    """Whether other steps gain what is needed on all windows, and anything on those held out."""
    gain = penalized_log_likelihood(alternative) - penalized_log_likelihood(state)
    held_out, _ = gain_of(state.test, alternative.test)
    return bool(gain > needed and held_out > 0)


def shift_in_time(instance: EffectInstance, magnitudes: Array) -> float | None:
    """Return how far an effect shifts signals or commands in time.

    Parameters
    ----------
    instance : EffectInstance
        Any effect.
    magnitudes : (q,) array
        Its numbers.

    Returns
    -------
    float or None
        The largest shift [s]; None of effects that shift nothing.
    """
    if instance.sensor_delay is not None:
        return float(np.max(np.abs(instance.sensor_delay(magnitudes))))
    times = [
        abs(size)
        for quantity, size in zip(instance.quantities, magnitudes.tolist(), strict=True)
        if quantity.unit == "s"
    ]
    return max(times, default=None)


def _shifts_within_a_step(library: Library, found: State) -> bool:
    """Whether the last effect of a model shifts something by less than a physics step."""
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator) or not found.accepted:
        return False
    last = found.accepted[-1]
    late = shift_in_time(last, found.theta[library.indices_of[last.label]])
    return late is not None and late < physics_step(simulator.model)
