"""Errors that estimated start states have in common, and what they do to a fit.

The pose and the velocity of a base that nobody logged come from one estimate along a run: feet that
slide together put all its velocities off by the same. Rows say nothing of such errors, so that the
scatter of scores does not hold them. Each is as large as the estimate's stated error here, the same
in all starts, and moves the parameters by what least squares makes of the predictions' change.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array
from dropo.estimators.support.standard_errors import StandardErrors


@dataclass(frozen=True)
class CommonErrorSettings:
    """How the parameters' response to common errors is computed.

    Attributes
    ----------
    degrees : float
        Degrees of freedom of the Student t by which rows count.
    farthest : float
        A prediction counts as changed by so many standard deviations of the noise at most: where a
        contact is made or broken it jumps.
    rows : int
        Rows that are taken at a time.
    """

    degrees: float = 4.0
    farthest: float = 5.0
    rows: int = 4096


SETTINGS = CommonErrorSettings()


def common_coordinates(problem: Problem) -> dict[int, float]:
    """Find the start coordinates whose errors are common, of joints whose position was estimated.

    Parameters
    ----------
    problem : Problem

    Returns
    -------
    dict of int to float
        By place among the signals the stated error, in the signal's unit.
    """
    names = [signal.name for signal in problem.simulator.signals]
    if problem.simulator.start_size != len(names):
        return {}
    of_joints = {_joint(name) for name in problem.estimated if name.startswith("qpos.")}
    return {
        names.index(name): sd for name, sd in problem.estimated.items() if _joint(name) in of_joints
    }


def _joint(name: str) -> str:
    """The joint of a signal such as "qpos.base.rx" or "qvel.base[2]"."""
    return name.split(".")[1].partition("[")[0] if "." in name else name


def with_common_errors(
    problem: Problem,
    run: Run,
    mean: Array,
    predicted: Array,
    noise: Array,
    errors: StandardErrors,
    settings: CommonErrorSettings = SETTINGS,
) -> StandardErrors:
    """Add to standard errors what common errors of the starts do to the means.

    Parameters
    ----------
    problem : Problem
    run : Run
        Counts the simulations.
    mean : (d,) array
        Of the fit.
    predicted : (R, p) array
        Its predictions.
    noise : (p,) array
        Variances of the noise.
    errors : StandardErrors

    Returns
    -------
    StandardErrors
        As they were where no position was estimated.
    """
    coordinates = common_coordinates(problem)
    free = np.isfinite(errors.mean)
    if not coordinates or not free.any():
        return errors
    names = [signal.name for signal in problem.simulator.signals]
    measured = np.array([name not in problem.estimated for name in names])
    measured &= noise > 0
    sd = np.sqrt(noise[measured])
    residual = (problem.simulator.targets(problem.segments) - predicted)[:, measured] / sd
    response = _Response(errors, free, measured, sd, residual, settings)
    moved = np.zeros(int(free.sum()))
    with run.counting():
        for place, size in coordinates.items():
            offsets = np.zeros((1, len(problem.segments), len(names)))
            offsets[:, :, place] = size
            shifted = problem.simulator.predict(mean[None], problem.segments, offsets=offsets)[0]
            moved += response.to(shifted[:, measured] - predicted[:, measured]) ** 2
    total = errors.mean.copy()
    total[free] = np.sqrt(total[free] ** 2 + moved)
    return replace(errors, mean=total)


class _Response:
    """The means' response to changes of the predictions, by weighted least squares."""

    def __init__(
        self,
        errors: StandardErrors,
        free: NDArray[np.bool_],
        measured: NDArray[np.bool_],
        sd: Array,
        residual: Array,
        settings: CommonErrorSettings,
    ):
        self.errors = errors
        self.free = free
        self.measured = measured
        self.sd = sd
        self.settings = settings
        self.weight = (settings.degrees + 1) / (settings.degrees + residual**2)
        count = int(free.sum())
        self.information = np.zeros((count, count))
        for rows in self._blocks():
            jacobian = self._jacobian(rows)
            weighted = self.weight[rows][:, :, None] * jacobian
            self.information += np.einsum("rpa,rpb->ab", jacobian, weighted, optimize=True)

    def _blocks(self) -> list[slice]:
        """The rows in blocks."""
        starts = range(0, len(self.weight), self.settings.rows)
        return [slice(start, start + self.settings.rows) for start in starts]

    def _jacobian(self, rows: slice) -> Array:
        """(r, m, f) of the measured signals in standard deviations, by the free means."""
        own = self.errors.jacobian[rows][:, self.measured]
        return np.asarray(own[:, :, self.free] / self.sd[:, None])

    def to(self, change: Array) -> Array:
        """(f,) how far the means move where predictions (R, m) change."""
        farthest = self.settings.farthest
        change = np.nan_to_num(np.clip(change / self.sd, -farthest, farthest))
        right = np.zeros(len(self.information))
        for rows in self._blocks():
            weighted = self.weight[rows] * change[rows]
            right += np.einsum("rpa,rp->a", self._jacobian(rows), weighted, optimize=True)
        return np.asarray(np.linalg.pinv(self.information, hermitian=True) @ right)
