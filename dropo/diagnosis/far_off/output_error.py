"""Numbers fitted to whole motions: robust Gauss-Newton on the output error."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear

from dropo.core.numerics.dependence import Units
from dropo.core.numerics.robust_covariance import sandwich
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.records.trajectories import Ints
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.validation import Array
from dropo.diagnosis.far_off.motions import Motions
from dropo.diagnosis.search.linearization import DIVERGED, Library
from dropo.diagnosis.search.record import recorded
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True)
class OutputErrorSettings:
    """How numbers are fitted to whole motions.

    Attributes
    ----------
    knee : float
        Number of standard deviations from which errors count linearly instead of squared (Huber's
        loss, smoothed).
    jacobians : int
        Largest number of Jacobians that a fit takes.
    tolerance : float
        A fit ends where the steps by a Jacobian gain less than this fraction of the cost.
    enough : float
        A fit also ends where the steps by a Jacobian gain less than this [nats].
    chords : int
        Largest number of steps that are taken by one Jacobian.
    sufficient : float
        Fraction of the promised gain below which a Jacobian no longer describes the motions.
    damping : tuple of float
        Levenberg's damping factors, for columns of length 1; each of them is tried in every step.
    of_value : float
        Width of one-sided differences, as a fraction of the number, if that is less than the usual
        width.
    of_value_central : float
        Width of differences both ways, which are narrow, as a fraction of the number.
    settling : int
        Largest number of Jacobians by narrow differences with which a fit settles.
    minimum_width : float
        Smallest width of any difference, as a fraction of the usual width.
    piece : float
        Length of the pieces of motions whose errors are taken as independent [s].
    pieces : int
        Largest number of such pieces in a window.

    References
    ----------
    Levenberg, Quarterly of Applied Mathematics 2 (1944), 164; Huber, Annals of Mathematical
    Statistics 35 (1964), 73.
    """

    knee: float = 2.5
    jacobians: int = 5
    tolerance: float = 1e-4
    enough: float = 0.2
    chords: int = 3
    sufficient: float = 0.3
    damping: tuple[float, ...] = (1e-8, 1e-4, 1e-2, 1.0)
    of_value: float = 0.01
    of_value_central: float = 1e-5
    settling: int = 2
    minimum_width: float = 1e-3
    piece: float = 0.5
    pieces: int = 10


SETTINGS = OutputErrorSettings()


@dataclass(frozen=True, eq=False)
class Fitted:
    """Numbers fitted to motions, and the motions linearized there.

    Attributes
    ----------
    theta : (m,) array
        The numbers.
    free : (f,) int array
        Which of them were fitted.
    scale : (p',) array
        Spread of the errors of what is compared.
    residuals : (W, n) array
        What is compared, measured less predicted.
    of_steps : (W, n) array
        What residuals in more exact physics steps differ by from those in the model's own; zeros
        where there are no such steps.
    rows : (f, W, N) array
        Derivatives of the predictions, whitened and weighted.
    target : (W, N) array
        The residuals, whitened and weighted likewise.
    cost : float
        Of the motions [nats].
    """

    theta: Array
    free: Ints
    scale: Array
    residuals: Array
    of_steps: Array
    rows: Array
    target: Array
    cost: float

    @cached_property
    def gram(self) -> Array:
        """(f, f) products of the derivatives."""
        flat = self.rows.reshape(len(self.rows), -1)
        return np.asarray(flat @ flat.T)


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of numbers beside the motions.

    Attributes
    ----------
    values : (m,) array
        About what they are.
    information : (m,) array
        One over the variance of that; 0 where nothing is known.
    """

    values: Array
    information: Array

    def cost(self, thetas: Array) -> Array:
        """Compute the cost of numbers that differ from what is known of them.

        Parameters
        ----------
        thetas : (..., m) array
            Vectors of all numbers.

        Returns
        -------
        (...) array
            Half the squared difference, in units of its variance [nats].
        """
        return np.asarray(0.5 * ((thetas - self.values) ** 2 @ self.information))


class OutputError:
    """The output error of motions under a library's numbers.

    Physics steps that are more exact cost several times as much. What they change hardly depends on
    the numbers: it is computed where motions are linearized, and added to all residuals near there,
    which are simulated in the model's own steps, as are all derivatives.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    motions : Motions
        What is compared.
    settings : OutputErrorSettings
        How numbers are fitted.
    known : Known, optional
        What is known of the numbers beside the motions.
    exact : RobotSimulator, optional
        The library's simulator in more exact steps, by which motions are evaluated; if None, they
        are by its own.

    References
    ----------
    Stetter, Numerische Mathematik 29 (1978), 425: the principle of defect correction.
    """

    def __init__(
        self,
        library: Library,
        motions: Motions,
        settings: OutputErrorSettings = SETTINGS,
        known: Known | None = None,
        exact: RobotSimulator | None = None,
    ) -> None:
        self.library = library
        self.motions = motions
        self.settings = settings
        self.exact = exact
        count = len(library.simulator.space)
        self.known = known or Known(np.zeros(count), np.zeros(count))
        self._by_step: dict[Fitted, Array] = {}

    def residuals(self, thetas: Array) -> Array:
        """Simulate all windows under several vectors of numbers, in the model's own steps.

        Parameters
        ----------
        thetas : (K, m) array
            Vectors of all numbers.

        Returns
        -------
        (K, W, n) array
            Measured less predicted, for the n = L p' compared values of each window; NaN where a
            simulation diverges.
        """
        return self.motions.residuals(self.library.predict(thetas, self.motions.windows))

    def evaluated(self, theta: Array) -> Array:
        """Simulate all windows in the steps by which motions are evaluated.

        Parameters
        ----------
        theta : (m,) array
            All numbers.

        Returns
        -------
        (W, n) array
            Measured less predicted; NaN where a simulation diverges.
        """
        if self.exact is None:
            return np.asarray(self.residuals(theta[None])[0])
        return self._by(self.exact, theta)

    def _by(self, simulator: RobotSimulator, theta: Array) -> Array:
        """Residuals (W, n) by another simulator of the same numbers, whose steps are counted."""
        windows = self.motions.windows
        before = simulator.steps
        predicted = simulator.predict(theta[None], windows.segments)
        self.library.simulator.steps += simulator.steps - before
        return self.motions.residuals(predicted.reshape(len(windows), -1))

    def scale_of(self, residuals: Array) -> Array:
        """Estimate the robust spread of the residuals of signals that move.

        A joint that mostly rests has tiny errors there, and its few motions would else count for
        more than those of all other joints.

        Parameters
        ----------
        residuals : (W, n) array
            Measured less predicted; steps that are not finite are left out.

        Returns
        -------
        (p',) array
            Standard deviation of each compared signal's errors, in its unit; no less than the
            sensors' noise.
        """
        scale = np.maximum(self.motions.floor, self.motions.noise)
        rows = residuals.reshape(-1, len(scale))
        counted = np.where(self.motions.moving, rows, np.nan)
        known = np.isfinite(counted).any(axis=0)
        scale[known] = np.maximum(deviation(counted[:, known]), scale[known])
        return scale

    def whitened(self, residuals: Array, scale: Array) -> Array:
        """Express residuals in units of their errors, the noise of the starts taken out.

        Where a simulation diverges, residuals are those of `DIVERGED`.

        Parameters
        ----------
        residuals : (..., W, n) array
            Measured less predicted.
        scale : (p',) array
            Standard deviation of each compared signal's errors.

        Returns
        -------
        (..., W, N) array
            Dimensionless; N is n and one row more for each number of the start that is not exactly
            known.
        """
        lost = DIVERGED * np.tile(scale, self.motions.windows.length)
        known = np.where(np.isfinite(residuals), residuals, lost)
        return self.motions.whitener(scale)(known)

    def cost(self, whitened: Array) -> Array:
        """Compute the robust cost of each window.

        Parameters
        ----------
        whitened : (..., W, N) array
            Residuals in units of their errors.

        Returns
        -------
        (..., W) array
            The cost [nats].
        """
        return np.asarray(self._costs(whitened).sum(axis=-1))

    def cost_by_piece(self, whitened: Array) -> Array:
        """Compute the robust cost of each piece of each window.

        Parameters
        ----------
        whitened : (W, N) array
            Residuals in units of their errors.

        Returns
        -------
        (W, P) array
            The cost of P pieces, whose errors are taken as independent [nats].
        """
        return np.asarray(self._costs(whitened) @ self._of_piece(whitened.shape[-1]))

    def _costs(self, whitened: Array) -> Array:
        """The robust cost of each residual [nats]."""
        knee = self.settings.knee
        return np.asarray(knee**2 * (np.sqrt(1 + (whitened / knee) ** 2) - 1))

    def _of_piece(self, width: int) -> Array:
        """(N, P) 1 where a whitened residual belongs to a piece of its window, else 0."""
        settings = self.settings
        length = self.motions.windows.length
        step = self.library.simulator.control_step or 1.0
        pieces = int(np.clip(length * step / settings.piece, 1, settings.pieces))
        piece = np.repeat(np.arange(length) * pieces // length, len(self.motions.floor))
        # What is known of the start stands behind the steps.
        piece = np.concatenate([piece, np.zeros(width - len(piece), dtype=np.int64)])
        return (piece[:, None] == np.arange(pieces)).astype(float)

    def linearize(self, theta: Array, free: Ints, *, central: bool = False) -> Fitted:
        """Differentiate the motions by some numbers, at widths that suit these.

        Parameters
        ----------
        theta : (m,) array
            All numbers.
        free : (f,) int array
            Indices of those by which motions are differentiated.
        central : bool
            Whether differences are taken both ways, as standard errors need them: what is only
            rounding of one-sided ones would be taken for knowledge of a direction that motions do
            not tell.

        Returns
        -------
        Fitted
            The residuals, whitened and weighted, with their derivatives.
        """
        space = self.library.simulator.space
        here = theta[free]
        usual = self.library.steps[free]
        settings = self.settings
        fraction = settings.of_value_central if central else settings.of_value
        width = np.maximum(fraction * np.abs(here), settings.minimum_width * usual)
        width = np.minimum(usual, width)
        upper = np.minimum(here + width, space.high[free])
        lower = np.maximum(here - width, space.low[free])
        if not central:
            lower = np.where(upper > here, here, lower)
        f = np.arange(len(free))
        values = np.repeat(theta[None], 1 + 2 * len(free), axis=0)
        values[1 + f, free] = upper
        values[1 + len(free) + f, free] = lower
        different, which = np.unique(values, axis=0, return_inverse=True)
        residuals = self.residuals(different)[which.ravel()]
        _, above, below = np.split(residuals, [1, 1 + len(free)])
        slopes = (below - above) / (upper - lower)[:, None, None]
        here = residuals[0] if self.exact is None else self.evaluated(theta)
        return self._linearized(theta, free, here, here - residuals[0], slopes)

    def _linearized(
        self, theta: Array, free: Ints, residuals: Array, of_steps: Array, slopes: Array
    ) -> Fitted:
        """Residuals (W, n) and their slopes (f, W, n), whitened and weighted."""
        scale = self.scale_of(residuals)
        whitened = self.whitened(residuals, scale)
        weights = self._weights(whitened)
        rows = self.motions.whitener(scale)(np.nan_to_num(slopes)) * weights
        cost = float(self.cost(whitened).sum())
        target = weights * whitened
        return Fitted(theta, free, scale, residuals, of_steps, rows, target, cost)

    def _weights(self, whitened: Array) -> Array:
        """What rows are multiplied with, so that their squares are those of the robust cost."""
        return np.asarray((1 + (whitened / self.settings.knee) ** 2) ** -0.25)

    def fit(
        self,
        theta: Array,
        free: Ints,
        log: EvaluationLog | None = None,
        watch: Callable[[Array], None] | None = None,
    ) -> Array:
        """Fit some numbers, from where they are.

        Parameters
        ----------
        theta : (m,) array
            All numbers, within their bounds.
        free : (f,) int array
            Those that are fitted.
        log : EvaluationLog, optional
            Where the steps are recorded, for a fit that can be resumed.
        watch : callable, optional
            Called with all numbers (m,) after the steps by each Jacobian.

        Returns
        -------
        (m,) array
            All numbers, where the fit ends.
        """
        log = log or EvaluationLog()
        for _ in range(self.settings.jacobians):
            step = partial(self._step_on, theta, free)
            found = recorded(log, self.library.simulator, theta, step, np.copy, np.copy)
            theta = found[:-1]
            if watch is not None:
                watch(theta)
            if found[-1]:
                break
        return theta

    def _step_on(self, theta: Array, free: Ints) -> Array:
        """The numbers (m,) after the steps by one Jacobian, then whether they gained little."""
        fitted = self.linearize(theta, free)
        theta, gain = self._steps(fitted)
        return np.append(theta, gain <= self._small(fitted.cost))

    def settle(self, end: Fitted) -> Fitted:
        """Go on from a fit by narrow derivatives.

        Along a direction that motions hardly tell, as where gain, rotor, damping and friction all
        grow alike, wide differences are too coarse for what is known beside the motions to count.

        Parameters
        ----------
        end : Fitted
            Where a fit ended, linearized by differences both ways.

        Returns
        -------
        Fitted
            Where steps gain no more, or where the settings' number of Jacobians is used up.
        """
        for _ in range(self.settings.settling):
            theta, gain = self._steps(end)
            if gain <= self._small(end.cost):
                break
            end = self.linearize(theta, end.free, central=True)
        return end

    def _small(self, cost: float) -> float:
        """The gain from which a fit has ended [nats]."""
        return max(self.settings.enough, self.settings.tolerance * cost)

    def _steps(self, fitted: Fitted) -> tuple[Array, float]:
        """Where a few steps by one Jacobian lead, and what they gain [nats]."""
        settings = self.settings
        theta = fitted.theta
        target = fitted.target
        cost = begun = fitted.cost + float(self.known.cost(theta))
        for _ in range(settings.chords):
            steps, promised = self._damped_steps(fitted, theta, target)
            residuals = self.residuals(steps) + fitted.of_steps
            whitened = self.whitened(residuals, fitted.scale)
            costs = self.cost(whitened).sum(axis=1) + self.known.cost(steps)
            best = int(np.argmin(costs))
            gain = cost - float(costs[best])
            if not gain > 0:
                break
            theta = steps[best]
            cost -= gain
            target = self._weights(whitened[best]) * whitened[best]
            if gain < max(self._small(fitted.cost), settings.sufficient * promised):
                break
        return theta, begun - cost

    def _damped_steps(self, fitted: Fitted, theta: Array, target: Array) -> tuple[Array, float]:
        """The numbers (K, m) after steps that are damped more and more, within their bounds, and
        the gain that the boldest promises [nats].
        """
        size = np.sqrt(np.diag(fitted.gram))
        # Numbers that change nothing stay where they are.
        acts = size > 1e-9 * size.max()
        free = fitted.free[acts]
        size = size[acts]
        space = self.library.simulator.space
        information = self.known.information[free]
        gram = fitted.gram[np.ix_(acts, acts)] + np.diag(information)
        moment = (fitted.rows.reshape(len(acts), -1) @ target.ravel())[acts]
        moment = (moment + information * (self.known.values - theta)[free]) / size
        scaled = gram / np.outer(size, size)
        low = np.minimum((space.low[free] - theta[free]) * size, -1e-12)
        high = np.maximum((space.high[free] - theta[free]) * size, 1e-12)
        steps = []
        for damping in self.settings.damping:
            root = cholesky(scaled + damping * np.eye(len(free)), lower=True)
            wanted = solve_triangular(root, moment, lower=True)
            steps.append(lsq_linear(root.T, wanted, bounds=(low, high)).x)
        boldest = steps[0]
        promised = float(boldest @ moment - 0.5 * boldest @ scaled @ boldest)
        thetas = np.repeat(theta[None], len(steps), axis=0)
        moved = theta[free] + np.stack(steps) / size
        thetas[:, free] = np.clip(moved, space.low[free], space.high[free])
        return thetas, promised

    def covariance(self, fitted: Fitted, prior: Array) -> Array:
        """Compute the covariance of the fitted numbers, by the sandwich over pieces of motions.

        The variance of a number that no motion tells is infinite.

        Parameters
        ----------
        fitted : Fitted
            The motions linearized at the numbers, f of which are free.
        prior : (f, f) array
            What is known of the numbers beside the motions, as information.

        Returns
        -------
        (f, f) array
            The covariance, in the units of the numbers.

        References
        ----------
        White, Econometrica 50 (1982), 1: the sandwich estimator of a misspecified model.
        """
        f, count, width = fitted.rows.shape
        of_piece = self._of_piece(width)
        pieces = of_piece.shape[1]
        scores = (fitted.rows * fitted.target) @ of_piece
        rows = scores.reshape(f, -1).T
        label = np.arange(count * pieces)
        information = fitted.gram + prior
        of_data = sandwich(rows, information, Units(label, False, label, "pieces"))[0]
        inverse = self._inverse(information)
        covariance = np.asarray(of_data + inverse @ prior @ inverse)
        not_identifiable = np.isnan(np.diag(covariance))
        covariance[not_identifiable] = 0.0
        covariance[:, not_identifiable] = 0.0
        covariance[not_identifiable, not_identifiable] = np.inf
        return covariance

    def halved(self, theta: Array, residuals: Array) -> Array:
        """Compute how residuals change when physics steps are halved.

        Parameters
        ----------
        theta : (m,) array
            All numbers.
        residuals : (W, n) array
            Measured less predicted, in the steps by which motions are evaluated, under these
            numbers.

        Returns
        -------
        (W, n) array
            The residuals less those with halved steps; zeros where the simulator has no physics
            steps.
        """
        simulator = self.exact or self.library.simulator
        if not isinstance(simulator, RobotSimulator):
            return np.zeros_like(residuals)
        return np.asarray(residuals - self._by(simulator.with_finer_steps(2), theta))

    def change_by_step(self, fitted: Fitted, prior: Array) -> Array:
        """Compute how far the fitted numbers are off because physics steps are not short.

        Predictions change when steps are halved; these are the changes of the numbers that make up
        for that, taken twice, since errors fall with the step.

        Parameters
        ----------
        fitted : Fitted
            The motions linearized at the numbers, f of which are free.
        prior : (f, f) array
            What is known of the numbers beside the motions, as information.

        Returns
        -------
        (f,) array
            Sizes of the errors, in the units of the numbers.
        """
        if fitted not in self._by_step:
            self._by_step[fitted] = self.halved(fitted.theta, fitted.residuals)
        change = self._by_step[fitted]
        whitened = self.motions.whitener(fitted.scale)(np.nan_to_num(change))
        moment = fitted.rows.reshape(len(fitted.free), -1) @ whitened.ravel()
        return np.asarray(2 * np.abs(self._inverse(fitted.gram + prior) @ moment))

    def left_after_step(self, fitted: Fitted, residuals: Array) -> float:
        """Compute what a linear step leaves of other residuals at the same numbers.

        Parameters
        ----------
        fitted : Fitted
            The motions linearized at the numbers, f of which are free.
        residuals : (W, n) array
            Measured less predicted otherwise, as in other physics steps.

        Returns
        -------
        float
            Half the sum of their squares, weighted as in `fitted` [nats].
        """
        whitened = self.whitened(residuals, fitted.scale)
        target = (self._weights(self.whitened(fitted.residuals, fitted.scale)) * whitened).ravel()
        moment = fitted.rows.reshape(len(fitted.free), -1) @ target
        prior = np.diag(self.known.information[fitted.free])
        taken = moment @ self._inverse(fitted.gram + prior) @ moment
        return float(0.5 * (target @ target - taken))

    def promised(self, fitted: Fitted, changes: Array) -> tuple[Array, Array]:
        """Compute what further numbers promise, one at a time, the fitted ones moving along.

        Parameters
        ----------
        fitted : Fitted
            The motions linearized at the numbers, f of which are free.
        changes : (K, W, n) array
            What predictions change by under a trial size of each of K further numbers.

        Returns
        -------
        gains : (K,) array
            By how much the cost would fall at best [nats].
        factors : (K,) array
            The best sizes, as multiples of the trials'.
        """
        weights = self._weights(self.whitened(fitted.residuals, fitted.scale))
        whitener = self.motions.whitener(fitted.scale)
        columns = (whitener(np.nan_to_num(changes)) * weights).reshape(len(changes), -1)
        rows = fitted.rows.reshape(len(fitted.rows), columns.shape[1])
        target = fitted.target.ravel()
        inverse = self._inverse(fitted.gram + np.diag(self.known.information[fitted.free]))
        shared = columns @ rows.T
        squares = np.sum(columns**2, axis=1) - np.sum((shared @ inverse) * shared, axis=1)
        moments = columns @ target - shared @ inverse @ (rows @ target)
        factors = moments / np.maximum(squares, 1e-300)
        return 0.5 * factors * moments, factors

    @staticmethod
    def _inverse(information: Array) -> Array:
        """The inverse of an information matrix (f, f), without directions that it does not tell."""
        size = np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information / np.outer(size, size)
        inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
        return np.asarray(inverse / np.outer(size, size))
