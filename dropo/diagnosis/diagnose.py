"""Data and a model in; what the model gets wrong, and why, out."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

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
from dropo.diagnosis.result import Diagnosis, HeldOut
from dropo.diagnosis.search.library import instances_for, robot_of
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.review import Review, merge, review
from dropo.diagnosis.search.selection import Progress, Selection, SelectionSettings, State
from dropo.diagnosis.search.window_length import (
    WindowLengthSettings,
    choose_length,
    first_noise,
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
    """

    windows: int = 96
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
        train, test = split(problem, self._length(problem), self._windows(problem))
        selection = self._selection(library, train)
        free = _free(problem, self.parameters)
        return per_step(_first(problem, library, selection, train, test, free))

    def _windows(self, problem: Problem) -> int:
        """About how many windows each side has."""
        if self.windows is not None:
            return int(self.windows)
        stated: Any = problem.settings.get("windows", self.settings.windows)
        return int(stated)

    def _length(self, problem: Problem) -> int:
        """Control steps in a window."""
        if self.length is not None:
            return self.length
        return choose_length(problem, self.settings.window_length)

    def _selection(
        self, library: Library, train: Windows, progress: Progress = silent
    ) -> Selection:
        """A search that has not begun."""
        floor = noise_floor(library.simulator, train, self.settings.window_length)
        return Selection(library, floor, progress, self.settings.selection)

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
        whole = problem
        if undisturbed is not None:
            problem = undisturbed.problem

        # Everything that may be wrong, and the data to find it in.
        free = _free(problem, self.parameters)
        simulator = robot_of(problem)
        instances = instances_for(problem, self.effects, free)
        length = self._length(problem)
        everything = [*instances, *impulses(simulator.model, length)]
        library = Library(simulator.with_effects(everything), everything, len(problem.space))
        progress = with_cost(progress, library.simulator)
        train, test = split(problem, length, self._windows(problem))
        _refuse_constant(problem, train)

        # The search, and what it leaves.
        selection = self._selection(library, train, progress)
        progress(0.0, "fitting the model as it is")
        first, last, reviews = _search(problem, library, selection, train, test, free)
        progress(0.9, "what remains")
        rest, forces = remaining(problem, library, last, selection.floor, rng)
        found_effects = [
            (instance, last.theta[library.places[instance.label]]) for instance in last.accepted
        ]
        extended = replace(problem, simulator=simulator.with_effects((), found_effects))
        declared = last.theta[: len(problem.space)]

        # Once the causes are known, disturbances stand out: leave them out and begin anew.
        if undisturbed is None and self.disturbances:
            undisturbed = without_disturbances(problem, extended.simulator, declared)
            if undisturbed is not None and self._can_diagnose(undisturbed.problem, length):
                return self._run(whole, rng, progress, undisturbed, library.simulator.steps)
            undisturbed = None

        # How good each model is on data held out.
        count = len(instances)
        errors = _errors_without_and_with(problem, library, last, reviews)
        found = causes(library, last, reviews, count, errors, selection.settings)
        thetas = [nominal_of(library), first.theta, last.theta]
        (draws,) = rng.spawn(1)
        nominal, fitted, with_causes = horizons(problem, library, thetas, last, draws)
        inside: list[list[Horizon]] = []
        if undisturbed is not None:
            # The windows' own horizon alone, on all data held out.
            own_horizon = replace(HELD_OUT, horizons=())
            inside = horizons(whole, library, thetas, last, draws, own_horizon)

        # What figures and tables show.
        progress(0.95, "what the pictures show")
        figures = figure_data(library, selection, first, last, reviews, forces, count)
        shown = motion(problem, library, first, last, fitted, with_causes)
        steps = spent + library.simulator.steps
        names = [signal.name for signal in simulator.signals]
        wrong = not rest.calibrated
        odd = outlier_runs(problem, extended, declared) if self.disturbances and wrong else ()
        return Diagnosis(
            name=problem.name,
            verdict=_verdict(found, wrong),
            causes=found,
            suspects=suspects(selection, last, count),
            baseline=HeldOut(per_step(first), tuple(fitted)),
            extended=HeldOut(per_step(last), tuple(with_causes)),
            remaining=rest,
            problem=extended,
            noise=dict(zip(names, last.train.whiten.sigma.tolist(), strict=True)),
            window_steps=length,
            nominal=tuple(nominal) if len(free) else (),
            parameters=dict(zip(problem.space.names, declared.tolist(), strict=True)),
            undetermined=undetermined(library, last),
            disturbances=None if undisturbed is None else left_out(undisturbed, inside),
            outlier_runs=odd,
            figures=figures,
            motion=shown,
            warnings=problem.warnings,
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


def _search(
    problem: Problem,
    library: Library,
    selection: Selection,
    train: Windows,
    test: Windows,
    free: Ints,
) -> tuple[State, State, dict[str, Review]]:
    """The model as it is, the one that the search ends with, and its effects' reviews."""
    first = _first(problem, library, selection, train, test, free)
    instances = without_impulses(library.instances)
    found = selection.run(first, first, instances)
    last, reviews = review(selection, found)
    # After an exchange, others may be confirmed.
    while last is not found:
        found = selection.run(first, last, instances)
        if found is last:
            break
        last, reviews = review(selection, found)
    merged = merge(selection, last, instances)
    if merged is not last:
        _, reviews = review(selection, merged)
    return first, merged, reviews


def _first(
    problem: Problem,
    library: Library,
    selection: Selection,
    train: Windows,
    test: Windows,
    free: Ints,
) -> State:
    """The model as it is, with its declared parameters and the noise fitted."""
    theta = nominal_of(library)
    sigma = first_noise(problem, library, train, theta, selection.floor)
    return selection.begin(train, test, theta, sigma, free)


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
