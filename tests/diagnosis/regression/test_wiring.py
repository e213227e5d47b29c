"""Signs, units and places of columns that are wrong are the finding; models that are far off are
none.

The thresholds of `WiringSettings` were chosen on machines of the seeds 1 to 3; these have others.
"""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from dropo import diagnose
from dropo.core.services.errors import Incompatible
from dropo.diagnosis.diagnose import Diagnose
from dropo.diagnosis.regression.quick import QuickDiagnose
from dropo.diagnosis.regression.wiring import WiringSettings, wiring_of
from dropo.problems.loading import load
from dropo.problems.measured.external_data import find_data
from dropo.problems.panda.sliding import sliding
from dropo.report.build import write_report
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.studies.first_models.machines import (
    Design,
    built,
    first_model,
    problem_of,
    random_machine,
    recorded,
)
from tests.models.furuta import furuta_problem
from tests.models.wiring import (
    DEGREES,
    MACHINES,
    exchanged,
    light_wrist,
    log_of,
    read_otherwise,
    scaled,
    torques_logged,
)

SERVOS = ("arm, 3 joints", "arm, 6 joints", "gantry with a wrist")
MOTORS = ("two links on motors", "three links on motors", "cart and pole on motors")
SEED = 61


def found(problem):
    """The kind and the joints of each fault."""
    return [(fault.kind, fault.target) for fault in wiring_of(problem).faults]


@pytest.fixture(scope="module")
def logs():
    """The log of each machine with its first model, made once.

    Those on motors carry no payload: as heavy as the links it leaves half of all forces to its own
    inertia, and no fault is told beside that.
    """
    made = {}

    def get(name):
        if name not in made:
            changed = {} if MACHINES[name].servos else {"payload": 0.0}
            made[name] = log_of(name, np.random.default_rng(SEED), **changed)
        return made[name]

    return get


@pytest.mark.parametrize("name", [*SERVOS, *MOTORS])
def test_a_turned_command_is_named(logs, name):
    """The sign of the first joint's command."""
    turned = read_otherwise(logs(name), commands=scaled(0, -1))
    assert found(turned) == [("sign", "joint0")]


@pytest.mark.parametrize("name", ["arm, 3 joints", "arm, 6 joints", *MOTORS])
def test_a_turned_angle_is_named(logs, name):
    """The sign of the first joint's angle."""
    turned = read_otherwise(logs(name), angles=scaled(0, -1))
    assert found(turned) == [("sign", "joint0")]


@pytest.mark.parametrize("place", [1, 2, 3])
def test_each_angle_of_a_gantry_is_named(logs, place):
    """Its wrist stands upright and sags under its load, so that forces alone do not tell its sign;
    but it moves against its command.
    """
    turned = read_otherwise(logs("gantry with a wrist"), angles=scaled(place, -1))
    assert found(turned) == [("sign", f"joint{place}")]


@pytest.mark.parametrize("of", ["angles", "commands"])
@pytest.mark.parametrize("name", ["arm, 3 joints", "arm, 6 joints", *MOTORS])
def test_exchanged_joints_are_named(logs, name, of):
    """Of two neighbours, by the columns of their angles or of their commands."""
    mixed = read_otherwise(logs(name), **{of: exchanged(0, 1)})
    assert found(mixed) == [("exchange", "joint0, joint1")]


def test_exchanged_angles_are_told_from_commands():
    """Where an exchange of commands explains most of what one of angles explains all of."""
    log = log_of("two links on servos", np.random.default_rng(1), runs=1, seconds=20.0)
    (fault,) = wiring_of(read_otherwise(log, angles=exchanged(0, 1))).faults
    assert (fault.kind, fault.target, fault.of) == ("exchange", "joint0, joint1", "angle")


@pytest.mark.parametrize("name", SERVOS)
@pytest.mark.parametrize("factor", [DEGREES, 1 / DEGREES, 1000.0, 5.0])
def test_another_unit_of_a_command_is_named(logs, name, factor):
    """With what the column is to be multiplied by; a factor of no known unit as well."""
    (fault,) = wiring_of(read_otherwise(logs(name), commands=scaled(0, factor))).faults
    assert (fault.kind, fault.target) == ("unit_factor", "joint0")
    times = fault.factor if fault.of != "angle" else 1 / fault.factor
    assert times == pytest.approx(1 / factor, rel=0.1)


@pytest.mark.parametrize("name", ["arm, 3 joints", "three links on motors"])
def test_degrees_are_named(logs, name):
    """All angles in degrees, and those of a servo's commands with them."""
    servos = MACHINES[name].servos

    def degrees(rows):
        return rows * DEGREES

    data = read_otherwise(logs(name), angles=degrees, commands=degrees if servos else None)
    (fault,) = wiring_of(data).faults
    assert (fault.kind, fault.target) == ("unit_factor", "joint0, joint1, joint2")
    assert fault.factor == pytest.approx(math.pi / 180)
    assert fault.of == ("both" if servos else "angle")


def test_the_unit_of_a_motor_is_named(logs):
    """Millinewton metres; not another gain, which a model that is far off may have."""
    log = logs("three links on motors")
    (fault,) = wiring_of(read_otherwise(log, commands=scaled(1, 1000.0))).faults
    assert (fault.kind, fault.target) == ("unit_factor", "joint1")
    assert fault.factor == pytest.approx(1e-3, rel=0.5)  # its gain was off before
    assert found(read_otherwise(log, commands=scaled(1, 20.0))) == []


def test_friction_that_takes_all_of_a_motor_is_no_unit():
    """A light wrist needs a thousandth of what its motor gives, and friction has the rest."""
    assert found(light_wrist(np.random.default_rng(SEED))) == []


@pytest.mark.parametrize("name", ["arm, 3 joints", "arm, 6 joints"])
def test_torques_in_the_place_of_positions_are_named(name):
    """Logged as commands of the model's servos: at every joint but light ones, and nothing else."""
    faults = found(torques_logged(name, np.random.default_rng(SEED)))
    assert {kind for kind, _ in faults} == {"torque_command"}
    assert len(faults) >= len(MACHINES[name].axes) // 2


@pytest.mark.parametrize("seed", [62, 63])
@pytest.mark.parametrize("name", [*SERVOS, *MOTORS, "pendulum on a motor"])
def test_first_models_have_no_fault(name, seed):
    """The control: rotors, friction, a payload, a gain and a delay are missing."""
    assert found(log_of(name, np.random.default_rng(seed))) == []


@pytest.mark.parametrize(
    ("name", "gain"),
    [
        *((name, gain) for name in SERVOS for gain in (0.02, 50.0)),
        *((SERVOS[0], gain) for gain in (0.1, 0.5, 2.0, 10.0)),
    ],
)
def test_far_off_gains_are_no_fault(name, gain):
    """The control: servos that are 50 times stronger or weaker than their model, which lacks the
    payload and friction besides.
    """
    assert found(log_of(name, np.random.default_rng(64), gain=gain)) == []


@pytest.fixture(scope="module")
def turned(logs):
    """The diagnosis of an arm one of whose angles has the wrong sign."""
    return diagnose(read_otherwise(logs("arm, 3 joints"), angles=scaled(1, -1)))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_drive_that_takes_speeds_is_turned_or_right(sign):
    """Friction is missing: a pull against the speed is no torque command; a turned one shows."""
    design = Design(("hinge y",), (0.3,), (0.5,), (1.0,), loaded=False)
    spec = first_model(design)
    spec.actuators[0].set_to_velocity(1.0)
    rng = np.random.default_rng(63)
    machine = random_machine(design, rng)
    machine = replace(machine, damping=4 * machine.damping, friction=5 * machine.friction)
    made = built(spec, machine)
    problem = problem_of("wheel", spec, recorded(made, True, 0.0, rng, runs=1))
    data = problem.trajectories
    problem = replace(problem, trajectories=replace(data, actions=sign * data.actions))
    assert found(problem) == ([] if sign > 0 else [("sign", "joint0")])


def test_the_full_diagnosis_ends_there(turned):
    """A cause of its own with its evidence, and no simulation at all."""
    (cause,) = turned.causes
    assert (cause.effect, cause.target, cause.variant) == ("sign", "joint1", "angle")
    assert (turned.verdict, turned.simulator_steps, turned.interrupted) == ("partly", 0, False)
    assert cause.rmse_after < 0.1 < 0.3 < cause.rmse_before
    assert cause.held_out_gain > 5 * cause.held_out_gain_se > 0
    assert cause.p_value < 1e-3
    assert "`sign: -1`" in turned.headline()
    assert "on data held out" in turned.headline()
    assert "Columns that mean something else" in str(turned)


def test_its_problem_has_the_columns_read_right(turned, logs):
    """As they were before one was turned."""
    data = logs("arm, 3 joints").trajectories
    np.testing.assert_allclose(turned.problem.trajectories.observations, data.observations)
    np.testing.assert_allclose(turned.problem.trajectories.actions, data.actions)
    assert found(turned.problem) == []


def test_json_and_report_say_the_same(turned, tmp_path):
    """The contract's keys, finite numbers, and a page with cause, evidence and what to change."""
    turned.save(tmp_path)
    saved = json.loads((tmp_path / "diagnosis.json").read_text())
    assert saved["verdict"] == "partly"
    (cause,) = saved["causes"]
    assert (cause["effect"], cause["target"]) == ("sign", "joint1")
    assert cause["to_change"]
    assert saved["faults"][0]["evidence"]["removed"] > 0.9
    page = write_report(tmp_path).read_text()
    assert "sign" in page
    assert "has the wrong sign" in page
    assert "sign: -1" in page


def test_quick_says_the_same(logs, turned):
    """The same fault with the same evidence."""
    quick = QuickDiagnose().run(read_otherwise(logs("arm, 3 joints"), angles=scaled(1, -1)))
    assert quick.faults == turned.faults
    assert quick.causes == ()


def test_velocities_are_turned_with_angles(logs):
    """Where they are logged, and follow the positions as these were logged."""
    problem = logs("arm, 3 joints")
    simulator = MujocoSimulator(
        problem.simulator.spec(), [], frame_skip=problem.simulator.frame_skip, threads=1
    )
    data = problem.trajectories
    step = simulator.control_step
    rate = np.gradient(data.observations, step, axis=0)
    right = replace(
        data,
        observations=np.hstack([data.observations, rate]),
        next_observations=np.hstack([data.next_observations, np.roll(rate, -1, axis=0)]),
    )
    whole = replace(problem, simulator=simulator, trajectories=right)
    wrong = read_otherwise(whole, angles=lambda rows: rows * [1, -1, 1, 1, -1, 1])
    mended = Diagnose().run(wrong).problem.trajectories
    np.testing.assert_allclose(mended.observations, right.observations)


def test_a_position_that_is_not_observed_is_no_fault():
    """Wiring cannot be checked then, and nothing is said of it: neither a fault nor a traceback."""
    assert found(sliding(threads=1)) == []
    with pytest.raises(Incompatible):
        QuickDiagnose().run(sliding(threads=1))


@pytest.mark.skipif(find_data("so101/runs.npz") is None, reason="the measured data are not here")
def test_a_servo_that_follows_is_wired_right_however_strong_its_model():
    """The SO-101's maker gives its servos a hundred times their gain, within small limits of force,
    so that their forces are explained better without any pull back. Its joints follow their
    commands all the same. The control: without that, some are taken to be commanded by torques.
    """
    problem = load("so101", threads=1)
    assert wiring_of(problem).faults == ()
    faults = wiring_of(problem, WiringSettings(closely=2.0)).faults
    assert {fault.kind for fault in faults} == {"torque_command"}


@pytest.mark.parametrize("place", [1, 2])
def test_a_joint_both_of_whose_columns_are_turned_is_named(logs, place):
    """It follows its command, and its weight and the joints beside it do not go with that."""
    turned = read_otherwise(
        logs("arm, 3 joints"), angles=scaled(place, -1), commands=scaled(place, -1)
    )
    (fault,) = wiring_of(turned).faults
    assert (fault.kind, fault.target, fault.of) == ("sign", f"joint{place}", "both")
    assert "angle and its command have the opposite sign" in fault.text


@pytest.mark.parametrize("place", [1, 2])
def test_one_joint_in_degrees_is_named(logs, place):
    """Its angle and its command: none of the other joints has another unit."""
    data = read_otherwise(
        logs("arm, 3 joints"), angles=scaled(place, DEGREES), commands=scaled(place, DEGREES)
    )
    (fault,) = wiring_of(data).faults
    assert (fault.kind, fault.target, fault.of) == ("unit_factor", f"joint{place}", "both")
    assert fault.factor == pytest.approx(1 / DEGREES)


def velocity_arm(rng):
    """The log of two hinges under velocity servos, with its first model."""
    design = Design(("hinge y", "hinge y"), (0.3, 0.3), (0.5, 0.3), (20.0, 20.0), loaded=False)
    spec = first_model(design)
    for drive in spec.actuators:
        drive.set_to_velocity(20.0)
    made = built(spec, random_machine(design, rng))
    return problem_of("wheels", spec, recorded(made, True, 0.0, rng, runs=1))


@pytest.mark.parametrize(
    ("kind", "target", "angles", "commands"),
    [
        ("exchange", "joint0, joint1", exchanged(0, 1), None),
        ("exchange", "joint0, joint1", None, exchanged(0, 1)),
        ("unit_factor", "joint1", scaled(1, DEGREES), None),
        ("unit_factor", "joint1", None, scaled(1, DEGREES)),
        ("sign", "joint1", None, scaled(1, -1)),
    ],
)
def test_speeds_tell_what_forces_do_not(kind, target, angles, commands):
    """A gain takes up any unit of a command of speeds; the joint's own speed does not."""
    log = velocity_arm(np.random.default_rng(66))
    assert found(log) == []
    (fault,) = wiring_of(read_otherwise(log, angles=angles, commands=commands)).faults
    assert (fault.kind, fault.target) == (kind, target)
    assert "command" in fault.text


def test_angles_without_drives_have_their_unit_too():
    """Of a pendulum that swings from a driven arm, both logged in degrees: it has no command that
    could be wrong in its angle's place.
    """
    problem = furuta_problem(3)
    degrees = read_otherwise(problem, angles=lambda rows: rows * DEGREES)
    (fault,) = wiring_of(degrees).faults
    assert (fault.kind, fault.target, fault.of) == ("unit_factor", "arm, swing", "angle")
    assert fault.factor == pytest.approx(1 / DEGREES)
