"""The contract of simulators, and the one quantity that carries everything: many parameter vectors,
many segments.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.numerics.array_api import checked, is_tensor, namespace, plain
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Segments, Signal
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.validation import Array, check_shape, float_array, require

WITHOUT_GRADIENTS = (
    "Use likelihood 'emulated', which has gradients whatever the simulator, or an optimizer "
    "without, such as 'cma-es'."
)
STEP = float(
    np.finfo(float).eps ** (1 / 3)
)  # central differences: truncation ~ h^2 meets rounding ~ eps / h here


class Simulator(ABC):
    """Replays segments under parameter vectors.

    A plug-in writes `_predict`, and sets `space` and `signals`.

    space: the d parameters that `predict` takes, in this order. signals: the p numbers that it
    gives for each row.
    nominal: (d,) the parameters' values before any fit, where there are such. steps: the simulator
    steps made so far;
    failures: the simulations so far that did not reach their end. has_gradients: whether `predict`
    takes torch tensors too, and gives a tensor with its history then.
    """

    space: ParameterSpace
    signals: Sequence[Signal]
    has_gradients = False
    steps: int = 0
    failures: int = 0

    def predict(
        self, values: ArrayLike, segments: Segments, *, offsets: ArrayLike | None = None
    ) -> Array:
        """What the simulator gives at every compared row of the segments, (K, R, p); NaN where a
        simulation failed.

        values: (K, d); or (K, G, d), where row g meets the segments of group g (0 ... G-1) alone.
        offsets: (K, N, s) added to the start states of the N segments, in the simulator's own s
        start coordinates (`start_size`), or None.
        """
        caller = f"{type(self).__name__}.predict"
        self._require_gradients(values, offsets)
        array: Any = values if is_tensor(values) else np.asarray(values, dtype=float)
        if array.ndim == 3:
            return self._predict_by_group(array, segments, offsets)
        array = checked("values", array, (None, len(self.space)), caller)
        moved = (
            None
            if offsets is None
            else checked("offsets", offsets, (len(array), len(segments), self.start_size), caller)
        )
        predictions = self._predict(array, segments, moved)
        check_shape(
            "predictions",
            predictions,
            (len(array), len(segments.rows[0]), len(self.signals)),
            caller,
        )
        bad = np.asarray(~np.isfinite(plain(predictions)).all(axis=2))  # (K, R)
        if bad.any():
            xp = namespace(predictions)
            predictions = xp.where(xp.asarray(bad)[..., None], np.nan, predictions)
        self.steps += int(segments.lengths.sum()) * len(array) * self.steps_per_action
        self.failures += (
            len({(k, s) for k, s in zip(*_where(bad, segments), strict=True)}) if bad.any() else 0
        )
        return predictions

    def _require_gradients(self, *given: object) -> None:
        if not self.has_gradients and any(is_tensor(x) for x in given):
            raise Incompatible(
                f"{type(self).__name__} gives no gradients, so it takes no tensors. "
                f"{WITHOUT_GRADIENTS}"
            )

    steps_per_action: int = 1
    nominal: Array | None = None

    @property
    def start_size(self) -> int:
        """s, the number of start coordinates that `offsets` moves; the p signals, unless the
        simulator says otherwise.
        """
        return len(self.signals)

    @abstractmethod
    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Array:
        """(K, d), N segments, (K, N, s) or None -> (K, R, p); anything that is not finite marks a
        failed row.
        """

    def targets(self, segments: Segments) -> Array:
        """What was measured at every compared row, in the coordinates of `predict`: (R, p)."""
        return segments.targets

    def extra_start_sd(self, value: Array, segments: Segments) -> Array:
        """(N, p) standard deviations by which true starts may be off what was measured, noise
        aside, under one parameter vector (d,).
        """
        return np.zeros((len(segments), len(self.signals)))

    def sensitivities(
        self, values: ArrayLike, segments: Segments, *, step: ArrayLike | None = None
    ) -> Array:
        """d prediction / d parameter at one parameter vector (d,), by central differences: (R, p,
        d).

        step: (d,) the half width of the differences; by default eps^(1/3) of each parameter's
        interval, kept in bounds.
        """
        return self.linearize(values, segments, step=step)[1]

    def linearize(
        self, values: ArrayLike, segments: Segments, *, step: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """The prediction (R, p) and its sensitivities (R, p, d) at (d,), from one batch of 2 d + 1."""
        d = len(self.space)
        centre = float_array("values", values, (d,), f"{type(self).__name__}.linearise")
        half = (
            STEP * (self.space.high - self.space.low)
            if step is None
            else float_array("step", step, (d,), "linearise")
        )
        design = np.concatenate(
            [centre[None], centre + np.diag(half), centre - np.diag(half)]
        )  # (2 d + 1, d)
        design = self.space.feasible(design)
        predictions = self.predict(design, segments)
        if not np.isfinite(predictions).all():
            raise SimulationFailed(describe_failures(predictions, design, self.space))
        reach = np.diagonal(design[1 : d + 1] - design[d + 1 :])
        slopes = (predictions[1 : d + 1] - predictions[d + 1 :]) / reach[:, None, None]
        return predictions[0], np.moveaxis(slopes, 0, -1)

    def _predict_by_group(
        self, values: Array, segments: Segments, offsets: ArrayLike | None
    ) -> Array:
        caller = f"{type(self).__name__}.predict"
        check_shape("values", values, (None, None, len(self.space)), caller)
        require(
            segments.group.max() < values.shape[1],
            "values",
            f"given for {segments.group.max() + 1} groups",
            values.shape,
            caller,
        )
        require(offsets is None, "offsets", "None where values differ by group", "an array", caller)
        row_group = segments.group[segments.rows[0]]
        groups = np.unique(segments.group)
        parts = [self.predict(values[:, g], segments.take(segments.group == g)) for g in groups]
        place = np.argsort(np.concatenate([np.flatnonzero(row_group == g) for g in groups]))
        together: Array = namespace(*parts).concat(parts, axis=1)[:, place]
        return together


def _where(bad: np.ndarray, segments: Segments) -> tuple[list[int], list[int]]:
    draw, row = np.nonzero(bad)
    return draw.tolist(), segments.rows[0][row].tolist()


def describe_failures(
    predictions: Array, values: Array, space: ParameterSpace, *, first: int = 0
) -> str:
    """Which rows of (K, R, p) predictions failed, and under which (K, d) values: a sentence for an
    error; rows count from `first`.
    """
    bad = ~np.isfinite(predictions).all(axis=2)
    k, row = (int(i[0]) for i in np.nonzero(bad))
    at = ", ".join(
        f"{name} = {value:.6g}" for name, value in zip(space.names, values[k], strict=True)
    )
    return (
        f"{int(bad.sum())} of {bad.size} simulated rows diverged, the first at row "
        f"{first + row} with {at}."
    )
