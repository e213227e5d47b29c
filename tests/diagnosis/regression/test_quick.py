"""A diagnosis by regression names what a first model lacks, and nothing where it is right."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.diagnosis.findings.fittable import fittable
from dropo.diagnosis.regression.quick import QuickDiagnose, QuickSettings, estimate_missing
from dropo.diagnosis.search.library import robot_of
from dropo.problems.file.writer import write_problem
from dropo.problems.hopper.problem import hopper
from dropo.problems.loading import load
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.studies.first_models.machines import (
    DESIGNS,
    Design,
    built,
    first_model,
    problem_of,
    random_machine,
    recorded,
)
from dropo.studies.first_models.study import diagnosed
from tests.models.fast_servo import fast_servo_problem
from tests.models.first_models import problem_with, recorded_machine, unknown_rotor
from tests.models.furuta import ARMATURE, DAMPING, FRICTION, XML, furuta_problem

TOLERANCE = 4.0
"""Standard errors that a number may be off by."""


@pytest.fixture(
    scope="module", params=[("arm, 3 joints", 11), ("arm, 6 joints", 12)], ids=["three", "six"]
)
def found(request):
    """A machine and its diagnosis."""
    design, seed = request.param
    machine, problem = problem_with(design, np.random.default_rng(seed))
    return machine, QuickDiagnose().run(problem)


def by_label(diagnosis):
    """The estimates of each cause by effect and target."""
    return {(cause.effect, cause.target): cause.estimate for cause in diagnosis.causes}


def test_every_number_is_found_and_nothing_else(found):
    """Rotor, viscous and dry friction at every joint, the payload, the gain and the delay."""
    machine, diagnosis = found
    estimates = by_label(diagnosis)
    truth = machine.numbers()
    assert set(estimates) == {(effect, target) for effect, target, _ in truth}
    for (effect, target, quantity), value in truth.items():
        estimate = estimates[effect, target][quantity]
        assert abs(estimate.value - value) < TOLERANCE * estimate.se, (effect, target, estimate)
    payload = next(cause for cause in diagnosis.causes if cause.effect == "payload")
    for letter, value in zip("xyz", machine.place, strict=True):
        estimate = payload.estimate[letter]
        assert abs(estimate.value - value) < TOLERANCE * estimate.se, (letter, estimate, value)


def test_forces_are_explained(found):
    """On held-out data next to nothing is left of the forces; the model alone leaves half."""
    _, diagnosis = found
    assert diagnosis.verdict == "explained"
    for joint in diagnosis.forces:
        assert joint.before > 0.3 * joint.drive
        assert joint.after < 0.05 * joint.drive


def test_extended_model_lacks_nothing(found, tmp_path):
    """Written and read again, the extended model has no force missing that is worth a payload."""
    _, diagnosis = found
    path = write_problem(diagnosis.problem, tmp_path)
    again = QuickDiagnose().run(load(path, threads=1))
    for before, after in zip(diagnosis.forces, again.forces, strict=True):
        assert after.before < 1.5 * before.after
    assert not {"payload", "actuator_gain", "joint_friction"} & {c.effect for c in again.causes}


def test_nothing_is_missing_from_the_right_model():
    """The control: a model with all numbers of the machine."""
    answer = diagnosed(["arm, 3 joints", "nothing missing", 13])
    assert answer["false"] == []
    assert answer["verdict"] == "consistent"


def test_a_right_model_leaves_no_force_where_no_drive_acts():
    """A pendulum that swings freely needs none: what is left is small beside what speeds it up."""
    spec = mujoco.MjSpec.from_string(XML)
    arm, swing = spec.joints
    arm.armature = ARMATURE
    arm.frictionloss = FRICTION
    arm.damping = [DAMPING[0], 0, 0]
    swing.damping = [DAMPING[1], 0, 0]
    simulator = MujocoSimulator(spec, [], frame_skip=5, threads=1)
    diagnosis = QuickDiagnose().run(replace(furuta_problem(7), simulator=simulator))
    assert diagnosis.causes == ()
    assert diagnosis.verdict == "consistent"
    assert diagnosis.forces[1].before < 0.1 * diagnosis.forces[1].drive


def test_what_the_physics_step_makes_is_not_missing():
    """A model that acts a millisecond early is off by a tenth of a strong servo's force."""
    diagnosis = QuickDiagnose().run(fast_servo_problem(1))
    (joint,) = diagnosis.forces
    assert joint.before > 0.1 * joint.drive
    assert joint.after < 0.03 * joint.drive
    assert diagnosis.causes == ()
    assert diagnosis.verdict == "consistent"


def test_what_motions_do_not_tell_of_a_payload_is_not_said():
    """Its height, where all axes are upright; what is left can be fitted as parameters."""
    design = Design(("hinge z", "hinge z"), (0.3, 0.25), (1.5, 0.8), (60.0, 30.0), along="xx")
    machine = replace(random_machine(design, np.random.default_rng(3)), gain=0.0)
    made = built(first_model(design), machine)
    data = recorded(made, design.servos, machine.delay, np.random.default_rng(4), runs=1)
    diagnosis = QuickDiagnose().run(problem_of("upright", first_model(design), data))
    payload = by_label(diagnosis)["payload", "body1"]
    assert "z" not in payload
    assert any("scale of all forces" in sentence for sentence in diagnosis.warnings)
    for (effect, target), estimate in by_label(diagnosis).items():
        first = next(iter(estimate.values()))
        assert first.se < abs(first.value), (effect, target)
    for letter in set("xy") & set(payload):
        value = machine.place["xyz".index(letter)]
        assert abs(payload[letter].value - value) < TOLERANCE * payload[letter].se
    as_parameters = fittable(diagnosis.problem, diagnosis.causes)
    assert len(as_parameters.space) >= len(diagnosis.causes)


def test_a_payload_on_a_slide_is_no_gain():
    """Its weight fixes the scale of all forces: a gain beside an offset explains the rest as well,
    but not that.
    """
    design = Design(
        ("hinge z", "hinge z", "slide z"),
        (0.32, 0.22, 0.1),
        (6.0, 4.0, 1.0),
        (60.0, 40.0, 2500.0),
        along="xxz",
    )
    machine = replace(random_machine(design, np.random.default_rng(1)), gain=0.0)
    made = built(first_model(design), machine)
    data = recorded(
        made, design.servos, machine.delay, np.random.default_rng(4), runs=1, seconds=20.0
    )
    estimates = by_label(QuickDiagnose().run(problem_of("lift", first_model(design), data)))
    truth = machine.numbers()
    assert set(estimates) <= {(effect, target) for effect, target, _ in truth}
    for (effect, target, quantity), value in truth.items():
        estimate = estimates.get((effect, target), {}).get(quantity)
        if estimate is not None:
            assert abs(estimate.value - value) < TOLERANCE * estimate.se, (effect, target, estimate)
    assert ("payload", "body2") in estimates


def weak_drive(gain):
    """The problem of an arm whose drives have these gains, and no payload."""
    design = DESIGNS["arm, 3 joints"]
    machine, spec, _ = recorded_machine("arm, 3 joints", np.random.default_rng(31), runs=1)
    machine = replace(machine, gain=np.array(gain), payload=0.0)
    made = built(spec, machine)
    data = recorded(made, design.servos, machine.delay, np.random.default_rng(32), runs=1)
    return problem_of("one weak drive", spec, data)


def gains_of(diagnosis):
    """The gains that are named, by drive."""
    causes = [cause for cause in diagnosis.causes if cause.effect == "actuator_gain"]
    return {cause.target: cause.estimate["gain"] for cause in causes}


def test_a_drive_may_have_a_gain_of_its_own():
    """One drive gives less than its command says, the others do not: no gain of all is named."""
    gains = gains_of(QuickDiagnose().run(weak_drive([0.0, -0.25, 0.0])))
    assert set(gains) == {"drive1"}
    assert abs(gains["drive1"].value + 0.25) < TOLERANCE * gains["drive1"].se
    assert gains["drive1"].se < 0.05


def test_a_weak_drive_beside_an_offset_elsewhere():
    """The offset of one joint is no reason to call all drives weak."""
    problem = changed(weak_drive([0.0, 0.0, -0.3]), commands=lambda rows: rows - [0, 0.05, 0])
    diagnosis = QuickDiagnose().run(problem)
    gains = gains_of(diagnosis)
    assert set(gains) == {"drive2"}
    assert abs(gains["drive2"].value + 0.3) < TOLERANCE * gains["drive2"].se
    bias = by_label(diagnosis)["actuator_bias", "drive1"]["bias"]
    assert abs(bias.value - 0.05) < TOLERANCE * bias.se < 0.02


def test_an_offset_of_a_weak_drive_is_one_of_its_command():
    """In the command's unit, with the drive's own gain; a load of the joint is as likely."""
    problem = changed(weak_drive([0.0, 0.0, -0.3]), commands=lambda rows: rows - [0, 0, 0.05])
    diagnosis = QuickDiagnose().run(problem)
    bias = by_label(diagnosis)["actuator_bias", "drive2"]["bias"]
    assert abs(bias.value - 0.05) < TOLERANCE * bias.se < 0.02
    cause = next(one for one in diagnosis.causes if one.effect == "actuator_bias")
    listed = {(one.effect, one.target, one.variant) for one in cause.confused_with}
    assert ("joint_stiffness", "joint2", "rest") in listed


def test_one_weak_motor_is_no_rotor_beside_friction():
    """About an upright axis a gain is like all the rest by one factor: one number of three."""
    design = Design(("hinge z", "hinge y"), (0.1, 0.2), (0.5, 0.8), (1.0, 1.5), servos=False)
    rng = np.random.default_rng(51)
    machine = replace(random_machine(design, rng), payload=0.0, delay=0.0, gain=0.0)
    spec = first_model(design)
    model = built(spec, machine)
    model.option.timestep = spec.option.timestep
    weak = built(spec, replace(machine, gain=np.array([-0.2, 0.0])))
    data = recorded(weak, design.servos, 0.0, rng, runs=1)
    diagnosis = QuickDiagnose().run(problem_of("pan and tilt", model, data))
    assert set(by_label(diagnosis)) == {("actuator_gain", "drive0")}
    gain = gains_of(diagnosis)["drive0"]
    assert abs(gain.value + 0.2) < TOLERANCE * gain.se


def test_two_weak_drives_of_three():
    """Most drives are weak, each by another part: no payload or friction stands for that."""
    gains = gains_of(QuickDiagnose().run(weak_drive([-0.15, -0.2, 0.0])))
    assert set(gains) == {"drive0", "drive1"}
    assert abs(gains["drive0"].value + 0.15) < TOLERANCE * gains["drive0"].se
    assert abs(gains["drive1"].value + 0.2) < TOLERANCE * gains["drive1"].se


def wrong_body(change):
    """The problem of an arm whose model is right but for one body, which a function changes."""
    design = DESIGNS["arm, 3 joints"]
    rng = np.random.default_rng(41)
    machine = replace(random_machine(design, rng), payload=0.0, gain=0.0, delay=0.0)
    spec = first_model(design)
    model = built(spec, machine)
    model.option.timestep = spec.option.timestep
    change(spec)
    data = recorded(built(spec, machine), design.servos, 0.0, rng, runs=1)
    return problem_of("one body", model, data)


def loaded_at(share):
    """The diagnosis of an arm with 0.4 kg on its second link, at a share of the way to the third.

    Beyond 1 it is the third link's.
    """

    def change(spec):
        last = spec.body("body2")
        body = spec.body("body1") if share <= 1 else last
        place = last.pos * (share if share <= 1 else share - 1)
        load = body.add_body(name="load", pos=place)
        load.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], mass=0.4)

    return QuickDiagnose().run(wrong_body(change))


def test_a_payload_on_an_axis_may_be_the_next_links():
    """On the axis between two links it is the one's as well as the other's: both are told.

    The control: in the middle of the last link it is none of the others'.
    """
    (cause,) = loaded_at(1.0).causes
    others = {one.target for one in cause.confused_with if one.effect == "payload"}
    assert cause.effect == "payload"
    assert {cause.target, *others} >= {"body1", "body2"}
    (cause,) = loaded_at(1.5).causes
    assert (cause.effect, cause.target) == ("payload", "body2")
    assert not [one for one in cause.confused_with if one.effect == "payload"]


def test_a_wrong_centre_of_mass_is_no_payload():
    """Nor a gain beside springs: the numbers of one body explain as much by themselves."""

    def change(spec):
        compiled = spec.compile().body("body1")
        body = spec.body("body1")
        body.explicitinertial = True
        body.mass = compiled.mass[0]
        body.ipos = compiled.ipos - np.array([0.04, 0, 0])
        body.iquat = compiled.iquat
        body.inertia = compiled.inertia

    estimates = by_label(QuickDiagnose().run(wrong_body(change)))
    assert set(estimates) == {("body_com", "body1")}
    found = estimates["body_com", "body1"]["x"]
    assert abs(found.value + 0.04) < TOLERANCE * found.se
    assert found.se < 0.004


def test_a_body_that_is_too_heavy_is_no_gain():
    """Its mass is named, with its inertia as far as that shows, and what looks the same."""

    def change(spec):
        spec.body("body1").first_geom().mass = 0.7

    diagnosis = QuickDiagnose().run(wrong_body(change))
    estimates = by_label(diagnosis)
    assert {target for _, target in estimates} == {"body1"}
    found = estimates["body_mass", "body1"]["mass"]
    assert abs(found.value + 0.3) < TOLERANCE * found.se
    mass = next(cause for cause in diagnosis.causes if cause.effect == "body_mass")
    assert ("body_com", "body1") in [(one.effect, one.target) for one in mass.confused_with]


def test_no_spring_pushes_away():
    """A command that falls behind with the angle is like a spring below 0, which there is none."""
    problem = weak_drive([0.0, 0.0, 0.0])
    data = problem.trajectories
    behind = data.actions - data.observations * [0, 0.1, 0]
    problem = replace(
        problem,
        trajectories=Trajectories(
            data.observations, behind, data.next_observations, data.terminals
        ),
    )
    for estimate in by_label(QuickDiagnose().run(problem)).values():
        assert "stiffness" not in estimate or estimate["stiffness"].value > 0


def test_numbers_that_are_not_known_are_not_named():
    """However large a force is: where its number's error exceeds it, the number says nothing."""
    problem = problem_with("arm, 3 joints", np.random.default_rng(35), runs=1)[1]
    settings = QuickSettings()
    found = estimate_missing(problem, problem.trajectories, settings)
    assert found.solution.payload is not None
    assert found.solution.payload.mass < 1.1 < 300.0
    for error in (1.1, 300.0):
        unknown = replace(found, errors=np.full(len(found.errors), error))
        payload = next(
            number
            for number in unknown.numbers(robot_of(problem), settings.certain)
            if number.effect == "payload"
        )
        assert not payload.named
    numbers = unknown.numbers(robot_of(problem), settings.certain)
    assert not [number for number in numbers if number.named]
    assert ("payload", True) in [(number.effect, number.unknown) for number in numbers]


def test_numbers_share_a_scale_that_no_motion_tells():
    """Of a single slide, whose rotor and gain do the same: a damping has the scale's error too."""
    design = Design(("slide x",), (0.2,), (3.0,), (2500.0,), along="x")
    machine = replace(random_machine(design, np.random.default_rng(2)), gain=0.0, payload=0.0)
    made = built(first_model(design), machine)
    data = recorded(
        made, design.servos, machine.delay, np.random.default_rng(4), runs=1, seconds=20.0
    )
    estimates = by_label(QuickDiagnose().run(problem_of("slide", first_model(design), data)))
    damping = estimates["joint_damping", "joint0"]["damping"]
    truth = machine.numbers()["joint_damping", "joint0", "damping"]
    assert abs(damping.value - truth) < 3 * damping.se


@pytest.fixture(scope="module")
def plain():
    """The problem of an arm of three joints, nothing hidden in its data but what machines have."""
    return problem_with("arm, 3 joints", np.random.default_rng(14), runs=1)[1]


def changed(problem, angles=None, commands=None):
    """The problem with angles and commands that something was done to."""
    data = problem.trajectories
    angles = angles or (lambda rows: rows)
    commands = commands or (lambda rows: rows)
    return replace(
        problem,
        trajectories=Trajectories(
            angles(data.observations),
            commands(data.actions),
            angles(data.next_observations),
            data.terminals,
        ),
    )


@pytest.mark.parametrize(
    ("kind", "target", "angles", "commands"),
    [
        ("unit_factor", "joint0", None, lambda rows: rows * [180 / np.pi, 1, 1]),
        ("exchange", "joint0, joint2", None, lambda rows: rows[:, [2, 1, 0]]),
    ],
)
def test_wiring_faults_are_named(plain, kind, target, angles, commands):
    """Degrees, two joints exchanged: said, and nothing else is looked for."""
    diagnosis = QuickDiagnose().run(changed(plain, angles, commands))
    assert [(fault.kind, fault.target) for fault in diagnosis.faults] == [(kind, target)]
    assert diagnosis.causes == ()
    assert target.split(",")[0] in diagnosis.headline()


def test_no_fault_where_joints_follow(plain):
    """The control: each joint follows its own command."""
    assert QuickDiagnose().run(plain).faults == ()


def test_built_in_effects_are_named():
    """Rotor inertia hidden in the torque arm, within its error."""
    diagnosis = QuickDiagnose().run(unknown_rotor())
    estimate = by_label(diagnosis)["joint_armature", "elbow"]["armature"]
    assert abs(estimate.value - 0.01) < TOLERANCE * estimate.se
    assert diagnosis.causes[0].effect == "joint_armature"


def test_joints_without_a_drive_leave_the_gain_alone():
    """Where a pendulum hangs on a driven arm, what that lacks is found, and no gain beside it."""
    estimates = by_label(QuickDiagnose().run(furuta_problem(1)))
    truth = {
        ("joint_armature", "arm"): ("armature", ARMATURE),
        ("joint_friction", "arm"): ("frictionloss", FRICTION),
        ("joint_damping", "arm"): ("damping", DAMPING[0]),
        ("joint_damping", "swing"): ("damping", DAMPING[1]),
    }
    assert set(estimates) == set(truth)
    for place, estimate in estimates.items():
        quantity, value = truth[place]
        found = estimate[quantity]
        assert abs(found.value - value) < TOLERANCE * found.se, (place, found)


def test_refusals(plain):
    """Robots whose base is not observed are not known, and logs that are too short."""
    with pytest.raises(Incompatible, match="needs the position of every joint"):
        QuickDiagnose().run(hopper(threads=1).using(transitions=50))
    with pytest.raises(BadArgument, match="No trajectory is longer than"):
        QuickDiagnose().run(plain.using(transitions=20))
    with pytest.raises(BadArgument, match="'problem' of QuickDiagnose must be a Problem"):
        QuickDiagnose().run("hopper")


@pytest.mark.parametrize(
    ("limits", "said"),
    [("", "every command is 0, as of motors that are off"), ("1 2", "No row of the log counts")],
)
def test_logs_that_tell_no_force_are_refused(limits, said):
    """A pendulum that swings without its motor, and one far beyond its range all along."""
    limited = f'range="{limits}"' if limits else ""
    xml = (
        '<mujoco><option timestep="0.01"/><worldbody><body>'
        f'<joint name="j" axis="0 1 0" {limited}/><geom size="0.05" pos="0 0 -0.4" mass="1"/>'
        '</body></worldbody><actuator><motor joint="j"/></actuator></mujoco>'
    )
    simulator = MujocoSimulator(mujoco.MjSpec.from_string(xml), [], threads=1)
    angle = -0.8 * np.cos(5 * 0.01 * np.arange(1001))
    rows = np.column_stack([angle, np.gradient(angle, 0.01)])
    commands = np.full((1000, 1), 1.0 if limits else 0.0)
    data = Trajectories(rows[:-1], commands, rows[1:], np.arange(1000) == 999)
    with pytest.raises((BadArgument, Incompatible), match=said):
        QuickDiagnose().run(Problem("pendulum", simulator, data, epsilon=1e-8))
