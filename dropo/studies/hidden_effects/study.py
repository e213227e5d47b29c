"""Hides effects of random kind, place and magnitude in simulated data, and sees if they are named.

Also, what is said if nothing is hidden, or nothing that the library of effects has.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import beta

from dropo import Diagnose, Diagnosis
from dropo.core.contracts.effect import EffectInstance, Quantity, StepState, instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.registry import names
from dropo.core.services.validation import Array, known, require
from dropo.diagnosis.parts import are_stated
from dropo.diagnosis.search.library import LAW
from dropo.mjmodel.dynamics.forces import force_per_command
from dropo.mjmodel.joints import actuators
from dropo.problems.simulated.robots import ROBOTS, SimulatedRobot, masses, simulated_robot
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work

CASES = ("one", "nothing", "white", "outside", "removed", "two", "masses", "three")
"""One effect; none; white noise on the forces; a cause that no effect stands for; the true cause
left out of the search; two effects; one effect beside masses that are off and fitted with it;
three effects.
"""
NAMED = {"one": 1, "two": 2, "masses": 1, "three": 3}
"""Case -> number of effects that are to be named."""
ARMS = ("torque-arm", "position-arm")
RUNS = {
    "one": (40, 40),
    "nothing": (100, 100),
    "white": (20, 10),
    "outside": (10, 5),
    "removed": (10, 5),
    "two": (10, 3),
    "masses": (10, 3),
    "three": (10, 3),
}
"""Case -> number of runs on each arm, and on each robot that walks or hops (there a run of several
effects takes minutes).
"""
HEADER = (
    "machine",
    "hidden",
    "runs",
    "as it should be",
    "95 %",
    "in the ambiguity set",
    "another beside it",
    "a false cause stated",
    "error of the size",
    "share of the gain",
    "simulator steps",
)
Hidden = list[tuple[EffectInstance, Array]]
"""Effects with their magnitudes."""


@dataclass(frozen=True)
class HiddenEffectSettings:
    """When a hidden effect counts, and how it is drawn.

    Attributes
    ----------
    minimum_gain : float
        Log-likelihood [nats] that the true effect must gain on held-out data for a run to count.
    minimum_margin : float
        Log-likelihood [nats per transition] on held-out data by which the true model must be better
        than the found one, for the removed cause to have no stand-in.
    noise : (float, float)
        Bounds of the sensors' standard deviation, which is drawn log-uniformly.
    attempts : int
        Maximum number of draws for effects that count.
    """

    minimum_gain: float = 100.0
    minimum_margin: float = 0.01
    noise: tuple[float, float] = (1e-4, 10**-2.5)
    attempts: int = 50


DEFAULT = HiddenEffectSettings()


def hidden_effects(
    work: Work,
    seeds: int | None = None,
    *,
    first_seed: int = 0,
    machines: Sequence[str] = tuple(ROBOTS),
    cases: Sequence[str] = CASES,
    settings: HiddenEffectSettings = DEFAULT,
) -> Study:
    """How often a hidden effect is named, what else is named, and what is said otherwise.

    Parameters
    ----------
    work : Work
        Runs the tasks.
    seeds : int or None
        Runs of each case on each robot; None for the numbers of `RUNS`.
    first_seed : int
        Seed of the first run of each, from 0; the others follow it.
    machines : sequence of str
        Names of robots.
    cases : sequence of str
        Some of `CASES`.
    settings : HiddenEffectSettings
        When a hidden effect counts, and how it is drawn.

    Returns
    -------
    Study
        The study.

    Raises
    ------
    BadArgument
        If `seeds` is below 1, or `first_seed` below 0.
    UnknownName
        If there is no such robot or case.
    """
    require(seeds is None or seeds >= 1, "seeds", "at least 1", seeds, "hidden_effects")
    require(first_seed >= 0, "first_seed", "at least 0", first_seed, "hidden_effects")
    extra = [] if settings == DEFAULT else [asdict(settings)]
    items = []
    for machine in machines:
        for case in cases:
            known("machine", machine, ROBOTS)
            known("case", case, CASES)
            count = RUNS[case][machine not in ARMS] if seeds is None else seeds
            drawn = range(first_seed, first_seed + count)
            items += [[machine, case, seed, *extra] for seed in drawn]
    runs = work.map(run, items)
    groups = [(machine, [r for r in runs if r["machine"] == machine]) for machine in machines]
    if len(machines) > 1:
        groups.append(("all", runs))
    rows = [row for name, own in groups for row in _rows(name, own, settings)]
    none = "-"
    of_all = (str(len(runs)), none, none, none, none, _false(runs), none, none, none)
    rows.append((groups[-1][0], "any of these", *of_all))
    wrong = [_wrong_row(r) for r in runs if not r["right"]]
    tables = (
        Table("What was said", HEADER, tuple(rows)),
        Table(
            "Other answers", ("machine", "hidden", "seed", "effect", "nats", "said"), tuple(wrong)
        ),
        Table("Taken for", ("effect", "named", "times"), tuple(_confusion(runs, settings))),
    )
    remarks = (
        f"Right: one, two, three, masses: every effect worth {settings.minimum_gain:.0f} nats on "
        "the data held out is named with its place; nothing, white: no effect is named; outside, "
        'removed: said to be unexplained in part or in whole, or "acts like".',
        "No stand-in: the runs of removed in which the true model is "
        f"{settings.minimum_margin} nats per transition better on data held out than what was "
        "found. In the others the effects that were left explain these data as well as the "
        "missing one.",
        f"A false cause stated: of {stated_falsely(runs)}",
        "Share of the gain: the median of what the causes gain, of what the true model would, on "
        "data held out.",
    )
    return Study(
        "hidden-effects", "Effects hidden in simulated data", tables, remarks, {"runs": runs}
    )


def _wrong_row(result: dict[str, Any]) -> tuple[str, ...]:
    """A run that was not as it should be, as a row."""
    nats = f"{result['nats']:.0f}"
    seed = str(result["seed"])
    return (result["machine"], result["case"], seed, result["hidden"], nats, result["said"])


def _rows(
    name: str, runs: Sequence[dict[str, Any]], settings: HiddenEffectSettings
) -> list[tuple[str, ...]]:
    """A row for each case of one robot's runs."""
    groups = [(case, [r for r in runs if r["case"] == case]) for case in CASES]
    margin = settings.minimum_margin
    no_stand_in = [r for r in runs if r["case"] == "removed" and r["short"] > margin]
    groups.insert(CASES.index("removed") + 1, ("removed, no stand-in", no_stand_in))
    rows = []
    for case, own in groups:
        always = case in ("nothing", "white", "outside")
        counted = [r for r in own if always or r["nats"] >= settings.minimum_gain]
        if counted:
            rows.append((name, case, *_cells(case, counted)))
    return rows


def _cells(case: str, runs: Sequence[dict[str, Any]]) -> tuple[str, ...]:
    """What is said of the runs of one case that count."""
    n = len(runs)
    right = sum(r["right"] for r in runs)
    low, high = interval(right, n)
    steps = f"{np.median([r['steps'] for r in runs]):,.0f}"
    among = beside = error = gain = "-"
    false = _false(runs)
    if case in NAMED:
        among = f"{sum(r['among'] for r in runs)}/{n}"
        beside = f"{sum(r['right'] and r['extra'] for r in runs)}/{n}"
        errors = [r["error"] for r in runs if r["error"] is not None]
        if errors:
            error = f"{np.median(errors):.2%}"
        gains = [r["share"] for r in runs if r["share"] is not None]
        if gains:
            gain = f"{np.median(gains):.1%}"
    share = f"{right}/{n}"
    return (str(n), share, f"{low:.0%}-{high:.0%}", among, beside, false, error, gain, steps)


def _false(runs: Sequence[dict[str, Any]]) -> str:
    """How many of some runs state a false cause."""
    return f"{sum(map(states_falsely, runs))}/{len(runs)}"


def states_falsely(result: dict[str, Any]) -> bool:
    """Say whether a run states a cause that is none.

    Parameters
    ----------
    result : dict
        Of a run, as `run` returns it.

    Returns
    -------
    bool
    """
    return bool(result["extra"]) and are_stated(result["verdict"])


def stated_falsely(runs: Sequence[dict[str, Any]]) -> str:
    """Say in how many runs a stated cause is false.

    Parameters
    ----------
    runs : sequence of dict
        Of the study, as `run` returns them.

    Returns
    -------
    str
        All runs count, those in which nothing is hidden, nothing that the search can name, or too
        little to be named, among them.
    """
    n = len(runs)
    false = sum(map(states_falsely, runs))
    low, high = interval(false, n)
    stating = sum(are_stated(one["verdict"]) for one in runs)
    least, most = interval(stating - false, stating)
    return (
        f"all {n} runs, those of effects too weak to count among them, {false} state a cause that "
        f"is none, or not at its place (95 %: {low:.1%} to {high:.1%}). {stating} state causes: "
        f"all of these are right in {stating - false} (95 %: {least:.1%} to {most:.1%}). A cause "
        'is stated where the verdict is "explained"; of others it is said that what is missing '
        "acts like them."
    )


def interval(right: int, n: int) -> tuple[float, float]:
    """The 95 % confidence interval of a proportion.

    Parameters
    ----------
    right : int
        Number of successes.
    n : int
        Number of trials.

    Returns
    -------
    (float, float)
        Its ends.

    References
    ----------
    Clopper and Pearson, "The use of confidence or fiducial limits illustrated in the case of the
    binomial", 1934.
    """
    low = float(beta.ppf(0.025, right, n - right + 1)) if right > 0 else 0.0
    high = float(beta.ppf(0.975, right + 1, n - right)) if right < n else 1.0
    return low, high


def _confusion(
    runs: Sequence[dict[str, Any]], settings: HiddenEffectSettings
) -> list[tuple[str, str, str]]:
    """How often each hidden effect was named as each other, for runs of one effect that count."""
    counted = [r for r in runs if r["case"] == "one" and r["nats"] >= settings.minimum_gain]
    pairs = Counter((re.split("[:.=]", r["hidden"])[0], r["first"]) for r in counted)
    return [(hidden, first, str(times)) for (hidden, first), times in sorted(pairs.items())]


def run(item: list[Any]) -> dict[str, Any]:
    """One run: a robot with something hidden, its data, and what a diagnosis of them says.

    Parameters
    ----------
    item : list
        Name of the robot, case, seed, and perhaps the settings as a dict.

    Returns
    -------
    dict
        What was hidden, and what was said, as plain numbers and texts.
    """
    name, case, seed, *rest = item
    settings = HiddenEffectSettings(**rest[0]) if rest else DEFAULT
    rng = np.random.default_rng([seed, CASES.index(case), list(ROBOTS).index(name)])
    robot = simulated_robot(name, masses(name) if case == "masses" else ())
    sigma = float(np.exp(rng.uniform(*np.log(settings.noise))))
    effects, data, nats = hide_some(robot, case, sigma, rng, settings)
    problem = Problem(name, robot.simulator, data, start_noise=True)
    searched = None
    if case == "removed":
        left_out = (effects[0][0].effect, "parameter_drift", LAW)
        searched = [effect for effect in names("effects") if effect not in left_out]
    found = Diagnose(searched).run(problem, rng=seed)
    result = {
        "machine": name,
        "case": case,
        "seed": seed,
        "noise": sigma,
        "nats": nats,
        "hidden": ", ".join(_label(*one) for one in effects) or "-",
        **evaluate(case, effects, found),
        "share": None,
        "short": None,
        "verdict": found.verdict,
        "steps": found.simulator_steps,
    }
    if case in ("one", "removed"):
        best = true_log_likelihood(problem, effects, found)
        result["short"] = best - found.extended.log_likelihood
        if case == "one":
            result["share"] = _fraction_of_gain(best, found)
    return result


def evaluate(case: str, effects: Hidden, found: Diagnosis) -> dict[str, Any]:
    """Whether the right thing was said, and what.

    Parameters
    ----------
    case : str
        One of `CASES`.
    effects : list of (EffectInstance, array)
        The hidden effects.
    found : Diagnosis
        The diagnosis.

    Returns
    -------
    dict
        said: the causes as a text, those that are not stated with a mark. first: the first cause's
        effect. among: whether every hidden effect is named, or in the ambiguity set of a cause.
        extra: whether another is named. right: whether the case's rule is met. error: relative
        error of the first magnitude, or None.
    """
    named = {(cause.effect, cause.target) for cause in found.causes}
    ambiguous = {
        (other.effect, other.target) for cause in found.causes for other in cause.confused_with
    }
    wanted = [equivalent(instance) for instance, _ in effects]
    truth: set[tuple[str, str | None]] = set().union(*wanted)
    texts = []
    for cause in found.causes:
        mark = "" if cause in found.stated else "~"
        texts.append(f"{mark}{cause.effect}:{cause.target or ''}.{cause.variant}")
    error = None
    if case in ("nothing", "white"):
        right = not named
    elif case in ("outside", "removed"):
        right = found.verdict in ("partly", "unexplained")
    else:
        right = all(same & named for same in wanted)
        error = _error(effects[0], found)
    return {
        "said": "; ".join(texts) + f" ({found.verdict})",
        "first": found.causes[0].effect if found.causes else "nothing",
        "among": all(same & (named | ambiguous) for same in wanted),
        "error": error,
        "extra": bool(named - truth),
        "right": right,
    }


def true_log_likelihood(problem: Problem, effects: Hidden, found: Diagnosis) -> float:
    """The log-likelihood of held-out data under the true model.

    Parameters
    ----------
    problem : Problem
        The problem that was diagnosed.
    effects : list of (EffectInstance, array)
        The hidden effects.
    found : Diagnosis
        Its windows' horizon is taken.

    Returns
    -------
    float
        Nats per transition.
    """
    simulator: Any = problem.simulator
    truth = replace(problem, simulator=simulator.with_effects((), effects))
    return Diagnose(length=found.window_steps).baseline(truth)


def _fraction_of_gain(best: float, found: Diagnosis) -> float:
    """What the causes gain on held-out data, as a fraction of what the true model gains."""
    return found.gain / (best - found.baseline.log_likelihood)


def equivalent(instance: EffectInstance) -> set[tuple[str, str | None]]:
    """Name an effect with its target, and the effects that no recorded data tell from it.

    Parameters
    ----------
    instance : EffectInstance

    Returns
    -------
    set of (str, str or None)
        Effects and targets.
    """
    return {(instance.effect, instance.target), *((name, None) for name in instance.alike)}


def _error(hidden: tuple[EffectInstance, Array], found: Diagnosis) -> float | None:
    """The relative error of the first magnitude; None if the effect is not named."""
    instance, magnitudes = hidden
    place = (instance.effect, instance.target, instance.variant)
    for cause in found.causes:
        if (cause.effect, cause.target, cause.variant) == place:
            estimate = cause.estimate[instance.quantities[0].name].value
            return float(abs(estimate / magnitudes[0] - 1))
    return None


def _label(instance: EffectInstance, magnitudes: Array) -> str:
    """An effect with its magnitudes as a text."""
    return f"{instance.label}={','.join(f'{value:.3g}' for value in magnitudes)}"


def hide_some(
    robot: SimulatedRobot,
    case: str,
    sigma: float,
    rng: np.random.Generator,
    settings: HiddenEffectSettings = DEFAULT,
) -> tuple[Hidden, Trajectories, float]:
    """Draw what is hidden, and record the data.

    Parameters
    ----------
    robot : SimulatedRobot
        The robot.
    case : str
        One of `CASES`.
    sigma : float
        Standard deviation of the noise on every sensor, in its unit.
    rng : numpy.random.Generator
        Source of everything drawn.
    settings : HiddenEffectSettings
        When an effect counts.

    Returns
    -------
    effects : list of (EffectInstance, array)
        The hidden effects.
    data : Trajectories
        The recorded data.
    nats : float
        About the log-likelihood that each effect gains on every other trajectory at the true noise,
        the smallest of them; 0 if no effect is to be named.
    """
    values = np.asarray(robot.simulator.nominal)
    if case == "masses":
        values = values * rng.uniform(0.75, 1.25, len(robot.simulator.space))
    if case in ("nothing", "white", "outside"):
        effects: Hidden = []
        if case == "white":
            effects = [white_noise()]
        elif case == "outside":
            effects = [unmodelled_cause(robot, rng)]
        return effects, robot.record(effects, noise=sigma, rng=rng.spawn(1)[0], values=values), 0.0
    kinds = [kind for kind in names("effects") if kind != LAW]  # which has no place by itself
    if case == "masses":  # body masses are fitted anyway
        kinds = [kind for kind in kinds if kind != "body_mass"]
    for _ in range(settings.attempts):
        chosen = rng.choice(kinds, NAMED.get(case, 1), replace=False)
        drawn = [draw(robot, str(kind), rng) for kind in chosen]
        effects = [one for one in drawn if one is not None]
        if len(effects) < len(chosen):
            continue
        data = robot.record(effects, noise=sigma, rng=rng.spawn(1)[0], values=values)
        gains = [0.0]
        if len(data) > 400:
            gains = [gain_of(robot, one, effects, values, data, sigma) for one in effects]
        if min(gains) >= settings.minimum_gain and all(
            every_magnitude_counts(robot, one, effects, values, data, sigma, settings)
            for one in effects
        ):
            break
    return effects, data, float(min(gains))


def draw(
    robot: SimulatedRobot,
    kind: str,
    rng: np.random.Generator,
    sizes: tuple[float, float] = (0.1, 2.0),
) -> tuple[EffectInstance, Array] | None:
    """Draw an effect of a kind at a random place.

    Parameters
    ----------
    robot : SimulatedRobot
        The robot.
    kind : str
        Name of an effect.
    rng : numpy.random.Generator
        Source of place and magnitudes.
    sizes : (float, float)
        Bounds of the first magnitude, in largest probes of the effect.

    Returns
    -------
    (EffectInstance, array) or None
        The effect, whose first magnitude is log-uniform within these bounds; None if the robot has
        no place for it, or its magnitude is 0.
    """
    instances = instances_of(robot.simulator.effect_context, kind)
    if not instances:
        return None
    instance = instances[rng.integers(len(instances))]
    trial = instance.trials[rng.integers(len(instance.trials))]
    magnitudes = np.sum(trial, axis=0)
    first = instance.quantities[0]
    size = max(np.abs(first.probes)) * np.exp(rng.uniform(*np.log(sizes)))
    magnitudes[0] = np.clip(np.sign(magnitudes[0]) * size, 0.9 * first.low, 0.9 * first.high)
    return (instance, magnitudes) if magnitudes[0] != 0 else None


def gain_of(
    robot: SimulatedRobot,
    one: tuple[EffectInstance, Array],
    effects: Hidden,
    values: Array,
    data: Trajectories,
    sigma: float,
) -> float:
    """About the log-likelihood [nats] that an effect gains on every other trajectory.

    Parameters
    ----------
    robot : SimulatedRobot
        The robot.
    one : (EffectInstance, array)
        The effect.
    effects : list of (EffectInstance, array)
        All hidden effects.
    values : (d,) array
        True parameters.
    data : Trajectories
        The recorded data.
    sigma : float
        Standard deviation of the noise on every sensor, in its unit.

    Returns
    -------
    float
        Nats, by `difference`.
    """
    without = [other for other in effects if other[0].label != one[0].label]
    return difference(robot, effects, without, values, data, sigma)


def every_magnitude_counts(
    robot: SimulatedRobot,
    one: tuple[EffectInstance, Array],
    effects: Hidden,
    values: Array,
    data: Trajectories,
    sigma: float,
    settings: HiddenEffectSettings = DEFAULT,
) -> bool:
    """Whether each magnitude of an effect gains a tenth of what an effect must.

    Without one of them it would be another effect, such as wind across an arm's plane.

    Parameters
    ----------
    robot, one, effects, values, data, sigma
        As in `gain_of`.
    settings : HiddenEffectSettings
        What an effect must gain.

    Returns
    -------
    bool
    """
    instance, magnitudes = one
    if len(magnitudes) == 1:
        return True
    for i in range(len(magnitudes)):
        reduced = magnitudes.copy()
        reduced[i] = 0.0
        without = []
        for own, size in effects:
            without.append((own, reduced if own is instance else size))
        gain = difference(robot, effects, without, values, data, sigma)
        if gain < settings.minimum_gain / 10:
            return False
    return True


def difference(
    robot: SimulatedRobot,
    effects: Hidden,
    without: Hidden,
    values: Array,
    data: Trajectories,
    sigma: float,
) -> float:
    """About the log-likelihood by which effects are better than others on every other trajectory.

    Parameters
    ----------
    robot : SimulatedRobot
        The robot.
    effects, without : lists of (EffectInstance, array)
        The true effects, and the others.
    values : (d,) array
        True parameters.
    data : Trajectories
        The recorded data.
    sigma : float
        Standard deviation of the noise on every sensor, in its unit.

    Returns
    -------
    float
        Nats: half the fall of the squared errors of windows of 5 control steps, in units of the
        noise of starts and ends, bounded for each window by a logarithm.
    """
    true_simulator = robot.simulator.with_effects((), effects)
    other_simulator = robot.simulator.with_effects((), without)
    return nats_between(true_simulator, other_simulator, values, data, sigma)


def nats_between(
    true_simulator: MujocoSimulator,
    other_simulator: MujocoSimulator,
    values: Array,
    data: Trajectories,
    sigma: float,
) -> float:
    """About the log-likelihood by which a simulator is better than another; see `difference`.

    Parameters
    ----------
    true_simulator, other_simulator : MujocoSimulator
        The one that made the data, and the other.
    values, data, sigma
        As of `difference`.

    Returns
    -------
    float
        Nats.
    """
    segments = data.segments(5)
    segments = segments.take(np.flatnonzero(segments.trajectory % 2 == 1))
    true_ends = true_simulator.predict(values[None], segments)[0]
    other_ends = other_simulator.predict(values[None], segments)[0]
    change = np.nan_to_num(true_ends - other_ends) / sigma
    # How much larger than the noise itself the true model's errors are, since starts are noisy.
    inflation: Array | float = 4.0
    if change.shape == segments.targets.shape:
        errors = np.nan_to_num((segments.targets - true_ends) / sigma)
        inflation = np.mean(errors**2, axis=0)
    squares = np.sum(change**2 / np.maximum(inflation, 1.0), axis=1)
    return float(np.sum(np.log1p(squares / 8)) * 4)


def white_noise() -> tuple[EffectInstance, Array]:
    """White noise on every force, added behind the clamp, of a tenth of the largest commands.

    Returns
    -------
    (EffectInstance, array)
        The same noise for the same commands, whenever it is asked for.
    """

    def actuation(commands: Array, step: float, magnitudes: Array) -> Array:
        own = np.random.default_rng(np.frombuffer(commands[0].tobytes(), dtype=np.uint32))
        return np.asarray(commands + magnitudes[0] * own.standard_normal(commands.shape))

    sd = Quantity("sd", "command", 0, 1, (0.1,))
    return EffectInstance("white_noise", None, (sd,), actuation=actuation), np.array([0.1])


def unmodelled_cause(
    robot: SimulatedRobot, rng: np.random.Generator
) -> tuple[EffectInstance, Array]:
    """Draw a cause that no effect stands for, at a random actuator's joint.

    It is drag that grows with the speed's square, a spring that hardens, or a command that counts
    more at large angles.

    Parameters
    ----------
    robot : SimulatedRobot
        The robot.
    rng : numpy.random.Generator
        Source of the cause and its place.

    Returns
    -------
    (EffectInstance, array)
        A force of a fifth of the actuator's.
    """
    model = robot.simulator.model
    i = int(rng.integers(model.nu))
    joint = actuators(model)[i].joint
    assert joint is not None
    q = joint.qpos
    v = joint.qvel
    full = force_per_command(model, i)
    shape = int(rng.integers(3))

    def force(state: StepState, magnitudes: Array) -> Array:
        angle = state.qpos[:, q]
        speed = state.qvel[:, v]
        shapes = (
            -speed * np.abs(speed) / 25,
            -4 * angle**3,
            state.ctrl[:, i] * np.sin(4 * angle),
        )
        out = np.zeros_like(state.qvel)
        out[:, v] = shapes[shape] * magnitudes[0]
        return out

    size = Quantity("size", "N m", 0, full, (full,))
    return EffectInstance("outside", str(shape), (size,), force=force), np.array([0.2 * full])
