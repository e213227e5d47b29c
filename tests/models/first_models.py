"""Machines of random numbers with the first models that an engineer has of them, and their logs."""

from dropo.problems.simulated.hidden import hide
from dropo.studies.first_models.machines import (
    DESIGNS,
    built,
    first_model,
    problem_of,
    random_machine,
    recorded,
)


def recorded_machine(design, rng, **recording):
    """A machine, the specification of its first model, and its log."""
    spec = first_model(DESIGNS[design])
    machine = random_machine(DESIGNS[design], rng)
    made = built(spec, machine)
    data = recorded(made, DESIGNS[design].servos, machine.delay, rng, **recording)
    return machine, spec, data


def problem_with(design, rng, **recording):
    """A machine, and its log with its first model."""
    machine, spec, data = recorded_machine(design, rng, **recording)
    return machine, problem_of(design, spec, data)


def unknown_rotor():
    """The torque arm with 0.01 kg m^2 more rotor inertia at its elbow than its model has."""
    return hide("torque-arm", ["joint_armature:elbow=0.01"], seed=0, threads=1)
