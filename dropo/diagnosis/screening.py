"""Which effects the residuals look like: a score test at finite probes, with what is fitted anyway projected out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.checks import Array
from dropo.core.effect import Atom
from dropo.diagnosis.model import Library, Look

BATCH = 64  # probes simulated at once
FINALISTS, THIRD = 24, 12  # atoms that are looked at on all windows; the least number of windows for a first choice


@dataclass(frozen=True, eq=False)
class Candidate:
    """An atom with the sizes (q,) that the residuals suggest, and what the score test promises.

    gain: [nats] of the windows' log-likelihood; z: of the score, windows taken as independent; signature: the whitened,
    weighted response (W (n + m),), of length 1.
    """

    atom: Atom
    sizes: Array
    gain: float
    z: float
    signature: Array


def screen(library: Library, seen: Look, free: np.ndarray, atoms: Sequence[Atom]) -> list[Candidate]:
    """The atoms by what they promise, most first: all of them on a third of the windows, the best of these on all windows.

    free: the numbers of theta that are fitted with any of them.
    """
    if len(atoms) > FINALISTS and len(seen.windows) >= 3 * THIRD:
        first = score(library, seen.take(np.arange(0, len(seen.windows), 3)), free, atoms)
        atoms = [candidate.atom for candidate in first[:FINALISTS]]
    return score(library, seen, free, atoms)


def score(library: Library, seen: Look, free: np.ndarray, atoms: Sequence[Atom]) -> list[Candidate]:
    """The atoms that the windows answer to, by what the score test promises, most first."""
    basis = np.linalg.qr(seen.flat(library.slopes(seen.theta, free, seen.windows)).T)[0] if len(free) else None
    target = _rest(seen.flat(seen.residuals), basis)
    size = float(target @ target) / seen.residuals[~seen.lost].size
    sets = [(atom, np.array(trial)) for atom in atoms for trial in atom.trials]
    base = library.predict(seen.theta[None], seen.windows)[0]
    best: dict[str, Candidate] = {}
    for first in range(0, len(sets), BATCH):
        part = sets[first : first + BATCH]
        responses = _rest(seen.flat(np.nan_to_num(_responses(library, seen, part) - base)), basis)
        ends = np.cumsum([len(trial) for _, trial in part])
        for (atom, trial), response in zip(part, np.split(responses, ends[:-1]), strict=True):
            found = _score(library, seen, atom, trial, response, target, size)
            if found is not None and (atom.label not in best or found.gain > best[atom.label].gain):
                best[atom.label] = found
    return sorted(best.values(), key=lambda candidate: -candidate.gain)


def _rest(rows: Array, basis: Array | None) -> Array:
    """Rows (..., N) without what an orthonormal basis (N, f) explains."""
    return rows if basis is None else rows - (rows @ basis) @ basis.T


def _responses(library: Library, seen: Look, sets: Sequence[tuple[Atom, Array]]) -> Array:
    """Predictions under every trial of the sets (sum of trials, W, n)."""
    rows = []
    for atom, trials in sets:
        for trial in trials:
            theta = seen.theta.copy()
            theta[library.places[atom.label]] += trial
            rows.append(theta)
    return library.predict(np.clip(rows, library.simulator.space.low, library.simulator.space.high), seen.windows)


def _score(library: Library, seen: Look, atom: Atom, trials: Array, responses: Array, target: Array, size: float) -> Candidate | None:
    """The score test along the trials' responses (t, ...); None where they answer nothing, or point out of bounds."""
    lengths = np.linalg.norm(responses, axis=1)
    if not np.all(lengths > 1e-9 * np.sqrt(size * len(target))):
        return None
    share = np.linalg.lstsq(responses.T, target, rcond=1e-8)[0]
    place, space = library.places[atom.label], library.simulator.space
    wanted = seen.theta[place] + share @ trials
    sizes = np.clip(wanted, space.low[place], space.high[place])
    if np.allclose(sizes, seen.theta[place], atol=1e-12):
        return None
    fitted = share @ responses
    each = (fitted * target).reshape(len(seen.windows), -1).sum(axis=1)
    z = float(each.sum() / np.sqrt((each**2).sum())) if np.any(each) else 0.0
    return Candidate(atom, sizes, float(fitted @ target) / (2 * size), z, fitted / np.linalg.norm(fitted))


def shortlist(candidates: Sequence[Candidate], most: int, each: int = 2, least: float = 3.0) -> list[Candidate]:
    """The first few that promise at least so many nats, no more than `each` of one effect."""
    chosen: list[Candidate] = []
    for candidate in candidates:
        same = sum(other.atom.effect == candidate.atom.effect for other in chosen)
        if candidate.gain > least and same < each and len(chosen) < most:
            chosen.append(candidate)
    return chosen
