"""Whether the fitted model can be right: the size of its residuals, and structure that a correct
model cannot leave.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.ridge_regression import ridge
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.records.dependence import Units, unit_sums, units_of, variance_of_sum
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.evaluation.features import Features, features_of

LEVEL = 0.001  # false alarms of each test, over all of its signals and features
# a size of the residuals (as a variance) from which it is worth telling: 5 % of a standard error
LARGE = 1.1
NOISY = 3.5  # times the stated noise, as a standard deviation
OUTLIER = 4.0  # robust standard deviations at which a residual is cut
# of held-out prediction; blocks of time where there are few trajectories
FOLDS = 5
BLOCKS = 40
RIDGES = np.logspace(-4, 2, 13)
# the least share of a feature beside what parameters explain: below it, its rest is mostly noise
OWN = 0.05
# residuals below this share of the signal, or of the noise, are no evidence
ROUNDING = 1e-7
FAINT = 1e-2


@dataclass(frozen=True)
class ModelCheck:
    """sentences: what speaks against the model, none where nothing does; found: the tests' numbers,
    for fit.json.
    """

    sentences: tuple[str, ...]
    found: dict[str, Any]


def check_model(
    problem: Problem,
    predicted: Array,
    jacobian: Array,
    epsilon: Array,
    *,
    whitened: Array | None = None,
    learned: bool = True,
) -> ModelCheck:
    """Holds the measurements against the fitted mean predictions (R, p).

    jacobian: (R, p, d) of the predictions by the parameters; epsilon: (p,) the fit's noise
    variances; whitened: (R, p) residuals whitened by the fitted covariance, where epsilon was given
    and not `learned`: their mean square must not be above 1.
    """
    residual = problem.simulator.targets(problem.segments) - predicted
    units = units_of(problem.segments)
    sentences: list[str] = []
    found: dict[str, Any] = {}
    if whitened is not None and not learned:
        found["size"], sentence = _size(whitened, units)
        sentences += sentence
    label = _groups(problem, residual.shape[1], jacobian.shape[2])
    scale = np.sqrt(np.mean(residual**2, axis=0))
    spread = np.std(problem.simulator.targets(problem.segments), axis=0)
    told = scale > np.maximum(ROUNDING * spread, FAINT * np.sqrt(epsilon))
    if told.any():
        white = (residual / np.where(told, scale, 1.0))[:, told]
        slopes = (jacobian / np.where(told, scale, 1.0)[:, None])[:, told]
        rest = _without_draws(white, slopes, label)
        names = [
            signal.name
            for signal, kept in zip(problem.simulator.signals, told, strict=True)
            if kept
        ]
        if problem.epsilon is not None and learned:
            stated = np.broadcast_to(np.asarray(problem.epsilon, dtype=float), told.shape)[told]
            sentences += _noise(
                rest * scale[told], stated, names, len(slopes) / max(len(slopes) - 1, 1)
            )
        features = features_of(problem, predicted, np.random.default_rng(0))
        found["structure"], sentence = _structure(_cut(rest), slopes, label, units, features, names)
        sentences += sentence
    return ModelCheck(tuple(sentences), {"passed": not sentences, **found})


def _size(whitened: Array, units: Units) -> tuple[dict[str, float], list[str]]:
    """Mean square of the whitened residuals, its standard error, and a sentence where it is above
    1.
    """
    square = np.mean(whitened**2, axis=1, keepdims=True)
    mean = float(square.mean())
    variance, degrees = variance_of_sum(square - mean, units)
    error = float(np.sqrt(variance[0, 0])) / len(square)
    p = float(stats.t.sf((mean - 1) / error, degrees[0])) if error > 0 else 0.5
    text = (
        f"the model is wrong or epsilon too small: residuals are {np.sqrt(mean):.3g} times as "
        "large as the fit allows"
    )
    return {"mean_square": mean, "standard_error": error}, [
        text
    ] if mean > LARGE and p < LEVEL else []


def _noise(rest: Array, stated: Array, names: list[str], factor: float) -> list[str]:
    ratio = np.sqrt(np.mean(rest**2, axis=0) * factor / np.maximum(stated, 1e-300))
    worst = int(ratio.argmax())
    if ratio[worst] <= NOISY or stated[worst] <= 0:
        return []
    return [
        (
            f"the model is wrong or the stated noise too small: residuals of {names[worst]} "
            f"are {ratio[worst]:.3g} times the stated noise"
        )
    ]


def _groups(problem: Problem, p: int, d: int) -> Ints:
    """(R,) the groups that may each have parameters of their own: the data's, where they have
    numbers enough, else one.
    """
    group = np.unique(problem.segments.group[problem.segments.rows[0]], return_inverse=True)[1]
    return group if np.median(np.bincount(group)) * p >= 4 * d else np.zeros_like(group)


def _coefficients(slopes: Array, moments: Array, label: Ints) -> Array:
    """(G, d, k) least squares on the slopes (R, p, d) within each group; moments: (R, d, k) slopes'
    values.
    """
    count = int(label.max()) + 1
    gram = np.zeros((count, slopes.shape[2], slopes.shape[2]))
    right = np.zeros((count, *moments.shape[1:]))
    np.add.at(gram, label, slopes.swapaxes(1, 2) @ slopes)
    np.add.at(right, label, moments)
    return np.asarray(np.linalg.pinv(gram, rcond=1e-12, hermitian=True) @ right, dtype=float)


def _without_draws(white: Array, slopes: Array, label: Ints) -> Array:
    """The residuals (R, p) without what other parameters in each group would explain: those may
    vary from draw to draw.
    """
    fitted = _coefficients(slopes, np.einsum("rpd,rp->rd", slopes, white)[:, :, None], label)
    return white - np.einsum("rpd,rd->rp", slopes, fitted[label, :, 0])


def _cut(rest: Array) -> Array:
    """Residuals with outliers cut, so that a few contacts do not drown the others."""
    sd = deviation(rest)
    sd = np.where(sd > 0, sd, np.sqrt(np.mean(rest**2, axis=0)))
    return np.clip(rest, -OUTLIER * sd, OUTLIER * sd)


def _structure(
    rest: Array, slopes: Array, label: Ints, units: Units, features: Features, names: list[str]
) -> tuple[dict[str, Any], list[str]]:
    """The strongest dependence of a signal's residuals (R, p) on one feature, and on all of them in
    held-out data.
    """
    scores = _scores(rest, slopes, label, units, features)  # (p, F)
    signal, feature = (int(i) for i in np.unravel_index(np.abs(scores).argmax(), scores.shape))
    strongest = float(scores[signal, feature])
    predicted = _held_out(rest[features.rows], features, units)  # (p,)
    best = int(predicted.argmax())
    found = {
        "signal": names[signal],
        "feature": features.names[feature],
        "z": strongest,
        "held_out_signal": names[best],
        "held_out_z": float(predicted[best]),
    }
    if stats.norm.sf(abs(strongest)) * 2 * scores.size < LEVEL:
        what = (
            f"residuals of {names[signal]} follow {features.names[feature]} (z "
            f"{abs(strongest):.0f})"
        )
    elif stats.norm.sf(predicted[best]) * len(predicted) < LEVEL:
        what = (
            f"residuals of {names[best]} can be predicted from state and action (z "
            f"{predicted[best]:.0f})"
        )
    else:
        return found, []
    return found, [f"the model is wrong: {what}"]


def _scores(rest: Array, slopes: Array, label: Ints, units: Units, features: Features) -> Array:
    """(p, F) z of the product of residuals and features, these too without what parameters explain
    (Frisch and Waugh 1933).
    """
    named = np.zeros((len(rest), features.named.shape[1]))
    named[features.rows] = features.named
    along = np.einsum("rpd,rp->rd", slopes, rest)
    out = np.empty((rest.shape[1], named.shape[1]))
    for j in range(rest.shape[1]):
        moments = slopes[:, j, :, None] * named[:, None, :]
        fitted = _coefficients(slopes, moments, label)[label]
        own = 1 - np.sum(moments * fitted, axis=(0, 1)) / np.sum(named**2, axis=0)
        product = rest[:, j, None] * named - np.einsum("rd,rdf->rf", along, fitted)
        out[j] = np.where(own > OWN, _z_of_sum(product, units), 0.0)
    return out


def _z_of_sum(values: Array, units: Units) -> Array:
    """(k,) normal scores of the t-tests that the columns of rows (R, k) sum to 0 over independent
    units.
    """
    if units.serial:
        variance, degrees = variance_of_sum(values - values.mean(axis=0), units)
        error = np.sqrt(np.diagonal(variance))
    else:
        sums = unit_sums(values, units)
        error = sums.std(axis=0, ddof=1) * np.sqrt(len(sums))
        degrees = np.full(values.shape[1], len(sums) - 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(error > 0, values.sum(axis=0) / error, 0.0)
    return np.asarray(
        np.sign(t) * stats.norm.isf(np.maximum(stats.t.sf(np.abs(t), degrees), 1e-300))
    )


def _held_out(rest: Array, features: Features, units: Units) -> Array:
    """(p,) z of the fall of the squared residuals (n, p) under ridge regressions that have not seen
    their block.
    """
    block = _blocks(units, features.rows)
    fold = (
        np.unique(block, return_inverse=True)[1] * FOLDS // (int(block.max()) + 1)
        if units.serial
        else block % FOLDS
    )
    design = np.concatenate([features.named, features.smooth], axis=1)
    gain = np.zeros_like(rest)
    for held in range(FOLDS):
        seen = fold != held
        if seen.all() or not seen.any():
            continue
        gain[~seen] = (
            rest[~seen] ** 2
            - (rest[~seen] - design[~seen] @ ridge(design[seen], rest[seen], RIDGES)) ** 2
        )
    sums = np.zeros((int(block.max()) + 1, rest.shape[1]))
    np.add.at(sums, block, gain)
    if len(sums) < 3:
        return np.zeros(rest.shape[1])
    error = sums.std(axis=0, ddof=1) * np.sqrt(len(sums))
    t = sums.sum(axis=0) / np.maximum(error, 1e-300)
    return np.asarray(
        np.sign(t) * stats.norm.isf(np.maximum(stats.t.sf(np.abs(t), len(sums) - 1), 1e-300))
    )


def _blocks(units: Units, rows: Ints) -> Ints:
    """(n,) whole units, or where they are few, blocks of time within them."""
    if not units.serial:
        return np.unique(units.label[rows], return_inverse=True)[1]
    place = np.empty(len(units.label), dtype=np.int64)
    place[units.order] = np.arange(len(units.label))
    length = max(10, -(-len(units.label) // BLOCKS))
    return np.unique(
        np.stack([units.label[rows], place[rows] // length]), axis=1, return_inverse=True
    )[1].ravel()
