"""The MJCF of a simulator's model, with those of its effects that MJCF has elements for."""

from pathlib import Path

import mujoco

from dropo.core.contracts.effect import ActiveEffects, EffectInstance
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.mjmodel.files.writing import write_model
from dropo.simulators.mujoco.model_assets import with_absolute_assets
from dropo.simulators.mujoco.simulator import MujocoSimulator


def format_model(
    simulator: MujocoSimulator, values: Array | None = None, active: ActiveEffects | None = None
) -> str:
    """Write the model of a simulator as MJCF.

    Parameters
    ----------
    simulator : MujocoSimulator
        The model.
    values : (d,) array, optional
        Its declared parameters, which are written in; by default the model's own numbers.
    active : sequence of (EffectInstance, (q,) array), optional
        Effects, which are written in where they are numbers of the model; by default the
        simulator's fixed ones.

    Returns
    -------
    str
        The MJCF, in which numbers have about six digits, and paths of files are absolute.

    Raises
    ------
    Incompatible
        If MuJoCo refuses the model with these numbers.
    """
    # Read anew, angles are in radians.
    source = simulator.spec()
    text = with_absolute_assets(source.to_xml(), Path(source.modelfiledir).absolute())
    spec = mujoco.MjSpec.from_string(text)
    spec.compile()
    every = simulator.fixed if active is None else active
    in_model = [pair for pair in every if is_in_model(pair[0])]
    model = simulator.model_of(simulator.nominal if values is None else values, in_model)
    write_model(spec, model)
    try:
        spec.compile()
    except ValueError as error:
        raise Incompatible(f"MuJoCo refuses the model with what was found: {error}") from None
    return str(spec.to_xml())


def is_in_model(instance: EffectInstance) -> bool:
    """Tell whether an effect is a number of the model that MJCF can hold.

    Parameters
    ----------
    instance : EffectInstance
        The effect at its place.

    Returns
    -------
    bool
        False for effects on commands or sensors, and for those that come with time.
    """
    return instance.model is not None and instance.time_profile is None
