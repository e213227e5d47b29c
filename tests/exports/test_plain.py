"""The target `mujoco` is run as it is written, by mujoco and numpy alone."""

import subprocess
import sys

import mujoco
import numpy as np
import pytest

from dropo.exports.export import export
from dropo.exports.plain import writer_of
from dropo.exports.support.subject import subject_of_fit
from dropo.mjmodel.fields import FieldParameter
from dropo.mjmodel.numbers import changed_numbers
from dropo.problems.file.plain_model import active_effects
from tests.exports.conftest import (
    ERRORS,
    MASS,
    MEANS,
    SCALES,
    arm_problem,
    beyond,
    known_fit,
    run_file,
)

DRAWS = 4000
BOUND = 4.5
"""Standard errors, of a dozen comparisons."""
SAME = 1e-12
CUT_SD = 0.8796
"""Of a normal distribution cut at two standard deviations."""


@pytest.fixture(scope="module")
def written(arm, tmp_path_factory):
    """The folder of an export of the arm's fit, and what its randomize.py defines."""
    problem, fit = arm
    folder = tmp_path_factory.mktemp("arm")
    export(fit, "mujoco", folder, problem=problem)
    return folder, run_file(folder / "randomize.py")


def differences(one, other):
    """The fields in which two models differ by more than rounding, with the largest difference."""
    found = {}
    for name, numbers in changed_numbers(one, other).items():
        owner, field = (one.opt, name[4:]) if name.startswith("opt.") else (one, name)
        off = np.abs(np.asarray(getattr(owner, field)) - numbers)
        if np.max(off) > SAME * max(1.0, np.abs(numbers).max()):
            found[name] = float(np.max(off))
    return found


def test_the_model_at_the_means(arm, written):
    """Every number of it is that of the simulator, though MJCF has six digits."""
    problem, fit = arm
    model = written[1]["load"]()
    assert differences(model, problem.simulator.model_of(fit.mean)) == {}
    rounded = mujoco.MjModel.from_xml_path(str(written[0] / "model.xml"))
    assert differences(rounded, problem.simulator.model_of(fit.mean)) != {}


def test_draws_are_over_spread_and_ignorance(written):
    """Means and standard deviations are those fitted; the controls lack the errors of means."""
    model = written[1]["load"]()
    rng = np.random.default_rng(0)
    draws = np.array([list(written[1]["randomize"](model, rng).values()) for _ in range(DRAWS)])
    sd = np.sqrt((CUT_SD * SCALES) ** 2 + ERRORS**2)
    assert beyond(draws, MEANS, sd) < BOUND
    assert beyond(draws, MEANS, CUT_SD * SCALES) > BOUND
    assert beyond(draws, MEANS + 0.2 * sd, sd) > BOUND


def test_a_draw_sets_every_number(arm, written):
    """All of the model, derived constants too, is as the simulator has it, draw after draw; the
    control has the constants of the means.
    """
    problem, fit = arm
    model = written[1]["load"]()
    rng = np.random.default_rng(1)
    for _ in range(3):
        values = np.array(list(written[1]["randomize"](model, rng).values()))
        assert differences(model, problem.simulator.model_of(values)) == {}
    assert {"body_mass", "body_subtreemass", "dof_invweight0", "opt.gravity"} <= set(
        differences(model, problem.simulator.model_of(fit.mean))
    )


def test_effects_and_kept_constants(tmp_path):
    """Effects that were fitted or fixed act on each draw once; `derived: keep` keeps constants."""
    kept = FieldParameter(
        "fore", 0.1, 2.0, field="body_mass", element="lower", derived=False, relative=True
    )
    free = ("joint_friction:elbow", "payload:lower", "actuator_gain:push", "actuator_lag:servo")
    absent = ("actuator_deadband:push", [0.0])
    fixed = [("body_mass:upper", [0.2]), ("actuator_delay:push", [0.006]), absent]
    problem = arm_problem((MASS, kept), free, fixed)
    means = np.array([1.3, 1.1, 0.0, 0.3, 0.05, 0.02, -0.1, 0.2, 0.02])
    spreads = np.where(means == 0, 0.05, 0.05 * np.abs(means))
    fit = known_fit(problem, means, spreads, 0.2 * spreads)
    found = export(fit, "mujoco", tmp_path, problem=problem)
    assert found.left_out == (
        "The spread of actuator_lag:servo/time constant is left out: actuator_lag:servo is no "
        "number of a model, and model.py has it at its mean.",
    )
    made = run_file(tmp_path / "randomize.py")
    simulator = problem.simulator
    model = made["load"]()
    rng = np.random.default_rng(2)
    for _ in range(3):
        values = np.array(list(made["randomize"](model, rng).values()))
        assert values[2] >= 0
        whole = simulator.model_of(values, active_effects(simulator, values))
        assert differences(model, whole) == {}
    text = (tmp_path / "model.py").read_text()
    assert "actuator_lag:servo: time constant 0.02 s" in text
    assert "actuator_delay:push: delay 0.006 s" in text
    assert "actuator_deadband" not in text


def test_it_runs_without_this_package(written):
    """In a process that cannot import it, the robot of model.py moves with a drawn model."""
    code = (
        "import sys; sys.modules['dropo'] = None; sys.path.insert(0, '.')\n"
        "import numpy as np, randomize, model as robot\n"
        "m = randomize.load(); print(randomize.randomize(m, np.random.default_rng(0))['mass'])\n"
        "r = robot.Robot(m, robot.FRAME_SKIP, robot.EFFECTS); r.step(np.zeros(2))\n"
        "print(r.data.qpos[0])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=written[0], capture_output=True, text=True, check=True
    )
    mass, moved = map(float, done.stdout.split())
    assert 0.9 < mass < 1.7
    assert mass != MEANS[0]
    assert moved > 0


def test_a_parameter_writer_sets_what_the_simulator_would():
    """Declared numbers with kept and with derived constants, effects with free and with fixed
    sizes, options: all as in the simulator's own model, and nothing adds up from draw to draw.
    """
    kept = FieldParameter(
        "fore", 0.1, 2.0, field="body_mass", element="lower", derived=False, relative=True
    )
    gravity = FieldParameter("gravity", -15.0, -5.0, field="gravity", index=2)
    air = FieldParameter("air", 0.0, 5.0, field="density")
    free = ("joint_friction:elbow", "payload:lower", "actuator_gain:push")
    problem = arm_problem((MASS, kept, gravity, air), free, [("body_mass:upper", [0.2])])
    means = np.array([1.3, 1.1, -9.7, 1.2, 0.0, 0.3, 0.05, 0.02, -0.1, 0.2])
    spreads = np.full(len(means), 0.05)
    subject = subject_of_fit(known_fit(problem, means, spreads, spreads), problem)
    writer = writer_of(subject)
    assert writer.count == 4
    simulator = problem.simulator
    model = simulator.model_of(means, active_effects(simulator, means))
    rng = np.random.default_rng(3)
    for _ in range(3):
        values = means + np.abs(0.05 * rng.standard_normal(len(means)))
        writer.write(model, values)
        whole = simulator.model_of(values, active_effects(simulator, values))
        assert differences(model, whole) == {}
    writer.write(model, means)
    off = differences(model, whole)
    assert {"body_mass", "dof_frictionloss", "opt.gravity", "opt.density"} <= set(off)


def test_an_effect_on_sensors_alone_is_said_to_be_left_out(tmp_path):
    problem = arm_problem((MASS,), fixed=[("sensor_bias:qpos.shoulder", [0.1])])
    fit = known_fit(problem, MEANS[:1], SCALES[:1], ERRORS[:1])
    found = export(fit, "mujoco", tmp_path, problem=problem)
    assert found.left_out[-1].endswith("is left out: it acts on what sensors say alone.")
