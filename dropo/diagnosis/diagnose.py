"""Data and a model in; what the model gets wrong, and why, out."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.estimator import silent, with_cost
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, known, require
from dropo.data.outliers.without_disturbances import WithoutDisturbances, without_disturbances
from dropo.diagnosis.findings.causes import causes, suspects
from dropo.diagnosis.findings.disturbances import left_out, outlier_runs
from dropo.diagnosis.findings.figures import figure_data
from dropo.diagnosis.findings.horizons import Horizon, errors_after, horizons
from dropo.diagnosis.findings.motion import motion
from dropo.diagnosis.findings.not_identifiable import undetermined
from dropo.diagnosis.findings.remaining import remaining
from dropo.diagnosis.findings.unexplained_forces import impulses, without_impulses
from dropo.diagnosis.parts import Cause
from dropo.diagnosis.regression.quick import QuickSettings
from dropo.diagnosis.regression.start import Start, start_of, wiring_warnings
from dropo.diagnosis.result import Diagnosis, HeldOut
from dropo.diagnosis.search.library import instances_for, robot_of
from dropo.diagnosis.search.linearization import Library, shift_linearization
from dropo.diagnosis.search.review import Review, merge, review
from dropo.diagnosis.search.selection import (
    Progress,
    Selection,
    SelectionSettings,
    State,
    gain_of,
)
from dropo.diagnosis.search.window_length import (
    WindowLengthSettings,
    choose_length,
    first_noise,
    longest_length,
    noise_floor,
)
from dropo.diagnosis.search.windows import Windows, split, spread_of
from dropo.evaluation.held_out import SETTINGS as HELD_OUT


@dataclass(frozen=True)
class DiagnosisSettings:
    """Numbers that decide in a diagnosis.

    Attributes
    ----------
    windows : int
        About how many windows are fitted, and how many are held out, unless something else is
        asked for.
    selection : SelectionSettings
        When an effect is accepted.
    window_length : WindowLengthSettings
        How the windows' horizon is chosen.
    far_off : int or None
        Numbers missing by regression from which the search begins with these (None: never) ...
    far_off_gain : float
        ... or the fraction by which the drives' gain is off.
    beside : tuple of str
        Names of effects that such a search looks for beside them. None by default: errors that so
        many numbers leave would be explained by chance, at a high cost.
    rate_noise : float
        Lower bound of a rate's noise in such a search, as a fraction of its spread: rates that were
        estimated from positions have errors that starts and targets share.
    regression : QuickSettings
        How they are found.
    """

    windows: int = 96
    rate_noise: float = 0.05
    far_off: int | None = 4
    far_off_gain: float = 0.5
    beside: tuple[str, ...] = ()
    regression: QuickSettings = field(default_factory=QuickSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    window_length: WindowLengthSettings = field(default_factory=WindowLengthSettings)


@dataclass(frozen=True)
class Diagnose:
    """A diagnosis of what a problem's simulator gets wrong.

    Attributes
    ----------
    effects : sequence of str, optional
        Names of effects to look for, or "effect:place"; all if None.
    length : int, optional
        Control steps in a window. If None, the problem's horizon decides, else the data
        (`choose_length`).
    windows : int, optional
        About how many windows are fitted, and how many are held out. If None, the problem's
        settings decide, else 96.
    parameters : sequence of str, optional
        The declared parameters that are fitted at the same time; the others stay as the model has
        them. If None, the problem's settings decide, else all are fitted.
    disturbances : bool
        Whether spans of time in which something else acts are looked for once the causes are known.
        They are listed and left out, and the rest is diagnosed anew.
    settings : DiagnosisSettings
        Numbers that decide.
    """

    effects: Sequence[str] | None = None
    _: KW_ONLY
    length: int | None = None
    windows: int | None = None
    parameters: Sequence[str] | None = None
    disturbances: bool = True
    settings: DiagnosisSettings = field(default_factory=DiagnosisSettings)

    def run(
        self,
        problem: Problem,
        *,
        rng: np.random.Generator | int | None = 0,
        progress: Progress = silent,
    ) -> Diagnosis:
        """Find what the problem's simulator gets wrong, evaluated on data that nothing was fitted
        to.

        Parameters
        ----------
        problem : Problem
            Measured data and a MuJoCo model.
        rng : numpy.random.Generator, int or None
            A generator or a seed.
        progress : callable
            Called with the fraction that is done (0 to 1) and a text.

        Returns
        -------
        Diagnosis

        Raises
        ------
        Incompatible
            If the simulator has no MuJoCo model.
        UnknownName
            If an effect, a place or a parameter does not exist.
        BadArgument
            If the problem is none, the length is below 1, the data are too few, or a signal never
            changes.
        SimulationFailed
            If the simulation diverges in too many windows.
        """
        expected = "a Problem, which dropo.load makes of a name or a file"
        require(isinstance(problem, Problem), "problem", expected, problem, "diagnose")
        long_enough = self.length is None or self.length >= 1
        require(long_enough, "length", "at least 1", self.length, "Diagnose")
        begun = time.perf_counter()
        seed = int(rng) if isinstance(rng, int | np.integer) else None
        # The simulator's threads use the cores; products of small matrices gain nothing from more.
        with threadpool_limits(1, user_api="blas"):
            found = self._run(problem, np.random.default_rng(rng), progress)
        return replace(found, wall_time_s=time.perf_counter() - begun, seed=seed)

    def baseline(self, problem: Problem) -> float:
        """Evaluate the model as it is, its declared parameters fitted; `run` starts there.

        Parameters
        ----------
        problem : Problem
            Measured data and a model.

        Returns
        -------
        float
            Log-likelihood of the windows held out [nats per transition].

        Raises
        ------
        BadArgument
            If the data are too few.
        UnknownName
            If a parameter does not exist.
        SimulationFailed
            If the simulation diverges in too many windows.
        """
        library = Library(problem.simulator, (), len(problem.space))
        length = self._length(problem)
        train, test = split(problem, length, self._windows(problem))
        rates = np.zeros(len(library.simulator.signals), dtype=bool)
        selection = self._selection(library, train, rates)
        free = _free(problem, self.parameters)
        setup = _Setup(problem, None, library, selection, train, test, free, rates, length, 0)
        return per_step(setup.first())

    def _windows(self, problem: Problem) -> int:
        """About how many windows each side has."""
        if self.windows is not None:
            return int(self.windows)
        stated: Any = problem.settings.get("windows", self.settings.windows)
        return int(stated)

    def _start(self, problem: Problem, free: Ints, progress: Progress) -> Start | None:
        """What regression finds, where effects need not be named and that is much."""
        settings = self.settings
        if self.effects is not None or settings.far_off is None:
            return None
        progress(0.0, "regression over inverse dynamics")
        return start_of(problem, free, settings.far_off, settings.far_off_gain, settings.regression)

    def _length(self, problem: Problem, start: Start | None = None) -> int:
        """Control steps in a window."""
        if self.length is not None:
            return self.length
        if start is not None:
            return longest_length(start.extended, start.parameters, self.settings.window_length)
        return choose_length(problem, self.settings.window_length)

    def _selection(
        self,
        library: Library,
        train: Windows,
        rates: NDArray[np.bool_],
        progress: Progress = silent,
    ) -> Selection:
        """A search that has not begun, with a lower bound of the noise of the rates (p,)."""
        floor = noise_floor(library.simulator, train, self.settings.window_length)
        least = self.settings.rate_noise * spread_of(library.simulator, train)
        floor = np.maximum(floor, np.where(rates, least, 0.0))
        return Selection(library, floor, progress, self.settings.selection)

    def _set_up(self, problem: Problem, progress: Progress) -> "_Setup":
        """Everything that may be wrong, and the data to find it in."""
        free = _free(problem, self.parameters)
        start = self._start(problem, free, progress)
        if start is not None:
            problem = start.problem
        simulator = robot_of(problem)
        if start is None:
            instances = instances_for(problem, self.effects, free)
        else:
            beside = self.settings.beside
            instances = start.among(instances_for(problem, beside, free) if beside else [])
        length = self._length(problem, start)
        everything = [*instances, *impulses(simulator.model, length)]
        library = Library(simulator.with_effects(everything), everything, len(problem.space))
        train, test = split(problem, length, self._windows(problem))
        _refuse_constant(problem, train)
        rates = np.zeros(len(simulator.signals), dtype=bool)
        if start is not None:
            rates = np.array([signal.unit.endswith("/s") for signal in simulator.signals])
        selection = self._selection(library, train, rates, with_cost(progress, library.simulator))
        return _Setup(
            problem, start, library, selection, train, test, free, rates, length, len(instances)
        )

    def _run(
        self,
        problem: Problem,
        rng: np.random.Generator,
        progress: Progress,
        undisturbed: WithoutDisturbances | None = None,
        spent: int = 0,
    ) -> Diagnosis:
        """The diagnosis of a problem, or of what is left of it without disturbances.

        spent: simulator steps that were spent on finding those.
        """
        data = problem if undisturbed is None else undisturbed.problem
        setup = self._set_up(data, progress)
        data = setup.problem
        whole = data if undisturbed is None else problem
        library, selection = setup.library, setup.selection
        progress = selection.progress
        progress(0.0, "fitting the model as it is")
        first, last, reviews = _search(setup)
        progress(0.9, "what remains")
        rest, forces = remaining(data, library, last, selection.floor, rng)
        found_effects = [
            (instance, last.theta[library.places[instance.label]]) for instance in last.accepted
        ]
        simulator = robot_of(data)
        extended = replace(data, simulator=simulator.with_effects((), found_effects))
        declared = last.theta[: len(data.space)]

        # Once the causes are known, disturbances stand out: leave them out and begin anew.
        if undisturbed is None and self.disturbances:
            undisturbed = without_disturbances(data, extended.simulator, declared)
            if undisturbed is not None and self._can_diagnose(undisturbed.problem, setup.length):
                return self._run(whole, rng, progress, undisturbed, library.simulator.steps)
            undisturbed = None

        # How good each model is on data held out.
        measured = setup.with_sensor_noise(last)
        errors = _errors_without_and_with(data, library, measured, reviews)
        far_off = setup.start is not None
        found = causes(
            library, last, reviews, setup.count, errors, selection.settings, far_off=far_off
        )
        if setup.start is not None:
            found = setup.start.with_errors(found)
        if far_off and not found:
            # Simulation does not bear out what regression finds.
            plain = replace(self, settings=replace(self.settings, far_off=None))
            return plain._run(problem, rng, progress, None, spent + library.simulator.steps)
        thetas = [nominal_of(library), first.theta, last.theta]
        (draws,) = rng.spawn(1)
        nominal, fitted, with_causes = horizons(data, library, thetas, measured, draws)
        inside: list[list[Horizon]] = []
        if undisturbed is not None:
            # The windows' own horizon alone, on all data held out.
            own_horizon = replace(HELD_OUT, horizons=())
            inside = horizons(whole, library, thetas, measured, draws, own_horizon)

        # What figures and tables show.
        progress(0.95, "what the pictures show")
        figures = figure_data(library, selection, first, last, reviews, forces, setup.count)
        shown = motion(data, library, first, last, fitted, with_causes)
        steps = spent + library.simulator.steps
        names = [signal.name for signal in simulator.signals]
        wrong = not rest.calibrated
        odd = outlier_runs(data, extended, declared) if self.disturbances and wrong else ()
        return Diagnosis(
            name=data.name,
            verdict=_verdict(found, wrong),
            causes=found,
            suspects=suspects(selection, last, setup.count),
            baseline=HeldOut(per_step(first), tuple(fitted)),
            extended=HeldOut(per_step(last), tuple(with_causes)),
            remaining=rest,
            problem=extended,
            noise=dict(zip(names, measured.train.whiten.sigma.tolist(), strict=True)),
            window_steps=setup.length,
            nominal=tuple(nominal) if len(setup.free) else (),
            parameters=dict(zip(data.space.names, declared.tolist(), strict=True)),
            undetermined=undetermined(library, last),
            disturbances=None if undisturbed is None else left_out(undisturbed, inside),
            outlier_runs=odd,
            figures=figures,
            motion=shown,
            warnings=(*data.warnings, *wiring_warnings(whole)),
            simulator_steps=steps,
        )

    def _can_diagnose(self, problem: Problem, length: int) -> bool:
        """Whether the data hold enough windows."""
        try:
            split(problem, length, self._windows(problem))
        except BadArgument:
            return False
        return True


def diagnose(
    problem: Problem,
    effects: Sequence[str] | None = None,
    *,
    rng: np.random.Generator | int | None = 0,
) -> Diagnosis:
    """Show what the simulation gets wrong, name the cause, extend the model and measure the gain.

    Parameters
    ----------
    problem : Problem
        Measured data and a MuJoCo model.
    effects : sequence of str, optional
        Names of effects to look for, or "effect:place"; all of `dropo list effects` if None.
    rng : numpy.random.Generator, int or None
        A generator or a seed.

    Returns
    -------
    Diagnosis

    Raises
    ------
    Incompatible
        If the simulator has no MuJoCo model.
    UnknownName
        If an effect or a place does not exist.
    BadArgument
        If the problem is none, the data are too few, or a signal never changes.
    SimulationFailed
        If the simulation diverges in too many windows.
    """
    return Diagnose(effects).run(problem, rng=rng)


def per_step(state: State) -> float:
    """Return the log-likelihood of a state's windows held out [nats per transition]."""
    return float(state.test.log_likelihood.sum() / state.test.windows.steps)


def nominal_of(library: Library) -> Array:
    """Return the parameters of a library's model as it is.

    Parameters
    ----------
    library : Library
        The simulator with every effect.

    Returns
    -------
    (m,) array
        The declared parameters as the model has them, within their bounds, and no effects.
    """
    space = library.simulator.space
    nominal = np.asarray(library.simulator.nominal, dtype=float)
    return np.clip(nominal, space.low, space.high)


def _free(problem: Problem, parameters: Sequence[str] | None) -> Ints:
    """The indices of the declared parameters that are fitted."""
    names = problem.space.names
    wanted: Any = parameters
    if wanted is None:
        wanted = problem.settings.get("parameters", names)
    chosen = [known("parameter", str(name), names) for name in wanted]
    return np.array([names.index(name) for name in chosen], dtype=np.int64)


@dataclass(frozen=True, eq=False)
class _Setup:
    """What a search works on.

    start: what it begins with, where the model is far off.
    free: (d,) the declared parameters that are fitted.
    rates: (p,) whether a signal is a rate whose noise was given a lower bound.
    length: control steps in a window.
    count: how many effects are looked for.
    """

    problem: Problem
    start: Start | None
    library: Library
    selection: Selection
    train: Windows
    test: Windows
    free: Ints
    rates: NDArray[np.bool_]
    length: int
    count: int

    def first(self) -> State:
        """The model as it is, with its declared parameters and the noise fitted."""
        theta = nominal_of(self.library)
        may_diverge = self.start is not None
        return self._begin(self.train, theta, self.free, may_diverge=may_diverge)

    def begun(self, first: State) -> State:
        """The model that the search begins with: with what regression finds, where that helps.

        Some of the windows say roughly where the numbers are, then all of them.
        """
        if self.start is None:
            return first
        library = self.library
        theta = first.theta.copy()
        for i, value in self.start.parameters.items():
            theta[i] = value
        for instance, sizes in self.start.numbers:
            theta[library.places[instance.label]] = sizes
        accepted = tuple(instance for instance, _ in self.start.numbers)
        every = self.selection.settings.first_noise
        some = self.train.take(np.arange(0, len(self.train), every))
        rough = self._begin(some, theta, first.free, accepted)
        begun = self._begin(self.train, rough.theta, first.free, accepted)
        return begun if gain_of(first.test, begun.test)[0] > 0 else first

    def _begin(
        self,
        train: Windows,
        theta: Array,
        free: Ints,
        accepted: tuple[EffectInstance, ...] = (),
        *,
        may_diverge: bool = False,
    ) -> State:
        """A model fitted from theta."""
        selection = self.selection
        sigma = first_noise(self.problem, self.library, train, theta, selection.floor)
        return selection.begin(
            train, self.test, theta, sigma, free, accepted, may_diverge=may_diverge
        )

    def with_sensor_noise(self, state: State) -> State:
        """A state whose rates have the noise of their own steps, not its lower bound."""
        if not self.rates.any():
            return state
        train = state.train
        sigma = train.whiten.sigma
        least = np.full(len(sigma), 1e-12)
        own = first_noise(self.problem, self.library, train.windows, state.theta, least)
        sigma = np.where(self.rates, np.minimum(own, sigma), sigma)
        return replace(state, train=shift_linearization(self.library, train, state.theta, sigma))


def _search(setup: _Setup) -> tuple[State, State, dict[str, Review]]:
    """The model as it is, the one that the search ends with, and its effects' reviews."""
    selection = setup.selection
    first = setup.first()
    begun = setup.begun(first)
    instances = without_impulses(setup.library.instances)
    last, reviews = review(selection, begun)
    while True:
        found = selection.run(begun, last, instances)
        if found is last:
            break
        # After an exchange, others may be confirmed.
        last, reviews = review(selection, found)
        if last is found:
            break
    merged = merge(selection, last, instances)
    if merged is not last:
        _, reviews = review(selection, merged)
    return first, merged, reviews


def _errors_without_and_with(
    problem: Problem, library: Library, last: State, reviews: Mapping[str, Review]
) -> list[tuple[float, float]]:
    """For each accepted effect, the error on held-out data without it and with everything."""
    thetas = [reviews[instance.label].without.theta for instance in last.accepted]
    *without, everything = errors_after(problem, library, [*thetas, last.theta], last)
    return [(errors.overall, everything.overall) for errors in without]


def _refuse_constant(problem: Problem, train: Windows) -> None:
    """Refuse signals that never change: they have no scale on which errors could be evaluated."""
    spread = spread_of(problem.simulator, train)
    for signal, size in zip(problem.simulator.signals, spread, strict=True):
        if not size > 0:
            raise BadArgument(
                f"The signal {signal.name!r} is the same in all the data: a stuck sensor? Leave "
                "it out of the observation."
            )


def _verdict(found: Sequence[Cause], wrong: bool) -> str:
    """The finding in a word; wrong: whether something remains."""
    wrong = wrong or any(cause.acts_like for cause in found)
    if found:
        return "partly" if wrong else "explained"
    return "unexplained" if wrong else "consistent"
