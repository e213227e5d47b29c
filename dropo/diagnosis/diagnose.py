"""Data and a model in; what the model gets wrong, named, out."""

import time
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
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
from dropo.diagnosis.findings.disturbances import LeftOut, left_out, outlier_runs
from dropo.diagnosis.findings.figures import figure_data
from dropo.diagnosis.findings.horizons import errors_after, horizons
from dropo.diagnosis.findings.motion import motion
from dropo.diagnosis.findings.not_identifiable import undetermined
from dropo.diagnosis.findings.remaining import remaining
from dropo.diagnosis.findings.unexplained_forces import impulses
from dropo.diagnosis.result import Diagnosis, HeldOut
from dropo.diagnosis.search.library import instances_for, robot_of
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.review import Review, review, merge
from dropo.diagnosis.search.selection import Progress, Selection, State
from dropo.diagnosis.search.window_length import choose_length, first_noise
from dropo.diagnosis.search.windows import Windows, split, spread_of
from dropo.evaluation.held_out import SETTINGS as HELD_OUT

WINDOWS = 96  # to fit, and held out
LEAST = 1e-5  # of a signal's spread: the least noise


@dataclass(frozen=True)
class Diagnose:
    """Settings of a diagnosis. effects: names of effects, or "effect:place"; None for all. length:
    control steps in a window; windows: about how many to fit, and how many to hold out;
    parameters: the declared ones that are fitted at the same time, the others stay as the model
    has them. Where None is given, the problem's settings decide, else its horizon
    (`choose_length`), 96, and all are fitted. disturbances: once the causes are known, spans of
    time in which something else acts are looked for; they are listed, left out, and what is left
    is diagnosed anew.
    """

    effects: Sequence[str] | None = None
    _: KW_ONLY
    length: int | None = None
    windows: int | None = None
    parameters: Sequence[str] | None = None
    disturbances: bool = True

    def run(
        self,
        problem: Problem,
        *,
        rng: np.random.Generator | int | None = 0,
        progress: Progress = silent,
    ) -> Diagnosis:
        """What the problem's simulator gets wrong, judged on data that nothing was fitted to.

        progress: called with the share that is done (0 to 1) and a text. Incompatible where the
        simulator is no MuJoCo model, UnknownName for an effect or a place that does not exist,
        BadArgument where the data are too few.
        """
        require(
            isinstance(problem, Problem),
            "problem",
            "a Problem, which dropo.load makes of a name or a file",
            problem,
            "diagnose",
        )
        require(
            self.length is None or self.length >= 1, "length", "at least 1", self.length, "Diagnose"
        )
        begun = time.perf_counter()
        seed = int(rng) if isinstance(rng, int | np.integer) else None
        with threadpool_limits(
            1, user_api="blas"
        ):  # the simulator's threads use the cores; small products gain nothing
            found = self._judged(problem, np.random.default_rng(rng), progress)
        return replace(found, wall_time_s=time.perf_counter() - begun, seed=seed)

    def _most(self, problem: Problem) -> int:
        """About how many windows each side has."""
        most: Any = (
            problem.settings.get("windows", WINDOWS) if self.windows is None else self.windows
        )
        return int(most)

    def _judged(
        self,
        problem: Problem,
        generator: np.random.Generator,
        progress: Progress,
        quiet: WithoutDisturbances | None = None,
        spent: int = 0,
    ) -> Diagnosis:
        """The diagnosis of a problem, or of what is left of it without disturbances, for which so
        many simulator steps were spent.
        """
        whole = problem
        problem = problem if quiet is None else quiet.problem
        free = _free(problem, self.parameters)
        simulator = robot_of(problem)
        instances = instances_for(problem, self.effects, free)
        length = choose_length(problem, self._most(problem)) if self.length is None else self.length
        hidden = impulses(simulator.model, length)
        library = Library(
            simulator.with_effects([*instances, *hidden]), [*instances, *hidden], len(problem.space)
        )
        progress = with_cost(progress, library.simulator)
        train, test = split(problem, length, self._most(problem))
        _refuse_constant(problem, train)
        selection = Selection(library, _floor(library, train), progress)
        progress(0.0, "fitting the model as it is")
        first, last, reviews = _search(problem, library, selection, train, test, free)
        progress(0.9, "what remains")
        rest, forces = remaining(problem, library, last, selection.floor, generator)
        fixed = [
            (instance, last.theta[library.places[instance.label]]) for instance in last.accepted
        ]
        extended = replace(problem, simulator=simulator.with_effects((), fixed))
        declared = last.theta[: len(problem.space)]
        if quiet is None and self.disturbances:
            quiet = without_disturbances(problem, extended.simulator, declared)
            if quiet is not None and _enough(quiet.problem, length, self._most(problem)):
                return self._judged(whole, generator, progress, quiet, library.simulator.steps)
            quiet = None
        without = [reviews[instance.label].without.theta for instance in last.accepted]
        *before, after = errors_after(problem, library, [*without, last.theta], last)
        errors = [(one.overall, after.overall) for one in before]
        found = causes(library, last, reviews, len(instances), errors)
        thetas = [nominal_of(library), first.theta, last.theta]
        chance = generator.spawn(1)[0]
        as_it_came, fitted, with_causes = horizons(problem, library, thetas, last, chance)
        with_them = (
            []
            if quiet is None
            else horizons(whole, library, thetas, last, chance, replace(HELD_OUT, horizons=()))
        )
        progress(0.95, "what the pictures show")
        wrong = not rest.calibrated
        figures = figure_data(library, selection, first, last, reviews, forces, len(instances))
        moved = motion(problem, library, first, last, fitted, with_causes)
        steps = spent + library.simulator.steps
        excluded: LeftOut | None = None
        if quiet is not None:
            excluded = left_out(quiet, with_them)
        names = [signal.name for signal in simulator.signals]
        return Diagnosis(
            name=problem.name,
            verdict=_verdict(bool(found), wrong or any(cause.acts_like for cause in found)),
            causes=found,
            suspects=suspects(selection, last, len(instances)),
            baseline=HeldOut(per_step(first), tuple(fitted)),
            extended=HeldOut(per_step(last), tuple(with_causes)),
            remaining=rest,
            problem=extended,
            noise=dict(zip(names, last.train.whiten.sigma.tolist(), strict=True)),
            window_steps=length,
            nominal=tuple(as_it_came) if len(free) else (),
            parameters=dict(zip(problem.space.names, declared.tolist(), strict=True)),
            undetermined=undetermined(library, last),
            disturbances=excluded,
            outlier_runs=outlier_runs(problem, extended, declared)
            if self.disturbances and wrong
            else (),
            figures=figures,
            motion=moved,
            warnings=problem.warnings,
            simulator_steps=steps,
        )

    def baseline(self, problem: Problem) -> float:
        """[nats per transition] of the windows held out under the model as it is, its declared
        parameters fitted; `run` starts there.
        """
        library = Library(problem.simulator, (), len(problem.space))
        most = self._most(problem)
        train, test = split(
            problem, choose_length(problem, most) if self.length is None else self.length, most
        )
        return per_step(
            _first(
                problem,
                library,
                Selection(library, _floor(library, train)),
                train,
                test,
                _free(problem, self.parameters),
            )
        )


def diagnose(
    problem: Problem,
    effects: Sequence[str] | None = None,
    *,
    rng: np.random.Generator | int | None = 0,
) -> Diagnosis:
    """Shows what the simulation gets wrong, names the cause, extends the model and measures the
    gain.

    effects: names of effects to look for, or "effect:place"; None for all of `dropo list effects`.
    Errors as of `Diagnose.run`.
    """
    return Diagnose(effects).run(problem, rng=rng)


def per_step(state: State) -> float:
    """Log-likelihood of the windows held out [nats per transition]."""
    return float(state.test.log_likelihood.sum() / state.test.windows.steps)


def _free(problem: Problem, parameters: Sequence[str] | None) -> Ints:
    """The places of the declared parameters that are fitted."""
    wanted: Any = parameters
    if wanted is None:
        wanted = problem.settings.get("parameters", problem.space.names)
    chosen = [known("parameter", str(name), problem.space.names) for name in wanted]
    return np.array([problem.space.names.index(name) for name in chosen], dtype=np.int64)


def _search(
    problem: Problem,
    library: Library,
    selection: Selection,
    train: Windows,
    test: Windows,
    free: Ints,
) -> tuple[State, State, dict[str, Review]]:
    """The model as it is, the one that the search ends with, and what became of each of its effects
    when it was judged again.
    """
    first = _first(problem, library, selection, train, test, free)
    instances = [
        instance for instance in library.instances if instance.effect != "unexplained_force"
    ]
    found = selection.run(first, first, instances)
    last, reviews = review(selection, found)
    while last is not found:  # after an exchange, others may be confirmed
        found = selection.run(first, last, instances)
        if found is last:
            break
        last, reviews = review(selection, found)
    whole = merge(selection, last, instances)
    return first, whole, reviews if whole is last else review(selection, whole)[1]


def _first(
    problem: Problem,
    library: Library,
    selection: Selection,
    train: Windows,
    test: Windows,
    free: Ints,
) -> State:
    """The model as it is, with its declared parameters and the noise fitted."""
    start = nominal_of(library)
    return selection.begin(
        train, test, start, first_noise(problem, library, train, start, selection.floor), free
    )


def _floor(library: Library, train: Windows) -> Array:
    """(p,) the least noise."""
    return np.maximum(LEAST * spread_of(library.simulator, train), 1e-12)


def nominal_of(library: Library) -> Array:
    """(m,) the declared parameters as the model has them, within their bounds, and no effects."""
    space = library.simulator.space
    return np.clip(np.asarray(library.simulator.nominal, dtype=float), space.low, space.high)


def _enough(problem: Problem, length: int, windows: int) -> bool:
    """Whether the data can be diagnosed."""
    try:
        split(problem, length, windows)
    except BadArgument:
        return False
    return True


def _refuse_constant(problem: Problem, train: Windows) -> None:
    """Signals that never change say nothing of a model, and have no scale to judge errors on."""
    still = [
        s.name
        for s, spread in zip(
            problem.simulator.signals, spread_of(problem.simulator, train), strict=True
        )
        if not spread > 0
    ]
    if still:
        raise BadArgument(
            f"The signal {still[0]!r} is the same in all the data: a stuck sensor? Leave "
            "it out of the observation."
        )


def _verdict(found: bool, wrong: bool) -> str:
    if found:
        return "partly" if wrong else "explained"
    return "unexplained" if wrong else "consistent"
