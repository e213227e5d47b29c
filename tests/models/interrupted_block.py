"""A sliding block whose simulations are interrupted."""

from dropo.simulators.toy import SlidingBlock


class InterruptedBlock(SlidingBlock):
    """Is interrupted, once, at its `at`-th prediction or linearization, none where `at` is 0."""

    def __init__(self, at: int = 0) -> None:
        super().__init__()
        self.at = at
        self.calls = 0

    def predict(self, *given, **named):
        self._count()
        return super().predict(*given, **named)

    def linearize(self, *given, **named):
        self._count()
        return super().linearize(*given, **named)

    def _count(self) -> None:
        self.calls += 1
        if self.calls == self.at:
            raise KeyboardInterrupt
