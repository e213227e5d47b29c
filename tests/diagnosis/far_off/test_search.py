"""The search for what a model lacks that is far off: what motions ask for, and what is certain."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dropo.core.contracts.estimator import silent
from dropo.diagnosis.far_off.motions import motions_of
from dropo.diagnosis.far_off.search import KNOWN, ROUGH, FarOffSearch, _Sides
from dropo.diagnosis.far_off.start import FarOffLimits, start_of
from dropo.diagnosis.regression.quick import QuickSettings
from dropo.mjmodel.options import integrator
from dropo.mjmodel.robot_simulator import RobotSimulator
from dropo.problems.simulated.hidden import hide
from tests.models.far_off import SETTINGS, torque_arm
from tests.models.first_models import unknown_rotor

TRUTH = 0.01  # [kg m^2] at the elbow


def searched(model, settings=SETTINGS):
    """What a search finds of a model's numbers."""
    return FarOffSearch(settings, silent).run(model)


def search_sides(model):
    """Its motions: to fit, which are few enough for all fits, and held out."""
    fitted, held_out = motions_of(model.problem, model.library, model.theta, SETTINGS.motions)
    return _Sides(fitted, fitted, held_out)


@pytest.fixture(scope="module")
def found():
    """An arm that lacks rotor inertia at its elbow, as a model with a gain alone."""
    return searched(torque_arm("actuator_gain"))


def test_a_group_that_motions_ask_for_is_added(found):
    """The inertias, of which the elbow's is certain and right; offsets are not asked for."""
    labels = [instance.label for instance, _ in found.model.numbers]
    assert labels == ["actuator_gain", "joint_armature:shoulder", "joint_armature:elbow"]
    assert found.certain == {"joint_armature:elbow"}
    assert found.own_steps  # the data are of the model's own steps
    error = found.errors[-1]
    assert abs(found.model.theta[-1] - TRUTH) < 4 * error < 0.4 * TRUTH


def test_its_cost_is_what_was_simulated(monkeypatch):
    """Every step of every simulator, those of shorter physics steps among them."""
    model = torque_arm("joint_armature:elbow")
    counted = []
    predict = RobotSimulator.predict

    def counting(simulator, thetas, segments, **given):
        steps = int(segments.lengths.sum()) * len(thetas) * simulator.steps_per_action
        counted.append(steps)
        return predict(simulator, thetas, segments, **given)

    monkeypatch.setattr(RobotSimulator, "predict", counting)
    assert searched(model).simulator_steps == sum(counted) > 0


def test_nothing_is_added_where_motions_are_explained():
    """With the inertia among the numbers no group is tried."""
    explained = searched(torque_arm("joint_armature:elbow"))
    labels = [instance.label for instance, _ in explained.model.numbers]
    assert labels == ["joint_armature:elbow"]


def test_a_group_that_takes_too_little_away_is_left(found):
    """No group takes all of the cost away."""
    left = searched(torque_arm("actuator_gain"), replace(SETTINGS, share=1.0))
    assert [instance.label for instance, _ in left.model.numbers] == ["actuator_gain"]


def test_without_an_effect_the_others_make_up_for_it(found):
    """The inertia left out is 0, and the gain has moved."""
    without = found.without["joint_armature:elbow"]
    assert without[-1] == 0.0
    assert without[-3] != found.model.theta[-3]


def test_errors_hold_the_accuracy_of_the_models_masses(found):
    """A tenth of every number in place of 2 %: the errors are at least that."""
    coarse = searched(torque_arm("joint_armature:elbow"), replace(SETTINGS, accuracy=0.1))
    assert coarse.errors[-1] > 0.1 * TRUTH * 0.9
    assert found.errors[-1] < coarse.errors[-1]


def test_a_number_at_its_bound_is_warned_of(found):
    """An interval that ends below what is missing; friction that is not there is no warning."""
    assert found.warnings == ()
    instance, sizes = torque_arm("joint_armature:elbow").numbers[0]
    narrow = replace(instance.quantities[0], high=0.5 * TRUTH)
    model = torque_arm()
    model = replace(model, numbers=((replace(instance, quantities=(narrow,)), sizes),))
    (warning,) = searched(model, replace(SETTINGS, families=())).warnings
    assert "joint_armature:elbow/armature is at its bound, 0.005" in warning
    assert np.isfinite(model.theta).all()


@pytest.mark.parametrize("count", [1, 2])
def test_what_is_certain_holds_the_mean_of_gains_alone(count):
    """Of motions that tell nothing, one gain is its own mean; of two, each is known to 0.2."""
    gains = ("actuator_gain:shoulder_motor", "actuator_gain:elbow_motor")
    model = torque_arm(*gains[:count])
    nothing = SimpleNamespace(
        covariance=lambda end, prior: np.linalg.inv(prior),
        change_by_step=lambda end, prior: np.zeros(count),
    )
    end = SimpleNamespace(free=model.fitted)
    search = FarOffSearch(SETTINGS, silent)
    beside = search._errors(model, nothing, end, search._prior(model, end, KNOWN))[model.fitted]
    apart = SETTINGS.scale / np.sqrt(2) if count == 2 else 0.0
    assert beside == pytest.approx(np.hypot(apart, SETTINGS.accuracy), rel=0.01)


def test_drives_that_differ_are_no_payload():
    """One gain for both and a payload give way to a gain of each, of which the elbow's is right."""
    problem = hide("torque-arm", ["actuator_gain:elbow_motor=0.3"], seed=0, threads=1)
    arm = torque_arm("actuator_gain", "payload:fore", problem=problem)
    explained = searched(arm, replace(SETTINGS, families=()))
    labels = [instance.label for instance, _ in explained.model.numbers]
    assert labels == ["actuator_gain:shoulder_motor", "actuator_gain:elbow_motor"]
    assert explained.certain == {"actuator_gain:elbow_motor"}
    assert explained.model.theta[-1] == pytest.approx(0.3, abs=4 * explained.errors[-1])


def test_a_payload_is_found_beside_gains_that_differ():
    """On its body, with its pull; where nothing is on it, there is none."""
    gains = ("actuator_gain:shoulder_motor", "actuator_gain:elbow_motor")
    loaded = hide("torque-arm", ["payload:fore=0.2,0.15,0,0"], seed=0, threads=1)
    search = FarOffSearch(SETTINGS, silent)
    arm = torque_arm(*gains, problem=loaded)
    found = search._with_payload(arm, search_sides(arm))
    ((instance, (mass, x, *_)),) = found.numbers[2:]
    assert instance.label == "payload:fore"
    assert mass * x == pytest.approx(0.2 * 0.15, rel=0.05)
    bare = torque_arm(*gains, problem=hide("torque-arm", [], seed=0, threads=1))
    assert search._with_payload(bare, search_sides(bare)) is bare


def test_numbers_begin_at_nothing_where_regression_is_worse_than_that():
    """A rotor of a hundred times its size is forgotten; the true one is not."""
    arm = torque_arm("joint_armature:elbow")
    search = FarOffSearch(SETTINGS, silent)
    wrong = arm.at(np.append(arm.declared, 100 * TRUTH))
    assert search._begun(wrong, search_sides(wrong)).theta[-1] == 0.0
    right = arm.at(np.append(arm.declared, TRUTH))
    assert search._begun(right, search_sides(right)) is right


def test_data_held_out_decide_nothing():
    """Others in their place, and all numbers are the same; other fitted data, and they are not."""
    problem = unknown_rotor()
    data = problem.trajectories
    half, first, last = (
        data.rows(np.flatnonzero(np.isin(data.trajectory % 4, some))) for some in ((2, 3), 0, 1)
    )
    free = np.zeros(0, dtype=np.int64)
    found = []
    for fitted, held_out in ((half, first), (half, last), (first, last)):
        given = replace(problem, trajectories=fitted, held_out=held_out)
        start = start_of(given, free, FarOffLimits(gain=0.0), QuickSettings()).far_off
        assert start.whole.held_out is held_out
        explained = FarOffSearch(SETTINGS, silent).run(start.model, start.whole)
        assert explained.model.problem.trajectories is fitted
        assert explained.model.problem.held_out is held_out
        found.append(explained.model.theta)
    np.testing.assert_array_equal(found[0], found[1])
    assert not np.array_equal(found[0], found[2])


def test_a_model_that_diverges_is_worse_and_misfits(monkeypatch):
    """Errors of any size on the way there, and of none behind, are no reason to doubt it."""
    search = FarOffSearch(SETTINGS, silent)
    model = torque_arm("joint_armature:elbow")
    other = model.without(["joint_armature:elbow"])
    sides = search_sides(model)
    usual = search._residuals

    def residuals(which, motions):
        found = usual(model, motions).copy()
        if which is other:
            found[:, found.shape[1] // 2 :] = np.nan
            found[0, found.shape[1] // 2 - 1] = 1e9
        return found

    monkeypatch.setattr(search, "_residuals", residuals)
    assert search._is_better(model, other, sides)
    assert not search._is_better(other, model, sides)
    monkeypatch.setattr(search, "_residuals", lambda *given: np.full_like(usual(*given), np.nan))
    assert search._is_misfit(other, sides.fitted)


def test_a_model_that_diverges_is_taken_in_steps_in_which_it_does_not(monkeypatch):
    """The cheapest; the control: one that does not is left as it is."""
    search = FarOffSearch(SETTINGS, silent)
    model = torque_arm("joint_armature:elbow")
    assert search._cut(model, SETTINGS.motions)[0] is model
    usual = search._error

    def error(which, motions):
        if which is model:
            return SimpleNamespace(residuals=lambda theta: np.full((1, 2, 3), np.nan))
        return usual(which, motions)

    monkeypatch.setattr(search, "_error", error)
    other, fitted, _ = search._cut(model, SETTINGS.motions)
    assert other.arithmetic is None
    cheapest = SETTINGS.steps.alternatives[0]
    assert integrator(other.library.simulator.model) == cheapest.integrator
    assert other.problem.simulator.steps_per_action == model.problem.simulator.steps_per_action
    assert len(fitted.windows)


@pytest.mark.parametrize(("gain", "kept"), [(0.5, False), (1.5, True), (3.0, True)])
def test_a_kind_is_left_out_within_one_standard_error(monkeypatch, gain, kept):
    """A loss of half a standard error is no reason to keep it; of one and a half it is, though a
    kind that gains as little would not be added.
    """
    search = FarOffSearch(SETTINGS, silent)
    model = torque_arm("joint_armature:elbow")
    # Taken twice, of windows held out and of those fitted: 16 pieces whose spread is 1.
    spread = np.sqrt(15 / 16) * np.array([-1.0, 1.0]).repeat(4)
    pieces = gain / np.sqrt(16) + spread
    monkeypatch.setattr(search, "_gains", lambda *arguments: (pieces, 1.0))
    sides = SimpleNamespace(held_out=None, few=None)
    assert (search._margin(model, model, sides, SETTINGS.needless) > 0) == kept
    assert search._is_better(model, model, sides) == (gain > SETTINGS.z)


@pytest.mark.parametrize(
    ("margins", "jacobians"),
    [
        ((-100.0, -60.0, 5.0), [1, 1, 2]),  # above 0: to the end
        ((-100.0, -80.0), [1]),  # three more such steps are too few
        ((-100.0, -60.0, -40.0), [1, 1]),
    ],
)
def test_a_fit_ends_where_the_steps_that_are_left_are_too_few(monkeypatch, margins, jacobians):
    """Each that is left is taken to gain as much as the last."""
    search = FarOffSearch(replace(SETTINGS, rough_fit=replace(ROUGH, jacobians=4)), silent)
    taken = []

    def fit(model, motions, settings):
        taken.append(settings.jacobians)
        return model

    monkeypatch.setattr(search, "_fit", fit)
    left = iter(margins)
    search._fit_toward(None, SimpleNamespace(few=None), lambda model: next(left))
    assert taken == jacobians


@pytest.mark.parametrize(
    ("mass", "gain", "stays"), [(0.3, -0.2, True), (0.3, -0.02, False), (-0.1, 0.2, False)]
)
def test_a_mass_that_a_gain_makes_up_for_stays(monkeypatch, mass, gain, stays):
    """Though no data ask for it. Controls: a gain that hardly moves, and a mass taken away."""
    search = FarOffSearch(SETTINGS, silent)
    model = torque_arm("actuator_gain", "body_mass:fore")
    theta = model.theta.copy()
    theta[-1] = mass
    model = model.at(theta)
    moved = theta.copy()
    moved[-2] = gain
    monkeypatch.setattr(search, "_margin", lambda *given: -1.0)
    monkeypatch.setattr("dropo.diagnosis.far_off.search._theta_without", lambda *given: moved)
    monkeypatch.setattr(search, "_fit", lambda model, motions, settings: model)
    found = search._without_needless(model, search_sides(model))
    assert (len(found.numbers) == 2) == stays


def test_kinds_that_are_needed_together_are_added_together(monkeypatch):
    """Each is refused alone; both are not."""
    search = FarOffSearch(SETTINGS, silent)
    arm = torque_arm()
    tried = []

    def better(model, other, sides):
        added = {instance.effect for instance, _ in other.numbers}
        tried.append(added)
        return other if len(added) == 2 else model

    monkeypatch.setattr(search, "_is_misfit", lambda model, motions: True)
    monkeypatch.setattr(search, "_better", better)
    found = search._with_families(arm, SimpleNamespace(fitted=None))
    assert tried == [{"joint_armature"}, {"actuator_bias"}, {"joint_armature", "actuator_bias"}]
    assert len(found.numbers) == 4


@pytest.mark.parametrize("begun", ["actuator_lag", "actuator_delay"])
@pytest.mark.parametrize("late", ["actuator_lag", "actuator_delay"])
def test_commands_lag_or_are_late_as_the_machines_do(late, begun):
    """Whichever the search begins with, and its size within its error."""
    problem = hide("torque-arm", [f"{late}:elbow_motor=0.03"], seed=0, threads=1)
    arm = torque_arm(f"{begun}:elbow_motor", problem=problem)
    explained = searched(arm.at(np.append(arm.declared, 0.03)), replace(SETTINGS, families=()))
    ((instance, (size,)),) = explained.model.numbers
    assert instance.effect == late
    assert size == pytest.approx(0.03, abs=4 * explained.errors[-1])
