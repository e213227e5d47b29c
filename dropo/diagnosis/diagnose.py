"""Data and a model in; what the model gets wrong, named, out."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from dropo.core.checks import Array
from dropo.core.dependence import Units
from dropo.core.problem import Problem
from dropo.core.sandwich import sandwich
from dropo.diagnosis.horizons import Horizon, horizon
from dropo.diagnosis.invariance import invariance
from dropo.diagnosis.library import atoms_for
from dropo.diagnosis.model import Library
from dropo.diagnosis.omnibus import omnibus
from dropo.diagnosis.result import Cause, Diagnosis
from dropo.diagnosis.selection import Selection, State, Trial, ambiguity, by_block, gain_of
from dropo.diagnosis.unexplained import Unexplained, impulses, unexplained_force
from dropo.diagnosis.windows import split

SURPRISE = 3.5  # times the stated noise, as a standard deviation, from which learned noise stands for something else
LEAST = 1e-5  # of a signal's spread: the least noise
HORIZONS = (1, 5, 20)


@dataclass(frozen=True)
class Diagnose:
    """Settings of a diagnosis. effects: names, or "effect:place"; None for all. length: steps in a window; windows: about how many
    to fit and how many held out."""

    effects: Sequence[str] | None = None
    length: int = 5
    windows: int = 96

    def run(
        self, problem: Problem, *, rng: np.random.Generator | int | None = 0, progress: Callable[[float, str], None] = lambda s, t: None
    ) -> Diagnosis:
        """What the problem's simulator gets wrong, judged on data that nothing was fitted to."""
        begun, generator = time.perf_counter(), np.random.default_rng(rng)
        atoms = atoms_for(problem, self.effects)
        simulator: Any = problem.simulator
        hidden = impulses(simulator.model, self.length, simulator.frame_skip)
        library = Library(simulator.with_effects([*atoms, *hidden]), [*atoms, *hidden], len(problem.space))
        train, test = split(problem, self.length, self.windows)
        spread = simulator.targets(train.segments).std(axis=0)
        floor = np.maximum(LEAST * spread, 1e-12)
        selection = Selection(library, floor, progress)
        nominal = np.concatenate([simulator.nominal, np.zeros(len(library.simulator.space) - len(problem.space))])
        start = np.clip(nominal, library.simulator.space.low, library.simulator.space.high)
        first = selection.begin(train, test, start, _first_noise(problem, library, train, start, floor), np.arange(len(problem.space)))
        states = selection.run(first, atoms)
        last = selection.backward(states[-1])
        force, rest = unexplained_force(library, last.train, last.test, floor, gain_of), omnibus(last.train, last.test, generator)
        surprise = _surprise(problem, last)
        wrong = force.present or rest.present or bool(surprise)
        causes = tuple(_cause(library, selection, states, last, i, len(atoms)) for i in range(len(last.accepted)))
        wrong = wrong or any(cause.acts_like for cause in causes)
        verdict = ("partly" if wrong else "explained") if causes else ("unexplained" if wrong else "consistent")
        where = _where(library, force, rest.signals if rest.present else (), surprise) if wrong else []
        remaining = {"calibrated": not wrong, "p_value": _p_value(max(force.z if force.present else 0.0, rest.z)), "where": where}
        before, after = _horizons(problem, library, (first, last))
        fixed = [(atom, last.theta[library.places[atom.label]]) for atom in last.accepted]
        seed = int(rng) if isinstance(rng, int | np.integer) else None
        return Diagnosis(
            problem.name, verdict, causes, _suspects(selection, last), _per_step(first), _per_step(last), before, after, remaining,
            replace(problem, simulator=simulator.with_effects((), fixed)),
            dict(zip([s.name for s in simulator.signals], last.train.whiten.sigma.tolist(), strict=True)),
            time.perf_counter() - begun, seed, library.simulator.steps, problem.warnings,
        )  # fmt: skip


def diagnose(problem: Problem, effects: Sequence[str] | None = None, *, rng: np.random.Generator | int | None = 0) -> Diagnosis:
    """Shows what the simulation gets wrong, names the cause, extends the model and measures the gain."""
    return Diagnose(effects).run(problem, rng=rng)


def _first_noise(problem: Problem, library: Library, train: Any, theta: Array, floor: Array) -> Array:
    """(p,) the stated noise, else the spread of most one-step residuals."""
    if problem.epsilon is not None:
        return np.maximum(np.sqrt(np.broadcast_to(np.asarray(problem.epsilon, dtype=float), floor.shape)), floor)
    residuals = (train.measured - library.predict(theta[None], train)[0])[:, : len(floor)]
    return np.maximum(1.4826 * np.nanmedian(np.abs(residuals), axis=0) / np.sqrt(2), floor)


def _per_step(state: State) -> float:
    return float(state.test.log_likelihood.sum() / state.test.windows.steps)


def _horizons(problem: Problem, library: Library, states: Sequence[State]) -> tuple[list[Horizon], ...]:
    longest = min(int(np.diff(span)[0]) for span in problem.trajectories.spans)
    out: tuple[list[Horizon], ...] = tuple([] for _ in states)
    for steps in HORIZONS:
        if steps <= max(longest, 5):
            test = split(problem, steps, 48)[1]
            for found, state in zip(out, states, strict=True):
                found.append(horizon(library, test, state.theta, states[-1].train.whiten.sigma))
    return out


def _cause(library: Library, selection: Selection, states: Sequence[State], last: State, i: int, count: int) -> Cause:
    atom = last.accepted[i]
    before = next(s for s, after in pairwise(states) if after.accepted[-1].label == atom.label)
    after = states[states.index(before) + 1]
    gain = gain_of(before.test, after.test)[0]
    steps = after.test.windows.steps
    error = float(by_block(before.test, after.test).std(ddof=1) * np.sqrt(len(np.unique(after.test.windows.block))) / steps)
    rounds = [r for r in selection.rounds if r and r[0].state.accepted[:-1] == before.accepted]
    trials = next(r for r in rounds if any(t.candidate.atom.label == atom.label for t in r))
    winner = next(t for t in trials if t.candidate.atom.label == atom.label)
    held = invariance(library, last.test, atom)
    rmse = [float(np.sqrt(np.median(s.test.residuals[:, -len(s.test.whiten.sigma) :] ** 2))) for s in (before, after)]
    p_value = float(min(1.0, count * np.exp(-max(gain, 0.0))))  # of the split likelihood-ratio test, for all effects tried
    return Cause(
        atom.effect, atom.target, atom.variant, _estimate(library, last, i), p_value, gain / steps, error, rmse[0], rmse[1],
        _confused(winner, trials), None if held.constant else held.variable,
    )  # fmt: skip


def _confused(winner: Trial, trials: Sequence[Trial]) -> tuple[dict[str, Any], ...]:
    told = [{"effect": atom.effect, "target": atom.target, "why": why} for atom, why in ambiguity(winner, trials)]
    alias = [{"effect": name, "target": None, "why": "the same in any recorded data"} for name in winner.candidate.atom.alike]
    return (*told, *alias)


def _estimate(library: Library, last: State, i: int) -> dict[str, dict[str, Any]]:
    """By quantity of the i-th cause: what is added, its standard error by the sandwich clustered by block, the model's own number."""
    atom, free = last.accepted[i], last.free
    seen = last.train
    slopes = seen.flat(library.slopes(seen.theta, free, seen.windows)).reshape(len(free), len(seen.windows), -1)
    rest = seen.flat(seen.residuals).reshape(len(seen.windows), -1)
    scores, information = np.einsum("fwn,wn->wf", slopes, rest), np.einsum("fwn,gwn->fg", slopes, slopes)
    block = np.unique(seen.windows.block, return_inverse=True)[1]
    units = Units(block, False, np.argsort(block, kind="stable"), "blocks")
    errors = np.sqrt(np.diagonal(sandwich(scores, information, units)[0]))
    out = {}
    for place, quantity in zip(library.places[atom.label], atom.quantities, strict=True):
        error = float(errors[int(np.flatnonzero(free == place)[0])])
        out[quantity.name] = {
            "value": float(seen.theta[place]),
            "se": error if np.isfinite(error) else None,
            "unit": quantity.unit,
            "model": quantity.base,
        }
    return out


def _surprise(problem: Problem, state: State) -> list[str]:
    """Signals whose learned noise is far beyond what the problem states."""
    if problem.epsilon is None:
        return []
    stated = np.sqrt(np.broadcast_to(np.asarray(problem.epsilon, dtype=float), state.train.whiten.sigma.shape))
    ratio = state.train.whiten.sigma / np.maximum(stated, 1e-300)
    return [signal.name for signal, r in zip(problem.simulator.signals, ratio, strict=True) if r > SURPRISE]


def _where(library: Library, force: Unexplained, signals: Sequence[float], surprise: Sequence[str]) -> list[str]:
    """In which joints and signals something remains."""
    out = [f"noise of {name} beyond what was stated" for name in surprise]
    if force.present:
        dof = int(np.argmax(force.sd))
        out.append(f"forces of {force.sd[dof]:.3g} that nothing explains at degree of freedom {dof}")
    if signals:
        worst = int(np.argmax(signals))
        out.append(f"{library.simulator.signals[worst].name}, which state and command predict")
    return out


def _suspects(selection: Selection, last: State) -> tuple[dict[str, Any], ...]:
    """Effects of the last round that seemed to help and were not confirmed."""
    taken = {atom.label for atom in last.accepted}
    rest = [t for t in (selection.rounds[-1] if selection.rounds else []) if t.held_out > 0 and t.candidate.atom.label not in taken]
    steps = last.test.windows.steps
    return tuple(
        {
            "effect": t.candidate.atom.effect,
            "target": t.candidate.atom.target,
            "p_value": _p_value(t.z),
            "held_out_gain": t.held_out / steps,
        }
        for t in rest
    )


def _p_value(z: float) -> float:
    from scipy.stats import norm

    return float(norm.sf(z))
