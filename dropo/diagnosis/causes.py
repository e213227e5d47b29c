"""What is told of each accepted effect: its size with error, what it gained, what it cannot be told from."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import norm

from dropo.core.dependence import Units
from dropo.core.effect import Atom
from dropo.core.sandwich import sandwich
from dropo.diagnosis.invariance import invariance, standing_out
from dropo.diagnosis.model import Library
from dropo.diagnosis.result import Cause
from dropo.diagnosis.screening import Candidate
from dropo.diagnosis.selection import Selection, State, ambiguity, by_block, gain_of
from dropo.diagnosis.windows import spread_of

LEAST_P = float(np.finfo(float).tiny)


def causes(library: Library, selection: Selection, states: Sequence[State], last: State, count: int) -> tuple[Cause, ...]:
    """The accepted effects of the last state, in the order in which they were found; count: how many effects were looked for."""
    return tuple(_cause(library, selection, states, last, atom, count) for atom in last.accepted)


def _cause(library: Library, selection: Selection, states: Sequence[State], last: State, atom: Atom, count: int) -> Cause:
    before, after = _sides(states, last, atom)
    gain, steps = gain_of(before.test, after.test)[0], after.test.windows.steps
    blocks = by_block(before.test, after.test)
    held = invariance(library, last.test, atom)
    return Cause(
        atom.effect, atom.target, atom.variant, estimate(library, last, atom), p_of(gain, count), gain / steps,
        float(blocks.std(ddof=1) * np.sqrt(len(blocks)) / steps), _rmse(library, before), _rmse(library, after),
        _confused(library, selection, before, atom),
        None if held.constant else held.variable,
    )  # fmt: skip


def _rmse(library: Library, state: State) -> float:
    """The error at the last step of the windows held out, in units of each signal's own spread."""
    seen, p = state.test, len(state.test.whiten.sigma)
    errors = (seen.windows.measured - seen.predicted)[~seen.lost, -p:]
    return float(np.sqrt(np.mean(np.mean(errors**2, axis=0) / spread_of(library.simulator, seen.windows) ** 2)))


def _sides(states: Sequence[State], last: State, atom: Atom) -> tuple[State, State]:
    """The states before and after an effect came; one that stands for several others: before the first of these, and the last."""
    for before, after in pairwise(states):
        if after.accepted[-1].label == atom.label:
            return before, after
    return next(b for b, after in pairwise(states) if after.accepted[-1].effect == atom.effect), last


def p_of(gain: float, count: int, z: float | None = None) -> float:
    """The p-value of the split likelihood-ratio test for all effects tried, and where that says less, of z by blocks."""
    p = min(1.0, count * float(np.exp(-max(gain, 0.0))))
    return max(p, LEAST_P, 0.0 if z is None else float(norm.sf(z)))


def _confused(library: Library, selection: Selection, before: State, atom: Atom) -> tuple[dict[str, Any], ...]:
    """The other effects that the data cannot tell from it, with why, and where in the data the difference is largest."""
    same = [i for i, r in enumerate(selection.rounds) if r and r[0].state.accepted[:-1] == before.accepted]
    trials = [(trial, i) for i in same for trial in selection.rounds[i]]
    winner, i = next(((trial, i) for trial, i in trials if trial.candidate.atom.label == atom.label), (None, 0))
    alias = tuple({"effect": name, "target": None, "why": "the same in any recorded data"} for name in atom.alike)
    if winner is None:
        return alias
    told = []
    for other, why in ambiguity(winner, selection.rounds[i], selection.screened[i]):
        entry = {"effect": other.atom.effect, "target": other.atom.target, "why": why}
        regime = _difference(library, before, winner.candidate, other)
        told.append(entry | ({"to_tell": f"record more {regime}"} if regime else {}))
    return (*told, *alias)


def _difference(library: Library, before: State, one: Candidate, two: Candidate) -> str | None:
    """The regime in which two effects' responses differ most, in words."""
    a, b = one.signature, two.signature
    rest = (a - (a @ b) * b).reshape(len(before.train.windows), -1)
    return standing_out(before.train.windows, library, (rest**2).sum(axis=1))


def estimate(library: Library, last: State, atom: Atom) -> dict[str, dict[str, Any]]:
    """By quantity: what is added, its standard error by the sandwich clustered by block, the model's own number."""
    free, seen = last.free, last.train
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
            "value": float(seen.theta[place]), "se": error if np.isfinite(error) else None, "unit": quantity.unit, "model": quantity.base,
        }  # fmt: skip
    return out


def suspects(selection: Selection, last: State, count: int) -> tuple[dict[str, Any], ...]:
    """Effects of the last round that seemed to help and were not confirmed."""
    taken = {atom.label for atom in last.accepted}
    trials = selection.rounds[-1] if selection.rounds else []
    return tuple(
        {
            "effect": trial.candidate.atom.effect, "target": trial.candidate.atom.target,
            "p_value": p_of(trial.held_out, count, trial.z), "held_out_gain": trial.held_out / last.test.windows.steps,
        }
        for trial in trials if trial.held_out > 0 and trial.candidate.atom.label not in taken
    )  # fmt: skip
