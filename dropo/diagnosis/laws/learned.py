"""A force that was learned from what nothing explains: called learned, not named.

Where no law is found, the force that is missing at a joint is learned as a function of its motion,
of its drive's force and of what that was a moment ago: a sum of bumps in places where the data are.
It is bounded, fades away outside the data, and is written as a formula, like any law.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from math import log
from typing import Any

import numpy as np
from scipy.cluster.vq import kmeans2

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array
from dropo.diagnosis.findings.accuracy.every_horizon import EveryHorizonSettings, worse_after
from dropo.diagnosis.findings.accuracy.horizons import AfterHorizon, after_horizons
from dropo.diagnosis.laws.extension import extended, padded, places_of_laws, with_laws
from dropo.diagnosis.laws.forces import RANK, ResidualForces, residual_forces
from dropo.diagnosis.laws.ideas import program_of, values_at
from dropo.diagnosis.search.confirmation import gain_of
from dropo.diagnosis.search.linearization import Library, LinearizedWindows, shift_linearization
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.trials import State
from dropo.effects.law import law_instance
from dropo.mjmodel.dynamics.forces import motors
from dropo.mjmodel.joints import Joint, joints
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True)
class LearnedSettings:
    """How forces are learned.

    Attributes
    ----------
    bumps : tuple of tuple of int
        How many bumps a force of one, two or three variables may have.
    width : float
        A bump's width, in distances between bumps that would fill two standard deviations of every
        variable to either side evenly.
    past : float
        Time constant with which the past of a drive's force is remembered [s].
    needed : float
        What a joint's force must promise beside the price of the choice between variables [nats].
    rounds : int
        Steps of Gauss-Newton by which it is fitted in simulation.
    halvings : int
        How often such a step is halved at most.
    evidence : int
        Rounds in which the prior and the noise are found.
    share : float
        Fraction of what is unexplained, over all horizons, from which it is used without being
        asked for.
    unexplained : float
        Multiple of the noise from which an error counts as unexplained.
    """

    bumps: tuple[tuple[int, ...], ...] = ((6, 12), (12, 40), (20, 50))
    width: float = 1.3
    past: float = 0.1
    needed: float = 10.0
    rounds: int = 2
    halvings: int = 4
    evidence: int = 50
    share: float = 0.5
    unexplained: float = 1.25


SETTINGS = LearnedSettings()
WEIGHT, CENTRES, WIDTH, PAST = "c", ("e", "f", "g"), "w", "T"
"""What the constants of a formula are called: weights, centres in each variable, widths, and the
time constant of the past.
"""
OF_MOTION = (("q",), ("v",), ("q", "v"), ("v", "load"), ("v", f"lag(v, {PAST})"))
"""What a force may be a function of ..."""
OF_DRIVE = (*OF_MOTION, ("v", "motor"), ("q", "v", "motor"), ("v", f"lag(motor, {PAST})"))
"""... at a joint that has a drive."""


@dataclass(frozen=True)
class LearnedForce:
    """A force at one joint.

    Attributes
    ----------
    joint : str
        A slide or hinge.
    variables : tuple of str
        What it is a function of.
    largest : float
        Its largest size in the data [N, N m].
    unit : str
        Of the force.
    formula : str
        What is simulated.
    """

    joint: str
    variables: tuple[str, ...]
    largest: float
    unit: str
    formula: str

    def __str__(self) -> str:
        of = ", ".join(self.variables)
        return f"{self.joint} (of {of}; up to {self.largest:.3g} {self.unit})"


@dataclass(frozen=True)
class Learned:
    """Forces that were learned, and what they gain on data held out.

    Attributes
    ----------
    forces : tuple of LearnedForce
        At each joint where something promises enough.
    gain, gain_se : float
        Of windows held out, with its standard error [nats].
    share : float
        The fraction of the squared errors on data held out beyond the noise's that they take away,
        in the mean over all horizons at which something is unexplained.
    used : bool
        Whether they are in the extended model.
    """

    forces: tuple[LearnedForce, ...]
    gain: float
    gain_se: float
    share: float
    used: bool

    @property
    def sentence(self) -> str:
        """What was learned, what it gains, and where it is."""
        where = " and ".join(map(str, self.forces))
        kept = "it is in the extended model" if self.used else "--learned puts it into the model"
        return (
            f"Learned, not named: a force at {where} takes away {self.share:.0%} of what is"
            f" unexplained on held-out data, over all horizons; {kept}."
        )

    def to_json(self) -> dict[str, Any]:
        """As diagnosis.json has it.

        Returns
        -------
        dict
        """
        forces = [
            {
                "joint": one.joint,
                "variables": list(one.variables),
                "largest": one.largest,
                "unit": one.unit,
                "formula": one.formula,
            }
            for one in self.forces
        ]
        return {
            "forces": forces,
            "held_out_gain": self.gain,
            "held_out_gain_se": self.gain_se,
            "share": self.share,
            "used": self.used,
        }


@dataclass(frozen=True, eq=False)
class WithLearned:
    """A search's end with forces that were learned.

    Attributes
    ----------
    learned : Learned
        What is said of them.
    selection : Selection
        The search, whose library has them.
    first, last : State
        As they were, with places for the forces' numbers; and the model with the forces.
    after : list of AfterHorizon
        The errors of the model without and with them.
    """

    learned: Learned
    selection: Selection
    first: State
    last: State
    after: list[AfterHorizon]


@dataclass(frozen=True, eq=False)
class _Bumps:
    """A force at a joint as a sum of K bumps.

    Attributes
    ----------
    joint : Joint
        Where it acts.
    variables : tuple of str
        Of the bumps, as formulas.
    centres : (K, D) array
        Of the bumps.
    widths : (D,) array
        In each variable.
    columns : (K, N) array
        Whitened changes of the residuals by each bump.
    heights : (K, W (L + 1)) array
        The bumps in all states.
    precision : float
        One over the variance of the weights, as the evidence says.
    evidence : float
        The logarithm of the evidence, over that of no force [nats].
    """

    joint: Joint
    variables: tuple[str, ...]
    centres: Array
    widths: Array
    columns: Array
    heights: Array
    precision: float
    evidence: float

    @property
    def formula(self) -> str:
        """The sum, with a letter and the bump's number for each constant."""
        bumps = []
        for k in range(len(self.centres)):
            squares = [
                f"(({variable} - {letter}{k}) / {WIDTH}{letter})**2"
                for variable, letter in zip(self.variables, CENTRES, strict=False)
            ]
            bumps.append(f"{WEIGHT}{k} * exp(-({' + '.join(squares)}))")
        return " + ".join(bumps)

    def constants(self, weights: Array, past: float) -> dict[str, float]:
        """The sizes of the formula's constants."""
        sizes = {f"{WEIGHT}{k}": float(weight) for k, weight in enumerate(weights)}
        for j, letter in enumerate(CENTRES[: len(self.variables)]):
            sizes |= {f"{letter}{k}": float(at) for k, at in enumerate(self.centres[:, j])}
            sizes[f"{WIDTH}{letter}"] = float(self.widths[j])
        return sizes | {PAST: past}


def learn_forces(
    problem: Problem,
    selection: Selection,
    first: State,
    last: State,
    rng: np.random.Generator,
    horizons: EveryHorizonSettings,
    *,
    asked: bool = False,
    settings: LearnedSettings = SETTINGS,
) -> WithLearned | None:
    """Learn the forces at the joints that a search left unexplained.

    Parameters
    ----------
    problem, selection, first, last
        As of `find_laws`.
    rng : numpy.random.Generator
        Draws where bumps are looked for, and the starts of windows by which horizons are compared.
    horizons : EveryHorizonSettings
        When errors after a horizon are larger.
    asked : bool
        Whether they are used wherever they make nothing worse.
    settings : LearnedSettings
        How forces are learned.

    Returns
    -------
    WithLearned or None
        None where nothing is learned that data held out confirm, or some error is larger with it.

    References
    ----------
    MacKay, Neural Computation 4 (1992), 415: the evidence, by which variables, the prior of the
    weights and the noise are chosen.
    """
    library = selection.library
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        return None
    places, draws = rng.spawn(2)
    forces = residual_forces(library, last, selection.floor)
    chosen = _chosen(simulator, places_of_laws(library), forces, places, settings)
    if not chosen:
        return None
    limits = selection.settings
    own, after = _with_forces(selection, last, forces, chosen, settings)
    kept = [one for one in chosen if _is_needed(own.library, after, one, limits.negligible_gain)]
    if 0 < len(kept) < len(chosen):
        chosen = kept
        own, after = _with_forces(selection, last, forces, chosen, settings)
    selection, library, theta = own, own.library, after.theta
    laws = after.accepted[len(last.accepted) :]
    before = padded(last, library)
    gain, z = gain_of(before.test, after.test)
    if gain <= limits.negligible_gain or z < limits.indistinguishable_z:
        return None
    compared = after_horizons(problem, library, [before.theta, theta], after, draws)
    if worse_after(compared, 0, 1, horizons) is not None:
        return None
    share = _share(compared, settings)
    used = asked or share >= settings.share
    learned = Learned(_described(chosen, laws, theta, library), gain, gain / z, share, used)
    return WithLearned(learned, selection, padded(first, library), after, compared)


def _with_forces(
    selection: Selection,
    last: State,
    forces: ResidualForces,
    chosen: Sequence[_Bumps],
    settings: LearnedSettings,
) -> tuple[Selection, State]:
    """A search whose library has the forces, and the model with them, fitted in simulation."""
    solver = _Solver(chosen, forces.residuals, settings)
    simulator: RobotSimulator = selection.library.simulator  # type: ignore[assignment]
    numbers = _laws(simulator, chosen, solver.weights, settings)
    laws = [law for law, _ in numbers]
    own = extended(selection, with_laws(selection.library, laws))
    theta = _fitted(own.library, padded(last, own.library), forces, numbers, solver, settings)
    windows = last.train.windows, last.test.windows
    noise = last.train.whiten.noise
    return own, own.without_fitting(*windows, theta, noise, last.free, (*last.accepted, *laws))


def _is_needed(library: Library, after: State, force: _Bumps, least: float) -> bool:
    """Whether windows held out lose so much [nats] without one of the forces.

    One that another joint's force leaves, where that was found far from the motion, is not.
    """
    law = next(one for one in after.accepted if one.formula and one.target == force.joint.name)
    theta = after.theta.copy()
    theta[library.indices_of[law.label]] = 0.0
    without = shift_linearization(library, after.test, theta, after.test.whiten.noise)
    lost, _ = gain_of(without, after.test)
    return lost >= least


# --- which forces


def _chosen(
    simulator: RobotSimulator,
    taken: Collection[str | None],
    forces: ResidualForces,
    rng: np.random.Generator,
    settings: LearnedSettings,
) -> list[_Bumps]:
    """At each joint the bumps that the residual forces ask for, where they do.

    taken: the joints at which there is a law.
    """
    measured = set(simulator.layout.names)
    driven = {one.id for one, _ in motors(simulator.model)}
    chosen = []
    for joint in joints(simulator.model):
        signals = {f"qpos.{joint.name}", f"qvel.{joint.name}"}
        if not signals <= measured or joint.name in taken:
            continue
        shared: dict[str, Array] = {}
        tried = [
            _bumps(simulator, forces, joint, variables, count, shared, rng, settings)
            for variables in (OF_DRIVE if joint.id in driven else OF_MOTION)
            for count in settings.bumps[len(variables) - 1]
        ]
        best = max(tried, key=lambda one: one.evidence)
        if best.evidence > settings.needed + log(len(tried)):
            chosen.append(best)
    return chosen


def _bumps(
    simulator: RobotSimulator,
    forces: ResidualForces,
    joint: Joint,
    variables: tuple[str, ...],
    count: int,
    shared: dict[str, Array],
    rng: np.random.Generator,
    settings: LearnedSettings,
) -> _Bumps:
    """So many bumps of some variables at a joint, spread over where the data are."""
    values = np.stack(
        [_values(simulator, forces, joint, one, shared, settings) for one in variables], axis=1
    )
    scale = np.maximum(values.std(axis=0), np.finfo(float).tiny)
    centres, _ = kmeans2(values / scale, count, minit="++", rng=rng)
    widths = scale * settings.width * 4 / count ** (1 / len(variables))
    centres = np.unique(centres * scale, axis=0)
    away = (values - centres[:, None]) / widths
    heights = np.exp(-np.sum(away**2, axis=2))
    columns, _ = forces.unexplained(forces.rows(heights, joint.qvel))
    precision, evidence = _evidence(columns, forces.residuals, settings.evidence)
    return _Bumps(joint, variables, centres, widths, columns, heights, precision, evidence)


def _values(
    simulator: RobotSimulator,
    forces: ResidualForces,
    joint: Joint,
    variable: str,
    shared: dict[str, Array],
    settings: LearnedSettings,
) -> Array:
    """A variable in all states (W (L + 1),)."""
    if variable not in shared:
        law = law_instance(simulator.effect_context, joint.name, f"c * {variable}")
        constants = [settings.past if one.name == PAST else 1.0 for one in law.quantities]
        program = program_of(law)
        shared[variable] = values_at(simulator, forces, joint, program, np.array(constants), {})
    return shared[variable]


def _evidence(columns: Array, residuals: Array, rounds: int) -> tuple[float, float]:
    """The precision of the weights' prior that has most evidence, and the logarithm of that over
    the evidence of no force; columns (K, N), residuals (N,).
    """
    count = len(residuals)
    left, sizes, _ = np.linalg.svd(columns @ columns.T, hermitian=True)
    along = left.T @ (columns @ residuals)
    total = float(residuals @ residuals)
    kept = sizes > RANK * sizes.max(initial=0.0)
    sizes, along = sizes[kept], along[kept]
    if not len(sizes) or not total:
        return np.inf, 0.0
    precision = float(np.median(sizes))
    noise = count / total
    for _ in range(rounds):
        weights = noise * along / (precision + noise * sizes)
        effective = float(np.sum(noise * sizes / (precision + noise * sizes)))
        rest = max(total - 2 * float(weights @ along) + float(sizes @ weights**2), RANK * total)
        precision = effective / max(float(weights @ weights), np.finfo(float).tiny)
        noise = (count - effective) / rest
    cost = 0.5 * (noise * rest + precision * float(weights @ weights))
    shrunk = 0.5 * float(np.sum(np.log1p(noise * sizes / precision)))
    evidence = 0.5 * count * log(noise) - cost - shrunk
    nothing = 0.5 * count * log(count / total) - 0.5 * count
    return precision, evidence - nothing


# --- their weights


class _Solver:
    """Weights of all bumps together, under the prior of each joint's."""

    def __init__(self, chosen: Sequence[_Bumps], residuals: Array, settings: LearnedSettings):
        self.columns = np.concatenate([one.columns for one in chosen])
        precision = np.concatenate([np.full(len(one.centres), one.precision) for one in chosen])
        self.gram = self.columns @ self.columns.T
        self.precision = precision
        self.noise = 1.0
        for _ in range(settings.evidence):
            weights = self.step(np.zeros(len(precision)), residuals)
            rest = residuals - weights @ self.columns
            self.noise = len(residuals) / max(float(rest @ rest), np.finfo(float).tiny)
        self.weights = self.step(np.zeros(len(precision)), residuals)

    def step(self, weights: Array, residuals: Array) -> Array:
        """Other weights (K,), by what these leave (N,)."""
        system = self.noise * self.gram + np.diag(self.precision)
        pull = self.noise * self.columns @ residuals - self.precision * weights
        return weights + np.linalg.solve(system, pull)

    def cost(self, weights: Array, residuals: Array) -> float:
        """The cost of weights that leave these [nats]."""
        prior = float(self.precision @ weights**2)
        return 0.5 * (self.noise * float(residuals @ residuals) + prior)


def _fitted(
    library: Library,
    before: State,
    forces: ResidualForces,
    laws: Sequence[tuple[EffectInstance, Array]],
    solver: _Solver,
    settings: LearnedSettings,
) -> Array:
    """All numbers (m,), the weights fitted in simulation by the responses to residual forces."""
    start = before.theta.copy()
    weighted: list[int] = []
    for law, sizes in laws:
        indices = library.indices_of[law.label]
        start[indices] = sizes
        weighted += _of_weights(law, indices).tolist()
    places = np.array(weighted)

    space = library.simulator.space

    def at(weights: Array) -> tuple[Array, Array, float]:
        """All numbers, the whitened residuals with them, and their cost."""
        theta = start.copy()
        theta[places] = np.clip(weights, space.low[places], space.high[places])
        side = shift_linearization(library, before.train, theta, before.train.whiten.noise)
        left = _left(forces, side)
        return theta, left, solver.cost(weights, left)

    weights = np.zeros(len(solver.weights))
    target = solver.weights
    theta, left, cost = at(weights)
    for _ in range(settings.rounds):
        for _ in range(settings.halvings):
            moved = at(target)
            if moved[2] < cost:
                break
            target = weights + 0.5 * (target - weights)
        else:
            break
        weights = target
        theta, left, cost = moved
        target = solver.step(weights, left)
    return theta


def _of_weights(law: EffectInstance, values: Array) -> Array:
    """What belongs to the weights (K,) of values of all constants, in the order of the bumps."""
    names = [quantity.name for quantity in law.quantities]
    by_name = dict(zip(names, values, strict=True))
    count = sum(name.startswith(WEIGHT) for name in names)
    return np.array([by_name[f"{WEIGHT}{k}"] for k in range(count)])


def _left(forces: ResidualForces, side: LinearizedWindows) -> Array:
    """Whitened residuals (N,) as of `forces`, without what is explained anyway."""
    whole = replace(forces.windows, residuals=side.residuals).flat(side.residuals)
    return np.asarray(whole - forces.basis @ (forces.basis.T @ whole))


# --- as laws


def _laws(
    simulator: RobotSimulator,
    chosen: Sequence[_Bumps],
    weights: Array,
    settings: LearnedSettings,
) -> list[tuple[EffectInstance, Array]]:
    """A law for each force, with its numbers (q,)."""
    context = simulator.effect_context
    laws = []
    begin = 0
    for one in chosen:
        own = weights[begin : begin + len(one.centres)]
        begin += len(own)
        sizes = one.constants(own, settings.past)
        largest = float(np.abs(own).max())
        typical = {n: largest if n.startswith(WEIGHT) else size for n, size in sizes.items()}
        law = law_instance(context, one.joint.name, one.formula, typical=typical)
        laws.append((law, np.array([sizes[quantity.name] for quantity in law.quantities])))
    return laws


def _described(
    chosen: Sequence[_Bumps],
    laws: Sequence[EffectInstance],
    theta: Array,
    library: Library,
) -> tuple[LearnedForce, ...]:
    """What is said of each force."""
    found = []
    for one, law in zip(chosen, laws, strict=True):
        numbers = theta[library.indices_of[law.label]]
        weights = _of_weights(law, numbers)
        largest = float(np.abs(weights @ one.heights).max())
        found.append(
            LearnedForce(one.joint.name, one.variables, largest, one.joint.force, law.formula)
        )
    return tuple(found)


def _share(compared: Sequence[AfterHorizon], settings: LearnedSettings) -> float:
    """The part of the unexplained squared errors that is taken away, over all horizons."""
    shares = []
    for after in compared:
        without, with_forces = after.models[:2]
        if not without.rmse > settings.unexplained * with_forces.noise:
            continue
        unexplained = without.rmse**2 - with_forces.noise**2
        shares.append(1 - max(with_forces.rmse**2 - with_forces.noise**2, 0.0) / unexplained)
    return float(np.mean(shares)) if shares else 0.0
