"""A simulator whose parameter vectors are shared out among the workers of any executor."""

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
    """Splits the K parameter vectors of every prediction into `parts`, sends each to a worker, and
    puts them together in order.

    executor: any concurrent.futures.Executor: processes, or the workers of a cluster. The results
    are those of the simulator itself, bit for bit. simulator: one that can be pickled; its copies
    stay with the workers between calls.
    parts: as many as there are workers, the executor's own number where it names one, else this
    machine's cores.
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
        self._pickled = pickle.dumps(simulator)
        self._segments: tuple[Segments, bytes] | None = None

    @property
    def start_size(self) -> int:
        return self.simulator.start_size

    def targets(self, segments: Segments) -> Array:
        return self.simulator.targets(segments)

    def in_contact(self, segments: Segments) -> NDArray[np.bool_]:
        return self.simulator.in_contact(segments)

    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Array:
        shares = np.array_split(np.arange(len(values)), min(self.parts, len(values)))
        sent = self._sent(segments)
        moved = [None if offsets is None else offsets[share] for share in shares]
        waiting = [
            self.executor.submit(_part, self._pickled, sent, values[share], offset)
            for share, offset in zip(shares, moved, strict=True)
        ]
        return np.concatenate([future.result() for future in waiting])

    def _sent(self, segments: Segments) -> bytes:
        """The segments, pickled once as long as the same ones are asked for."""
        if self._segments is None or self._segments[0] is not segments:
            self._segments = segments, pickle.dumps(segments)
        return self._segments[1]


def _part(simulator: bytes, segments: bytes, values: Array, offsets: Array | None) -> Array:
    """One worker's share (k, R, p)."""
    return _unpickled(simulator)._predict(values, _unpickled(segments), offsets)


@lru_cache(maxsize=4)
def _unpickled(content: bytes) -> Any:
    return pickle.loads(content)
