"""Each run of a machine beside its reference runs.

Every run is described by numbers of its own, which its motion determines. How they vary among the
reference runs is what is normal; a run that lies outside is attributed to the one candidate that
explains it best.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray
from scipy import special

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints, Segments, Trajectories
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, known, require
from dropo.data.outliers.disturbances import cut
from dropo.data.outliers.outlier_runs import OutlierRunSettings, SingleRunFit, fit_run
from dropo.data.outliers.without_disturbances import both_sides
from dropo.diagnosis.parts import Estimate
from dropo.diagnosis.reference.candidates import (
    PossibleDifference,
    effect_candidates,
    independent,
    parameter_candidates,
    responses,
)
from dropo.diagnosis.reference.result import ComparedRun, RunComparison, RunDifference
from dropo.diagnosis.search.library import robot_of
from dropo.mjmodel.robot_simulator import RobotSimulator

EFFECTS = ("actuator_gain", "joint_friction", "joint_damping", "body_mass")
"""What is looked for where neither the caller nor the problem says: usual faults."""


@dataclass(frozen=True)
class ReferenceSettings:
    """What decides how runs are compared.

    Attributes
    ----------
    level : float
        Chance at which a normal run is said to differ.
    fewest : int
        Reference runs at least that a run is compared with.
    independent : float
        A candidate describes runs by a number of its own if those before it leave this part of its
        response; else they express it.
    share : float
        A further cause must explain this part of what the first one does.
    confused : float
        Candidates are confused if their squared t differ by less; 6 is a likelihood ratio of 20.
    runs : OutlierRunSettings
        How a run's own numbers are found.
    """

    level: float = 0.01
    fewest: int = 3
    independent: float = 0.2
    share: float = 0.2
    confused: float = 6.0
    runs: OutlierRunSettings = field(default_factory=OutlierRunSettings)


SETTINGS = ReferenceSettings()


def compare_with_reference(
    problem: Problem,
    reference: Sequence[str] | None = None,
    effects: Sequence[str] | None = None,
    *,
    tolerances: Mapping[str, float] | None = None,
    settings: ReferenceSettings = SETTINGS,
) -> RunComparison:
    """Say of every run what differs from the reference runs, where, and how much.

    Parameters
    ----------
    problem : Problem
        With a MuJoCo model and several runs.
    reference : sequence of str, optional
        Names or patterns of the runs that are normal; by default those that the problem marks. A
        run without a name goes by its number.
    effects : sequence of str, optional
        What may differ, as `effect_candidates` takes it; by default `settings["effects"]` of the
        problem, else `EFFECTS` as far as the robot has them. Declared parameters always may.
    tolerances : mapping of str to float, optional
        Effect -> standard deviation of each of its numbers between normal runs beyond what the
        reference runs show, in the number's unit; by default `settings["tolerances"]` of the
        problem. They are allowed for when a cause is named, not when a run is found to differ.
    settings : ReferenceSettings
        What decides.

    Returns
    -------
    RunComparison

    Raises
    ------
    UnknownName
        If a run, an effect or a place does not exist.
    BadArgument
        If there are too few reference runs.

    Notes
    -----
    With b the K numbers of a run, m their mean over n reference runs (without the run itself) and
    V (1 + 1/n) times the variance between them, pooled over the places of an effect, a run differs
    if (b - m)' V^-1 (b - m) / K is beyond the quantile of F(K, n_f (n - 1)), where n_f is the least
    number of places that were pooled. A candidate that changes the numbers by c per unit has size
    c' W (b - m) / c' W c with W the inverse of V and the tolerances, kept within its bounds; the
    one that explains most is named.
    """
    simulator = robot_of(problem)
    candidates, is_reference = check_comparison(problem, reference, effects, settings)
    names, members = _runs(problem)
    data = both_sides(problem)
    allowed = problem.settings.get("tolerances", {}) if tolerances is None else tolerances
    assert isinstance(allowed, Mapping)
    nuisances = effect_candidates(problem, list(allowed))
    normal = data.rows(np.flatnonzero(is_reference[members]))
    windows = cut(normal, problem.horizon)
    windows = windows.take(windows.thin(settings.runs.windows))

    # The numbers that describe runs, each run's own, and what all candidates do to them.
    numbers = _describing(simulator, candidates, windows, settings)
    extended = simulator.with_effects(_instances(numbers))
    common = fit_run(extended, normal, extended.nominal, problem.horizon, settings.runs).value
    fits = _own_numbers(extended, data, members, common, problem.horizon, settings)
    values = np.array([fit.value for fit in fits])
    mean = values[is_reference].mean(axis=0)
    signature = _signatures(extended, numbers, [*candidates, *nuisances], mean, windows)
    tolerance = np.zeros((len(numbers), len(numbers)))
    for one in nuisances:
        sd = allowed[one.effect] * signature[one.label]
        tolerance += np.outer(sd, sd)

    compared = []
    for i, name in enumerate(names):
        others = np.flatnonzero(is_reference & (np.arange(len(names)) != i))
        test = _Comparison(numbers, values, fits, others, i)
        p_value = test.p_value
        differs = p_value <= settings.level
        causes = test.causes(candidates, signature, tolerance, settings) if differs else ()
        own = tuple(values[i].tolist())
        compared.append(ComparedRun(name, bool(is_reference[i]), p_value, differs, causes, own))
    return RunComparison(
        name=problem.name,
        numbers=tuple(one.label for one in numbers),
        mean=tuple(mean.tolist()),
        spread=tuple(values[is_reference].std(axis=0, ddof=1).tolist()),
        runs=tuple(compared),
        level=settings.level,
        tolerances=tuple(f"{name} by {sd:g} (sd)" for name, sd in allowed.items()),
        simulator_steps=extended.steps,
    )


def check_comparison(
    problem: Problem,
    reference: Sequence[str] | None = None,
    effects: Sequence[str] | None = None,
    settings: ReferenceSettings = SETTINGS,
) -> tuple[list[PossibleDifference], NDArray[np.bool_]]:
    """Refuse what `compare_with_reference` would, before anything is simulated.

    Parameters
    ----------
    problem, reference, effects, settings
        As of `compare_with_reference`.

    Returns
    -------
    candidates : list of PossibleDifference
        What may differ.
    is_reference : (G,) array of bool
        Which runs are normal.

    Raises
    ------
    UnknownName
        If a run, an effect or a place does not exist.
    BadArgument
        If there are too few reference runs.
    """
    names, _ = _runs(problem)
    is_reference = _marked(names, problem.reference if reference is None else reference)
    rule = f"at least {settings.fewest + 1} runs of the data"
    enough = int(is_reference.sum()) > settings.fewest
    require(enough, "reference", rule, int(is_reference.sum()), "compare_with_reference")
    wanted = _chosen_effects(problem, effects)
    return parameter_candidates(robot_of(problem)) + effect_candidates(
        problem, wanted
    ), is_reference


def _instances(candidates: Sequence[PossibleDifference]) -> list[EffectInstance]:
    """The effects among candidates, in their order."""
    return [one.instance for one in candidates if one.instance is not None]


def _describing(
    simulator: RobotSimulator,
    candidates: Sequence[PossibleDifference],
    windows: Segments,
    settings: ReferenceSettings,
) -> list[PossibleDifference]:
    """The candidates that do not stand in for each other; declared parameters first, and all."""
    columns = responses(simulator, _instances(candidates), simulator.nominal, windows)
    chosen = independent(columns, settings.independent)
    alike = [one.label for k, one in enumerate(candidates) if k not in chosen and not one.instance]
    if alike:
        raise BadArgument(
            "A comparison of runs needs parameters that these data tell from each other. Got"
            f" {', '.join(alike)}, which others can stand in for, or which change nothing."
        )
    if not chosen:
        raise BadArgument("Nothing that was looked for changes the motion of these runs.")
    return [candidates[k] for k in chosen]


def _signatures(
    extended: RobotSimulator,
    numbers: Sequence[PossibleDifference],
    candidates: Sequence[PossibleDifference],
    mean: Array,
    windows: Segments,
) -> dict[str, Array]:
    """What a unit of each candidate does to the numbers (K,), by least squares, by label."""
    own = [one.label for one in numbers]
    others = {one.label: one for one in candidates if one.label not in own}
    columns = responses(extended, _instances(list(others.values())), mean, windows)
    found = np.linalg.lstsq(columns[:, : len(own)], columns, rcond=None)[0].T
    return dict(zip([*own, *others], found, strict=True))


def _chosen_effects(problem: Problem, effects: Sequence[str] | None) -> Sequence[str]:
    """What to look for: as asked, as the problem says, or what is usual and the robot can have."""
    if effects is not None:
        return effects
    own = problem.settings.get("effects")
    if own is not None:
        assert isinstance(own, Sequence)
        return own
    found = []
    for name in EFFECTS:
        try:
            effect_candidates(problem, [name])
        except BadArgument:
            continue
        found.append(name)
    return found


def _runs(problem: Problem) -> tuple[list[str], Ints]:
    """The names of all runs, and of every row of `both_sides` which run it belongs to."""
    data = both_sides(problem)
    if problem.run_names and any(problem.run_names):
        count = len(data.spans)
        rule = f"one for each of {count} trajectories"
        found = len(problem.run_names)
        require(found == count, "run_names", rule, found, f"Problem {problem.name!r}")
        names = list(dict.fromkeys(problem.run_names))
        place = {name: i for i, name in enumerate(names)}
        of_trajectory = np.array([place[name] for name in problem.run_names], dtype=np.int64)
        return names, of_trajectory[data.trajectory]
    label = data.trajectory if data.group is None else data.group
    numbers, members = np.unique(label, return_inverse=True)
    return [str(one) for one in numbers.tolist()], members.astype(np.int64)


def _marked(names: list[str], patterns: Sequence[str]) -> NDArray[np.bool_]:
    """Which runs (G,) the names or patterns mean."""
    found = np.zeros(len(names), dtype=bool)
    for pattern in patterns:
        fitting = [name == pattern or fnmatchcase(name, pattern) for name in names]
        if not any(fitting):
            known("run", pattern, names)
        found |= np.array(fitting)
    return found


def _own_numbers(
    simulator: RobotSimulator,
    data: Trajectories,
    members: Ints,
    common: Array,
    length: int,
    settings: ReferenceSettings,
) -> list[SingleRunFit]:
    """Each run's numbers by themselves."""
    fits = []
    for run in range(int(members.max()) + 1):
        rows = data.rows(np.flatnonzero(members == run))
        longest = max(stop - start for start, stop in rows.spans)
        rule = f"runs of at least {length} control steps"
        got = f"{longest} in run {run}, counted from 0"
        require(longest >= length, "trajectories", rule, got, "compare_with_reference")
        fits.append(fit_run(simulator, rows, common, length, settings.runs))
    return fits


class _Comparison:
    """One run beside others that are normal."""

    def __init__(
        self,
        numbers: Sequence[PossibleDifference],
        values: Array,
        fits: Sequence[SingleRunFit],
        normal: Ints,
        run: int,
    ):
        n = len(normal)
        self.away = values[run] - values[normal].mean(axis=0)
        between = values[normal].var(axis=0, ddof=1)
        errors = np.array([np.diagonal(fit.covariance) for fit in fits])
        families = [one.family for one in numbers]
        pooled = np.empty(len(numbers))
        places = []
        for family in dict.fromkeys(families):
            own = np.array([one == family for one in families])
            pooled[own] = between[own].mean()
            places.append(int(own.sum()))
        self.degrees = float(min(places) * (n - 1))
        # A run whose own numbers are less sure than those of the others.
        excess = np.maximum(errors[run] - errors[normal].mean(axis=0), 0.0)
        floor = 1e-24 + 1e-12 * np.abs(values).max(axis=0) ** 2
        self.variance = np.diag(np.maximum(pooled, floor) * (1 + 1 / n) + excess)

    @property
    def p_value(self) -> float:
        """The chance of a normal run to be as far off."""
        return self._p_value(self.away, self.variance)

    def _p_value(self, away: Array, variance: Array) -> float:
        """The tail of F for a deviation (K,)."""
        statistic = float(away @ np.linalg.solve(variance, away)) / len(away)
        return float(special.fdtrc(len(away), self.degrees, statistic))

    def causes(
        self,
        candidates: Sequence[PossibleDifference],
        signature: Mapping[str, Array],
        tolerance: Array,
        settings: ReferenceSettings,
    ) -> tuple[RunDifference, ...]:
        """The candidate that explains the run best, and a second one where it is needed."""
        variance = self.variance + tolerance
        weight = np.asarray(np.linalg.inv(variance))
        found: list[RunDifference] = []
        away: Array = self.away
        taken: Array = np.zeros((len(away), 0))
        first = 0.0
        while len(found) < len(candidates):
            sizes = [
                self._size(one, signature[one.label], away, taken, weight) for one in candidates
            ]
            squares = np.array([size * abs(size) / error**2 for size, error in sizes])
            squares = np.where([size == 0 for size, _ in sizes], 0.0, np.abs(squares))
            best = int(squares.argmax())
            if squares[best] <= settings.share * first or squares[best] == 0:
                break
            one = candidates[best]
            size, error = sizes[best]
            close = np.flatnonzero(squares > squares[best] - settings.confused)
            confused = tuple(candidates[k].label for k in close.tolist() if k != best)
            found.append(
                RunDifference(
                    one.effect,
                    one.target,
                    one.variant,
                    one.quantity,
                    Estimate(size, error, one.unit),
                    float(np.sqrt(squares[best])),
                    confused,
                )
            )
            first = max(first, float(squares[best]))
            column = signature[one.label]
            away = away - size * column
            taken = np.asarray(np.column_stack([taken, column]), dtype=float)
            if self._p_value(away, variance) > settings.level:
                break
        return tuple(found)

    def _size(
        self, one: PossibleDifference, column: Array, away: Array, taken: Array, weight: Array
    ) -> tuple[float, float]:
        """Size of a candidate within its bounds, beside those that are taken, and its error."""
        if taken.shape[1]:
            inner = taken.T @ weight @ taken
            column = column - taken @ np.linalg.solve(inner, taken.T @ weight @ column)
        information = float(column @ weight @ column)
        if information <= 1e-12 * float(np.trace(weight)):
            return 0.0, np.inf
        size = float(column @ weight @ away) / information
        return float(np.clip(size, one.low, one.high)), information**-0.5
