"""Hides an effect of random kind, place and size in simulated data: is it named? And what is said
where nothing known is hidden?
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import beta

from dropo import Diagnose, Diagnosis
from dropo.core.contracts.effect import EffectInstance, Quantity, StepState
from dropo.core.contracts.problem import Problem
from dropo.core.services.registry import find, names
from dropo.core.services.validation import Array, known, require
from dropo.problems.simulated.robots import MACHINES, Machine, machine, masses
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work

CASES = ("one", "nothing", "white", "outside", "removed", "two", "masses", "three")
"""One effect; none; white noise on the forces; a cause that no effect stands for; the true cause
left out of the search; two effects; one effect beside masses that are off and fitted with it;
three effects.
"""
NAMED = {"one": 1, "two": 2, "masses": 1, "three": 3}  # effects that are to be named
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
"""How many on each arm, and on each machine that walks or hops: there a run of several effects
takes minutes.
"""
ENOUGH = 100.0  # [nats] on data held out that the true effect is worth, from which it counts
# [nats per transition] on data held out by which the true model is better where they tell it from
# what was found
TOLD = 0.01
NOISE = (1e-4, 10**-2.5)  # sd of every sensor, log-uniform
Hidden = list[tuple[EffectInstance, Array]]


def hidden_effects(
    work: Work,
    seeds: int | None = None,
    *,
    machines: Sequence[str] = tuple(MACHINES),
    cases: Sequence[str] = CASES,
) -> Study:
    """How often the hidden effect is named, what else is named, and what is said where it cannot
    be. seeds: runs of each case on each machine; RUNS where None is given.
    """
    require(seeds is None or seeds >= 1, "seeds", "at least 1", seeds, "hidden_effects")
    pairs = [
        (known("machine", m, MACHINES), known("case", case, CASES))
        for m in machines
        for case in cases
    ]
    items = [
        [m, case, seed]
        for m, case in pairs
        for seed in range(RUNS[case][m not in ARMS] if seeds is None else seeds)
    ]
    runs = work.map(run, items)
    groups = [(m, [r for r in runs if r["machine"] == m]) for m in machines] + (
        [("all", runs)] if len(machines) > 1 else []
    )
    rows = [row for name, own in groups for row in _rows(name, own)]
    header = (
        "machine",
        "hidden",
        "runs",
        "as it should be",
        "95 %",
        "in the ambiguity set",
        "another beside it",
        "error of the size",
        "share of the gain",
        "simulator steps",
    )
    wrong = [
        (r["machine"], r["case"], str(r["seed"]), r["hidden"], f"{r['nats']:.0f}", r["said"])
        for r in runs
        if not r["right"]
    ]
    tables = (
        Table("What was said", header, tuple(rows)),
        Table(
            "Other answers", ("machine", "hidden", "seed", "effect", "nats", "said"), tuple(wrong)
        ),
        Table("Taken for", ("effect", "named", "times"), tuple(_confusion(runs))),
    )
    remarks = (
        f"Right: one, two, three, masses: every effect worth {ENOUGH:.0f} nats on the data "
        "held out is named with its place; nothing, "
        "white: no effect is named; outside, removed: said to be unexplained in part or in "
        'whole, or "acts like".',
        f"No stand-in: the runs of removed in which the true model is {TOLD} nats per "
        "transition better on data held out than what was "
        "found. In the others the effects that were left explain these data as well as the "
        "missing one.",
        (
            "Share of the gain: the median of what the causes gain, of what the true model "
            "would, on data held out."
        ),
    )
    return Study(
        "hidden-effects", "Effects hidden in simulated data", tables, remarks, {"runs": runs}
    )


def _rows(name: str, runs: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    out: list[tuple[str, ...]] = []
    groups = [(case, [r for r in runs if r["case"] == case]) for case in CASES]
    alone = [r for r in runs if r["case"] == "removed" and r["short"] > TOLD]
    groups.insert(CASES.index("removed") + 1, ("removed, no stand-in", alone))
    for case, own in groups:
        judged = [r for r in own if r["nats"] >= ENOUGH or case in ("nothing", "white", "outside")]
        if not judged:
            continue
        right = sum(r["right"] for r in judged)
        n = len(judged)
        named = [r for r in judged if case in NAMED]
        among = f"{sum(r['among'] for r in named)}/{len(named)}" if named else "-"
        beside = f"{sum(r['right'] and r['extra'] for r in named)}/{len(named)}" if named else "-"
        errors = [r["error"] for r in named if r["error"] is not None]
        error = f"{np.median(errors):.2%}" if errors else "-"
        low, high = interval(right, n)
        shares = [r["share"] for r in named if r["share"] is not None]
        share = f"{np.median(shares):.1%}" if shares else "-"
        steps = f"{np.median([r['steps'] for r in judged]):,.0f}"
        out.append(
            (
                name,
                case,
                str(n),
                f"{right}/{n}",
                f"{low:.0%}-{high:.0%}",
                among,
                beside,
                error,
                share,
                steps,
            )
        )
    return out


def interval(right: int, n: int) -> tuple[float, float]:
    """The 95 % interval of a share (Clopper and Pearson 1934)."""
    low = float(beta.ppf(0.025, right, n - right + 1)) if right > 0 else 0.0
    return low, float(beta.ppf(0.975, right + 1, n - right)) if right < n else 1.0


def _confusion(runs: Sequence[dict[str, Any]]) -> list[tuple[str, str, str]]:
    judged = [r for r in runs if r["case"] == "one" and r["nats"] >= ENOUGH]
    pairs = Counter((re.split("[:.=]", r["hidden"])[0], r["first"]) for r in judged)
    return [(hidden, first, str(times)) for (hidden, first), times in sorted(pairs.items())]


def run(item: list[Any]) -> dict[str, Any]:
    """One machine with something hidden, its data, and what a diagnosis of them says."""
    name, case, seed = item
    rng = np.random.default_rng([seed, CASES.index(case), list(MACHINES).index(name)])
    robot = machine(name, masses(name) if case == "masses" else ())
    sigma = float(np.exp(rng.uniform(*np.log(NOISE))))
    effects, data, nats = hide_some(robot, case, sigma, rng)
    problem = Problem(name, robot.simulator, data, start_noise=True)
    searched = (
        [e for e in names("effects") if e not in (effects[0][0].effect, "parameter_drift")]
        if case == "removed"
        else None
    )
    found = Diagnose(searched).run(problem, rng=seed)
    best = of_the_truth(problem, effects, found) if case in ("one", "removed") else None
    return {
        "machine": name,
        "case": case,
        "seed": seed,
        "noise": sigma,
        "nats": nats,
        "hidden": ", ".join(_told(*one) for one in effects) or "-",
        **judge(case, effects, found),
        "share": _share(best, found) if best is not None and case == "one" else None,
        "short": best - found.extended.log_likelihood if best is not None else None,
        "verdict": found.verdict,
        "steps": found.simulator_steps,
    }


def judge(case: str, effects: Hidden, found: Diagnosis) -> dict[str, Any]:
    """Whether the right thing was said, and what."""
    named = {(c.effect, c.target) for c in found.causes}
    said = (
        "; ".join(
            f"{'~' if c.acts_like else ''}{c.effect}:{c.target or ''}.{c.variant}"
            for c in found.causes
        )
        + f" ({found.verdict})"
    )
    truth = {place for instance, _ in effects for place in _same(instance)}
    wanted = [_same(instance) for instance, _ in effects]
    among = named | {(e.effect, e.target) for c in found.causes for e in c.confused_with}
    first = next(iter(found.causes), None)
    out = {
        "said": said,
        "first": first.effect if first else "nothing",
        "among": all(same & among for same in wanted),
        "error": None,
    }
    out["extra"] = bool(named - truth)
    if case in ("nothing", "white"):
        out["right"] = not named
    elif case in ("outside", "removed"):
        out["right"] = found.verdict in ("partly", "unexplained")
    else:
        out["right"] = all(same & named for same in wanted)
        out["error"] = _error(effects[0], found)
    return out


def of_the_truth(problem: Problem, effects: Hidden, found: Diagnosis) -> float:
    """The log-likelihood of data held out under the true model, of windows as long as the
    diagnosis's.
    """
    simulator: Any = problem.simulator
    truth = replace(problem, simulator=simulator.with_effects((), effects))
    return Diagnose(length=found.window_steps).baseline(truth)


def _share(best: float, found: Diagnosis) -> float:
    """What the causes gain on data held out, as a share of what the true model does."""
    return found.gain / (best - found.baseline.log_likelihood)


def _same(instance: EffectInstance) -> set[tuple[str, str | None]]:
    """An effect with its place, and what no recorded data can tell from it."""
    return {(instance.effect, instance.target), *((name, None) for name in instance.alike)}


def _error(hidden: tuple[EffectInstance, Array], found: Diagnosis) -> float | None:
    """The relative error of the first size, where the effect is named."""
    instance, sizes = hidden
    cause = next(
        (
            c
            for c in found.causes
            if (c.effect, c.target, c.variant)
            == (instance.effect, instance.target, instance.variant)
        ),
        None,
    )
    return (
        None
        if cause is None
        else float(abs(cause.estimate[instance.quantities[0].name].value / sizes[0] - 1))
    )


def _told(instance: EffectInstance, sizes: Array) -> str:
    return f"{instance.label}={','.join(f'{size:.3g}' for size in sizes)}"


def hide_some(
    robot: Machine, case: str, sigma: float, rng: np.random.Generator
) -> tuple[Hidden, Any, float]:
    """What is hidden, the data, and the fewest nats per effect that it is worth on every other
    trajectory at the true noise.
    """
    values = np.asarray(robot.simulator.nominal) * (
        rng.uniform(0.75, 1.25, len(robot.simulator.space)) if case == "masses" else 1.0
    )
    if case in ("nothing", "white", "outside"):
        there = {"nothing": [], "white": [white_noise(robot)], "outside": [outside(robot, rng)]}[
            case
        ]
        return there, robot.record(there, noise=sigma, rng=rng.spawn(1)[0], values=values), 0.0
    kinds = [
        kind for kind in names("effects") if (case, kind) != ("masses", "body_mass")
    ]  # which are fitted anyway
    for _ in range(50):
        chosen = rng.choice(kinds, NAMED.get(case, 1), replace=False)
        effects = [one for kind in chosen if (one := draw(robot, str(kind), rng)) is not None]
        if len(effects) < len(chosen):
            continue
        data = robot.record(effects, noise=sigma, rng=rng.spawn(1)[0], values=values)
        nats = (
            [worth(robot, one, effects, values, data, sigma) for one in effects]
            if len(data) > 400
            else [0.0]
        )
        if min(nats) >= ENOUGH and all(
            whole(robot, one, effects, values, data, sigma) for one in effects
        ):
            break
    return effects, data, float(min(nats))


def draw(
    robot: Machine, kind: str, rng: np.random.Generator
) -> tuple[EffectInstance, Array] | None:
    """An effect of that kind at a random place, its first size between a tenth and twice its
    largest probe.
    """
    instances = list(find("effects", kind)(robot.simulator.effect_context))
    if not instances:
        return None
    instance = instances[rng.integers(len(instances))]
    sets = instance.trials[rng.integers(len(instance.trials))]
    sizes = np.sum(sets, axis=0)
    first = instance.quantities[0]
    largest = max(np.abs(first.probes)) * np.exp(rng.uniform(np.log(0.1), np.log(2.0)))
    sizes[0] = np.clip(np.sign(sizes[0]) * largest, 0.9 * first.low, 0.9 * first.high)
    return (instance, sizes) if sizes[0] != 0 else None


def worth(
    robot: Machine,
    one: tuple[EffectInstance, Array],
    effects: Hidden,
    values: Array,
    data: Any,
    sigma: float,
) -> float:
    """About how many nats the effect is worth on every other trajectory: half the fall of the
    squared errors of windows of 5 steps, in units of noise that starts and ends have, robustly.
    """
    without = [other for other in effects if other[0].label != one[0].label]
    return difference(robot, effects, without, values, data, sigma)


def whole(
    robot: Machine,
    one: tuple[EffectInstance, Array],
    effects: Hidden,
    values: Array,
    data: Any,
    sigma: float,
) -> bool:
    """Whether each of the effect's numbers shows: without one of them, a wind across an arm's plane
    (say) is another effect.
    """
    instance, sizes = one
    for i in range(len(sizes) if len(sizes) > 1 else 0):
        less = np.where(np.arange(len(sizes)) == i, 0.0, sizes)
        other = [(instance, less) if own is instance else (own, other) for own, other in effects]
        if difference(robot, effects, other, values, data, sigma) < ENOUGH / 10:
            return False
    return True


def difference(
    robot: Machine, effects: Hidden, without: Hidden, values: Array, data: Any, sigma: float
) -> float:
    """About how many nats the effects are better than others on every other trajectory."""
    segments = data.segments(5)
    segments = segments.take(np.flatnonzero(segments.trajectory % 2 == 1))
    ends = [
        robot.simulator.with_effects((), there).predict(values[None], segments)[0]
        for there in (effects, without)
    ]
    moved = np.nan_to_num(ends[0] - ends[1]) / sigma
    grown = (
        np.mean(np.nan_to_num((segments.targets - ends[0]) / sigma) ** 2, axis=0)
        if moved.shape == segments.targets.shape
        else 4.0
    )
    return float(np.sum(np.log1p(np.sum(moved**2 / np.maximum(grown, 1.0), axis=1) / 8)) * 4)


def white_noise(robot: Machine) -> tuple[EffectInstance, Array]:
    """White noise on every force, put in behind the clamp, of a tenth of the largest commands; the
    same whenever it is asked for again.
    """

    def actuation(commands: Array, step: float, sizes: Array) -> Array:
        own = np.random.default_rng(np.frombuffer(commands[0].tobytes(), dtype=np.uint32))
        return np.asarray(commands + sizes[0] * own.standard_normal(commands.shape))

    return EffectInstance(
        "white_noise", None, (Quantity("sd", "command", 0, 1, (0.1,)),), actuation=actuation
    ), np.array([0.1])


def outside(robot: Machine, rng: np.random.Generator) -> tuple[EffectInstance, Array]:
    """A cause that no effect stands for: drag that grows with the speed's square, a spring that
    hardens, or a command that counts more at large angles.
    """
    model = robot.simulator.model
    i = int(rng.integers(model.nu))
    joint = int(model.actuator_trnid[i, 0])
    q = int(model.jnt_qposadr[joint])
    v = int(model.jnt_dofadr[joint])
    full = abs(float(model.actuator_gainprm[i, 0] * model.actuator_gear[i, 0]))
    shape = int(rng.integers(3))

    def force(moment: StepState, sizes: Array) -> Array:
        out = np.zeros_like(moment.qvel)
        angle = moment.qpos[:, q]
        speed = moment.qvel[:, v]
        out[:, v] = (
            -speed * np.abs(speed) / 25,
            -4 * angle**3,
            moment.ctrl[:, i] * np.sin(4 * angle),
        )[shape] * sizes[0]
        return out

    return EffectInstance(
        "outside", str(shape), (Quantity("size", "N m", 0, full, (full,)),), force=force
    ), np.array([0.2 * full])
