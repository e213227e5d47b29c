"""A diagnosis by regression names what a first model lacks, and nothing where it is right."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.diagnosis.regression.quick import QuickDiagnose
from dropo.problems.file.writer import write_problem
from dropo.problems.hopper.problem import hopper
from dropo.problems.loading import load
from dropo.problems.simulated.hidden import hide
from tests.models.servo_arms import arm, built, machine, problem_of, recorded

TOLERANCE = 4.0
"""Standard errors that a number may be off by."""


def diagnosed(joints, seed):
    """A machine of random numbers, and its diagnosis."""
    rng = np.random.default_rng(seed)
    spec = arm(joints)
    there = machine(joints, rng)
    logs = recorded(built(spec, there), rng)
    return there, QuickDiagnose().run(problem_of(spec, logs))


@pytest.fixture(scope="module", params=[(3, 11), (6, 12)], ids=["three", "six"])
def found(request):
    """A machine and its diagnosis."""
    return diagnosed(*request.param)


def by_label(diagnosis):
    """The estimates of each cause by effect and target."""
    return {(cause.effect, cause.target): cause.estimate for cause in diagnosis.causes}


def test_every_number_is_found_and_nothing_else(found):
    """Rotor, viscous and dry friction at every joint, the payload, the gain and the delay."""
    there, diagnosis = found
    estimates = by_label(diagnosis)
    truth = {("actuator_gain", None): ("gain", there.gain)}
    truth["actuator_delay", None] = ("delay", there.delay)
    for i in range(len(there.armature)):
        truth["joint_armature", f"joint{i}"] = ("armature", there.armature[i])
        truth["joint_damping", f"joint{i}"] = ("damping", there.damping[i])
        truth["joint_friction", f"joint{i}"] = ("frictionloss", there.friction[i])
    last = f"link{len(there.armature) - 1}"
    truth["payload", last] = ("mass", there.payload)
    assert set(estimates) == set(truth)
    for place, (quantity, value) in truth.items():
        estimate = estimates[place][quantity]
        assert abs(estimate.value - value) < TOLERANCE * estimate.se, (place, estimate, value)
    payload = estimates["payload", last]
    place = [payload[letter].value for letter in "xyz"]
    np.testing.assert_allclose(place, there.place, atol=5e-3)


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
    rng = np.random.default_rng(13)
    there = replace(machine(3, rng), delay=0.0)
    made = built(arm(3), there)
    right = made.copy()
    right.option.timestep = arm(3).option.timestep
    diagnosis = QuickDiagnose().run(problem_of(right, recorded(made, rng, delay=0.0)))
    assert diagnosis.causes == ()
    assert diagnosis.verdict == "consistent"


@pytest.fixture(scope="module")
def plain():
    """The problem of an arm of three joints, nothing hidden in its data but what machines have."""
    rng = np.random.default_rng(14)
    spec = arm(3)
    return problem_of(spec, recorded(built(spec, machine(3, rng)), rng, runs=1))


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
        ("sign", "joint1", lambda rows: rows * [1, -1, 1], None),
        ("unit factor", "joint0", None, lambda rows: rows * [180 / np.pi, 1, 1]),
        ("exchange", "joint0, joint2", None, lambda rows: rows[:, [2, 1, 0]]),
    ],
)
def test_wiring_faults_are_named(plain, kind, target, angles, commands):
    """A wrong sign, degrees, two joints exchanged: said, and nothing else is looked for."""
    diagnosis = QuickDiagnose().run(changed(plain, angles, commands))
    assert [(fault.kind, fault.target) for fault in diagnosis.faults] == [(kind, target)]
    assert diagnosis.causes == ()
    assert target.split(",")[0] in diagnosis.headline()


def test_no_fault_where_joints_follow(plain):
    """The control: each joint follows its own command."""
    assert QuickDiagnose().run(plain).faults == ()


def test_built_in_effects_are_named():
    """Rotor inertia hidden in the torque arm, within its error."""
    problem = hide("torque-arm", ["joint_armature:elbow=0.01"], seed=0, threads=1)
    diagnosis = QuickDiagnose().run(problem)
    estimate = by_label(diagnosis)["joint_armature", "elbow"]["armature"]
    assert abs(estimate.value - 0.01) < TOLERANCE * estimate.se
    assert diagnosis.causes[0].effect == "joint_armature"


def test_refusals(plain):
    """Robots with a floating base are not known, and logs that are too short."""
    with pytest.raises(Incompatible, match="needs hinges and slides"):
        QuickDiagnose().run(hopper(threads=1).using(transitions=50))
    with pytest.raises(BadArgument, match="No trajectory is longer than"):
        QuickDiagnose().run(plain.using(transitions=20))
    with pytest.raises(BadArgument, match="'problem' of QuickDiagnose must be a Problem"):
        QuickDiagnose().run("hopper")
