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
    """Replays all draws and segments at once, in float64.

    A plug-in writes `_advance`, of torch operations alone.

    `predict` takes tensors and gives tensors with their history; Jacobians are exact, by
    forward-mode differentiation.
    """

    has_gradients = True

    def __init__(self, parameters: Sequence[Parameter], signals: Sequence[Signal | str]):
        self.space = ParameterSpace(tuple(parameters))
        self.signals = [
            signal if isinstance(signal, Signal) else Signal(signal) for signal in signals
        ]

    @abstractmethod
    def _advance(self, values: "Tensor", states: "Tensor", actions: "Tensor") -> "Tensor":
        """One control step: values (K, 1, d), states (K, N, p), actions (N, q) -> the states after
        it (K, N, p).
        """

    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Any:
        import torch

        if is_tensor(values) or is_tensor(offsets):
            return self._replay(torch.as_tensor(values), segments, offsets)
        with torch.no_grad():
            return self._replay(torch.tensor(values), segments, offsets).numpy()

    def _replay(self, values: "Tensor", segments: Segments, offsets: Any) -> "Tensor":
        """(K, R, p), level after level: a segment of a chain goes on from where the one before it
        ended.
        """
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
            blocks.append(self._level(values[:, None], begin, segments, level))
            place[level] = np.arange(len(level))
        order = np.argsort(np.concatenate(segments.levels))
        segment, step = segments.rows
        return torch.cat(blocks, dim=1)[:, order[segment], step]

    def _level(
        self, values: "Tensor", states: "Tensor", segments: Segments, level: Any
    ) -> "Tensor":
        """The states after every step (K, n, L, p) of segments without a predecessor among them;
        each rests where it has ended.
        """
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
        """The prediction (R, p) and its exact Jacobian (R, p, d): d equal draws, each with the
        tangent of one parameter.

        With a `step` given, central differences. Parameters, returns and errors as in the contract.
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
            pushed: Any = torch.func.jvp(replay, (draws,), (torch.eye(d, dtype=torch.float64),))
        prediction, slopes = pushed
        self.steps += int(segments.lengths.sum()) * d * self.steps_per_action
        if not prediction.isfinite().all():
            failed = describe_failures(prediction.numpy(), draws.numpy(), self.space)
            raise SimulationFailed(failed)
        return prediction[0].numpy(), np.moveaxis(slopes.numpy(), 0, -1)
