"""Simulators that replay one segment at a time: any Python function, any gymnasium.Env whose state
can be set. Slow, general.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from dropo.core.contracts.simulator import Simulator
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.records.trajectories import Segments, Signal
from dropo.core.services.validation import Array, check_shape


class ReplaySimulator(Simulator):
    """Replays segments whose whole state is the observation. A plug-in writes `_replay`."""

    def __init__(self, parameters: Sequence[Parameter], signals: Sequence[Signal | str]):
        self.space = ParameterSpace(tuple(parameters))
        self.signals = [
            signal if isinstance(signal, Signal) else Signal(signal) for signal in signals
        ]

    @abstractmethod
    def _replay(self, value: Array, starts: Array, actions: Array) -> Array:
        """(d,), start observations (n, p), actions (n, L, q) -> the observations after every action
        (n, L, p).
        """

    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Array:
        return np.stack(
            [
                self._one(v, segments, 0.0 if offsets is None else offsets[k])
                for k, v in enumerate(values)
            ]
        )

    def _one(self, value: Array, segments: Segments, offset: Array | float) -> Array:
        starts = segments.starts + offset
        actions = segments.actions
        steps = np.full((*actions.shape[:2], len(self.signals)), np.nan)
        for level in segments.levels:
            begin = starts[level]
            before = segments.previous[level]
            if before[0] >= 0:
                begin = np.where(
                    segments.set_columns, begin, steps[before, segments.lengths[before] - 1]
                )
            replayed = self._replay(value, begin, actions[level])
            check_shape(
                "replayed observations",
                replayed,
                (len(level), actions.shape[1], len(self.signals)),
                type(self).__name__,
            )
            steps[level] = replayed
        segment, step = segments.rows
        return steps[segment, step]


class FunctionSimulator(ReplaySimulator):
    """Any Python function: function(values (d,), starts (n, p), actions (n, L, q)) -> observations
    (n, L, p).
    """

    def __init__(
        self,
        function: Callable[[Array, Array, Array], Array],
        parameters: Sequence[Parameter],
        signals: Sequence[Signal | str],
    ):
        super().__init__(parameters, signals)
        self.function = function

    def _replay(self, value: Array, starts: Array, actions: Array) -> Array:
        return np.asarray(self.function(value, starts, actions), dtype=float)


class EnvSimulator(ReplaySimulator):
    """Any gymnasium.Env whose state can be set.

    set_state(env, observation (p,)) puts the environment where the observation was measured;
    set_parameters(env, {name: value}) sets the parameters. The observations compared are those that
    `env.step` returns.
    """

    def __init__(
        self,
        env: Any,
        parameters: Sequence[Parameter],
        *,
        set_state: Callable[[Any, Array], None],
        set_parameters: Callable[[Any, Mapping[str, float]], None],
        signals: Sequence[Signal | str] | None = None,
    ):
        size = int(np.prod(env.observation_space.shape))
        super().__init__(
            parameters, [f"observation[{i}]" for i in range(size)] if signals is None else signals
        )
        self.env = env
        self.set_state = set_state
        self.set_parameters = set_parameters
        env.reset(seed=0)

    def _replay(self, value: Array, starts: Array, actions: Array) -> Array:
        self.set_parameters(self.env, dict(zip(self.space.names, value.tolist(), strict=True)))
        out = np.empty((len(starts), actions.shape[1], len(self.signals)))
        space = self.env.action_space
        commands = (
            actions.astype(space.dtype) if np.issubdtype(space.dtype, np.integer) else actions
        )  # choices come as numbers
        for i, start in enumerate(starts):
            self.set_state(self.env, start)
            for j, action in enumerate(commands[i]):
                out[i, j] = np.ravel(self.env.step(action.reshape(space.shape))[0])
        return out
