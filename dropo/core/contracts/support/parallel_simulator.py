"""A simulator whose parameter vectors are distributed to the workers of any executor."""

import os
import pickle
from concurrent.futures import Executor
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array, require


class ParallelSimulator(Simulator):
    """Splits the K parameter vectors of every prediction among workers.

    The results are those of the simulator itself, bit for bit.

    Parameters
    ----------
    simulator : Simulator
        One that can be pickled; its copies stay with the workers between calls.
    executor : concurrent.futures.Executor
        Any executor: processes of this machine, or the workers of a cluster.
    parts : int, optional
        Into how many parts a prediction is split; by default the executor's number of workers,
        or, where it does not name one, this machine's cores.

    Raises
    ------
    BadArgument
        If `parts` is less than 1.
    Incompatible
        If the simulator gives gradients, which do not cross processes.
    """

    def __init__(self, simulator: Simulator, executor: Executor, parts: int | None = None):
        require(parts is None or parts >= 1, "parts", "at least 1", parts, "ParallelSimulator")
        if simulator.has_gradients:
            raise Incompatible(
                f"{type(simulator).__name__} gives gradients, which do not cross "
                "processes. Use it without an executor."
            )
        self.simulator = simulator
        self.executor = executor
        self.parts = parts or int(getattr(executor, "_max_workers", 0)) or os.cpu_count() or 1
        self.space = simulator.space
        self.signals = simulator.signals
        self.nominal = simulator.nominal
        self.steps_per_action = simulator.steps_per_action
        self.control_step = simulator.control_step
        self.minimum_step = simulator.minimum_step
        self._pickled_simulator = pickle.dumps(simulator)
        self._last_segments: tuple[Segments, bytes] | None = None

    @property
    def start_size(self) -> int:
        """The number s of start coordinates of the simulator itself."""
        return self.simulator.start_size

    @property
    def state_coordinates(self) -> NDArray[np.bool_]:
        """Which start coordinates (s,) move the state of the simulator itself."""
        return self.simulator.state_coordinates

    def observing_state(self) -> tuple[Simulator, Array]:
        """The simulator itself with starts in all coordinates of its state, on the executor."""
        whole, columns = self.simulator.observing_state()
        if whole is self.simulator:
            return self, columns
        return ParallelSimulator(whole, self.executor, self.parts), columns

    def with_finer_steps(self, times: int) -> Simulator | None:
        """The simulator itself with so many physics steps in the place of one, on the executor."""
        finer = self.simulator.with_finer_steps(times)
        return None if finer is None else ParallelSimulator(finer, self.executor, self.parts)

    def targets(self, segments: Segments) -> Array:
        """Measured signals (R, p) at every compared row of the segments."""
        return self.simulator.targets(segments)

    def in_contact(self, segments: Segments) -> NDArray[np.bool_]:
        """Whether bodies overlap in the measured start of each of the segments, (N,)."""
        return self.simulator.in_contact(segments)

    def extra_start_sd(self, value: Array, segments: Segments) -> Array:
        """Standard deviations (N, p) of true starts about the measured ones, beside the noise."""
        return self.simulator.extra_start_sd(value, segments)

    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Array:
        pickled_segments = self._pickle_segments(segments)
        futures = []
        for part in np.array_split(np.arange(len(values)), min(self.parts, len(values))):
            own_offsets = None if offsets is None else offsets[part]
            future = self.executor.submit(
                _predict_part, self._pickled_simulator, pickled_segments, values[part], own_offsets
            )
            futures.append(future)
        return np.concatenate([future.result() for future in futures])

    def _pickle_segments(self, segments: Segments) -> bytes:
        """The segments pickled, once as long as the same ones are predicted."""
        if self._last_segments is None or self._last_segments[0] is not segments:
            self._last_segments = segments, pickle.dumps(segments)
        return self._last_segments[1]


def _predict_part(simulator: bytes, segments: bytes, values: Array, offsets: Array | None) -> Array:
    """Predict (k, R, p) in a worker, for its own k parameter vectors."""
    return _unpickle(simulator)._predict(values, _unpickle(segments), offsets)


@lru_cache(maxsize=4)
def _unpickle(content: bytes) -> Any:
    """The object of a pickle; the last ones are kept."""
    return pickle.loads(content)
