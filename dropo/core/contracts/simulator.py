"""The contract of simulators, and the one quantity that carries everything: many parameter vectors,
many segments.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.numerics.array_api import checked, is_tensor, namespace, plain
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Segments, Signal
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.validation import Array, check_shape, float_array, known, require

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

    Attributes
    ----------
    space : ParameterSpace
        The d parameters that `predict` takes, in this order.
    signals : sequence of Signal
        The p numbers that `predict` gives for each row.
    has_gradients : bool
        Whether `predict` takes torch tensors too, and gives a tensor with its history then.
    steps : int
        The simulator steps made so far.
    failures : int
        The simulations so far that did not reach their end.
    steps_per_action : int
        The simulator steps that replay one action.
    nominal : (d,) array or None
        The parameters' values before any fit, where there are such.
    control_step : float or None
        The time for which one action is held [s]; None, the default, where it is not known.
    """

    space: ParameterSpace
    signals: Sequence[Signal]
    has_gradients = False
    steps: int = 0
    failures: int = 0
    steps_per_action: int = 1
    nominal: Array | None = None
    control_step: float | None = None

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

    def in_contact(self, segments: Segments) -> NDArray[np.bool_]:
        """(N,) whether something overlaps in each segment's measured start; nowhere, by default."""
        return np.zeros(len(segments), dtype=bool)

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
        self,
        values: ArrayLike,
        segments: Segments,
        *,
        step: ArrayLike | None = None,
        offsets: ArrayLike | None = None,
    ) -> tuple[Array, Array]:
        """The prediction and its slopes in the parameters, from one batch of 2 d + 1 simulations.

        Parameters
        ----------
        values : (d,) array
            The parameters around which predictions are linearized.
        segments : Segments
            What is replayed, R compared rows in all.
        step : (d,) array, optional
            Half widths of the central differences, in the parameters' units; by default eps^(1/3)
            of each parameter's interval. Kept within what is physically possible.
        offsets : (N, s) array, optional
            Added to the start states of the N segments.

        Returns
        -------
        prediction : (R, p) array
        jacobian : (R, p, d) array
            d prediction / d parameter.

        Raises
        ------
        SimulationFailed
            Where one of the simulations did not reach its end.
        """
        caller = f"{type(self).__name__}.linearize"
        d = len(self.space)
        centre = float_array("values", values, (d,), caller)
        if step is None:
            half = STEP * (self.space.high - self.space.low)
        else:
            half = float_array("step", step, (d,), caller)
        ahead = centre + np.diag(half)
        behind = centre - np.diag(half)
        design = self.space.feasible(np.concatenate([centre[None], ahead, behind]))  # (2 d + 1, d)
        moved = self._repeated(offsets, segments, len(design), caller)
        predictions = self.predict(design, segments, offsets=moved)
        if not np.isfinite(predictions).all():
            raise SimulationFailed(describe_failures(predictions, design, self.space))
        width = np.diagonal(design[1 : d + 1] - design[d + 1 :])
        slopes = (predictions[1 : d + 1] - predictions[d + 1 :]) / width[:, None, None]
        return predictions[0], np.moveaxis(slopes, 0, -1)

    def linearize_starts(
        self,
        values: ArrayLike,
        segments: Segments,
        step: ArrayLike,
        *,
        offsets: ArrayLike | None = None,
        failures: Literal["raise", "nan"] = "raise",
    ) -> "StartLinearization":
        """The prediction, and those from start states moved either way along each coordinate.

        Each segment's own start is moved: where segments go on from each other (`partial` resets),
        those of one place in their chains are moved at a time.

        Parameters
        ----------
        values : (d,) array
            The parameters, the same in every simulation.
        segments : Segments
            What is replayed: N segments with R compared rows in all.
        step : (s,) array
            How far each start coordinate is moved, in its own unit; above 0.
        offsets : (N, s) array, optional
            Added to the start states of the N segments, around which they are moved then.
        failures : {"raise", "nan"}
            What becomes of simulations that do not reach their end: an error, or rows of NaN.

        Returns
        -------
        StartLinearization
            With the Jacobian and the curvature as properties. It costs 2 s + 1 simulations of each
            segment.

        Raises
        ------
        SimulationFailed
            Where a simulation did not reach its end, with `failures="raise"`.
        """
        caller = f"{type(self).__name__}.linearize_starts"
        known("way with failures", failures, ("raise", "nan"))
        s = self.start_size
        centre = float_array("values", values, (len(self.space),), caller)
        half = float_array("step", step, (s,), caller)
        require(bool((half > 0).all()), "step", "above 0", half, caller)
        design = np.repeat(centre[None], 2 * s + 1, axis=0)
        moves = np.concatenate([np.zeros((1, s)), np.diag(half), -np.diag(half)])
        base = self._repeated(offsets, segments, len(design), caller)
        row_segment = segments.rows[0]
        out = np.empty((len(design), len(row_segment), len(self.signals)))
        for level in segments.levels:
            moved = np.zeros((len(design), len(segments), s)) if base is None else base.copy()
            moved[:, level] += moves[:, None]
            predictions = self.predict(design, segments, offsets=moved)
            if failures == "raise" and not np.isfinite(predictions).all():
                raise SimulationFailed(describe_failures(predictions, design, self.space))
            own = np.isin(row_segment, level)
            out[:, own] = predictions[:, own]
        return StartLinearization(out[0], out[1 : s + 1], out[s + 1 :], half)

    def _repeated(
        self, offsets: ArrayLike | None, segments: Segments, times: int, caller: str
    ) -> Array | None:
        """Start offsets (N, s) for each of several parameter vectors, (times, N, s); None for None."""
        if offsets is None:
            return None
        one = float_array("offsets", offsets, (len(segments), self.start_size), caller)
        return np.repeat(one[None], times, axis=0)

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


@dataclass(frozen=True, eq=False)
class StartLinearization:
    """Predictions around measured start states, for central differences in s start coordinates.

    Attributes
    ----------
    prediction : (R, p) array
        From the starts themselves.
    forward, backward : (s, R, p) arrays
        From starts moved by `step` along each coordinate, and against it.
    step : (s,) array
        How far the starts are moved, in each coordinate's unit.
    """

    prediction: Array
    forward: Array
    backward: Array
    step: Array

    @property
    def jacobian(self) -> Array:
        """(R, p, s) d prediction / d start."""
        return np.moveaxis(self.forward - self.backward, 0, -1) / (2 * self.step)

    @property
    def curvature(self) -> Array:
        """(R, p, s) second derivatives of the prediction along each start coordinate."""
        bend = self.forward + self.backward - 2 * self.prediction
        return np.moveaxis(bend, 0, -1) / self.step**2


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
