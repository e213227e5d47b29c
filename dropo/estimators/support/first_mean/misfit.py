"""How far simulations over the whole box are from some of the measurements."""

import math
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Segments
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class MisfitSettings:
    """How a misfit is measured.

    Attributes
    ----------
    wide : float
        An interval whose upper end is more than this factor above its lower one is searched in
        logarithms.
    floor : float
        Residuals below this fraction of a signal's spread count alike: they are rounding, or what
        learned noise is at least.
    far : float
        Residuals above so many ranges of a signal, those of simulations that diverged among them,
        count alike.
    step : float
        Step of the differences, as a fraction of the unit box.
    errors : float
        An optimum is so many of its own standard errors wide.
    widest : float
        It is at most this fraction of the unit box wide.
    ridge : float
        This is added to a curvature of unit diagonal before it is inverted.
    floats : int
        Numbers that one batch of simulations may hold.
    """

    wide: float = 30.0
    floor: float = 1e-4
    far: float = 3.0
    step: float = 1e-3
    errors: float = 5.0
    widest: float = 0.05
    ridge: float = 1e-6
    floats: int = 8_000_000


SETTINGS = MisfitSettings()


@dataclass(frozen=True, eq=False)
class Slopes:
    """What a step needs to know of K points.

    Attributes
    ----------
    value : (K,) array
        The misfit.
    gradient : (K, d) array
        Of the misfit in the coordinates of the unit box.
    curvature : (K, d, d) array
        Its Gauss-Newton matrix.
    """

    value: Array
    gradient: Array
    curvature: Array


class Misfit:
    """Minus the log-likelihood of R rows of p signals whose noise is known by their residuals.

    Sum over the signals of R/2 log(mean squared residual) [nats]. Points are those of the unit box,
    in logarithms for wide positive intervals.

    Parameters
    ----------
    problem : Problem
        Whose simulator predicts.
    run : Run
        Counts the simulations.
    segments : Segments
        What is compared.
    settings : MisfitSettings
    """

    def __init__(
        self,
        problem: Problem,
        run: Run,
        segments: Segments,
        settings: MisfitSettings = SETTINGS,
    ):
        self.problem = problem
        self.run = run
        self.segments = segments
        self.settings = settings
        space = problem.space
        self.low = space.low
        self.high = space.high
        positive = np.where(space.low > 0, space.low, 1.0)
        ratio = np.where(space.low > 0, space.high / positive, 1.0)
        self.in_logarithms = space.is_log | (ratio > settings.wide)
        self.targets = problem.simulator.targets(segments)
        self.rows = len(self.targets)
        spread = self.targets.std(axis=0)
        size = np.sqrt(np.mean(self.targets**2, axis=0))
        # Rotations, whose targets are angles of 0, are in radians.
        spread = np.where(spread > 1e-12 * np.maximum(size, 1.0), spread, 1.0)
        reach = np.abs(self.targets - np.median(self.targets, axis=0)).max(axis=0)
        self.floor = (settings.floor * spread) ** 2
        self.far = settings.far * np.maximum(reach, spread)

    def values_of(self, unit: Array) -> Array:
        """Map points of the unit box to parameters.

        Parameters
        ----------
        unit : (K, d) array
            Points; those outside the box are moved to its edge.

        Returns
        -------
        (K, d) array
            In the parameters' units.
        """
        unit = np.clip(unit, 0.0, 1.0)
        base = np.where(self.in_logarithms, self.low, 1.0)
        ratio = np.where(self.in_logarithms, self.high / base, 1.0)
        linear = self.low + unit * (self.high - self.low)
        values = np.where(self.in_logarithms, base * ratio**unit, linear)
        return np.asarray(np.clip(values, self.low, self.high))

    def unit_of(self, values: Array) -> Array:
        """Map parameters to points of the unit box.

        Parameters
        ----------
        values : (K, d) array
            In the parameters' units.

        Returns
        -------
        (K, d) array
            The points of which `values_of` makes them.
        """
        base = np.where(self.in_logarithms, self.low, 1.0)
        ratio = np.where(self.in_logarithms, self.high / base, math.e)
        logarithm = np.log(np.where(self.in_logarithms, values, 1.0) / base) / np.log(ratio)
        linear = (values - self.low) / (self.high - self.low)
        return np.asarray(np.where(self.in_logarithms, logarithm, linear))

    def width_at(self, unit: Array) -> Array:
        """Return how wide an optimum is, from the curvature there.

        Parameters
        ----------
        unit : (d,) array
            The optimum, a point of the unit box.

        Returns
        -------
        (d,) array
            Half widths, in the parameters' units.
        """
        curvature = self.slopes(unit[None]).curvature[0]
        size = np.sqrt(np.maximum(np.diagonal(curvature), 1e-12))
        scaled = curvature / np.outer(size, size) + self.settings.ridge * np.eye(len(size))
        error = np.sqrt(np.diagonal(np.linalg.inv(scaled))) / size
        width = np.minimum(self.settings.errors * error, self.settings.widest)
        ends = np.stack([unit - width, unit + width])
        below, above = self.values_of(ends)
        return np.asarray(above - below) / 2

    def _residuals(self, unit: Array) -> Array:
        """(K, R, p) residuals, no larger than what counts as far."""
        predicted = self.problem.simulator.predict(self.values_of(unit), self.segments)
        residuals = np.nan_to_num(predicted - self.targets, nan=np.inf)
        return np.clip(residuals, -self.far, self.far)

    def _of_residuals(self, residuals: Array) -> tuple[Array, Array]:
        """The misfit (K,) of residuals (K, R, p), and their mean squares (K, p)."""
        squares = np.mean(residuals**2, axis=1) + self.floor
        return 0.5 * self.rows * np.log(squares).sum(axis=1), squares

    def _batches(self, points: int, each: int) -> list[slice]:
        """Slices of so many points, of which each needs so many simulations."""
        floats = each * max(self.targets.size, 1)
        size = max(1, self.settings.floats // floats)
        return [slice(i, i + size) for i in range(0, points, size)]

    def at(self, unit: Array) -> Array:
        """Evaluate the misfit.

        Parameters
        ----------
        unit : (K, d) array
            Points of the unit box.

        Returns
        -------
        (K,) array
            In nats.
        """
        found = np.empty(len(unit))
        with self.run.counting(evaluations=1):
            for part in self._batches(len(unit), 1):
                found[part] = self._of_residuals(self._residuals(unit[part]))[0]
        return found

    def slopes(self, unit: Array) -> Slopes:
        """Differentiate the misfit by one-sided differences into the box.

        Parameters
        ----------
        unit : (K, d) array
            Points of the unit box.

        Returns
        -------
        Slopes
            Value, gradient and Gauss-Newton curvature at each point.
        """
        k, d = unit.shape
        step = np.where(unit > 0.5, -self.settings.step, self.settings.step)
        around = unit[:, None] + np.concatenate(
            [np.zeros((k, 1, d)), step[:, None, :] * np.eye(d)], axis=1
        )
        value = np.empty(k)
        gradient = np.empty((k, d))
        curvature = np.empty((k, d, d))
        with self.run.counting(evaluations=1):
            for part in self._batches(k, d + 1):
                points = around[part]
                residuals = self._residuals(points.reshape(-1, d))
                residuals = residuals.reshape(len(points), d + 1, *self.targets.shape)
                value[part], squares = self._of_residuals(residuals[:, 0])
                moved = residuals[:, 1:] - residuals[:, :1]
                jacobian = moved / step[part][:, :, None, None]  # (k, d, R, p)
                weighted = jacobian / squares[:, None, None, :]
                gradient[part] = np.einsum("kdrp,krp->kd", weighted, residuals[:, 0])
                curvature[part] = np.einsum("kdrp,kerp->kde", weighted, jacobian)
        return Slopes(value, gradient, curvature)
