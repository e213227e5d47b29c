"""The payload that whole motions ask for, where a model with many other numbers lacks one."""

import numpy as np

from dropo.core.contracts.effect import EffectInstance, instances_of
from dropo.core.services.validation import Array
from dropo.diagnosis.far_off.model import PAYLOAD, FarOffModel
from dropo.diagnosis.far_off.output_error import OutputError
from dropo.diagnosis.search.library import declared, robot_of


def promised_payload(model: FarOffModel, error: OutputError) -> tuple[EffectInstance, Array] | None:
    """Find the payload that promises to lower the cost of motions most.

    A point mass is tried at several places of every body, by what it changes in proportion to its
    mass, all other numbers free to move along.

    Parameters
    ----------
    model : FarOffModel
        Without a payload.
    error : OutputError
        Its motions.

    Returns
    -------
    tuple of EffectInstance and (q,) array, or None
        The payload with its mass and place; None where no mass above 0 lowers the cost.
    """
    simulator = robot_of(model.problem)
    tried = [
        (instance, np.array(trial))
        for instance in instances_of(simulator.effect_context, PAYLOAD)
        if not instance.variant and not declared(simulator, instance, model.free)
        for trial in instance.trials[0]
    ]
    if not tried:
        return None
    instances = list({instance.label: instance for instance, _ in tried}.values())
    library = model.library_with(instances)
    theta = model.theta_with(sum(len(instance.quantities) for instance in instances))
    thetas = np.repeat(theta[None], 1 + len(tried), axis=0)
    for row, (instance, trial) in enumerate(tried, start=1):
        thetas[row, library.indices_of[instance.label]] = trial
    residuals = OutputError(library, error.motions).residuals(thetas)
    error.library.simulator.steps += library.simulator.steps
    end = error.linearize(model.theta, model.fitted)
    gains, factors = error.promised(end, residuals[0] - residuals[1:])
    gains = np.where(factors > 0, gains, 0.0)
    best = int(np.argmax(gains))
    if not gains[best] > 0:
        return None
    instance, trial = tried[best]
    mass = instance.quantities[0]
    return instance, np.array([np.clip(factors[best] * trial[0], mass.low, mass.high), *trial[1:]])
