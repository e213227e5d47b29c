"""Whether an accepted effect has one size in all regimes, as a true cause has; what only acts like it has not."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from dropo.core.checks import Array
from dropo.core.effect import Atom
from dropo.diagnosis.model import Library, Look
from dropo.diagnosis.windows import Windows

BINS = 4  # quantile bins of each variable
DIFFERS = 0.01  # p-value, corrected for the number of variables, below which the size differs between regimes


@dataclass(frozen=True)
class Invariance:
    """The regime variable in which the size differs most, its p-value (Bonferroni), and the size's relative change in each bin."""

    variable: str
    p_value: float
    edges: tuple[float, ...]
    sizes: tuple[float, ...]
    errors: tuple[float, ...]

    @property
    def constant(self) -> bool:
        """Whether nothing speaks against one size in all regimes."""
        return self.p_value > DIFFERS


def invariance(library: Library, seen: Look, atom: Atom) -> Invariance:
    """The test on windows that the effect was not fitted to: one-step estimates of its size in each bin, compared by chi-square."""
    place = library.places[atom.label]
    halves = np.stack([seen.theta, seen.theta])
    halves[:, place] *= np.array([[1.05], [0.95]])
    ends = library.predict(np.clip(halves, library.simulator.space.low, library.simulator.space.high), seen.windows)
    response = np.nan_to_num(ends[0] - ends[1]) / 0.1  # of the size doubling
    slope = seen.flat(response).reshape(len(seen.windows), -1)
    rest = seen.flat(seen.residuals).reshape(len(seen.windows), -1)
    score, weight = (slope * rest).sum(axis=1), (slope**2).sum(axis=1)
    found = [_test(name, values, score, weight) for name, values in regimes(seen.windows, library).items()]
    worst = min(found, key=lambda one: one.p_value)
    p_value = min(1.0, worst.p_value * len(found))
    return Invariance(worst.variable, p_value, worst.edges, worst.sizes, worst.errors)


def _test(name: str, values: Array, score: Array, weight: Array) -> Invariance:
    edges = np.quantile(values, np.linspace(0, 1, BINS + 1))
    bin_of = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
    each = [bin_of == g for g in range(BINS)]
    total = np.array([weight[g].sum() for g in each])
    used = total > 1e-6 * total.sum()
    sizes = np.array([score[g].sum() / max(weight[g].sum(), 1e-300) for g in each])
    errors = np.array([np.sqrt((score[g] ** 2).sum()) / max(weight[g].sum(), 1e-300) for g in each])
    used &= errors > 0
    if used.sum() < 2:
        return Invariance(name, 1.0, tuple(edges.tolist()), tuple(sizes.tolist()), tuple(errors.tolist()))
    inverse = 1 / errors[used] ** 2
    spread = (inverse * (sizes[used] - (inverse @ sizes[used]) / inverse.sum()) ** 2).sum()
    return Invariance(name, float(chi2.sf(spread, used.sum() - 1)), tuple(edges.tolist()), tuple(sizes.tolist()), tuple(errors.tolist()))


def regimes(windows: Windows, library: Library) -> dict[str, Array]:
    """What may set windows apart, each (W,): place in the data, signals at the start, commands and their changes."""
    segments = windows.segments
    found = {"time": segments.steps[:, 0].astype(float)}
    starts, actions = segments.starts, segments.actions
    names = getattr(getattr(library.simulator, "layout", None), "names", [f"signal {i}" for i in range(starts.shape[1])])
    found |= {name: starts[:, i] for i, name in enumerate(names)}
    for i in range(actions.shape[2]):
        found[f"command {i}"] = actions[:, :, i].mean(axis=1)
        found[f"change of command {i}"] = (
            np.abs(np.diff(actions[:, :, i], axis=1)).mean(axis=1) if actions.shape[1] > 1 else actions[:, 0, i]
        )
    return {name: values for name, values in found.items() if np.ptp(values) > 0}
