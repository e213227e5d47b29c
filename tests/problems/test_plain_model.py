"""An extended model in plain MuJoCo moves like the one that was fitted."""

import subprocess
import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadFile
from dropo.core.services.registry import find, names
from dropo.diagnosis.search.library import declared
from dropo.effects.law import law_of_text
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.file.plain_model import write_extended
from dropo.problems.file.verification import PlainRollout
from dropo.problems.loading import load
from dropo.problems.simulated.robots import simulated_robot
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.models.hidden_in_arm import UPPER, instance, problem, with_tendon

SAME = 1e-9
ROUNDED = 1e-5
"""What changes through the data changes the numbers of model.xml, which have six digits."""
MASS = 1.23456789
LAWS = (
    "-0.05 * c * abs(v) * v",
    "0.1 * d * t - 0.1 * c * dahl(x) - 0.1 * f * abs(load) * lag(v, T)",
)
"""Laws, of small forces where their constants are 1."""
WINDOWS = np.array([0, 7, 12, 24, 31, 38, 48])


@pytest.fixture(scope="module")
def arm():
    """An arm with a declared mass, and a little data."""
    return problem([], parameters=[UPPER], episodes=3, steps=24)


def with_effect(arm, one):
    """The arm with an effect at its largest trial."""
    fixed = [(one, np.sum(one.trials[-1], axis=0))]
    return replace(arm, simulator=arm.simulator.with_effects((), fixed))


def both(found, folder, mass=MASS):
    """What the simulator and plain MuJoCo predict of the same windows, and the former with another
    mass.
    """
    write_extended(found, {"upper_mass": mass}, folder)
    back = load(folder / "problem.yaml", threads=1).simulator
    windows = found.trajectories.from_rows(WINDOWS, 5)
    ours, off = found.simulator.predict(np.array([[mass], [1.001 * mass]]), windows)
    rollout = PlainRollout(back, np.asarray(back.nominal), folder, trusted=False)
    return ours, rollout.predict(windows), off


@pytest.mark.parametrize("effect", names("effects"))
def test_every_effect_is_there(effect, arm, tmp_path):
    """At its first and last place; the control: a mass of 0.1 % more is another motion."""
    arm = with_tendon(arm) if effect.startswith("tendon") else arm
    every = find("effects", effect)(arm.simulator.effect_context)
    instances = [one for one in every if not declared(arm.simulator, one)]
    if effect == "law":
        context = arm.simulator.effect_context
        instances = [law_of_text(context, f"elbow:{text}") for text in LAWS]
    for i, one in enumerate((instances[0], instances[-1])):
        ours, plain, off = both(with_effect(arm, one), tmp_path / str(i))
        same = ROUNDED if one.time_profile else SAME
        np.testing.assert_allclose(plain, ours, rtol=0, atol=same)
        assert np.abs(off - ours).max() > 10 * same


def test_it_runs_without_this_package(arm, tmp_path):
    """In a process that cannot import it: commands held, one control step after another, as in the
    simulator's own replay.
    """
    late = with_effect(arm, instance(arm.simulator, "actuator_delay"))
    write_extended(late, {"upper_mass": MASS}, tmp_path)
    run = late.trajectories.select(0)
    np.savez(tmp_path / "run.npz", observations=run.observations, actions=run.actions)
    code = (
        "import sys; sys.modules['dropo'] = None\n"
        "import model, numpy as np\n"
        "run = np.load('run.npz'); robot = model.load()\n"
        "robot.reset(*np.split(run['observations'][0], 2))\n"
        "for command in run['actions']: robot.step(command)\n"
        "print(*robot.data.qpos, *robot.data.qvel)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    ours = late.simulator.predict(np.array([[MASS]]), run.segments(reset="start"))[0, -1]
    np.testing.assert_allclose(np.array(done.stdout.split(), dtype=float), ours, atol=1e-9)


def test_fitted_parameters_are_in_the_model(tmp_path):
    """Those of fields in model.xml to its six digits; bounds of a factor follow; a free effect has
    its size in model.py, and its bounds in the problem file.
    """
    ours = (
        FieldParameter("fore", 0.1, 2.0, "kg", field="body_mass", element="fore"),
        FieldParameter("share", 0.5, 2.0, field="body_mass", element="upper", relative=True),
    )
    found = problem([], parameters=ours, episodes=3, steps=24)
    free = instance(found.simulator, "actuator_lag:elbow_motor")
    found = replace(found, simulator=found.simulator.with_effects([free]))
    values = {"fore": 0.7654321, "share": 1.25, free.parameters[0].name: 0.01}
    write_extended(found, values, tmp_path)
    back = load(tmp_path / "problem.yaml", threads=1).simulator
    whole = found.simulator.model.body("upper").mass[0]
    assert back.nominal[:2] == pytest.approx([0.7654321, 1.0], rel=1e-5)
    assert back.model.body("upper").mass[0] == pytest.approx(1.25 * whole, rel=1e-5)
    assert (back.space.low[1], back.space.high[1]) == (0.4, 1.6)
    assert "actuator_lag:elbow_motor: time constant 0.01 s" in (tmp_path / "model.py").read_text()
    windows = found.trajectories.from_rows(WINDOWS, 5)
    theirs = PlainRollout(back, np.array([0.7654321, 1.0, 0.01]), tmp_path, trusted=False)
    expected = found.simulator.predict(np.array([list(values.values())]), windows)[0]
    np.testing.assert_allclose(theirs.predict(windows), expected, atol=SAME)


def test_contacts_and_a_floating_base(tmp_path):
    """The half-cheetah's, whose model has names for few of its parts."""
    robot = simulated_robot("half-cheetah", ())
    found = problem([], name="half-cheetah", episodes=2, steps=20)
    write_extended(found, {}, tmp_path)
    windows = found.trajectories.from_rows(WINDOWS[:2], 10)
    ours = robot.simulator.predict(np.zeros((1, 0)), windows)[0]
    back = load(tmp_path / "problem.yaml", threads=1).simulator
    plain = PlainRollout(back, np.zeros(0), tmp_path, trusted=False).predict(windows)
    np.testing.assert_allclose(plain, ours, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("model.npz", b"PK", "model.xml and model.npz as"),
        ("model.npz", None, "model.xml and model.npz as"),
        ("model.py", b"print('run')", "what this version of dropo writes"),
        ("model.py", None, "a model in plain MuJoCo"),
    ],
)
def test_broken_files_are_refused(arm, tmp_path, capsys, name, content, told):
    """Nothing that is not written by dropo is run."""
    write_extended(arm, {}, tmp_path)
    path = tmp_path / name
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    windows = arm.trajectories.from_rows(np.arange(2), 5)
    with pytest.raises(BadFile, match=told):
        PlainRollout(arm.simulator, np.ones(1), tmp_path, trusted=False).predict(windows)
    assert capsys.readouterr().out == ""


def test_states_of_actuators_begin_as_observed(tmp_path):
    """A lag inside of an actuator, whose state is part of the observation."""
    xml = """<mujoco><option timestep="0.005"/><worldbody><body name="link">
    <joint name="hinge" axis="0 1 0"/><geom size="0.1" mass="1"/></body></worldbody><actuator>
    <general name="motor" joint="hinge" dyntype="filter" dynprm="0.1"/></actuator></mujoco>"""
    simulator = MujocoSimulator(
        mujoco.MjSpec.from_string(xml), [], observation=["qpos", "qvel", "act"], threads=1
    )
    rows = np.random.default_rng(0).normal(size=(10, 3))
    data = Trajectories(rows, np.zeros((10, 1)), rows, np.arange(10) == 9)
    found = Problem("lag", simulator, data)
    write_extended(found, {}, tmp_path)
    windows = data.from_rows(np.arange(3), 5)
    plain = PlainRollout(simulator, np.zeros(0), tmp_path, trusted=False).predict(windows)
    ours = simulator.predict(np.zeros((1, 0)), windows)[0]
    np.testing.assert_allclose(plain, ours, atol=SAME)
    assert np.abs(ours[:, 2]).min() > 100 * SAME
