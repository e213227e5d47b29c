"""Any Gymnasium MuJoCo environment by its id."""

from collections.abc import Sequence
from typing import Any

import gymnasium

from dropo.core.services.errors import Incompatible, UnknownName
from dropo.core.services.validation import nearest
from dropo.mjmodel.fields import FieldParameter
from dropo.mjmodel.warnings import suppress_mujoco_warnings
from dropo.simulators.mujoco.simulator import MujocoSimulator


class GymnasiumSimulator(MujocoSimulator):
    """Replays segments with the model and frame skip of a Gymnasium MuJoCo environment, in batches.

    Parameters
    ----------
    env_id : str
        "Hopper-v5" or another.
    parameters : sequence of FieldParameter
        The d parameters.
    observation : sequence of str, optional
        The columns of the data's rows. By default those of the environment's own observation that
        are positions and velocities (`qpos[k:]`, `qvel`; velocities not clipped, contact forces and
        inertias left out).
    threads : int
        The number of threads; 0 for all cores.
    options
        Of `gymnasium.make`.

    Raises
    ------
    UnknownName
        If there is no such environment; with the nearest name.
    Incompatible
        If the environment cannot be made, is not a MuJoCo one, or observes something else than
        positions and velocities (such as Reacher's cosines) and no `observation` is given: then
        data with the columns ["qpos", "qvel"] are needed.
    """

    def __init__(
        self,
        env_id: str,
        parameters: Sequence[FieldParameter],
        *,
        observation: Sequence[str] | None = None,
        threads: int = 0,
        **options: Any,
    ):
        env = make_environment(env_id, options)
        model = env.model
        frame_skip = int(env.frame_skip)
        columns = observed_columns(env_id, env) if observation is None else observation
        env.close()
        super().__init__(
            model, parameters, observation=columns, frame_skip=frame_skip, threads=threads
        )


def make_environment(env_id: str, options: dict[str, Any]) -> Any:
    """Make a Gymnasium MuJoCo environment without its wrappers.

    Parameters
    ----------
    env_id : str
        "Hopper-v5" or another.
    options : dict
        Of `gymnasium.make`.

    Returns
    -------
    gymnasium.Env

    Raises
    ------
    UnknownName
        If there is no such environment; with the nearest name.
    Incompatible
        If the environment cannot be made here, or is not a MuJoCo one.
    """
    try:
        with suppress_mujoco_warnings():  # some of its models use deprecated MJCF
            env = gymnasium.make(env_id, **options).unwrapped
    except (gymnasium.error.Error, ImportError) as error:
        if env_id in gymnasium.registry:
            raise Incompatible(f"The environment {env_id!r} cannot be made here: {error}") from None
        raise UnknownName(
            f"No Gymnasium environment called {env_id!r}. {nearest(env_id, gymnasium.registry)}"
        ) from None
    if not hasattr(env, "model") or not hasattr(env, "frame_skip"):
        raise Incompatible(
            f"The environment {env_id!r} is not a MuJoCo one. Use EnvSimulator with a "
            "function that sets its state."
        )
    return env


def observed_columns(env_id: str, env: Any) -> list[str]:
    """List the columns of an environment's observation that are positions and velocities.

    Parameters
    ----------
    env_id : str
        The name of the environment, for refusals.
    env : gymnasium.Env
        The environment.

    Returns
    -------
    list of str
        `qpos` or `qpos[k:]`, and `qvel`.

    Raises
    ------
    Incompatible
        If the observation does not begin with positions and velocities as they are.
    """
    structure = getattr(env, "observation_structure", None)
    skipped = int(env.model.nq - structure["qpos"]) if structure else 0
    if (
        structure is None
        or structure["qvel"] != env.model.nv
        or skipped != structure.get("skipped_qpos", 0)
    ):
        raise Incompatible(
            f"The observation of {env_id!r} does not hold positions and velocities as they are."
            " Give observation=['qpos', 'qvel'], and data with these columns."
        )
    return [f"qpos[{skipped}:]" if skipped else "qpos", "qvel"]
