"""Any Gymnasium MuJoCo environment by its id."""

from collections.abc import Sequence
from typing import Any

import gymnasium

from dropo.core.checks import nearest
from dropo.core.errors import Incompatible, UnknownName
from dropo.simulators.fields import FieldParameter
from dropo.simulators.mujoco import MujocoSimulator, quiet


class GymnasiumSimulator(MujocoSimulator):
    """The model, frame skip and observation of a Gymnasium MuJoCo environment, replayed in batches.

    Observations are the environment's positions and velocities (`qpos[k:]`, `qvel`), velocities not clipped; other parts
    of an observation (contact forces, inertias) do not determine the state and are left out of the data's columns.
    """

    def __init__(self, env_id: str, parameters: Sequence[FieldParameter], *, threads: int = 0, **options: Any):
        model, frame_skip, skipped = _environment(env_id, options)
        observation = [f"qpos[{skipped}:]" if skipped else "qpos", "qvel"]
        super().__init__(model, parameters, observation=observation, frame_skip=frame_skip, threads=threads)


def _environment(env_id: str, options: dict[str, Any]) -> tuple[Any, int, int]:
    """The model, the frame skip, and how many leading positions the observation leaves out."""
    try:
        with quiet():  # some of its models use deprecated MJCF
            env = gymnasium.make(env_id, **options).unwrapped
    except (gymnasium.error.Error, ImportError) as error:
        if env_id in gymnasium.registry:
            raise Incompatible(f"The environment {env_id!r} cannot be made here: {error}") from None
        raise UnknownName(f"No Gymnasium environment called {env_id!r}. {nearest(env_id, gymnasium.registry)}") from None
    if not hasattr(env, "model") or not hasattr(env, "frame_skip"):
        raise Incompatible(f"The environment {env_id!r} is not a MuJoCo one. Use EnvSimulator with a function that sets its state.")
    structure = getattr(env, "observation_structure", None)
    skipped = env.model.nq - structure["qpos"] if structure else 0
    if structure is None or structure["qvel"] != env.model.nv or skipped != structure.get("skipped_qpos", 0):
        raise Incompatible(
            f"The observation of {env_id!r} does not hold positions and velocities as they are. Use MujocoSimulator with its model."
        )
    found = env.model, int(env.frame_skip), int(skipped)
    env.close()
    return found
