"""Any Gymnasium MuJoCo environment by its id."""

from collections.abc import Sequence
from typing import Any

import gymnasium

from dropo.core.services.errors import Incompatible, UnknownName
from dropo.core.services.validation import nearest
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.simulators.mujoco.warnings import quiet


class GymnasiumSimulator(MujocoSimulator):
    """The model and frame skip of a Gymnasium MuJoCo environment, replayed in batches.

    env_id: "Hopper-v5" or another; parameters: FieldParameters; threads: 0 for all cores; options:
    of `gymnasium.make`.
    observation: the columns of the data's rows. By default those of the environment's own
    observation that are positions and velocities (`qpos[k:]`, `qvel`; velocities not clipped,
    contact forces and inertias left out). Environments that observe something else (Reacher's
    cosines) need it given, as ["qpos", "qvel"], and data with these columns.
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
    """A Gymnasium MuJoCo environment without its wrappers; UnknownName or Incompatible where there
    is none.
    """
    try:
        with quiet():  # some of its models use deprecated MJCF
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
    """The environment's positions and velocities, where its observation begins with them as they
    are.
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
