"""Whether the fitted model can be right: the size of its residuals, and structure that a correct
model cannot leave.
"""

from dataclasses import dataclass, field

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.dependence import Units, unit_sums, variance_of_sum
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.numerics.tails import normal_tail, student_tail
from dropo.core.records.fit_parts import ModelCheck, ResidualSize, ResidualStructure
from dropo.core.records.independent_units import units_of
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.evaluation.features import Features, features_of
from dropo.evaluation.residual_tests import (
    ResidualTestSettings,
    predictability,
    score_of_t,
)


@dataclass(frozen=True)
class ModelCheckSettings:
    """When residuals speak against a model.

    Attributes
    ----------
    level : float
        False alarms of each test, over all of its signals and features.
    large : float
        Size of the residuals (as a variance) from which it is reported: 5 % of a standard error.
    noisy : float
        Residuals above so many times the stated noise, as a standard deviation, are reported.
    outlier : float
        Robust standard deviations at which a residual is cut, so that a few contacts do not drown
        the others.
    folds : int
        Parts of the rows of which each is predicted from the others.
    blocks : int
        Blocks of time, where trajectories are few.
    own : float
        Least share of a feature beside what parameters explain: below it, its rest is mostly
        noise.
    rounding : float
        Residuals below this share of the signal are no evidence ...
    faint : float
        ... nor are those below this share of the noise.
    lost : float
        Residuals of this share of a signal's variance, which are smooth, have lost the motion.
    smooth : float
        Correlation of successive residuals from which they are smooth.
    regression : ResidualTestSettings
        Of the regression on state and command.
    """

    level: float = 0.001
    large: float = 1.1
    noisy: float = 3.5
    outlier: float = 4.0
    folds: int = 5
    blocks: int = 40
    own: float = 0.05
    rounding: float = 1e-7
    faint: float = 1e-2
    lost: float = 0.25
    smooth: float = 0.5
    regression: ResidualTestSettings = field(default_factory=ResidualTestSettings)


SETTINGS = ModelCheckSettings()


@dataclass(frozen=True, eq=False)
class _Residuals:
    """Residuals of the R rows and p signals that are evidence, in units of their size.

    rest: (R, p) without what parameters of each group would explain; jacobian: (R, p, d) of the
    predictions; group: (R,); units: the independent units of rows; names: of the signals.
    """

    rest: Array
    jacobian: Array
    group: Ints
    units: Units
    names: list[str]


def check_model(
    problem: Problem,
    predicted: Array,
    jacobian: Array,
    epsilon: Array,
    *,
    whitened: Array | None = None,
    learned: bool = True,
    unexplained: tuple[Array, Array] | None = None,
    settings: ModelCheckSettings = SETTINGS,
) -> ModelCheck:
    """Compare the measurements with fitted mean predictions.

    Parameters
    ----------
    problem : Problem
        With R compared rows of p signals.
    predicted : (R, p) array
        Mean predictions.
    jacobian : (R, p, d) array
        Of the predictions by the parameters.
    epsilon : (p,) array
        The fit's noise variances.
    whitened : (R, p) array
        Residuals whitened by the fitted covariance: where epsilon was given, their mean
        square must not be above 1.
    learned : bool
        Whether epsilon was fitted.
    unexplained : tuple of (R, p) and (R, p, d) array, optional
        What is new in the residuals of each row, with its Jacobian, where noise has a memory: this
        must not follow state and command. By default the residuals themselves.
    settings : ModelCheckSettings
        Levels and limits.

    Returns
    -------
    ModelCheck
        Sentences and numbers.
    """
    targets = problem.simulator.targets(problem.segments)
    residual = targets - predicted
    units = units_of(problem.segments)
    sentences: list[str] = []
    size: ResidualSize | None = None
    structure: ResidualStructure | None = None
    # Under a given epsilon, the size of the whitened residuals is known.
    if whitened is not None and not learned:
        size, sentence = _size(whitened, units, settings)
        sentences += sentence
    sentences += _lost_motion(problem, residual, targets, settings)
    if unexplained is not None:
        residual, jacobian = unexplained
    # Residuals that are only rounding are no evidence of anything.
    scale = np.sqrt(np.mean(residual**2, axis=0))
    rounding = settings.rounding * np.std(targets, axis=0)
    least = np.maximum(rounding, settings.faint * np.sqrt(epsilon))
    evident = scale > least
    if evident.any():
        unit = np.where(evident, scale, 1.0)
        white = (residual / unit)[:, evident]
        scaled_jacobian = (jacobian / unit[:, None])[:, evident]
        group = _groups(problem, residual.shape[1], jacobian.shape[2])
        rest = _without_draws(white, scaled_jacobian, group)
        signals = zip(problem.simulator.signals, evident, strict=True)
        names = [signal.name for signal, kept in signals if kept]
        # The noise that was stated, where another one was fitted; that of starts is carried along.
        if problem.epsilon is not None and learned and not problem.start_noise:
            stated = np.asarray(problem.epsilon, dtype=float)
            stated = np.broadcast_to(stated, evident.shape)[evident]
            factor = len(scaled_jacobian) / max(len(scaled_jacobian) - 1, 1)
            sentences += _noise(rest * scale[evident], stated, names, factor, settings)
        # Structure: residuals must not follow state and command.
        features = features_of(problem, predicted, np.random.default_rng(0), settings.regression)
        left = _Residuals(_cut(rest, settings.outlier), scaled_jacobian, group, units, names)
        structure, sentence = _structure(left, features, settings)
        sentences += sentence
    return ModelCheck(not sentences, size, structure, tuple(sentences))


def _lost_motion(
    problem: Problem, residual: Array, targets: Array, settings: ModelCheckSettings
) -> list[str]:
    """A sentence where residuals (R, p) are about as large as the motion, and as smooth.

    Sensors' noise may be as large, but does not go on from row to row.
    """
    segments = problem.segments
    run = segments.trajectories.trajectory[segments.steps[segments.rows[0], 0]]
    follows = run[1:] == run[:-1]
    size = np.sqrt(np.mean(residual**2, axis=0))
    if not follows.any() or not (size > settings.rounding * targets.std(axis=0)).any():
        return []
    variance = np.maximum(targets.var(axis=0), 1e-300)
    share = np.mean(residual**2, axis=0) / variance
    pairs = np.mean((residual[1:] * residual[:-1])[follows], axis=0)
    successive = pairs / np.maximum(np.mean(residual**2, axis=0), 1e-300)
    lost = np.flatnonzero((share > settings.lost) & (successive > settings.smooth))
    if not len(lost):
        return []
    worst = lost[np.argmax(share[lost])]
    return [
        f"the fit does not follow the motion: the residuals of "
        f"{problem.simulator.signals[worst].name} are {np.sqrt(share[worst]):.0%} of the signal's "
        "spread. The search may have ended in a local optimum: start elsewhere, or narrow the "
        "bounds"
    ]


def _size(
    whitened: Array, units: Units, settings: ModelCheckSettings
) -> tuple[ResidualSize, list[str]]:
    """Mean square of the whitened residuals, its standard error, a sentence if it is above 1."""
    square = np.mean(whitened**2, axis=1, keepdims=True)
    mean = float(square.mean())
    variance, degrees = variance_of_sum(square - mean, units)
    error = float(np.sqrt(variance[0, 0])) / len(square)
    p_value = float(student_tail((mean - 1) / error, degrees[0])) if error > 0 else 0.5
    found = ResidualSize(mean, error)
    if mean <= settings.large or p_value >= settings.level:
        return found, []
    times = f"{np.sqrt(mean):.3g} times as large as the fit allows"
    return found, [f"the model is wrong or epsilon too small: residuals are {times}"]


def _noise(
    rest: Array, stated: Array, names: list[str], factor: float, settings: ModelCheckSettings
) -> list[str]:
    """A sentence where some signal's residuals (R, p) are far above the stated variances (p,)."""
    ratio = np.sqrt(np.mean(rest**2, axis=0) * factor / np.maximum(stated, 1e-300))
    worst = int(ratio.argmax())
    if ratio[worst] <= settings.noisy or stated[worst] <= 0:
        return []
    times = f"{ratio[worst]:.3g} times the stated noise"
    wrong = "the model is wrong or the stated noise too small"
    return [f"{wrong}: residuals of {names[worst]} are {times}"]


def _groups(problem: Problem, p: int, d: int) -> Ints:
    """(R,) the groups that may each have parameters of their own: the data's, where they have
    numbers enough, else one.
    """
    own = problem.segments.group[problem.segments.rows[0]]
    group = np.unique(own, return_inverse=True)[1]
    return group if np.median(np.bincount(group)) * p >= 4 * d else np.zeros_like(group)


def _coefficients(jacobian: Array, moments: Array, group: Ints) -> Array:
    """(G, d, k) least squares on the Jacobian (R, p, d) within each group.

    moments: (R, d, k) of each row, the product of its Jacobian and its values.
    """
    count = int(group.max()) + 1
    gram = np.zeros((count, jacobian.shape[2], jacobian.shape[2]))
    right = np.zeros((count, *moments.shape[1:]))
    np.add.at(gram, group, jacobian.swapaxes(1, 2) @ jacobian)
    np.add.at(right, group, moments)
    return np.asarray(np.linalg.pinv(gram, rcond=1e-12, hermitian=True) @ right, dtype=float)


def _without_draws(white: Array, jacobian: Array, group: Ints) -> Array:
    """The residuals (R, p) without what other parameters in each group would explain: those may
    vary from draw to draw.
    """
    moments = np.einsum("rpd,rp->rd", jacobian, white)[:, :, None]
    fitted = _coefficients(jacobian, moments, group)
    return white - np.einsum("rpd,rd->rp", jacobian, fitted[group, :, 0])


def _cut(rest: Array, outlier: float) -> Array:
    """Residuals (R, p) cut at so many robust standard deviations."""
    sd = deviation(rest)
    sd = np.where(sd > 0, sd, np.sqrt(np.mean(rest**2, axis=0)))
    return np.clip(rest, -outlier * sd, outlier * sd)


def _structure(
    left: _Residuals, features: Features, settings: ModelCheckSettings
) -> tuple[ResidualStructure, list[str]]:
    """The strongest dependence of a signal's residuals on one feature, and on all of them in
    held-out data.
    """
    scores = _scores(left, features, settings.own)  # (p, F)
    signal, feature = np.unravel_index(np.abs(scores).argmax(), scores.shape)
    strongest = float(scores[signal, feature])
    predicted = _predictability(left, features, settings)  # (p,)
    best = int(predicted.argmax())
    found = ResidualStructure(
        signal=left.names[int(signal)],
        feature=features.names[int(feature)],
        z=strongest,
        held_out_signal=left.names[best],
        held_out_z=float(predicted[best]),
    )
    if normal_tail(abs(strongest)) * 2 * scores.size < settings.level:
        what = f"{found.signal} follow {found.feature} (z {abs(strongest):.0f})"
    elif normal_tail(predicted[best]) * len(predicted) < settings.level:
        z = f"(z {predicted[best]:.0f})"
        what = f"{left.names[best]} can be predicted from state and action {z}"
    else:
        return found, []
    return found, [f"the model is wrong: residuals of {what}"]


def _scores(left: _Residuals, features: Features, own_share: float) -> Array:
    """(p, F) normal scores of the product of residuals and features, these too without what
    parameters explain (Frisch and Waugh 1933).
    """
    rest = left.rest
    named = np.zeros((len(rest), features.named.shape[1]))
    named[features.rows] = features.named
    along = np.einsum("rpd,rp->rd", left.jacobian, rest)
    out = np.empty((rest.shape[1], named.shape[1]))
    for j in range(rest.shape[1]):
        moments = left.jacobian[:, j, :, None] * named[:, None, :]
        fitted = _coefficients(left.jacobian, moments, left.group)[left.group]
        own = 1 - np.sum(moments * fitted, axis=(0, 1)) / np.sum(named**2, axis=0)
        product = rest[:, j, None] * named - np.einsum("rd,rdf->rf", along, fitted)
        out[j] = np.where(own > own_share, _score_of_sum(product, left.units), 0.0)
    return out


def _score_of_sum(values: Array, units: Units) -> Array:
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
    return score_of_t(t, degrees)


def _predictability(left: _Residuals, features: Features, settings: ModelCheckSettings) -> Array:
    """(p,) normal scores of the regression on all features, each block of rows predicted from the
    others.
    """
    block = _blocks(left.units, features.rows, settings.blocks)
    fold = block % settings.folds
    if left.units.serial:  # neighbouring blocks together, as they depend on each other
        fold = np.unique(block, return_inverse=True)[1] * settings.folds // (int(block.max()) + 1)
    folds = [(fold != k, fold == k) for k in range(settings.folds)]
    design = np.concatenate([features.named, features.smooth], axis=1)
    found = predictability(design, left.rest[features.rows], folds, block, settings.regression)
    return found.by_signal


def _blocks(units: Units, rows: Ints, count: int) -> Ints:
    """(n,) whole units, or where they are few, so many blocks of time within them."""
    if not units.serial:
        return np.unique(units.label[rows], return_inverse=True)[1]
    place = np.empty(len(units.label), dtype=np.int64)
    place[units.order] = np.arange(len(units.label))
    length = max(10, -(-len(units.label) // count))
    label = np.stack([units.label[rows], place[rows] // length])
    return np.unique(label, axis=1, return_inverse=True)[1].ravel()
