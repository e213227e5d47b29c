"""Simulators that replay one draw at a time: any Python function, any gymnasium.Env.

They are slow, and general.
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
    """Replays segments whose whole state is the observation; a plug-in writes `_replay`.

    Parameters
    ----------
    parameters : sequence of Parameter
        The d parameters.
    signals : sequence of Signal or str
        The p observed numbers; a name alone has no unit.
    """

    def __init__(self, parameters: Sequence[Parameter], signals: Sequence[Signal | str]):
        self.space = ParameterSpace(tuple(parameters))
        self.signals = [
            signal if isinstance(signal, Signal) else Signal(signal) for signal in signals
        ]

    @abstractmethod
    def _replay(self, value: Array, starts: Array, actions: Array) -> Array:
        """(n, L, p) observations after every action.

        From parameters (d,), start observations (n, p) and actions (n, L, q).
        """

    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Array:
        starts = segments.starts
        actions = segments.actions
        predictions = []
        for k, value in enumerate(values):
            begin = starts if offsets is None else starts + offsets[k]
            predictions.append(self._replay_segments(value, segments, begin, actions))
        return np.stack(predictions)

    def _replay_segments(
        self, value: Array, segments: Segments, starts: Array, actions: Array
    ) -> Array:
        """(R, p) for one parameter vector, level after level of the segments that go on."""
        steps = np.full((*actions.shape[:2], len(self.signals)), np.nan)
        for level in segments.levels:
            begin = starts[level]
            before = segments.previous[level]
            if before[0] >= 0:
                ends = steps[before, segments.lengths[before] - 1]
                begin = np.where(segments.set_columns, begin, ends)
            replayed = self._replay(value, begin, actions[level])
            shape = (len(level), actions.shape[1], len(self.signals))
            check_shape("replayed observations", replayed, shape, type(self).__name__)
            steps[level] = replayed
        segment, step = segments.rows
        return steps[segment, step]


class FunctionSimulator(ReplaySimulator):
    """Replays segments by any Python function.

    Parameters
    ----------
    function : callable
        function(values (d,), starts (n, p), actions (n, L, q)) -> observations (n, L, p) after
        every action.
    parameters : sequence of Parameter
        The d parameters.
    signals : sequence of Signal or str
        The p observed numbers; a name alone has no unit.
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
    """Replays segments in any gymnasium.Env whose state can be set.

    The observations compared are those that `env.step` returns.

    Parameters
    ----------
    env : gymnasium.Env
        The environment.
    parameters : sequence of Parameter
        The d parameters.
    set_state : callable
        set_state(env, observation (p,)) puts the environment where the observation was measured.
    set_parameters : callable
        set_parameters(env, {name: value}) sets the parameters.
    signals : sequence of Signal or str, optional
        The p observed numbers; by default "observation[0]" and so on.
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
        if signals is None:
            size = int(np.prod(env.observation_space.shape))
            signals = [f"observation[{i}]" for i in range(size)]
        super().__init__(parameters, signals)
        self.env = env
        self.set_state = set_state
        self.set_parameters = set_parameters
        env.reset(seed=0)

    def _replay(self, value: Array, starts: Array, actions: Array) -> Array:
        self.set_parameters(self.env, dict(zip(self.space.names, value.tolist(), strict=True)))
        out = np.empty((len(starts), actions.shape[1], len(self.signals)))
        space = self.env.action_space
        is_choice = np.issubdtype(space.dtype, np.integer)
        commands = actions.astype(space.dtype) if is_choice else actions
        for i, start in enumerate(starts):
            self.set_state(self.env, start)
            for j, action in enumerate(commands[i]):
                out[i, j] = np.ravel(self.env.step(action.reshape(space.shape))[0])
        return out
