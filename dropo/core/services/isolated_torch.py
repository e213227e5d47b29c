"""torch with randomness and threads of its own, whatever the rest of the process does with it."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

_one = threading.RLock()  # torch has one random stream for all threads of a process


@contextmanager
def isolated_torch(seed: int) -> Iterator[None]:
    """Torch on one thread, since a handful of numbers gains nothing from more, and seeded; as it
    was before, afterwards.

    Another thread that asks for the same waits, so that each gets its own numbers.
    """
    import torch

    with _one:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(seed)
                yield
        finally:
            torch.set_num_threads(threads)
