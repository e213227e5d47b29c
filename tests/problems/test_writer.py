"""Problems written as files are the problems that were written."""

from dataclasses import replace

import numpy as np
import pytest

from dropo import Diagnose, fit, hide
from dropo.core.services.errors import BadFile, Incompatible, InvalidInput
from dropo.core.services.files.strict_yaml import format_yaml, read_yaml
from dropo.core.services.registry import find, names
from dropo.diagnosis.search.library import declared
from dropo.effects.law import law_of_text
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.file.writer import write_problem
from dropo.problems.loading import load
from dropo.problems.simulated.slide import slide
from tests.models.hidden_in_arm import UPPER, instance, problem, with_tendon

DIGITS = 2e-5  # relative: MJCF is written with six digits, and five steps add up


@pytest.fixture(scope="module")
def arm():
    """An arm with a declared mass, a little data, and data held out."""
    found = problem([], parameters=[UPPER], episodes=4, steps=24)
    return replace(
        found,
        held_out=problem([], parameters=[UPPER], episodes=2, steps=12, seed=1).trajectories,
        epsilon=1e-6,
    )


def predicted(found):
    """(R, p) what a problem's simulator gives for its own data, its parameters a little off."""
    return found.simulator.predict(
        np.asarray(found.simulator.nominal)[None] * 1.1, found.trajectories.segments(5)
    )[0]


def written(found, folder):
    """The problem, there and back."""
    return load(write_problem(found, folder), threads=1)


def test_everything_comes_back(arm, tmp_path):
    """Data bit for bit, parameters, noise, and predictions to the digits of MJCF."""
    back = written(arm, tmp_path)
    for name in ("observations", "actions", "next_observations", "terminals"):
        np.testing.assert_array_equal(
            getattr(back.trajectories, name), getattr(arm.trajectories, name)
        )
        np.testing.assert_array_equal(getattr(back.held_out, name), getattr(arm.held_out, name))
    assert [b.parameter for b in back.simulator.bindings] == [
        b.parameter for b in arm.simulator.bindings
    ]
    assert (back.epsilon, back.start_noise, back.horizon) == (
        arm.epsilon,
        arm.start_noise,
        arm.horizon,
    )
    np.testing.assert_allclose(predicted(back), predicted(arm), rtol=DIGITS, atol=DIGITS)


def test_whole_runs_come_back(arm, tmp_path):
    """A problem that asks for them asks again; the others do not."""
    asking = replace(arm, whole_runs=True)
    assert written(asking, tmp_path / "a").whole_runs
    assert not written(arm, tmp_path / "b").whole_runs


@pytest.mark.parametrize("effect", names("effects"))
def test_effects_come_back(effect, arm, tmp_path):
    """With each effect at its first and last place: the same predictions, far closer than those
    without the effect.
    """
    arm = with_tendon(arm) if effect.startswith("tendon") else arm
    every = find("effects", effect)(arm.simulator.effect_context)
    plain = predicted(arm)
    instances = [one for one in every if not declared(arm.simulator, one)]
    if effect == "law":
        instances = [law_of_text(arm.simulator.effect_context, "elbow:-0.05 * c * abs(v) * v")]
    for i, one in enumerate(
        {instances[0].label: instances[0], instances[-1].label: instances[-1]}.values()
    ):
        fixed = [(one, np.sum(one.trials[-1], axis=0))]
        has = replace(arm, simulator=arm.simulator.with_effects((), fixed))
        there = predicted(has)
        back = predicted(written(has, tmp_path / str(i)))
        np.testing.assert_allclose(back, there, rtol=5 * DIGITS, atol=5 * DIGITS)
        moved = np.abs(there - plain).max()
        assert moved < 1e-12 or np.abs(back - there).max() < 0.02 * moved


def test_a_relative_parameter_and_one_of_an_option_come_back(arm, tmp_path):
    """A factor on a mass, with the derived constants kept, and the strength of gravity."""
    ours = (
        FieldParameter(
            "share", 0.5, 2.0, field="body_mass", element="fore", relative=True, derived=False
        ),
        FieldParameter("gravity", -12.0, -8.0, "m/s^2", field="gravity", index=2),
    )
    found = problem([], parameters=ours, episodes=4, steps=24)
    back = written(found, tmp_path)
    assert [b.parameter for b in back.simulator.bindings] == [
        b.parameter for b in found.simulator.bindings
    ]
    np.testing.assert_allclose(predicted(back), predicted(found), rtol=DIGITS, atol=DIGITS)


def test_exact_physics_steps_come_back(arm, tmp_path):
    """The step and the integrator stand in the model: predictions are the same."""
    exact = replace(arm, simulator=arm.simulator.with_finer_steps(2).with_integrator("RK4"))
    back = written(exact, tmp_path)
    assert back.simulator.control_step == pytest.approx(arm.simulator.control_step)
    np.testing.assert_allclose(predicted(back), predicted(exact), rtol=DIGITS, atol=DIGITS)
    assert not np.allclose(predicted(back), predicted(arm), rtol=DIGITS, atol=DIGITS)


def test_effects_stand_in_mjcf_where_it_has_them(arm, tmp_path):
    """Damping is a number of the model; a delay stands in the problem file."""
    has = replace(
        arm,
        simulator=arm.simulator.with_effects(
            (),
            [
                (instance(arm.simulator, "joint_damping:elbow"), np.array([0.25])),
                (instance(arm.simulator, "actuator_delay"), np.array([0.007])),
            ],
        ),
    )
    content = read_yaml(write_problem(has, tmp_path), "a problem file")
    assert content["effects"] == [
        {"effect": "actuator_delay", "target": None, "sizes": {"delay": 0.007}}
    ]
    assert 'damping="0.3"' in (tmp_path / "model.xml").read_text()


@pytest.mark.parametrize(
    ("entry", "told"),
    [
        ({"effect": "joint_dampin"}, "joint_damping"),
        ({"effect": "joint_damping", "target": "elbo", "sizes": {"damping": 1}}, "elbow"),
        ({"effect": "joint_damping", "target": "elbow", "sizes": {"dampin": 1}}, "damping"),
        (
            {"effect": "joint_damping", "target": "elbow", "variant": "x", "sizes": {"damping": 1}},
            "variant",
        ),
        (
            {"effect": "joint_damping", "target": "elbow", "fit": {"damping": [2, 1]}},
            r"effects\[0\].fit.damping.*\[low, high\] between",
        ),
        (
            {
                "effect": "joint_damping",
                "target": "elbow",
                "fit": {"damping": [0, 1]},
                "sizes": {"damping": 1},
            },
            "either sizes, or fit",
        ),
        ({"effect": "joint_damping", "target": "elbow"}, "neither"),
        ("joint_damping", "list of mappings"),
    ],
)
def test_wrong_entries_are_refused(arm, tmp_path, entry, told):
    """A misspelt effect, place, quantity or variant in `effects` is refused with what was meant."""
    path = write_problem(arm, tmp_path)
    path.write_text(path.read_text() + format_yaml({"effects": [entry]}))
    with pytest.raises(BadFile, match=told):
        load(path)


def test_effects_are_fitted_as_parameters(tmp_path):
    """Dry friction and a command's latency of an arm, beside its masses: found within four standard
    errors, kept by the writer, and fitted along by a diagnosis, which then misses nothing;
    without them something is missing.
    """
    hidden = hide(
        "torque-arm",
        ["joint_friction:elbow=0.12", "actuator_delay:shoulder_motor=0.008"],
        threads=1,
    )
    path = write_problem(hidden, tmp_path)
    entries = [
        {"effect": "joint_friction", "target": "elbow", "fit": {"frictionloss": [0, 0.5]}},
        {"effect": "actuator_delay", "target": "shoulder_motor", "fit": {"delay": [0, 0.02]}},
    ]
    path.write_text(path.read_text() + format_yaml({"effects": entries}))
    arm = load(path, threads=1)
    assert arm.space.names[2:] == (
        "joint_friction:elbow/frictionloss",
        "actuator_delay:shoulder_motor/delay",
    )
    found = fit(arm.using(horizon=5, transitions=200))
    assert np.all(np.abs(found.mean - [1.0, 0.6, 0.12, 0.008]) < 4 * found.mean_se)
    assert np.all(found.mean_se < [2e-3, 2e-3, 2e-3, 2e-4])
    again = read_yaml(write_problem(arm, tmp_path / "again"), "a problem file")
    assert again["effects"] == entries
    told = Diagnose(["joint_damping"], length=5, windows=12, disturbances=False).run(arm)
    assert told.verdict == "consistent"
    assert told.parameters["joint_friction:elbow/frictionloss"] == pytest.approx(0.12, rel=0.02)
    lacking = Diagnose(["joint_damping"], length=5, windows=12, disturbances=False).run(hidden)
    assert lacking.verdict in ("partly", "unexplained")


def test_other_simulators_cannot_be_written(tmp_path):
    """Nothing is left behind."""
    with pytest.raises(Incompatible, match="MuJoCo"):
        write_problem(slide(), tmp_path / "x")
    assert not (tmp_path / "x").exists()
    assert issubclass(Incompatible, InvalidInput)
