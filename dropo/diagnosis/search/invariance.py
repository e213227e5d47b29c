"""Whether a number has one size in all regimes, as a true cause has; what only acts like it has
not.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from dropo.core.contracts.effect import EffectInstance
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library, LinearizedWindows
from dropo.diagnosis.search.windows import Windows
from dropo.mjmodel.robot_simulator import RobotSimulator

BINS = 4  # quantile bins of each variable
# p-value, corrected for the number of variables, below which the size differs between regimes
DIFFERS = 0.01
STANDS_OUT = 3.0  # standard errors by which a bin must differ from the rest to be named


@dataclass(frozen=True)
class Invariance:
    """The regime variable in which the size differs most, its p-value (Bonferroni), and the size's
    relative change in each bin.
    """

    variable: str
    p_value: float
    sizes: tuple[float, ...]
    errors: tuple[float, ...]

    @property
    def constant(self) -> bool:
        """Whether nothing speaks against one size in all regimes."""
        return self.p_value > DIFFERS


def invariance(library: Library, linearized: LinearizedWindows, instance: EffectInstance) -> Invariance:
    """The test on windows that the effect was not fitted to: one-step estimates of its size in each
    bin, compared by chi-square.
    """
    return differing(linearized, response_of(library, linearized, instance), regimes(linearized.windows, library))


def response_of(library: Library, linearized: LinearizedWindows, instance: EffectInstance) -> Array:
    """(W, n) how the predictions change as the effect's size doubles, by their slope."""
    place = library.places[instance.label]
    space = library.simulator.space
    halves = np.stack([linearized.theta, linearized.theta])
    halves[:, place] *= np.array([[1.05], [0.95]])
    ends = library.predict(np.clip(halves, space.low, space.high), linearized.windows)
    return np.asarray(np.nan_to_num(ends[0] - ends[1]) / 0.1)


def drifting(library: Library, linearized: LinearizedWindows, names: tuple[str, ...]) -> list[str]:
    """The declared parameters whose size differs with time in the data."""
    if not names:
        return []
    slopes = library.jacobian(linearized.theta, np.arange(len(names)), linearized.windows)
    time = {"time": regimes(linearized.windows, library)["time"]}
    return [
        n
        for n, slope in zip(names, slopes, strict=True)
        if differing(linearized, slope, time).p_value * len(names) < DIFFERS
    ]


def differing(linearized: LinearizedWindows, response: Array, variables: dict[str, Array]) -> Invariance:
    """The variable over whose bins the estimate of the response's share (W, n) in the residuals
    differs most.
    """
    slope = linearized.flat(response).reshape(len(linearized.windows), -1)
    rest = linearized.flat(linearized.residuals).reshape(len(linearized.windows), -1)
    score = (slope * rest).sum(axis=1)
    weight = (slope**2).sum(axis=1)
    found = [_test(name, values, score, weight) for name, values in variables.items()]
    worst = min(found, key=lambda one: one.p_value)
    return Invariance(
        worst.variable, min(1.0, worst.p_value * len(found)), worst.sizes, worst.errors
    )


def _test(name: str, values: Array, score: Array, weight: Array) -> Invariance:
    masks = bins_of(values)
    total = np.array([weight[mask].sum() for mask in masks])
    sizes = np.array([score[mask].sum() for mask in masks]) / np.maximum(total, 1e-300)
    errors = np.array([_error(score[mask], weight[mask]) for mask in masks])
    used = (
        (total > 1e-6 * total.sum()) & (errors > 0) & np.array([mask.sum() >= 5 for mask in masks])
    )
    if used.sum() < 2:
        return Invariance(name, 1.0, tuple(sizes.tolist()), tuple(errors.tolist()))
    inverse = 1 / errors[used] ** 2
    spread = (inverse * (sizes[used] - (inverse @ sizes[used]) / inverse.sum()) ** 2).sum()
    return Invariance(
        name, float(chi2.sf(spread, used.sum() - 1)), tuple(sizes.tolist()), tuple(errors.tolist())
    )


def _error(score: Array, weight: Array) -> float:
    """The standard error of sum(score) / sum(weight): by the scores' spread, leverage allowed for
    (MacKinnon and White 1985, HC3), and no less than by the weights, which are the scores'
    variances.
    """
    total = float(weight.sum())
    if not total > 0:
        return 0.0
    left = score - score.sum() / total * weight
    spread = (left / np.maximum(1 - weight / total, 0.05)) ** 2
    return float(np.sqrt(max(spread.sum(), total)) / total)


def bins_of(values: Array) -> list[np.ndarray]:
    """Masks (W,) of quantile bins, ascending; fewer where values repeat."""
    edges = np.unique(np.quantile(values, np.linspace(0, 1, BINS + 1)))
    bin_of = (
        np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(len(edges) - 2, 0))
        if len(np.unique(values)) > 2
        else values
    )
    return [bin_of == b for b in np.unique(bin_of)]


def regimes(windows: Windows, library: Library) -> dict[str, Array]:
    """What may set windows apart, each (W,): place in the data, contact, signals at the start,
    speed, commands and their changes.
    """
    segments = windows.segments
    simulator = library.simulator
    found = {"time": segments.steps[:, 0].astype(float)}
    found["contact"] = simulator.in_contact(segments).astype(float)
    starts = segments.starts
    actions = segments.actions
    if isinstance(simulator, RobotSimulator):
        names = simulator.layout.names
        drives = simulator.action_names
    else:
        names = [f"signal {i}" for i in range(starts.shape[1])]
        drives = [f"column {i}" for i in range(actions.shape[2])]
    found |= {name: starts[:, i] for i, name in enumerate(names)}
    found |= {
        f"|{name}|": np.abs(starts[:, i]) for i, name in enumerate(names) if name.startswith("qvel")
    }
    for i, name in enumerate(drives):
        found[f"the command of {name}"] = actions[:, :, i].mean(axis=1)
        found[f"the change of the command of {name}"] = np.abs(
            np.diff(actions[:, :, i], axis=1, prepend=actions[:, :1, i])
        ).mean(axis=1)
    return {name: values for name, values in found.items() if np.ptp(values) > 0}


def standing_out(windows: Windows, library: Library, excess: Array) -> str | None:
    """The regime in which an excess (W,) is largest, in words; None where it is the same in all."""
    best = STANDS_OUT
    told = None
    for name, values in regimes(windows, library).items():
        masks = bins_of(values)
        for k, mask in ((0, masks[0]), (len(masks) - 1, masks[-1])):
            inside = excess[mask]
            outside = excess[~mask]
            if min(len(inside), len(outside)) < 5:
                continue
            error = np.sqrt(inside.var(ddof=1) / len(inside) + outside.var(ddof=1) / len(outside))
            z = (inside.mean() - outside.mean()) / error if error > 0 else 0.0
            if z > best:
                best = float(z)
                told = _words(name, k > 0)
    return told


def _words(name: str, high: bool) -> str:
    if name == "contact":
        return "in contact" if high else "out of contact"
    if name == "time":
        return "late in the data" if high else "early in the data"
    return f"where {name} is {'large' if high else 'small'}"
