"""`check_simulator` meets simulators broken on purpose."""

import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.simulators.toy import SlidingBlock
from dropo.testing import check_simulator


def data():
    """Three trajectories of 8, 6 and 4 rows in the coordinates of SlidingBlock."""
    rng = np.random.default_rng(0)
    ends = np.isin(np.arange(18), [7, 13, 17])
    return Trajectories(
        rng.normal(size=(18, 2)), rng.normal(size=(18, 1)), rng.normal(size=(18, 2)), ends
    )


CUTS = {
    "transitions": {},
    "lambda": {"horizon": 2},
    "every step": {"horizon": 2, "every_step": True},
    "start": {"reset": "start"},
    "partial": {"horizon": 2, "reset": "partial", "set_columns": [True, False]},
}


@pytest.mark.parametrize("cut", CUTS)
def test_a_valid_simulator_passes(cut):
    """The toy simulator, on segments of every kind."""
    check_simulator(SlidingBlock(), data().segments(**CUTS[cut]))


class Remembers(SlidingBlock):
    """Something of the last call stays."""

    calls = 0

    def _predict(self, values, segments, offsets):
        self.calls += 1
        return super()._predict(values, segments, offsets) + 1e-13 * self.calls


class Pools(SlidingBlock):
    """Draws of one batch touch each other."""

    def _predict(self, values, segments, offsets):
        out = super()._predict(values, segments, offsets)
        return out + 1e-12 * out.mean(axis=0)


class Ordered(SlidingBlock):
    """A draw's place in a large batch matters: warm starts do that."""

    def _predict(self, values, segments, offsets):
        out = super()._predict(values, segments, offsets)
        return (
            out
            + 1e-12
            * np.arange(len(segments.rows[0]))[None, :, None]
            * (len(values) == 5)
            * np.arange(len(values))[:, None, None]
        )


class Neighbours(SlidingBlock):
    """Segments of one batch touch each other."""

    def _predict(self, values, segments, offsets):
        out = super()._predict(values, segments, offsets)
        return out + 1e-12 * out.mean(axis=1, keepdims=True)


class EndsOnly(SlidingBlock):
    """Another number where every step is compared."""

    def _predict(self, values, segments, offsets):
        return super()._predict(values, segments, offsets) + 1e-9 * segments.every_step


class GroupsMixed(SlidingBlock):
    """Every group gets the first group's values."""

    def _predict_by_group(self, values, segments, offsets):
        return self.predict(values[:, 0], segments)


class OffsetsLost(SlidingBlock):
    """Moves the start even by an offset of zero."""

    def _predict(self, values, segments, offsets):
        return super()._predict(values, segments, offsets) + (0.1 if offsets is not None else 0.0)


class WrongSlopes(SlidingBlock):
    """Sensitivities of damping 1 % too large."""

    def linearize(self, values, segments, *, step=None, offsets=None):
        prediction, slopes = super().linearize(values, segments, step=step)
        return prediction, slopes * [1.0, 1.01]


class Constant(SlidingBlock):
    """Ignores its parameters."""

    def _predict(self, values, segments, offsets):
        return super()._predict(np.ones_like(values), segments, offsets)


class Breaks(SlidingBlock):
    """Fails under light masses, and then everywhere in the batch."""

    spoil = False

    def _predict(self, values, segments, offsets):
        out = super()._predict(values, segments, offsets)
        light = values[:, 0] < 0.6
        out[light] = np.nan
        return out + (1e-12 if self.spoil and light.any() else 0.0)


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (Remembers, "Remembers.predict is not deterministic"),
        (Pools, "Pools.predict depends on how the draws are split"),
        (Ordered, "Ordered.predict depends on how the draws are split"),
        (Neighbours, "Neighbours.predict depends on which segments come together"),
        (EndsOnly, "EndsOnly.predict gives other numbers where every step is compared"),
        (GroupsMixed, "GroupsMixed.predict with values by group is wrong in group 1"),
        (OffsetsLost, "OffsetsLost.predict changes under start offsets of zero"),
        (WrongSlopes, "WrongSlopes: d .* / d damping at row .* differences give"),
        (Constant, "Constant.predict does not depend on the parameters"),
    ],
)
def test_broken_simulators_are_caught(broken, words):
    """Each defect gets the message that names it."""
    with pytest.raises(AssertionError, match=words):
        check_simulator(broken(), data().segments())


def test_failures_are_checked_where_some_are_known():
    """A failing draw must leave the others alone; parameters that do not fail prove nothing."""
    simulator = Breaks()
    segments = data().segments()
    check_simulator(
        simulator,
        segments,
        diverging=[0.5, 1.0],
        values=np.array([[1.0, 1.0], [2.0, 0.5], [1.5, 2.0]]),
    )
    with pytest.raises(
        AssertionError, match="no simulation of Breaks failed under the diverging parameters"
    ):
        check_simulator(simulator, segments, diverging=[1.0, 1.0])
    simulator.spoil = True
    with pytest.raises(AssertionError, match="a failed simulation of Breaks changes the others"):
        check_simulator(simulator, segments, diverging=[0.5, 1.0])
    with pytest.raises(AssertionError, match=r"simulations of Breaks fail under .* give `values`"):
        check_simulator(simulator, segments, values=[[0.5, 1.0], [1.0, 1.0], [2.0, 1.0]])
