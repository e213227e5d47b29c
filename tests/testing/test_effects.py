"""`check_effect` meets effects broken on purpose."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.contracts.effect import EffectInstance, Quantity, instances_of
from dropo.core.services import registry
from dropo.core.services.errors import BadArgument
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
    """A constant generalised force."""
    check(VALID)


def known_force(steps, sizes):
    """A valid hook of forces known beforehand, for the arm's two joints."""
    return np.full((steps, 2), sizes[0])


def test_forces_known_beforehand_are_a_hook():
    """An effect may have this one alone."""
    check(replace(VALID, force=None, applied_force=known_force))


def test_an_effect_without_a_place_is_not_checked():
    """Nothing is offered for the arm: silence would say that it keeps to the contract."""
    with pytest.raises(AssertionError, match=r"offers no instance .* nothing was checked"):
        check()


def test_an_effect_whose_instances_have_another_name_is_found(monkeypatch):
    """It is registered by one name, and writes another into files and results."""

    def push(context):
        yield VALID

    monkeypatch.setattr(registry, "_registered", {"effects": {"push": push}})
    robot = ROBOTS["arm"]()
    words = "registered as 'push' gives instances called 'pull'"
    with pytest.raises(AssertionError, match=words):
        check_effect(push, robot.simulator, robot.segments)
    for given in ("push", "push:everything"):
        effect, _, place = given.partition(":")
        with pytest.raises(BadArgument, match=words):
            instances_of(robot.simulator.effect_context, effect, place)


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        (lambda context: VALID, "must be a function that yields instances. Got EffectInstance"),
        (lambda context: None, "must be a function that yields instances. Got NoneType"),
        (lambda context: ["pull"], "must be EffectInstance each. Got 'pull'"),
        (
            lambda context: [EffectInstance("pull", None, SIZE, force=pull)],
            r"'quantities' of EffectInstance pull must be a tuple of Quantity.* Got Quantity\(",
        ),
        (
            lambda context: [EffectInstance("pull", None, (Quantity("size", "N", 0, 1, 0.5),))],
            r"'probes' of Quantity size must be a tuple of numbers.* Got 0.5",
        ),
        (
            lambda context: [replace(VALID, quantities=(SIZE, *probed().quantities), trials=())],
            "pull:everything/size has no probes",
        ),
    ],
)
def test_what_is_no_effect_is_named(effect, words):
    """One returned in place of yielded, and tuples that are none."""
    robot = ROBOTS["arm"]()
    with pytest.raises(AssertionError, match=words):
        check_effect(effect, robot.simulator, robot.segments)


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


def of_three(state, sizes, step):
    """Takes an argument too many."""
    return np.zeros_like(state.qvel)


def unpaired(sizes):
    """A wrench without its body."""
    return 7


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
    "argument too many": (
        (replace(VALID, force=of_three),),
        "the hook 'force' of pull:everything must take 2 arguments, the magnitudes last:",
    ),
    "wrench without body": (
        (replace(VALID, force=None, wrench=unpaired),),
        "the hook 'wrench' of pull:everything must give a body's id and (6,) numbers, not 7",
    ),
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
