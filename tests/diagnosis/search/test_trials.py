"""The order of trials of which several are good."""

from types import SimpleNamespace

import numpy as np
import pytest

from dropo.diagnosis.search.confirmation import SelectionSettings
from dropo.diagnosis.search.plausibility import Plausibility
from dropo.diagnosis.search.screening import most_usual_of_twins_first
from dropo.diagnosis.search.trials import most_plausible_first
from tests.models.linear_mass import instances

AXES = np.eye(2)


def trial(gain, numbers=1, effect=None, signature=AXES[0]):
    """One that gains so many nats by so many numbers, on both sides alike."""
    linearized = SimpleNamespace(
        log_likelihood=np.full(10, gain / 10), windows=SimpleNamespace(block=np.arange(10))
    )
    instance = instances()[numbers] if effect is None else SimpleNamespace(effect=effect)
    return SimpleNamespace(
        candidate=SimpleNamespace(signature=signature, instance=instance),
        magnitudes=np.ones(numbers),
        penalized_gain=gain,
        state=SimpleNamespace(test=linearized),
    )


@pytest.mark.parametrize(("better", "first"), [(3.0, 1), (30.0, 2)])
def test_fewer_numbers_where_windows_held_out_do_not_tell(better, first):
    """One that needs two numbers comes first only where it is clearly better on data that it was
    not fitted to.
    """
    trials = [trial(100 + better, 2, signature=AXES[1]), trial(100.0)]
    assert len(most_plausible_first(trials)[0].magnitudes) == first


@pytest.mark.parametrize(
    ("better", "cosine", "first"),
    [
        (0.5, 1.0, "joint_armature"),  # the data do not tell them apart: the usual one
        (3.0, 1.0, "body_inertia"),  # data that do outweigh what is usual
        (0.5, 0.9, "body_inertia"),  # effects that do something else to the data are no twins
    ],
)
def test_the_more_usual_one_where_two_do_the_same(better, cosine, first):
    """A rotor is more usual than a link's inertia that is wrong: by 1.5 nats, and no more."""
    turned = np.array([cosine, np.sqrt(1 - cosine**2)])
    trials = [
        trial(100 + better, effect="body_inertia"),
        trial(100.0, effect="joint_armature", signature=turned),
    ]
    assert most_plausible_first(trials)[0].candidate.instance.effect == first


def test_who_knows_better_says_so():
    """Odds of one's own decide, and an effect that they do not name has those of others."""
    trials = [trial(100.0, effect="joint_armature"), trial(100.0, effect="body_inertia")]
    own = SelectionSettings(plausibility=Plausibility({"body_inertia": 0.0}))
    assert most_plausible_first(trials)[0].candidate.instance.effect == "joint_armature"
    assert most_plausible_first(trials, own)[0].candidate.instance.effect == "body_inertia"


def test_the_most_usual_of_twins_is_tried_where_the_first_would_be():
    """Before those that promise less but do something else; the others stay in their order."""

    def candidate(effect, signature):
        return SimpleNamespace(instance=SimpleNamespace(effect=effect), signature=signature)

    first = candidate("body_com", AXES[0])
    other = candidate("actuator_gain", AXES[1])
    twins = [candidate(name, -AXES[0]) for name in ("body_inertia", "joint_armature")]
    found = most_usual_of_twins_first([first, other, *twins], 0.98, Plausibility())
    assert found == [twins[1], first, other, twins[0]]
    assert most_usual_of_twins_first([first, other], 0.98, Plausibility()) == [first, other]
