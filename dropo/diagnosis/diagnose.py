"""Data and a model in; what the model gets wrong, named, out."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.checks import Array, require
from dropo.core.errors import BadArgument
from dropo.core.problem import Problem
from dropo.diagnosis.causes import causes, suspects
from dropo.diagnosis.horizons import horizons
from dropo.diagnosis.library import atoms_for
from dropo.diagnosis.model import Library
from dropo.diagnosis.remaining import remaining
from dropo.diagnosis.result import Diagnosis
from dropo.diagnosis.selection import Progress, Selection, State
from dropo.diagnosis.unexplained import impulses
from dropo.diagnosis.windows import Windows, split, spread_of

LEAST = 1e-5  # of a signal's spread: the least noise


def silent(share: float, text: str) -> None:
    """Shows no progress."""


@dataclass(frozen=True)
class Diagnose:
    """Settings of a diagnosis. effects: names, or "effect:place"; None for all. length: steps in a window; windows: about how many
    to fit and how many held out."""

    effects: Sequence[str] | None = None
    length: int = 5
    windows: int = 96

    def run(self, problem: Problem, *, rng: np.random.Generator | int | None = 0, progress: Progress = silent) -> Diagnosis:
        """What the problem's simulator gets wrong, judged on data that nothing was fitted to."""
        require(self.length >= 1, "length", "at least 1", self.length, "Diagnose")
        begun, generator = time.perf_counter(), np.random.default_rng(rng)
        atoms = atoms_for(problem, self.effects)
        simulator: Any = problem.simulator
        hidden = impulses(simulator.model, self.length, simulator.frame_skip)
        library = Library(simulator.with_effects([*atoms, *hidden]), [*atoms, *hidden], len(problem.space))
        train, test = split(problem, self.length, self.windows)
        _refuse_constant(problem, train)
        selection = Selection(library, np.maximum(LEAST * spread_of(simulator, train), 1e-12), progress)
        progress(0.0, "fitting the model as it is")
        states, last = _search(problem, library, selection, train, test)
        progress(0.9, "what remains")
        rest = remaining(problem, library, last, selection.floor, generator)
        found = causes(library, selection, states, last, len(atoms))
        before, after = horizons(problem, library, states[0], last)
        fixed = [(atom, last.theta[library.places[atom.label]]) for atom in last.accepted]
        return Diagnosis(
            problem.name, _verdict(bool(found), rest.wrong or any(cause.acts_like for cause in found)), found,
            suspects(selection, last, len(atoms)), per_step(states[0]), per_step(last), before, after, rest.to_json(),
            replace(problem, simulator=simulator.with_effects((), fixed)),
            dict(zip([s.name for s in simulator.signals], last.train.whiten.sigma.tolist(), strict=True)),
            time.perf_counter() - begun, int(rng) if isinstance(rng, int | np.integer) else None, library.simulator.steps,
            problem.warnings,
        )  # fmt: skip


def diagnose(problem: Problem, effects: Sequence[str] | None = None, *, rng: np.random.Generator | int | None = 0) -> Diagnosis:
    """Shows what the simulation gets wrong, names the cause, extends the model and measures the gain."""
    return Diagnose(effects).run(problem, rng=rng)


def per_step(state: State) -> float:
    """Log-likelihood of the windows held out [nats per transition]."""
    return float(state.test.log_likelihood.sum() / state.test.windows.steps)


def _search(problem: Problem, library: Library, selection: Selection, train: Windows, test: Windows) -> tuple[list[State], State]:
    """The states from the model as it is on, and the last after what has become unnecessary was taken out."""
    nominal = np.concatenate([problem.simulator.nominal, np.zeros(len(library.simulator.space) - len(problem.space))])
    start = np.clip(nominal, library.simulator.space.low, library.simulator.space.high)
    first = selection.begin(
        train, test, start, _first_noise(problem, library, train, start, selection.floor), np.arange(len(problem.space))
    )
    atoms = [atom for atom in library.atoms if atom.effect != "unexplained_force"]
    states = selection.run(first, atoms)
    return states, selection.together(selection.backward(states[-1]), atoms)


def _first_noise(problem: Problem, library: Library, train: Windows, theta: Array, floor: Array) -> Array:
    """(p,) the stated noise, else the spread of most one-step residuals."""
    if problem.epsilon is not None:
        return np.maximum(np.sqrt(np.broadcast_to(np.asarray(problem.epsilon, dtype=float), floor.shape)), floor)
    residuals = (train.measured - library.predict(theta[None], train)[0])[:, : len(floor)]
    found = residuals[np.isfinite(residuals).all(axis=1)]
    return np.maximum(1.4826 * np.median(np.abs(found), axis=0) / np.sqrt(2), floor) if len(found) else floor


def _refuse_constant(problem: Problem, train: Windows) -> None:
    """Signals that never change say nothing of a model, and have no scale to judge errors on."""
    still = [s.name for s, spread in zip(problem.simulator.signals, spread_of(problem.simulator, train), strict=True) if not spread > 0]
    if still:
        raise BadArgument(f"The signal {still[0]!r} is the same in all the data: a stuck sensor? Leave it out of the observation.")


def _verdict(found: bool, wrong: bool) -> str:
    if found:
        return "partly" if wrong else "explained"
    return "unexplained" if wrong else "consistent"
