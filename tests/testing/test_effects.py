"""`check_effect` meets effects broken on purpose."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.testing import check_effect
from tests.models.robots import ROBOTS

SIZE = Quantity("size", "N", -1.0, 1.0, (-0.5, 0.05, 0.5))


def pull(state, sizes):
    """A valid force hook."""
    return np.full_like(state.qvel, sizes[0])


VALID = EffectInstance("pull", "everything", (SIZE,), force=pull)


def check(*instances):
    """Checks a plug-in that offers these effect instances on the arm."""
    robot = ROBOTS["arm"]()
    check_effect(lambda _: iter(instances), robot.simulator, robot.segments)


def test_a_valid_effect_passes():
    """A constant generalised force; and a plug-in that has nothing to offer for a robot."""
    check(VALID)
    check()


def jumps(state, sizes):
    """Not neutral: a force that does not go away with its size."""
    return np.full_like(state.qvel, 0.1 + sizes[0])


def root(state, sizes):
    """Not smooth."""
    return np.full_like(state.qvel, 0.2 * np.sqrt(np.abs(sizes[0])) + sizes[0])


def greedy_force(state, sizes):
    """Changes the state."""
    state.qvel[:] += sizes[0]
    return np.zeros_like(state.qvel)


def greedy_command(commands, sizes):
    """Changes the commands that it is given."""
    commands += sizes[0]
    return commands


def explodes(state, sizes):
    """Makes simulations fail."""
    return np.full_like(state.qvel, np.nan if abs(sizes[0]) > 0.3 else sizes[0])


def short(state, sizes):
    """One joint too few."""
    return np.full((len(state.qvel), 1), sizes[0])


def probed(*probes, low=-1.0, high=1.0, unit="N"):
    """The valid instance with another quantity."""
    return replace(VALID, quantities=(Quantity("size", unit, low, high, probes),), trials=())


BROKEN = {
    "not neutral": ((replace(VALID, force=jumps),), "still changes predictions"),
    "not smooth": ((replace(VALID, force=root),), "not in proportion"),
    "changes the state": ((replace(VALID, force=greedy_force),), "changes what it is given"),
    "changes commands": (
        (replace(VALID, force=None, command=greedy_command),),
        "'command' of pull:everything changes what it is given",
    ),
    "fails": ((replace(VALID, force=explodes),), "simulations fail under pull:everything at"),
    "wrong shape": ((replace(VALID, force=short),), "gives shape"),
    "probe out of bounds": ((probed(0.5, 2.0),), "outside of its bounds"),
    "probe 0": ((probed(0.0),), "0 or outside"),
    "no probe": ((probed(),), "no probes"),
    "bounds without 0": ((probed(0.5, low=0.1),), "without 0 between"),
    "empty bounds": ((probed(0.0, low=0.0, high=0.0),), "empty interval"),
    "endless bounds": ((probed(0.5, high=np.inf),), "not finite"),
    "no unit": ((probed(0.5, unit=""),), "no unit"),
    "trial out of bounds": ((replace(VALID, trials=(((5.0,),),)),), "trial (5.0,) outside"),
    "trial of another length": ((replace(VALID, trials=(((0.5, 0.5),),)),), "for 1 quantities"),
    "trial of size 0": ((replace(VALID, trials=(((0.0,),),)),), "size 0"),
    "no hook": ((replace(VALID, force=None),), "has no hook"),
    "no quantity": (
        (EffectInstance("pull", None, (), force=pull, trials=(((),),)),),
        "no quantity",
    ),
    "same label": ((VALID, replace(VALID)), "appear twice"),
    "two names": ((VALID, replace(VALID, effect="push")), "several names"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_faults_are_found(fault):
    """Each fault is named."""
    instances, words = BROKEN[fault]
    with pytest.raises(AssertionError) as found:
        check(*instances)
    assert words in str(found.value)
