"""Which effects are accepted: refitted on the windows to fit, confirmed on the windows held out, one after another."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.checks import Array
from dropo.core.data import Ints
from dropo.core.effect import Atom
from dropo.core.errors import SimulationFailed
from dropo.diagnosis.model import Library, Look, look, moved
from dropo.diagnosis.refit import refit, settle, with_noise
from dropo.diagnosis.screening import Candidate, Screening, shortlist
from dropo.diagnosis.windows import Windows

FALSE_ALARM = 0.01  # of the split likelihood-ratio test: gain > log(atoms / FALSE_ALARM) (Wasserman, Ramdas, Balakrishnan 2020)
CERTAIN, SPREAD, TRAINED = 3.0, 1.5, 5.0  # standard errors of the held-out gain by window and by block; nats on the windows to fit
NEGLIGIBLE = 0.01  # of what earlier effects gained together: a later one must bring more
TRIED, MOST = 6, 4  # candidates refitted in a round; effects accepted in all
UNTOLD, DEFICIT = 2.0, 4.0  # a candidate within so many standard errors, or nats, of the winner cannot be told from it
DIVERGES = 0.3  # share of the windows beyond which a diverging simulation is refused
ALIKE = 0.98  # cosine of the angle between whitened responses, beyond which two effects cannot be told apart

Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class State:
    """Where the model stands: the windows to fit and those held out as it explains them, and what has been accepted."""

    train: Look
    test: Look
    free: np.ndarray
    accepted: tuple[Atom, ...] = ()

    @property
    def theta(self) -> Array:
        """(m,) the declared parameters, then all sizes."""
        return self.train.theta


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate refitted: the state with it, and what it gains on windows to fit and on windows held out, with the latter's z."""

    candidate: Candidate
    state: State
    trained: float
    held_out: float
    z: float

    @property
    def worth(self) -> float:
        """[nats] gained in all, less what each number beyond the first gains by chance (Schwarz 1978)."""
        return self.trained + self.held_out - 0.5 * (len(self.candidate.sizes) - 1) * np.log(self.state.train.windows.steps)


@dataclass(eq=False)
class Selection:
    """The search. floor: (p,) the least noise; progress(share, text)."""

    library: Library
    floor: Array
    progress: Progress = lambda share, text: None
    rounds: list[list[Trial]] = field(default_factory=list)
    screened: list[list[Candidate]] = field(default_factory=list)
    screening: Screening = field(init=False)

    def __post_init__(self) -> None:
        self.screening = Screening(self.library)

    def begin(self, train: Windows, test: Windows, theta: Array, sigma: Array, free: np.ndarray) -> State:
        """The model as it is, with its declared parameters and the noise fitted."""
        first = look(self.library, train, theta, sigma)
        if first.lost.mean() > DIVERGES:
            raise SimulationFailed(
                f"The simulation diverges in {first.lost.mean():.0%} of the windows, with the parameters at their nominal values. Check"
                " the model, the time step and the units of the data."
            )
        fitted = refit(self.library, with_noise(self.library, first, self.floor), free, self.floor, rounds=2, renewals=1)
        return State(fitted, self._held_out(fitted, test), free)

    def run(self, state: State, atoms: Sequence[Atom]) -> list[State]:
        """The states, from the model as it is to the last that an accepted effect improved."""
        states = [state]
        while len(states[-1].accepted) < MOST:
            found = self.step(states[-1], atoms, states[0])
            if found is None:
                break
            states.append(found)
        return states

    def step(self, state: State, atoms: Sequence[Atom], first: State) -> State | None:
        """The state with one more effect; None where none is confirmed."""
        taken = {atom.label for atom in state.accepted}
        rest = [atom for atom in atoms if atom.label not in taken]
        done = len(state.accepted)
        self.progress(done / MOST, f"screening {len(rest)} effects")
        self.screened.append(self.screening(state.train, state.free, rest))
        listed = shortlist(self.screened[-1], TRIED, TRAINED)
        known = self.library.slopes(state.theta, state.free, state.train.windows) if len(state.free) and listed else None
        trials = []
        for i, candidate in enumerate(listed):
            self.progress((done + (1 + i) / (1 + len(listed))) / MOST, f"fitting {candidate.atom.label}")
            trials.append(self._try(state, candidate, known))
        self.rounds.append(sorted(trials, key=lambda trial: -trial.worth))
        least = np.log(len(atoms) / FALSE_ALARM)
        gained = float((state.test.log_likelihood - first.test.log_likelihood).sum()) if done else 0.0
        least = max(least, NEGLIGIBLE * gained)
        for trial in self.rounds[-1]:
            if trial.trained > TRAINED and confirmed(state.test, trial.state.test, least):
                polished = self.polish(trial.state)
                if confirmed(state.test, polished.test, least):
                    return polished
        return None

    def polish(self, state: State) -> State:
        """The same effects with everything fitted to the end."""
        rough = rough_numbers(self.library, state.accepted)
        fitted = refit(self.library, state.train, state.free, self.floor, rough=rough)
        return replace(state, train=fitted, test=self._held_out(fitted, state.test.windows))

    def backward(self, state: State) -> State:
        """The state without the effects that the later ones made unnecessary: those whose absence costs nothing on data held out."""
        for atom in state.accepted[:-1]:
            fewer = self.without(state, atom)
            if gain_of(fewer.test, state.test)[0] < DEFICIT:
                return self.backward(fewer)
        return state

    def together(self, state: State, atoms: Sequence[Atom]) -> State:
        """The state with one effect that acts everywhere alike in the place of several of its kind, where it needs fewer numbers for as
        much (Schwarz 1978)."""
        for whole in (atom for atom in atoms if atom.target is None and len(atom.quantities) == 1):
            single = [atom for atom in state.accepted if (atom.effect, atom.target is None) == (whole.effect, False)]
            if len(single) < 2 or whole in state.accepted:
                continue
            theta, places = state.theta.copy(), self.library.places
            theta[places[whole.label]] = np.mean([theta[places[atom.label][0]] for atom in single])
            gone = np.concatenate([places[atom.label] for atom in single])
            theta[gone] = 0.0
            free = np.append(np.setdiff1d(state.free, gone), places[whole.label])
            begun = moved(self.library, state.train, theta, state.train.whiten.sigma)
            kept = tuple(atom for atom in state.accepted if atom not in single)
            fewer = self.polish(State(begun, state.test, free, (*kept, whole)))
            if -gain_of(state.train, fewer.train)[0] < 0.5 * (len(gone) - 1) * np.log(state.train.windows.steps):
                return fewer
        return state

    def without(self, state: State, atom: Atom) -> State:
        """The state with one accepted effect taken out and the rest fitted again."""
        theta, place = state.theta.copy(), self.library.places[atom.label]
        theta[place] = 0.0
        left = tuple(other for other in state.accepted if other.label != atom.label)
        free = np.setdiff1d(state.free, place)
        begun = moved(self.library, state.train, theta, state.train.whiten.sigma)
        return self.polish(State(begun, state.test, free, left))

    def _try(self, state: State, candidate: Candidate, known: Array | None) -> Trial:
        theta, place = state.theta.copy(), self.library.places[candidate.atom.label]
        theta[place] = candidate.sizes
        free = np.concatenate([state.free, place]).astype(np.int64)
        rough = rough_numbers(self.library, (candidate.atom,))
        begun = moved(self.library, state.train, theta, state.train.whiten.sigma)
        fitted = settle(self.library, begun, free, self.floor, rough=rough, known=known)
        held_out = moved(self.library, state.test, fitted.theta, fitted.whiten.sigma)
        new = State(fitted, held_out, free, (*state.accepted, candidate.atom))
        gain, z = gain_of(state.test, new.test)
        return Trial(candidate, new, float((fitted.log_likelihood - state.train.log_likelihood).sum()), gain, z)

    def _held_out(self, fitted: Look, test: Windows) -> Look:
        return look(self.library, test, fitted.theta, fitted.whiten.sigma)


def rough_numbers(library: Library, atoms: Sequence[Atom]) -> Ints:
    """The numbers of theta in which predictions are not smooth."""
    found = [library.places[a.label][i] for a in atoms for i, q in enumerate(a.quantities) if not q.smooth]
    return np.array(found, dtype=np.int64)


def by_block(before: Look, after: Look) -> Array:
    """(B,) nats gained in each block of the windows."""
    gain, block = after.log_likelihood - before.log_likelihood, before.windows.block
    return np.asarray(np.bincount(np.unique(block, return_inverse=True)[1], gain), dtype=float)


def confirmed(before: Look, after: Look, least: float) -> bool:
    """Whether windows held out gain at least so many nats, and not a few of them or a single block alone."""
    gain, z = gain_of(before, after)
    windows = after.log_likelihood - before.log_likelihood
    return gain > least and z > SPREAD and float(windows.sum()) > CERTAIN * float(windows.std(ddof=1)) * np.sqrt(len(windows))


def gain_of(before: Look, after: Look) -> tuple[float, float]:
    """Nats gained on the windows, and how many of its standard errors by block that is."""
    blocks = by_block(before, after)
    error = blocks.std(ddof=1) * np.sqrt(len(blocks)) if len(blocks) > 1 else np.inf
    return float(blocks.sum()), float(blocks.sum() / error) if error > 0 else 0.0


def ambiguity(winner: Trial, trials: Sequence[Trial], screened: Sequence[Candidate]) -> list[tuple[Candidate, str]]:
    """The other effects that the data cannot tell from the winner, each with why: those that were refitted, and those that move the
    predictions in the same way. Not that it sets in at a moment, which may be the data's beginning."""
    own = winner.candidate
    found: dict[str, tuple[Candidate, str]] = {}
    for candidate in screened:
        same = abs(float(candidate.signature @ own.signature))
        if same > ALIKE:
            found[candidate.atom.label] = candidate, f"similarity {same:.3f}"
    for other in trials:
        deficit, z = gain_of(other.state.test, winner.state.test)
        if other.candidate.atom.label not in found and (z < UNTOLD or deficit < DEFICIT):
            found[other.candidate.atom.label] = other.candidate, f"{deficit:.1f} nats worse on held-out data, {z:.1f} standard errors"
    return [(other, why) for other, why in found.values() if own.atom.label not in (other.atom.label, other.atom.target)]
