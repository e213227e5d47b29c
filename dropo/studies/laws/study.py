"""Hides laws that no effect of the registry stands for, and sees if their formulas are found.

Also, what is said where nothing is hidden, under four kinds of noise.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dropo import Diagnose
from dropo.core.contracts.problem import Problem
from dropo.core.services.optional_dependencies import need
from dropo.core.services.tables import number
from dropo.core.services.validation import Array, known, require
from dropo.diagnosis.search.library import robot_of
from dropo.effects.law import law_instance
from dropo.problems.simulated.robots import masses, problem_of, simulated_robot
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work

MACHINE = "torque-arm"
NOISE = 1e-3
"""Standard deviation of every sensor's noise, in its unit."""
FINER = 4
"""Physics steps of the hidden machine for one of the model."""
RIVALS = (
    "joint_damping",
    "joint_friction",
    "joint_stribeck",
    "joint_stiffness",
    "joint_armature",
    "joint_load_friction",
    "joint_cogging",
    "actuator_gain",
    "actuator_bias",
    "actuator_torque_speed",
)
"""The effects that a law competes with: those of joints and drives, at all places."""
WINDOWS = 48
"""About how many windows are fitted, and how many are held out."""
COUNTED = 100.0
"""Nats on data held out that the true law must gain for a run to count."""
DEVELOPMENT = {
    "quadratic drag": ("elbow", "-c * abs(v) * v", {"c": 0.1}),
    "cubic drag": ("shoulder", "-c * v**3", {"c": 0.02}),
    "friction away from the middle": ("elbow", "-c * q**2 * v", {"c": 0.2}),
}
"""The laws on which the search was worked out, each with its place and sizes."""
EVALUATION = {
    "cubic spring": ("shoulder", "-c * q**3", {"c": 1.0}),
    "tether": ("elbow", "-c * max(q - a, 0)", {"c": 3.0, "a": 0.4}),
    "asymmetric viscous friction": ("elbow", "-c * abs(v)", {"c": 0.1}),
    "square-root friction": ("shoulder", "-c * sign(v) * sqrt(abs(v))", {"c": 0.2}),
    "coupling of speeds": ("elbow", "-c * v.shoulder * v", {"c": 0.05}),
    "torque ripple": ("shoulder", "c * sin(5 * q)", {"c": 0.3}),
    "thermal derating": ("elbow", "-c * motor * t", {"c": 0.5}),
    "load friction with presliding": (
        "elbow",
        "-c * abs(motor) * dahl(x)",
        {"c": 0.3, "x": 0.05},
    ),
    "spring with play": ("elbow", "-c * dead(q, w)", {"c": 3.0, "w": 0.3}),
    "detent": (
        "shoulder",
        "-c * (q - a) * exp(-((q - a) / w)**2)",
        {"c": 5.0, "a": 0.3, "w": 0.2},
    ),
}
"""The laws that are reported, on seeds of their own."""
FIRST_SEED = {"development": 0, "evaluation": 1000, "null": 2000}
NULLS = ("gaussian", "t3", "ar1", "quantised")
"""Noise of machines with nothing hidden."""


def laws(
    work: Work,
    seeds: int | None = None,
    *,
    names: Sequence[str] = (*EVALUATION, *DEVELOPMENT),
    nulls: Sequence[str] = NULLS,
) -> Study:
    """How often the formula of a hidden law is found, and what is found where none is.

    Parameters
    ----------
    work : Work
        Runs the tasks.
    seeds : int or None
        Runs of each law and of each kind of noise; 1 if None.
    names : sequence of str
        Some of the laws of `EVALUATION` and `DEVELOPMENT`.
    nulls : sequence of str
        Some of `NULLS`.

    Returns
    -------
    Study

    Raises
    ------
    BadArgument
        If `seeds` is below 1.
    UnknownName
        If there is no such law or kind of noise.
    """
    require(seeds is None or seeds >= 1, "seeds", "at least 1", seeds, "laws")
    count = seeds or 1
    items: list[list[Any]] = []
    for name in names:
        known("law", name, (*EVALUATION, *DEVELOPMENT))
        kind = "development" if name in DEVELOPMENT else "evaluation"
        items += [[kind, name, FIRST_SEED[kind] + seed] for seed in range(count)]
    for name in nulls:
        known("kind of noise", name, NULLS)
        items += [["null", name, FIRST_SEED["null"] + seed] for seed in range(count)]
    runs = work.map(run, items)
    hidden = [one for one in runs if one["set"] != "null"]
    none = [one for one in runs if one["set"] == "null"]
    return Study(
        "laws",
        f"Laws that no effect stands for, hidden in {len(hidden)} recordings of {MACHINE}; "
        f"{len(none)} with nothing hidden",
        (_totals(hidden, none), _found(hidden), _silent(none)),
        (
            f"{MACHINE}, noise {NOISE:g} on every sensor, the hidden machine with physics steps "
            f"{FINER} times finer. A run counts where the true law gains {COUNTED:g} nats.",
        ),
        {"runs": runs},
    )


def run(item: list[Any]) -> dict[str, Any]:
    """Diagnose one recording.

    Parameters
    ----------
    item : list
        The set ("development", "evaluation" or "null"), the law or the kind of noise, the seed.

    Returns
    -------
    dict
        What was hidden, what was said.
    """
    kind, name, seed = item
    robot = simulated_robot(MACHINE, masses(MACHINE), 1)
    finer = replace(robot, simulator=robot.simulator.with_finer_steps(FINER))
    rng = np.random.default_rng(seed)
    hidden = []
    answer: dict[str, Any] = {"set": kind, "name": name, "seed": seed}
    if kind != "null":
        place, text, sizes = {**DEVELOPMENT, **EVALUATION}[name]
        law = law_instance(robot.simulator.effect_context, place, text, typical=sizes)
        numbers = np.array([sizes[quantity.name] for quantity in law.quantities])
        hidden = [(law, numbers)]
        answer |= {"hidden": text, "target": place}
    data = finer.record(hidden, noise=NOISE if kind != "null" else 1e-12, rng=rng)
    if kind == "null":
        data = _with_noise(data, name, rng)
    problem = problem_of(MACHINE, robot, data, NOISE)
    found = Diagnose([*RIVALS, "law"], windows=WINDOWS).run(problem, rng=seed)
    causes = [cause.to_json(rank) for rank, cause in enumerate(found.causes, 1)]
    said = [one for one in causes if one["effect"] == "law"]
    answer |= {
        "verdict": found.verdict,
        "causes": [[one["effect"], one["target"], one.get("formula", "")] for one in causes],
        "acts_like": [one["acts_like"] for one in said],
        "steps": found.simulator_steps,
    }
    if kind != "null":
        best = _oracle(problem, hidden, found.window_steps)
        gain = best - found.baseline.log_likelihood
        answer["nats"] = gain * WINDOWS * found.window_steps
        answer["share"] = (found.extended.log_likelihood - found.baseline.log_likelihood) / gain
        answer["right"] = any(
            one["target"] == answer["target"] and equivalent(one["formula"], answer["hidden"])
            for one in said
        )
        answer["among"] = answer["right"] or any(
            equivalent(other.formula, answer["hidden"])
            for cause in found.causes
            for other in cause.confused_with
            if other.formula
        )
    return answer


def _oracle(problem: Problem, hidden: list[Any], length: int) -> float:
    """The log-likelihood of the true model on data held out [nats per transition]."""
    true = replace(problem, simulator=robot_of(problem).with_effects((), hidden))
    return Diagnose(length=length, windows=WINDOWS).baseline(true)


def _with_noise(data: Any, kind: str, rng: np.random.Generator) -> Any:
    """A recording without noise, with noise of a kind on every measurement."""
    observations = data.observations.copy()
    after = data.next_observations.copy()
    for first, last in data.spans:
        whole = np.concatenate([observations[first:last], after[last - 1 : last]])
        whole = whole + _noise(kind, whole.shape, rng)
        if kind == "quantised":
            whole = np.round(whole / (4 * NOISE)) * 4 * NOISE
        observations[first:last] = whole[:-1]
        after[first:last] = whole[1:]
    return replace(data, observations=observations, next_observations=after)


def _noise(kind: str, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Noise (k, p) of a kind, of standard deviation `NOISE`."""
    if kind == "t3":
        return np.asarray(NOISE * rng.standard_t(3, shape) / np.sqrt(3))
    if kind == "quantised":
        return np.zeros(shape)
    white = NOISE * rng.standard_normal(shape)
    if kind == "ar1":
        for k in range(1, shape[0]):
            white[k] = 0.5 * white[k - 1] + np.sqrt(0.75) * white[k]
    return white


def equivalent(one: str, two: str) -> bool:
    """Decide whether two formulas are the same but for the sizes and names of constants.

    Parameters
    ----------
    one, two : str
        Formulas of the same place.

    Returns
    -------
    bool
    """
    return _terms(one) == _terms(two)


def _terms(text: str) -> frozenset[str]:
    """The terms of a formula, all constants within them called alike and those before them left
    out.
    """
    need("sympy", extra="law", caller="the study of laws")
    import sympy

    names = {"abs": sympy.Abs, "sign": sympy.sign, "max": sympy.Max, "min": sympy.Min}
    names |= {name: sympy.Function(name) for name in ("dahl", "lag", "dead")}
    names |= {name: sympy.Symbol(name, real=True) for name in ("q", "v", "t", "u", "motor", "load")}
    plain = text.replace("v.", "v_").replace("q.", "q_")
    whole = sympy.sympify(plain, locals=names)
    found = set()
    for term in sympy.Add.make_args(whole):
        taken = sympy.Integer(1)
        for factor in sympy.Mul.make_args(term):
            if factor.is_number or _is_constant(str(factor)):
                continue
            taken *= factor
        within = {
            symbol: sympy.Symbol("w") for symbol in taken.free_symbols if _is_constant(symbol.name)
        }
        found.add(
            str(sympy.simplify(taken.xreplace(within)) if not within else taken.xreplace(within))
        )
    return frozenset(found)


def _is_constant(name: str) -> bool:
    """Whether a name is that of a constant: a letter, and perhaps a number."""
    return name[:1] in "cawxT" and (len(name) == 1 or name[1:].isdigit())


def _totals(hidden: list[dict[str, Any]], none: list[dict[str, Any]]) -> Table:
    """How many of each set are right."""
    rows = []
    for name in ("development", "evaluation"):
        own = [one for one in hidden if one["set"] == name and one["nats"] >= COUNTED]
        if own:
            right = sum(one["right"] for one in own)
            among = sum(one["among"] for one in own)
            share = number(float(np.median([one["share"] for one in own])), 3)
            rows.append((name, str(len(own)), str(right), str(among), share))
    false = sum(any(effect == "law" for effect, *_ in one["causes"]) for one in none)
    rows.append(("nothing hidden", str(len(none)), f"{false} laws proposed", "-", "-"))
    header = ("set", "runs", "formula right", "right or among the others", "share of the gain")
    return Table("In all", header, tuple(rows))


def _found(hidden: list[dict[str, Any]]) -> Table:
    """What was said of each."""
    rows = []
    for one in hidden:
        said = "; ".join(
            f"{formula or effect} at {target}" for effect, target, formula in one["causes"]
        )
        rows.append(
            (
                one["name"],
                f"{one['hidden']} at {one['target']}",
                said or "-",
                _how_right(one),
                number(one["nats"], 3),
                number(one["share"], 3),
                one["verdict"],
                f"{one['steps']:,}",
            )
        )
    header = ("law", "hidden", "said", "right", "nats", "share", "verdict", "simulator steps")
    return Table("Hidden laws", header, tuple(rows))


def _how_right(one: dict[str, Any]) -> str:
    """Whether the hidden formula is the one found, or among those that it is confused with."""
    if one["right"]:
        return "yes"
    return "among the others" if one["among"] else "no"


def _silent(none: list[dict[str, Any]]) -> Table:
    """What was said where nothing is hidden."""
    rows = []
    for one in none:
        said = "; ".join(
            f"{formula or effect} at {target}" for effect, target, formula in one["causes"]
        )
        rows.append((one["name"], str(one["seed"]), said or "-", one["verdict"]))
    return Table("Nothing hidden", ("noise", "seed", "said", "verdict"), tuple(rows))
