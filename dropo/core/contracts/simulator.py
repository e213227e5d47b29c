"""The contract of simulators: predict many segments under many parameter vectors in one call.

Monte-Carlo moments, Jacobians, emulators and the responses of effects are all computed from
`Simulator.predict`.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.numerics.array_api import checked, is_tensor, namespace, plain
from dropo.core.numerics.finite_differences import axial_design, difference_quotients
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.segment_blocks import segment_blocks
from dropo.core.records.trajectories import Segments, Signal
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.validation import Array, check_shape, float_array, require

WITHOUT_GRADIENTS = (
    "Use likelihood 'emulated', which has gradients whatever the simulator, or an optimizer "
    "without, such as 'cma-es'."
)
# Relative step of central differences, at which truncation ~ h^2 equals rounding ~ eps / h.
STEP = float(np.finfo(float).eps ** (1 / 3))


class Simulator(ABC):
    """Replays measured segments under parameter vectors.

    A plug-in sets `space` and `signals` and writes `_predict`. Where its predictions come from
    torch it sets `has_gradients`; where its start states have other coordinates than its signals
    it overrides `start_size`, and where it compares other numbers than the data's columns,
    `targets`.

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
    minimum_step : float
        The least half width of differences, as a fraction of a parameter's interval or a start's
        spread, that rounding does not drown: more than the default in single precision.
    model : MjModel or None
        The compiled model, where MuJoCo simulates.
    """

    space: ParameterSpace
    signals: Sequence[Signal]
    has_gradients = False
    steps: int = 0
    failures: int = 0
    steps_per_action: int = 1
    nominal: Array | None = None
    control_step: float | None = None
    minimum_step: float = STEP
    model: Any = None

    def predict(
        self, values: ArrayLike, segments: Segments, *, offsets: ArrayLike | None = None
    ) -> Array:
        """Predict every compared row of the segments under many parameter vectors.

        Parameters
        ----------
        values : (K, d) or (K, G, d) array_like
            K parameter vectors, in the parameters' units. With three axes, row g of each is for
            the segments of group g (0 ... G-1) alone.
        segments : Segments
            N segments with R compared rows.
        offsets : (K, N, s) array_like, optional
            Added to the start states of the segments, in the simulator's own s start coordinates
            (`start_size`).

        Returns
        -------
        (K, R, p) array
            The signals, in their units; NaN in rows whose simulation failed. A tensor if the
            values or offsets are one.

        Raises
        ------
        BadArgument
            If an array has another shape or is not finite.
        Incompatible
            If a tensor is passed to a simulator without gradients.
        """
        caller = f"{type(self).__name__}.predict"
        self._require_gradients(values, offsets)
        array: Any = values if is_tensor(values) else np.asarray(values, dtype=float)
        if array.ndim == 3:
            return self._predict_by_group(array, segments, offsets)
        array = checked("values", array, (None, len(self.space)), caller)
        start_offsets = None
        if offsets is not None:
            shape = (len(array), len(segments), self.start_size)
            start_offsets = checked("offsets", offsets, shape, caller)
        predictions = self._predict(array, segments, start_offsets)
        expected = (len(array), len(segments.rows[0]), len(self.signals))
        check_shape("predictions", predictions, expected, caller)
        failed = np.asarray(~np.isfinite(plain(predictions)).all(axis=2))  # (K, R)
        if failed.any():
            xp = namespace(predictions)
            predictions = xp.where(xp.asarray(failed)[..., None], np.nan, predictions)
            self.failures += _count_failures(failed, segments)
        self.steps += int(segments.lengths.sum()) * len(array) * self.steps_per_action
        return predictions

    def _require_gradients(self, *given: object) -> None:
        """Refuse tensors where the simulator gives no gradients."""
        if not self.has_gradients and any(is_tensor(x) for x in given):
            raise Incompatible(
                f"{type(self).__name__} gives no gradients, so it takes no tensors. "
                f"{WITHOUT_GRADIENTS}"
            )

    def predict_with_ends(
        self, values: ArrayLike, segments: Segments, *, offsets: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Predict every compared row, and the state in which each segment ends.

        A state is given as the offset that the measured state at that instant needs: a segment that
        starts there with these offsets goes on where this one ended. Rotations are vectors in the
        tangent space of the measured one.

        Parameters
        ----------
        values : (K, d) or (K, G, d) array_like
            As of `predict`.
        segments : Segments
            N segments with R compared rows.
        offsets : (K, N, s) array_like, optional
            As of `predict`.

        Returns
        -------
        predictions : (K, R, p) array
            As of `predict`.
        ends : (K, N, s) array
            In start coordinates; NaN where the simulation failed. Of a coordinate that is not
            `state_coordinates`, what is compared there less what was measured.

        Raises
        ------
        BadArgument
            As `predict`.
        Incompatible
            If the simulator's start coordinates are not its signals, and it does not say where
            segments end.
        """
        predictions = self.predict(values, segments, offsets=offsets)
        return predictions, self._ends(predictions, segments)

    def _ends(self, predictions: Array, segments: Segments) -> Array:
        """Ends (K, N, s) from predictions (K, R, p), where start coordinates are the signals."""
        if self.start_size != len(self.signals):
            raise Incompatible(
                f"{type(self).__name__} has {self.start_size} start coordinates and"
                f" {len(self.signals)} signals, and does not say in which state segments end."
            )
        segment = segments.rows[0]
        last = np.flatnonzero(np.append(segment[1:] != segment[:-1], True))
        return predictions[:, last] - self.targets(segments)[last]

    @property
    def state_coordinates(self) -> NDArray[np.bool_]:
        """Which of the s start coordinates move the state (s,); all unless overridden."""
        return np.ones(self.start_size, dtype=bool)

    def observing_state(self) -> tuple["Simulator", Array]:
        """Make the same simulator with starts in all coordinates of its state.

        Returns
        -------
        simulator : Simulator
            Itself where the data's columns hold the whole state, as it is unless overridden; else
            one of data with further columns behind theirs.
        columns : (c,) array
            What these columns hold where nothing is known of them.
        """
        return self, np.zeros(0)

    def with_finer_steps(self, times: int) -> "Simulator | None":
        """Make the same simulator with so many physics steps in the place of one.

        Parameters
        ----------
        times : int
            How many.

        Returns
        -------
        Simulator or None
            A new one, whose counts of steps and failures begin at 0; None where there are no
            physics steps, as it is unless overridden.
        """
        return None

    @property
    def start_size(self) -> int:
        """The number s of start coordinates that `offsets` moves; p unless overridden."""
        return len(self.signals)

    @abstractmethod
    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Array:
        """Predict (K, R, p) under checked values (K, d) and offsets (K, N, s) or None.

        Whatever is not finite marks a failed row.
        """

    def targets(self, segments: Segments) -> Array:
        """Give the measured signals of every compared row, in the coordinates of `predict`.

        Parameters
        ----------
        segments : Segments
            N segments with R compared rows.

        Returns
        -------
        (R, p) array
            In the signals' units; the segments' own targets unless overridden.
        """
        return segments.targets

    def extra_start_sd(self, value: Array, segments: Segments) -> Array:
        """Give the standard deviations of start states about the measured ones, beside the noise.

        Parameters
        ----------
        value : (d,) array
            Parameter vector.
        segments : Segments
            N segments.

        Returns
        -------
        (N, p) array
            In the signals' units; 0 unless overridden.
        """
        return np.zeros((len(segments), len(self.signals)))

    def in_contact(self, segments: Segments) -> NDArray[np.bool_]:
        """Tell in which measured starts bodies overlap.

        Parameters
        ----------
        segments : Segments
            N segments.

        Returns
        -------
        (N,) array of bool
            False everywhere unless overridden.
        """
        return np.zeros(len(segments), dtype=bool)

    def jacobian(
        self, values: ArrayLike, segments: Segments, *, step: ArrayLike | None = None
    ) -> Array:
        """Differentiate the prediction by the parameters.

        Parameters
        ----------
        values : (d,) array_like
            Parameter vector at which to differentiate.
        segments : Segments
            What is replayed.
        step : (d,) array_like, optional
            Half widths of the central differences, in the parameters' units; by default
            `minimum_step` of each parameter's interval, kept in bounds.

        Returns
        -------
        (R, p, d) array
            d prediction / d parameter.

        Raises
        ------
        BadArgument
            If an array has another shape or is not finite.
        SimulationFailed
            If a simulation of the differences diverges.
        """
        return self.linearize(values, segments, step=step)[1]

    def linearize(
        self,
        values: ArrayLike,
        segments: Segments,
        *,
        step: ArrayLike | None = None,
    ) -> tuple[Array, Array]:
        """Predict, and differentiate the prediction by the parameters, in batches of 2 d + 1.

        Parameters
        ----------
        values, segments, step
            As of `jacobian`.

        Returns
        -------
        prediction : (R, p) array
        jacobian : (R, p, d) array

        Raises
        ------
        BadArgument
            If an array has another shape or is not finite.
        SimulationFailed
            If a simulation of the differences diverges.
        """
        d = len(self.space)
        centre = float_array("values", values, (d,), f"{type(self).__name__}.linearize")
        if step is None:
            half = self.minimum_step * (self.space.high - self.space.low)
        else:
            half = float_array("step", step, (d,), "linearize")
        design = self.space.feasible(centre + axial_design(half, -half))  # (2 d + 1, d)
        widths = np.diagonal(design[1 : d + 1] - design[d + 1 :])
        shape = (len(segments.rows[0]), len(self.signals))
        prediction = np.empty(shape)
        jacobian = np.empty((*shape, d))
        for part, rows, _ in segment_blocks(segments, 8 * len(design) * shape[1]):
            predictions = self.predict(design, part)
            if not np.isfinite(predictions).all():
                failures = describe_failures(predictions, design, self.space, first=rows.start)
                raise SimulationFailed(failures)
            prediction[rows] = predictions[0]
            jacobian[rows] = difference_quotients(predictions, widths)
        return prediction, jacobian

    def linearize_starts(
        self, values: ArrayLike, segments: Segments, *, step: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Predict, and differentiate the prediction by each segment's own start, in one batch.

        Parameters
        ----------
        values : (d,) array_like
            Parameter vector at which to differentiate.
        segments : Segments
            What is replayed. Where segments go on from each other (`partial` resets), a row is
            differentiated by its own segment's start, with all before it as it is.
        step : (s,) array_like, optional
            Half widths of the central differences in the s start coordinates; by default
            `minimum_step` of each one's spread over the segments, or of 1 where it does not vary or
            starts have other columns than coordinates, as with rotations.

        Returns
        -------
        prediction : (R, p) array
        jacobian : (R, p, s) array

        Raises
        ------
        BadArgument
            If an array has another shape or is not finite.
        SimulationFailed
            If a simulation of the differences diverges.
        """
        caller = f"{type(self).__name__}.linearize_starts"
        value = float_array("values", values, (len(self.space),), caller)
        if step is None:
            half = self.minimum_step * self._start_spread(segments)
        else:
            half = float_array("step", step, (self.start_size,), caller)
        predictions = predict_from_starts(self, value, segments, axial_design(half, -half))
        if not np.isfinite(predictions).all():
            design = np.repeat(value[None], len(predictions), axis=0)
            raise SimulationFailed(describe_failures(predictions, design, self.space))
        return predictions[0], difference_quotients(predictions, 2 * half)

    def _start_spread(self, segments: Segments) -> Array:
        """Standard deviation (s,) of each start coordinate over the segments, or 1."""
        if segments.starts.shape[1] != self.start_size:
            return np.ones(self.start_size)
        spread = np.std(segments.starts, axis=0)
        return np.where(spread > 0, spread, 1.0)

    def _predict_by_group(
        self, values: Array, segments: Segments, offsets: ArrayLike | None
    ) -> Array:
        """Predict (K, R, p) under values (K, G, d) that differ from group to group."""
        caller = f"{type(self).__name__}.predict"
        check_shape("values", values, (None, None, len(self.space)), caller)
        last = segments.group.max()
        rule = f"given for {last + 1} groups"
        require(last < values.shape[1], "values", rule, values.shape, caller)
        start_offsets: Any = offsets
        if offsets is not None:
            shape = (len(values), len(segments), self.start_size)
            start_offsets = checked("offsets", offsets, shape, caller)
        row_group = segments.group[segments.rows[0]]
        parts = []
        rows = []
        for group in np.unique(segments.group):
            which = segments.group == group
            moved = None if offsets is None else start_offsets[:, which]
            parts.append(self.predict(values[:, group], segments.take(which), offsets=moved))
            rows.append(np.flatnonzero(row_group == group))
        # Put the rows of all groups back into the order of the segments.
        order = np.argsort(np.concatenate(rows))
        together: Array = namespace(*parts).concat(parts, axis=1)[:, order]
        return together


def predict_from_starts(
    simulator: Simulator, value: Array, segments: Segments, moves: Array
) -> Array:
    """Predict every row with its own segment's start moved, and no start before it in its chain.

    Parameters
    ----------
    simulator : Simulator
    value : (d,) array
        Parameter vector.
    segments : Segments
        What is replayed.
    moves : (K, s) array
        Offsets of a start, in the simulator's start coordinates.

    Returns
    -------
    (K, R, p) array
        NaN where a simulation failed.
    """
    values = np.repeat(value[None], len(moves), axis=0)
    levels = segments.levels
    out = np.empty((len(moves), len(segments.rows[0]), len(simulator.signals)))
    for level in levels:
        offsets = np.zeros((len(moves), len(segments), moves.shape[1]))
        offsets[:, level] = moves[:, None]
        predictions = simulator.predict(values, segments, offsets=offsets)
        if len(levels) == 1:
            return predictions
        own = np.isin(segments.rows[0], level)
        out[:, own] = predictions[:, own]
    return out


def _count_failures(failed: NDArray[np.bool_], segments: Segments) -> int:
    """How many simulations (draw and segment) have one of the failed rows (K, R)."""
    draw, row = np.nonzero(failed)
    simulations = np.stack([draw, segments.rows[0][row]])
    return np.unique(simulations, axis=1).shape[1]


def describe_failures(
    predictions: Array, values: Array, space: ParameterSpace, *, first: int = 0
) -> str:
    """Describe which predictions failed, as a sentence for an error.

    Parameters
    ----------
    predictions : (K, R, p) array
        Predictions, some of them not finite.
    values : (K, d) array
        Their parameter vectors.
    space : ParameterSpace
        The parameters.
    first : int
        The number of the first row.

    Returns
    -------
    str
        How many rows diverged, and the first one with its parameters.
    """
    failed = ~np.isfinite(predictions).all(axis=2)
    k, row = (int(index[0]) for index in np.nonzero(failed))
    named = zip(space.names, values[k], strict=True)
    parameters = ", ".join(f"{name} = {value:.6g}" for name, value in named)
    return (
        f"{int(failed.sum())} of {failed.size} simulated rows diverged, the first at row "
        f"{first + row} with {parameters}."
    )
