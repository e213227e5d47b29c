"""Whether the fitted model can be right: the size of its residuals, and structure that a correct
model cannot leave.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.dependence import Units, unit_sums, variance_of_sum
from dropo.core.numerics.kept_rows import KeptRows, row_blocks
from dropo.core.numerics.lattice import lattice_step
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.numerics.tails import normal_tail, student_tail
from dropo.core.records.fits.fit_parts import ModelCheck, ResidualSize, ResidualStructure
from dropo.core.records.independent_units import units_of
from dropo.core.records.trajectories import Ints, Segments
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
        The probability of a false alarm in each test, over all of its signals and features.
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
        A feature counts if at least this fraction of it is beside what parameters explain: else its
        rest is mostly noise.
    rounding : float
        Residuals below this fraction of the signal are no evidence.
    rounded : float
        Of a rounded signal, what residuals may follow a feature by is this fraction of its step:
        errors of rounding are no noise, where motions begin alike.
    faint : float
        Residuals below this fraction of the noise are no evidence either.
    lost : float
        Smooth residuals of this fraction of a signal's variance have lost the motion.
    smooth : float
        Residuals are smooth if the correlation of successive ones is at least this.
    rows : int
        Of more rows about so many are tested for structure, in stretches of time all over the data.
    stretches : int
        The rows that are tested are so many stretches of time.
    regression : ResidualTestSettings
        How the residuals are regressed on state and command.
    """

    level: float = 0.001
    large: float = 1.1
    noisy: float = 3.5
    outlier: float = 4.0
    folds: int = 5
    blocks: int = 40
    own: float = 0.05
    rounding: float = 1e-7
    rounded: float = 0.05
    faint: float = 1e-2
    lost: float = 0.25
    smooth: float = 0.5
    rows: int = 30_000
    stretches: int = 1000
    regression: ResidualTestSettings = field(default_factory=ResidualTestSettings)


SETTINGS = ModelCheckSettings()


@dataclass(frozen=True, eq=False)
class _StandardizedResiduals:
    """Residuals of the n rows and p signals that are evidence, in units of their size.

    rest: (n, p) without what parameters of each group would explain; jacobian: (n, p, d) of the
    predictions; gram: (G, d, d) its square summed over each group; group: (n,); units: the
    independent units of rows; step: (p,) of signals that are rounded, else 0; names: of the
    signals.
    """

    rest: Array
    jacobian: Array
    gram: Array
    group: Ints
    units: Units
    step: Array
    names: list[str]


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Slopes (R, p, d) of the signals that are evidence, in units of the residuals' size.

    step: (p,) of those that are rounded, in the same units, else 0; names: of the signals.
    """

    jacobian: KeptRows
    unit: Array
    step: Array
    evident: NDArray[np.bool_]
    names: list[str]

    def of_rows(self, rows: slice | Ints) -> Array:
        """Those of some rows, (r, p, d)."""
        return (self.jacobian[rows] / self.unit[:, None])[:, self.evident]

    @property
    def blocks(self) -> list[slice]:
        """The rows in blocks."""
        rows, p, d = self.jacobian.shape
        return row_blocks(rows, 8 * p * d * 4)


def check_model(
    problem: Problem,
    predicted: Array,
    jacobian: KeptRows,
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
    jacobian : (R, p, d) array, in memory or in a file
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
    scale = np.sqrt(np.mean(residual**2, axis=0))
    evident = evident_signals(residual, targets, epsilon, settings)
    if evident.any():
        unit = np.where(evident, scale, 1.0)
        signals = zip(problem.simulator.signals, evident, strict=True)
        names = [signal.name for signal, kept in signals if kept]
        step = np.array([lattice_step(column) or 0.0 for column in targets.T[evident]])
        slopes = _Slopes(jacobian, unit, step / unit[evident], evident, names)
        group = groups_with_draws(problem.segments, residual.shape[1], jacobian.shape[2])
        rest = _without_draws((residual / unit)[:, evident], slopes, group)
        # The noise that was stated, where another one was fitted; that of starts is carried along.
        if problem.epsilon is not None and learned and not problem.start_noise:
            stated = np.asarray(problem.epsilon, dtype=float)
            stated = np.broadcast_to(stated, evident.shape)[evident]
            factor = len(rest) / max(len(rest) - 1, 1)
            sentences += _noise(rest * scale[evident], stated, names, factor, settings)
        # Structure: residuals must not follow state and command.
        structure, sentence = _follows(problem, predicted, rest, slopes, group, units, settings)
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
    fraction = np.mean(residual**2, axis=0) / variance
    pairs = np.mean((residual[1:] * residual[:-1])[follows], axis=0)
    successive = pairs / np.maximum(np.mean(residual**2, axis=0), 1e-300)
    lost = np.flatnonzero((fraction > settings.lost) & (successive > settings.smooth))
    if not len(lost):
        return []
    worst = lost[np.argmax(fraction[lost])]
    name = problem.simulator.signals[worst].name
    return [
        f"the fit does not follow the motion: the residuals of {name} are "
        f"{np.sqrt(fraction[worst]):.0%} of the signal's spread. The search may have ended in a "
        "local optimum: start elsewhere, or narrow the bounds"
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


def evident_signals(
    residual: Array, targets: Array, epsilon: Array, settings: ModelCheckSettings = SETTINGS
) -> NDArray[np.bool_]:
    """Find the signals whose residuals are evidence: neither rounding nor far below the noise.

    Parameters
    ----------
    residual, targets : (R, p) array
        In the signals' units.
    epsilon : (p,) array
        The fit's noise variances.
    settings : ModelCheckSettings
        What is no evidence.

    Returns
    -------
    (p,) array of bool
    """
    rounding = settings.rounding * np.std(targets, axis=0)
    least = np.maximum(rounding, settings.faint * np.sqrt(epsilon))
    return np.asarray(np.sqrt(np.mean(residual**2, axis=0)) > least)


def groups_with_draws(segments: Segments, p: int, d: int) -> Ints:
    """Find the groups that may each have parameters of their own.

    Parameters
    ----------
    segments : Segments
        With R compared rows.
    p, d : int
        Numbers of signals and of parameters.

    Returns
    -------
    (R,) array of int
        Their labels: the data's groups where these have numbers enough, else one.
    """
    own = segments.group[segments.rows[0]]
    group = np.unique(own, return_inverse=True)[1]
    return group if np.median(np.bincount(group)) * p >= 4 * d else np.zeros_like(group)


def _follows(
    problem: Problem,
    predicted: Array,
    rest: Array,
    slopes: _Slopes,
    group: Ints,
    units: Units,
    settings: ModelCheckSettings,
) -> tuple[ResidualStructure, list[str]]:
    """The structure of evident residuals (R, p), and a sentence where there is one."""
    tested, units = _tested(units, settings)
    rng = np.random.default_rng(0)
    features = features_of(problem, predicted, rng, settings.regression, tested)
    features = replace(features, rows=np.searchsorted(tested, features.rows))
    cut = _cut(rest[tested], settings.outlier)
    own = slopes.of_rows(tested)
    group = np.unique(group[tested], return_inverse=True)[1]
    left = _StandardizedResiduals(
        cut, own, _grams(own, group), group, units, slopes.step, slopes.names
    )
    return _structure(left, features, settings)


def _tested(units: Units, settings: ModelCheckSettings) -> tuple[Ints, Units]:
    """The rows (n,) that are tested for structure, in rising order, and their units.

    They are the beginnings of stretches of the rows in the order of units and time; of a series in
    time, rows of different stretches count as independent.
    """
    count = len(units.label)
    if count <= settings.rows:
        return np.arange(count), units
    length = -(-count // settings.stretches)
    place = np.arange(count)
    kept = place % length < max(1, length * settings.rows // count)
    rows = units.order[kept]
    label = units.label[rows]
    if units.serial:
        label = label * settings.stretches + place[kept] // length
    label = np.unique(label, return_inverse=True)[1]
    rising = np.argsort(rows)
    order = np.argsort(rising)  # from place in units and time to place among rising rows
    return rows[rising], replace(units, label=label[rising], order=order)


def _grams(jacobian: Array, group: Ints) -> Array:
    """(G, d, d) the sum of J' J over the rows (r, p, d) of each group."""
    d = jacobian.shape[2]
    gram = np.zeros((int(group.max()) + 1, d, d))
    for rows in row_blocks(len(group), 8 * d * (d + 2 * jacobian.shape[1])):
        own = jacobian[rows]
        np.add.at(gram, group[rows], own.swapaxes(1, 2) @ own)
    return gram


def _coefficients(gram: Array, right: Array) -> Array:
    """(G, d, k) least squares within each group, from sums (G, d, d) and (G, d, k)."""
    return np.asarray(np.linalg.pinv(gram, rcond=1e-12, hermitian=True) @ right, dtype=float)


def _without_draws(white: Array, slopes: _Slopes, group: Ints) -> Array:
    """The residuals (R, p) without what other parameters in each group would explain: those may
    vary from draw to draw.
    """
    d = slopes.jacobian.shape[2]
    gram = np.zeros((int(group.max()) + 1, d, d))
    right = np.zeros((len(gram), d, 1))
    for rows in slopes.blocks:
        own = slopes.of_rows(rows)
        np.add.at(gram, group[rows], own.swapaxes(1, 2) @ own)
        np.add.at(right, group[rows], np.einsum("rpd,rp->rd", own, white[rows])[:, :, None])
    fitted = _coefficients(gram, right)
    rest = np.empty_like(white)
    for rows in slopes.blocks:
        explained = np.einsum("rpd,rd->rp", slopes.of_rows(rows), fitted[group[rows], :, 0])
        rest[rows] = white[rows] - explained
    return rest


def _cut(rest: Array, outlier: float) -> Array:
    """Residuals (R, p) cut at so many robust standard deviations."""
    sd = deviation(rest)
    sd = np.where(sd > 0, sd, np.sqrt(np.mean(rest**2, axis=0)))
    return np.clip(rest, -outlier * sd, outlier * sd)


def _structure(
    left: _StandardizedResiduals, features: Features, settings: ModelCheckSettings
) -> tuple[ResidualStructure, list[str]]:
    """The strongest dependence of a signal's residuals on one feature, and on all of them in
    held-out data.
    """
    scores = _scores(left, features, settings)  # (p, F)
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


def _scores(
    left: _StandardizedResiduals, features: Features, settings: ModelCheckSettings
) -> Array:
    """(p, F) normal scores of the product of residuals and features, these too without what
    parameters explain (Frisch and Waugh 1933), less what rounding may make of it.
    """
    rest = left.rest
    named = np.zeros((len(rest), features.named.shape[1]))
    named[features.rows] = features.named
    along = np.einsum("rpd,rp->rd", left.jacobian, rest)
    size = np.sum(named**2, axis=0)
    count = named.shape[1]
    blocks = row_blocks(len(rest), 16 * left.jacobian.shape[2] * count)
    out = np.empty((rest.shape[1], count))
    for j in range(rest.shape[1]):
        right = np.zeros((*left.gram.shape[:2], count))
        for rows in blocks:
            moments = left.jacobian[rows, j, :, None] * named[rows, None, :]
            np.add.at(right, left.group[rows], moments)
        fitted = _coefficients(left.gram, right)
        own = 1 - np.sum(right * fitted, axis=(0, 1)) / size
        product = rest[:, j, None] * named
        for rows in blocks:
            product[rows] -= np.einsum("rd,rdf->rf", along[rows], fitted[left.group[rows]])
        allowed = settings.rounded * left.step[j] * own * np.sqrt(len(rest) * size)
        scores = score_of_sum(product, left.units, allowed)
        out[j] = np.where(own > settings.own, scores, 0.0)
    return out


def score_of_sum(values: Array, units: Units, allowed: Array | float = 0.0) -> Array:
    """Return the normal scores of t-tests that columns sum to 0 over independent units.

    Parameters
    ----------
    values : (R, k) array
        The columns.
    units : Units
        Of the R rows.
    allowed : (k,) array or float
        By how much sums may be off 0.

    Returns
    -------
    (k,) array
    """
    if units.serial:
        variance, degrees = variance_of_sum(values - values.mean(axis=0), units)
        error = np.sqrt(np.diagonal(variance))
    else:
        sums = unit_sums(values, units)
        error = sums.std(axis=0, ddof=1) * np.sqrt(len(sums))
        degrees = np.full(values.shape[1], len(sums) - 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        whole = values.sum(axis=0)
        beyond = np.sign(whole) * np.maximum(np.abs(whole) - allowed, 0.0)
        t = np.where(error > 0, beyond / error, 0.0)
    return score_of_t(t, degrees)


def _predictability(
    left: _StandardizedResiduals, features: Features, settings: ModelCheckSettings
) -> Array:
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
