"""A whole diagnosis, on the arm with two joints."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dropo import Diagnose, diagnose
from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, Incompatible, SimulationFailed, UnknownName
from dropo.problems.simulated.slide import slide
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.studies.benchmark.answers import causes_of
from tests.models.hidden_in_arm import SOME, UPPER, problem

FAST = Diagnose((*SOME, "sensor_bias", "body_mass"), windows=16)
FEW = Diagnose(
    ("joint_damping", "joint_stiffness", "actuator_gain", "actuator_delay", "body_mass"),
    length=5,
    windows=16,
    disturbances=False,
)
CONTRACT = {
    "": {
        "verdict",
        "causes",
        "suspects",
        "leaders",
        "alternatives",
        "baseline",
        "extended",
        "remaining",
        "extended_problem",
        "seed",
        "version",
        "wall_time_s",
    },
    "cause": {
        "effect",
        "target",
        "rank",
        "estimate",
        "p_value",
        "held_out_gain",
        "held_out_gain_se",
        "rmse_before",
        "rmse_after",
        "confused_with",
        "stability",
    },
    "side": {"held_out_log_likelihood", "rmse", "horizons_s"},
    "remaining": {"calibrated", "p_value", "where"},
}
BESIDE = {
    "headline",
    "problem",
    "noise",
    "warnings",
    "simulator_steps",
    "pictures",
    "nominal",
    "undetermined",
    "detectable",
    "learned",
    "numerics",
    "to_type",
    "window_steps",
    "disturbances",
    "odd_runs",
    "replay",
    "parameters",
    "status",
}


@pytest.fixture(scope="module")
def damped():
    """The diagnosis of an arm whose elbow has 0.05 N m s/rad more damping than its model."""
    return FAST.run(problem([("joint_damping:elbow", [0.05])]))


def test_hidden_damping_is_named_with_its_size(damped):
    """Kind, place, size within four standard errors and 2 %, and nothing else; the errors fall to
    what noise gives.
    """
    assert damped.verdict == "explained"
    (cause,) = damped.causes
    assert (cause.effect, cause.target, cause.acts_like) == ("joint_damping", "elbow", None)
    told = cause.estimate["damping"]
    assert abs(told.value - 0.05) < 4 * told.se < 0.02 * 0.05 * 4
    assert told.model == 0.05
    assert damped.gain == pytest.approx(cause.held_out_gain, rel=1e-6)
    assert cause.rmse_after < 0.5 * cause.rmse_before
    assert (
        damped.extended.horizons[1].rmse
        < 1.5 * damped.extended.horizons[1].noise
        < damped.baseline.horizons[1].rmse
    )
    np.testing.assert_allclose(list(damped.noise.values()), 1e-3, rtol=0.25)


def test_headline_says_it_in_words(damped):
    """The error, the cause with its number and unit, and the verdict; one paragraph."""
    text = damped.headline()
    assert text.startswith("On held-out data the simulation is off by")
    assert "Cause: joint damping at elbow, damping +0.0" in text
    assert "N m s/rad" in text
    assert text.endswith("After adding it, nothing remains unexplained.")
    printed = str(damped).split("\n")
    assert printed[0] == text[: len(printed[0])]
    assert printed[1].startswith("Cause: joint damping at elbow")
    assert printed[2] == "After adding it, nothing remains unexplained."
    typed = next(line for line in printed if line.startswith('  <joint name="elbow" damping='))
    assert "was damping=" in typed


def test_what_explains_in_part_is_not_called_the_cause(damped):
    """Where something remains, another cause may be behind it."""
    partly = replace(damped, verdict="partly")
    text = partly.headline()
    assert "Acts like: joint damping at elbow" in text
    assert "Cause:" not in text
    assert (damped.stated, partly.stated) == (damped.causes, ())
    assert replace(damped, interrupted=True).stated == ()


def test_every_output_states_the_same_causes(damped):
    """JSON, data frame and answers to the benchmark name as causes what the headline does."""
    partly = replace(damped, verdict="partly")
    for found, stated in ((damped, True), (partly, False)):
        assert [one["stated"] for one in found.to_json()["causes"]] == [stated]
        assert found.to_pandas()["stated"].tolist() == [stated]
        assert len(causes_of(found)) == int(stated)


def test_json_is_the_contracts(damped, tmp_path):
    """Every key of the contract, and besides them only those listed here; numbers are finite;
    p-values are never 0.
    """
    damped.save(tmp_path)
    found = json.loads((tmp_path / "diagnosis.json").read_text())
    assert set(found) == CONTRACT[""] | BESIDE
    (cause,) = found["causes"]
    assert set(cause) == CONTRACT["cause"] | {"variant", "acts_like", "stated"}
    assert set(cause["estimate"]["damping"]) == {
        "value",
        "se",
        "unit",
        "model",
        "interval",
        "degrees",
    }
    assert 0 < cause["p_value"] < 1e-6  # a few blocks alone: by Student's t
    for side in ("baseline", "extended"):
        assert set(found[side]) == CONTRACT["side"] | {"horizons"}
        assert list(found[side]["rmse"]) == ["1", "5", "20"]
    assert set(found["remaining"]) == CONTRACT["remaining"] | {"forces"}
    assert found["remaining"]["calibrated"]
    assert found["extended_problem"] == "extended/problem.yaml"


def test_extended_problem_has_nothing_left(damped):
    """Diagnosed again, the extended problem is consistent."""
    assert FAST.run(damped.problem).verdict == "consistent"


def test_same_answer_on_any_number_of_threads():
    """One thread and two give the same numbers, bit for bit."""
    one = problem([("joint_damping:elbow", [0.02])])
    two = problem([("joint_damping:elbow", [0.02])])
    two.simulator.threads = 2
    two.simulator._start_threads()
    found = [
        Diagnose(("joint_damping", "joint_friction"), windows=12).run(p).to_json()
        for p in (one, two)
    ]
    for part in found:
        del part["wall_time_s"]
    assert found[0] == found[1]


def test_nothing_hidden():
    """Consistent, and no cause."""
    found = FAST.run(problem([], seed=1))
    assert (found.verdict, found.causes) == ("consistent", ())
    assert "nothing is missing" in found.headline()


def test_data_without_noise():
    """Exact data: consistent where nothing is hidden, and an effect of a thousandth of a bias is
    named; numbers stay finite.
    """
    assert FEW.run(problem([], sigma=0.0)).verdict == "consistent"
    found = FEW.run(problem([("joint_damping:elbow", [1e-4])], sigma=0.0))
    assert [(c.effect, c.target) for c in found.causes] == [("joint_damping", "elbow")]
    assert found.causes[0].estimate["damping"].value == pytest.approx(1e-4, rel=1e-3)


def test_masses_fitted_at_the_same_time():
    """A declared mass off by a fifth is fitted, and the damping hidden beside it is named."""
    found = FEW.run(problem([("joint_damping:elbow", [0.05])], parameters=[UPPER], truth=[1.2]))
    assert [(c.effect, c.target) for c in found.causes] == [("joint_damping", "elbow")]
    assert found.causes[0].estimate["damping"].value == pytest.approx(0.05, rel=0.05)


def test_declared_parameter_that_is_off_is_no_missing_effect():
    """With the mass declared nothing is missing; without, the mass is the cause."""
    assert FEW.run(problem([], parameters=[UPPER], truth=[1.2])).verdict == "consistent"
    found = FEW.run(problem([("body_mass:upper", [0.2])]))
    assert [(c.effect, c.target) for c in found.causes] == [("body_mass", "upper")]


def test_one_trajectory_is_split_in_time():
    """A single trajectory of 900 steps."""
    found = FEW.run(problem([("actuator_gain:elbow_motor", [-0.1])], episodes=1, steps=900))
    assert [(c.effect, c.target) for c in found.causes] == [("actuator_gain", "elbow_motor")]


def test_white_torque_noise_is_said_to_be_forces():
    """Random torques behind the clamp: no effect is named, forces at both joints are unexplained,
    about as large as they are.
    """
    drawn = np.random.default_rng(0).standard_normal((200, 2))
    drawn -= drawn.mean(axis=0)  # else it has a constant load in it, which is named
    push = lambda commands, step, sizes: (
        commands
        + sizes[0] * np.resize(np.roll(drawn, int(1e6 * commands[0, 0]), axis=0), commands.shape)
    )
    noise = EffectInstance("white", None, (Quantity("sd", "1", 0, 1, (0.1,)),), actuation=push)
    found = FAST.run(problem([(noise, [0.1])]))
    assert (found.verdict, found.causes) == ("unexplained", ())
    assert "forces of" in " ".join(found.remaining.where)
    expected = {
        "shoulder [N m]": 0.8 / 2,
        "elbow [N m]": 0.4 / 2,
    }  # gear times sd, the mean of four physics steps
    for name, sd in expected.items():
        assert found.remaining.forces[name] == pytest.approx(sd, rel=0.3)


def test_true_cause_left_out_of_the_search():
    """What is named instead is not all: the verdict says so, or that it acts like the cause."""
    found = FEW.run(problem([("joint_friction:elbow", [0.15])]))
    assert found.verdict in ("partly", "unexplained")


def test_delay_stands_for_sensors_too():
    """Delays of all commands and of all sensors are the same in recorded data; it says so."""
    some = Diagnose(("joint_damping", "actuator_delay"), windows=14, disturbances=False)
    found = some.run(problem([("actuator_delay", [0.01])]))
    assert (found.causes[0].effect, found.causes[0].target) == ("actuator_delay", None)
    # A simulation acts up to half a physics step early.
    step = found.problem.simulator.model.opt.timestep
    assert found.causes[0].estimate["delay"].se > step / np.sqrt(12)
    assert found.causes[0].estimate["delay"].value == pytest.approx(0.01, rel=0.02)
    assert any(c.effect == "sensor_delay" for c in found.causes[0].confused_with)


# What is refused


def test_unknown_effects_and_places_are_refused_with_the_nearest():
    """A misspelt effect, a place that is not there, one that is declared, and a simulator without
    effects.
    """
    arm = problem([], episodes=4, steps=60)
    with pytest.raises(UnknownName, match="Did you mean 'joint_damping'"):
        diagnose(arm, ["joint_dampin"])
    with pytest.raises(UnknownName, match="Did you mean 'elbow'"):
        diagnose(arm, ["joint_damping:elbo"])
    with pytest.raises(Incompatible, match="needs a MuJoCo model"):
        diagnose(slide())
    with pytest.raises(
        BadArgument, match=r"'problem' of diagnose must be a Problem, which dropo.load makes"
    ):
        diagnose("hopper")
    declared = problem([], parameters=[UPPER], episodes=4, steps=60)
    with pytest.raises(BadArgument, match="declared as parameters"):
        diagnose(declared, ["body_mass:upper"])


def test_unfit_data_are_refused():
    """A constant signal by its name, and too few windows with the number needed."""
    arm = problem([], episodes=6, steps=60)
    data = arm.trajectories
    still = np.array(data.observations)
    after = np.array(data.next_observations)
    still[:, 1] = after[:, 1] = 0.3
    with pytest.raises(BadArgument, match=r"qpos.elbow.*stuck"):
        diagnose(
            Problem(
                "stuck", arm.simulator, Trajectories(still, data.actions, after, data.terminals)
            ),
            ["joint_damping"],
        )
    with pytest.raises(BadArgument, match="at least 8 windows"):
        diagnose(problem([], episodes=1, steps=12))
    with pytest.raises(BadArgument, match="length"):
        Diagnose(length=0).run(arm)


def test_diverging_model_is_refused():
    """A spring far too stiff for its time step."""
    xml = """<mujoco><option timestep="0.05" integrator="Euler"/><worldbody><body>
      <joint name="j" type="slide" axis="1 0 0" stiffness="1e9"/>
      <geom size="0.1" mass="1"/></body></worldbody>
      <actuator><motor joint="j"/></actuator></mujoco>"""
    simulator = MujocoSimulator(mujoco.MjSpec.from_string(xml), [], frame_skip=20, threads=1)
    rng = np.random.default_rng(0)
    n = 400
    data = Trajectories(
        rng.normal(size=(n, 2)),
        rng.normal(size=(n, 1)),
        rng.normal(size=(n, 2)),
        np.arange(n) % 40 == 39,
    )
    with pytest.raises(SimulationFailed, match=r"diverges in .* of the windows"):
        diagnose(Problem("stiff", simulator, data), ["joint_damping"])
