"""One effect of an arm, and what is predicted with it."""

import numpy as np

from dropo.core.services.registry import find


def instance(robot, label):
    """The instance of that label."""
    found = {
        a.label: a
        for a in find("effects", label.split(":")[0].split(".")[0])(robot.simulator.effect_context)
    }
    return found[label]


def predicted(robot, label, *magnitudes):
    """(R, nq + nv) what the simulator with the effect predicts; of a free body, its orientation's
    three numbers in place of four.
    """
    simulator = robot.simulator.with_effects((), [(instance(robot, label), np.array(magnitudes))])
    found = simulator.predict(simulator.nominal[None], robot.segments)[0]
    assert not np.allclose(
        found,
        robot.simulator.predict(simulator.nominal[None], robot.segments)[0],
        rtol=1e-7,
        atol=1e-9,
    )
    return found


def observed(robot, states):
    """States (R, nq + nv) as the signals of the simulator."""
    extra = np.zeros((len(states), len(robot.simulator.layout) - states.shape[1]))
    return robot.simulator.layout.coordinates(np.hstack([states, extra]), robot.segments.targets)[
        :, : robot.simulator.model.nv * 2
    ]


def same(robot, found, states):
    """Whether predictions are those of a twin, to rounding."""
    np.testing.assert_allclose(
        found[:, : robot.simulator.model.nv * 2], observed(robot, states), rtol=1e-7, atol=1e-9
    )
