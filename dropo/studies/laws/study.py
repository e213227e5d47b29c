"""Hides laws that no effect of the registry stands for, and sees if their formulas are found.

Also, what is said where nothing is hidden, under four kinds of noise.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dropo import Diagnose, Diagnosis
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.optional_dependencies import need
from dropo.core.services.tables import number
from dropo.core.services.validation import Array, known, require
from dropo.diagnosis.search.library import robot_of
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.studies.laws.cases import DEVELOPMENT, EVALUATION, NULLS, REMOVED, HiddenLaw
from dropo.studies.laws.machines import FINER, MACHINES, LawMachine, law_machine

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
FIRST_SEED = {"development": 0, "evaluation": 87_000, "removed": 88_000, "null": 89_000}
"""Seeds of each set; the search was worked out on seeds below 80,000, and what earlier code made of
those from 81,000 to 86,000 was read before its last rules were made.
"""
STEP = 4.0
"""Step of the quantised sensors, in standard deviations of the others' noise."""


def laws(
    work: Work,
    seeds: int | None = None,
    *,
    problems: Sequence[str] = (),
) -> Study:
    """How often the formula of a hidden law is found, and what is said where none is hidden.

    Parameters
    ----------
    work : Work
        Runs the tasks.
    seeds : int or None
        Runs of each law, and of each kind of noise on each machine; 1 if None.
    problems : sequence of str
        Some of the laws of `EVALUATION`, `REMOVED` and `DEVELOPMENT`, and of the recordings with
        nothing hidden, such as "t3 pendulum"; all but the development ones if empty.

    Returns
    -------
    Study

    Raises
    ------
    BadArgument
        If `seeds` is below 1.
    UnknownName
        If there is no such law or recording.
    """
    require(seeds is None or seeds >= 1, "seeds", "at least 1", seeds, "laws")
    sets = every_item()
    chosen = [known("law", name, sets) for name in problems]
    names = chosen or [name for name in sets if sets[name] != "development"]
    items = [
        [sets[name], name, FIRST_SEED[sets[name]] + seed]
        for name in names
        for seed in range(seeds or 1)
    ]
    runs = work.map(run, items)
    hidden = [one for one in runs if one["set"] != "null"]
    none = [one for one in runs if one["set"] == "null"]
    return Study(
        "laws",
        f"Laws that no effect stands for, hidden in {len(hidden)} recordings; "
        f"{len(none)} with nothing hidden",
        (_totals(hidden, none), _found(hidden), _silent(none)),
        (
            f"Recorded by Runge-Kutta's integrator with physics steps {FINER} times finer than the "
            f"model's. A run counts where the true law gains {COUNTED:g} nats there. The share of "
            "the gain and the steps, in those of a diagnosis that looks for no law, are medians.",
        ),
        {"runs": runs},
    )


def every_item() -> dict[str, str]:
    """List what may be hidden, and the recordings with nothing hidden.

    Returns
    -------
    dict of str to str
        The set that each belongs to, by name.
    """
    found = dict.fromkeys(EVALUATION, "evaluation") | dict.fromkeys(REMOVED, "removed")
    found |= {f"{noise} {machine}": "null" for noise in NULLS for machine in MACHINES}
    return found | dict.fromkeys(DEVELOPMENT, "development")


def run(item: list[Any]) -> dict[str, Any]:
    """Diagnose one recording.

    Parameters
    ----------
    item : list
        The set, the name of the law or recording, the seed.

    Returns
    -------
    dict
        What was hidden, what was said.
    """
    kind, name, seed = item
    rng = np.random.default_rng(seed)
    answer: dict[str, Any] = {"set": kind, "name": name, "seed": seed}
    if kind == "null":
        noise, machine = name.split(" ", 1)
        data = _with_noise(law_machine(machine), noise, rng)
        problem = law_machine(machine).problem(machine, data)
        found = _diagnosis(problem, RIVALS, seed)
        return answer | {"machine": machine} | _said(found)
    law = {**DEVELOPMENT, **EVALUATION, **REMOVED}[name]
    made = law_machine(law.machine)
    hidden = [law.instance(made.robot.simulator)]
    problem = made.problem(law.machine, made.record(hidden, rng, 1.0))
    rivals = [rival for rival in RIVALS if rival != law.effect]
    found = _diagnosis(problem, rivals, seed)
    answer["steps_without"] = _diagnosis(problem, rivals, seed, laws=()).simulator_steps
    answer |= {"machine": law.machine, "hidden": law.formula, "target": law.place} | _said(found)
    without, with_law = _oracle(problem, hidden, found.window_steps)
    before = found.baseline.log_likelihood
    answer["nats"] = (with_law - without) * WINDOWS * found.window_steps
    answer["share"] = (found.extended.log_likelihood - before) / (with_law - before)
    answer["right"] = any(_is_right(cause, law) for cause in answer["causes"])
    others = [
        [other.effect, other.target, other.formula]
        for cause in found.causes
        for other in cause.confused_with
    ]
    answer["among"] = answer["right"] or any(_is_right(other, law) for other in others)
    answer["false"] = sum(not _is_right(cause, law) for cause in answer["causes"])
    return answer


def _diagnosis(
    problem: Problem, rivals: Sequence[str], seed: int, laws: Sequence[str] = ("law",)
) -> Diagnosis:
    """What is said of a recording, of the effects of joints and drives and of laws."""
    return Diagnose([*rivals, *laws], windows=WINDOWS).run(problem, rng=seed)


def _said(found: Diagnosis) -> dict[str, Any]:
    """The causes, whether they are stated as such, and what it took."""
    return {
        "verdict": found.verdict,
        "causes": [[one.effect, one.target, one.formula] for one in found.causes],
        "stated": len(found.stated),
        "steps": found.simulator_steps,
    }


def _is_right(cause: Sequence[Any], law: HiddenLaw) -> bool:
    """Whether an effect, a place and a formula are the hidden law."""
    effect, target, formula = cause
    return effect == "law" and target == law.place and equivalent(formula, law.formula)


def _oracle(problem: Problem, hidden: list[Any], length: int) -> tuple[float, float]:
    """The log-likelihoods of the machine itself without and with its law, on data held out [nats
    per transition].
    """
    finer = robot_of(problem).with_integrator("RK4").with_finer_steps(FINER)
    models = [finer, finer.with_effects((), hidden)]
    search = Diagnose(length=length, windows=WINDOWS)
    without, with_law = (search.baseline(replace(problem, simulator=one)) for one in models)
    return without, with_law


def _with_noise(machine: LawMachine, kind: str, rng: np.random.Generator) -> Trajectories:
    """A recording with nothing hidden, with noise of a kind on every measurement."""
    data = machine.record([], rng, 1e-9)
    observations = data.observations.copy()
    after = data.next_observations.copy()
    for first, last in data.spans:
        whole = np.concatenate([observations[first:last], after[last - 1 : last]])
        whole = whole + machine.noise * _noise(kind, whole.shape, rng)
        if kind == "quantised":
            tick = STEP * machine.noise
            whole = np.round(whole / tick) * tick
        observations[first:last] = whole[:-1]
        after[first:last] = whole[1:]
    return replace(data, observations=observations, next_observations=after)


def _noise(kind: str, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Noise (k, p) of a kind, of standard deviation 1."""
    if kind == "t3":
        return np.asarray(rng.standard_t(3, shape) / np.sqrt(3))
    if kind == "quantised":
        return np.zeros(shape)
    white = rng.standard_normal(shape)
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
    return name[:1] in "cakwxT" and (len(name) == 1 or name[1:].isdigit())


def _totals(hidden: list[dict[str, Any]], none: list[dict[str, Any]]) -> Table:
    """How many of each set are right, and what is stated as a cause without being one."""
    rows = []
    for name in ("development", "evaluation", "removed"):
        own = [one for one in hidden if one["set"] == name]
        if not own:
            continue
        counted = [one for one in own if one["nats"] >= COUNTED]
        shares = [one["share"] for one in counted]
        right = sum(one["right"] for one in counted)
        among = sum(one["among"] for one in counted)
        share = number(float(np.median(shares)), 3) if shares else "-"
        times = [one["steps"] / one["steps_without"] for one in counted]
        cost = number(float(np.median(times)), 2) if times else "-"
        whole = (str(len(counted)), str(right), str(among), share, cost)
        rows.append((name, str(len(own)), *whole, *_stated_in(own)))
    proposed = sum(any(effect == "law" for effect, *_ in one["causes"]) for one in none)
    silent = ("-", f"{proposed} laws proposed", "-", "-", "-")
    rows.append(("nothing hidden", str(len(none)), *silent, *_stated_in(none)))
    header = (
        "set",
        "runs",
        f"of {COUNTED:g} nats",
        "formula right",
        "or among the others",
        "share of the gain",
        "times the steps",
        "causes stated",
        "of these false",
    )
    return Table("In all", header, tuple(rows))


def _stated_in(runs: list[dict[str, Any]]) -> tuple[str, str]:
    """How many causes are stated, and how many of these are not what is hidden."""
    stated = [one for one in runs if one["stated"]]
    false = sum(one.get("false", len(one["causes"])) for one in stated)
    return str(sum(one["stated"] for one in stated)), str(false)


def _found(hidden: list[dict[str, Any]]) -> Table:
    """What was said of each."""
    rows = []
    for one in hidden:
        rows.append(
            (
                one["name"],
                one["machine"],
                f"{one['hidden']} at {one['target']}",
                _in_words(one),
                _how_right(one),
                number(one["nats"], 3),
                number(one["share"], 3),
                one["verdict"],
                f"{one['steps']:,}",
                number(one["steps"] / one["steps_without"], 2),
            )
        )
    header = (
        "law",
        "machine",
        "hidden",
        "said",
        "right",
        "nats",
        "share",
        "verdict",
        "simulator steps",
        "times those without",
    )
    return Table("Hidden laws", header, tuple(rows))


def _in_words(one: dict[str, Any]) -> str:
    """The causes, each with its place."""
    said = [f"{formula or effect} at {target}" for effect, target, formula in one["causes"]]
    return "; ".join(said) or "-"


def _how_right(one: dict[str, Any]) -> str:
    """Whether the hidden formula is the one found, or among those that it is confused with."""
    if one["right"]:
        return "yes"
    return "among the others" if one["among"] else "no"


def _silent(none: list[dict[str, Any]]) -> Table:
    """What was said where nothing is hidden."""
    rows = [(one["name"], str(one["seed"]), _in_words(one), one["verdict"]) for one in none]
    return Table("Nothing hidden", ("noise and machine", "seed", "said", "verdict"), tuple(rows))
