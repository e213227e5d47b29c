"""Differentiable simulators in torch, whose whole state is the observation."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.simulator import Simulator, describe_failures
from dropo.core.numerics.array_api import constant, is_tensor
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.records.trajectories import Segments, Signal
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array, float_array

if TYPE_CHECKING:
    from torch import Tensor


class TorchSimulator(Simulator):
    """Replays all draws and segments at once, in float64; a plug-in writes `_advance`.

    `_advance` must consist of torch operations alone. `predict` takes tensors and gives tensors
    with their history; Jacobians are exact, by forward-mode differentiation.

    Parameters
    ----------
    parameters : sequence of Parameter
        The d parameters.
    signals : sequence of Signal or str
        The p observed numbers, which are the whole state; a name alone has no unit.
    """

    has_gradients = True

    def __init__(self, parameters: Sequence[Parameter], signals: Sequence[Signal | str]):
        self.space = ParameterSpace(tuple(parameters))
        self.signals = [
            signal if isinstance(signal, Signal) else Signal(signal) for signal in signals
        ]

    @abstractmethod
    def _advance(self, values: "Tensor", states: "Tensor", actions: "Tensor") -> "Tensor":
        """(K, N, p) the states after a control step.

        From values (K, 1, d), states (K, N, p) and actions (N, q).
        """

    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Any:
        import torch

        if is_tensor(values) or is_tensor(offsets):
            return self._replay(torch.as_tensor(values), segments, offsets)
        with torch.no_grad():
            return self._replay(torch.tensor(values), segments, offsets).numpy()

    def _replay(self, values: "Tensor", segments: Segments, offsets: Any) -> "Tensor":
        """(K, R, p) level after level: a chained segment goes on where the one before it ended."""
        import torch

        starts = constant(segments.starts, values).expand(len(values), -1, -1)
        starts = starts if offsets is None else starts + constant(offsets, values)
        columns = torch.as_tensor(segments.set_columns)
        place = np.empty(len(segments), dtype=np.int64)
        blocks: list[Tensor] = []
        for level in segments.levels:
            begin = starts[:, level]
            before = segments.previous[level]
            if before[0] >= 0:
                begin = torch.where(columns, begin, blocks[-1][:, place[before], -1])
            blocks.append(self._replay_level(values[:, None], begin, segments, level))
            place[level] = np.arange(len(level))
        order = np.argsort(np.concatenate(segments.levels))
        segment, step = segments.rows
        return torch.cat(blocks, dim=1)[:, order[segment], step]

    def _replay_level(
        self, values: "Tensor", states: "Tensor", segments: Segments, level: Any
    ) -> "Tensor":
        """(K, n, L, p) the states after every step of one level; each rests where it has ended."""
        import torch

        actions = constant(segments.actions[level], values)
        lengths = torch.as_tensor(segments.lengths[level])
        steps = []
        for j in range(actions.shape[1]):
            after = self._advance(values, states, actions[:, j])
            states = torch.where((j < lengths)[:, None], after, states)
            steps.append(states)
        return torch.stack(steps, dim=2)

    def linearize(
        self,
        values: ArrayLike,
        segments: Segments,
        *,
        step: ArrayLike | None = None,
    ) -> tuple[Array, Array]:
        """Predict, and differentiate the prediction exactly by the parameters.

        Parameters
        ----------
        values : (d,) array_like
            Parameter vector at which to differentiate.
        segments : Segments
            What is replayed.
        step : (d,) array_like, optional
            Half widths of central differences, which are taken only where they are given.

        Returns
        -------
        prediction : (R, p) array
        jacobian : (R, p, d) array

        Raises
        ------
        SimulationFailed
            If the simulation diverges.

        Notes
        -----
        d equal draws are replayed at once, each with the tangent of one parameter.
        """
        if step is not None:
            return super().linearize(values, segments, step=step)
        import torch

        d = len(self.space)
        caller = f"{type(self).__name__}.linearize"
        centre = float_array("values", values, (d,), caller)
        draws = torch.tensor(np.tile(centre, (d, 1)))
        with torch.no_grad():
            replay = lambda given: self._replay(given, segments, None)
            tangents = torch.eye(d, dtype=torch.float64)
            result: Any = torch.func.jvp(replay, (draws,), (tangents,))
        prediction, jacobian = result
        self.steps += int(segments.lengths.sum()) * d * self.steps_per_action
        if not prediction.isfinite().all():
            failed = describe_failures(prediction.numpy(), draws.numpy(), self.space)
            raise SimulationFailed(failed)
        return prediction[0].numpy(), np.moveaxis(jacobian.numpy(), 0, -1)
