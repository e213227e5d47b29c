"""A context in which torch has random numbers and threads of its own."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.RLock()  # torch has one random stream for all threads of a process


@contextmanager
def isolated_torch(seed: int) -> Iterator[None]:
    """Seed torch and let it use one thread, inside a block; restore both afterwards.

    A handful of numbers gains nothing from more threads. Another thread that enters such a block
    waits, so that each gets its own numbers.

    Parameters
    ----------
    seed : int
        Of torch's random numbers.
    """
    import torch

    with _lock:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(seed)
                yield
        finally:
            torch.set_num_threads(threads)
