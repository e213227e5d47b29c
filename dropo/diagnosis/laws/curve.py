"""The force that a law stands for, as the data have it, beside the law."""

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.records.figure_data import LawCurve
from dropo.core.services.validation import Array
from dropo.diagnosis.laws.forces import residual_forces
from dropo.diagnosis.laws.ideas import joint_at, program_of, values_at
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.trials import State
from dropo.effects.law import units_at
from dropo.mjmodel.robot_simulator import RobotSimulator

BINS = 12
"""Parts of the data in each of which one force is fitted."""


def law_curve(
    library: Library, law: EffectInstance, magnitudes: Array, without: State, floor: Array
) -> LawCurve:
    """Fit the force that is missing without a law, in bins of the variable that it depends on.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    law : EffectInstance
        A law of a joint.
    magnitudes : (q,) array
        Its constants.
    without : State
        The model without it.
    floor : (p,) array
        Lower bound of the noise.

    Returns
    -------
    LawCurve
        Over the one variable that the law has, or where it has several over its own value.

    Raises
    ------
    AssertionError
        If the simulator is not a `MujocoSimulator`, around which alone laws are found.
    """
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        raise AssertionError("laws are found around a MuJoCo model")
    forces = residual_forces(library, without, floor)
    joint = joint_at(simulator, str(law.target))
    program = program_of(law)
    shared: dict[tuple[str, str], Array] = {}
    value = values_at(simulator, forces, joint, program, magnitudes, shared)
    units, unit = units_at(simulator.effect_context, law.target)
    if len(program.variables) == 1 and not program.hidden:
        ((name, other),) = program.variables
        x = shared[name, other]
        axis = f"{name}.{other}" if other else name
        axis_unit = units[name, other]
    else:
        x = value
        axis = law.formula
        axis_unit = unit
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
    inside = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    masks = [inside == b for b in range(max(len(edges) - 1, 1))]
    rows, _ = forces.unexplained(forces.rows(np.array(masks, dtype=float), joint.qvel))
    information = rows @ rows.T / forces.variance
    covariance = np.linalg.pinv(information, hermitian=True)
    force = covariance @ (rows @ forces.residuals) / forces.variance
    return LawCurve(
        label=law.label,
        axis=axis,
        axis_unit=axis_unit,
        unit=unit,
        x=tuple(float(x[mask].mean()) for mask in masks),
        force=tuple(force.tolist()),
        error=tuple(np.sqrt(np.diagonal(covariance)).tolist()),
        law=tuple(float(value[mask].mean()) for mask in masks),
    )
