"""The input that moved the simulated machine is chosen over one that did not, and neither where
both did.
"""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument
from dropo.data.outliers.input_choice import choose_input
from tests.models.pushed_arm import STEP, recorded


def test_the_input_that_acted_is_chosen(simulator):
    """Beside it stand one with noise of a tenth and one that came 20 ms late; parameters are fitted
    under each.
    """
    true = recorded(simulator, {})
    rng = np.random.default_rng(1)
    noisy = replace(true, actions=true.actions + 0.15 * rng.normal(size=true.actions.shape))
    late = replace(true, actions=np.roll(true.actions, 2, axis=0))
    found = choose_input(
        simulator, {"current": noisy, "late": late, "command": true}, [0.3, 0.8], STEP
    )
    assert found.best == "command"
    assert found.sure
    assert min(found.gain[1:]) > 0.2
    assert abs(found.values["command"]["mass"] - 0.6) < 0.03
    assert found.rmse["command"]["qvel.hinge"] < found.rmse["current"]["qvel.hinge"]
    assert "input to trust is 'command'" in str(found)


def test_inputs_that_are_alike_are_not_told_apart(simulator):
    """Two copies with noise of a thousandth: the gain is within its error."""
    true = recorded(simulator, {})
    rng = np.random.default_rng(2)
    same = {
        name: replace(true, actions=true.actions + 1e-3 * rng.normal(size=true.actions.shape))
        for name in "ab"
    }
    found = choose_input(simulator, same, [0.3, 0.8], STEP)
    assert not found.sure
    assert "do not tell" in str(found)


def test_other_observations_are_refused(simulator):
    """Candidates are inputs of the same motion."""
    true = recorded(simulator, {})
    with pytest.raises(BadArgument, match="others under 'b'"):
        choose_input(
            simulator,
            {"a": true, "b": replace(true, observations=true.observations + 1)},
            [0.3, 0.8],
            STEP,
        )
