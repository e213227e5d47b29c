"""Policies that are networks: SAC and PPO of stable-baselines3 (extra `rl`), with the thesis'
networks.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from dropo.core.services.atomic_write import atomic_write, write_json
from dropo.core.services.errors import Incompatible
from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import Array, require
from dropo.training.policy import Policy, write, written_limits
from dropo.training.setup import Progress, TrainingSetup

MODEL = "model.zip"
BUFFER = "buffer.pkl"
SCALE = "scale.pkl"
STATE = "networks.json"
"""What an interrupted training goes on from."""
CLIP = 10.0  # standard deviations, beyond which a normalised observation is cut


@dataclass(frozen=True, eq=False)
class NetworkPolicy(Policy):
    """A network of stable-baselines3, which acts without exploration.

    model: its algorithm; algorithm: "sac" or "ppo"; mean, deviation: (o,) by which observations are
    normalised, None where they are not;
    limits: (2, q); about: as for `Policy`.
    """

    model: Any
    algorithm: str
    mean: Array | None
    deviation: Array | None
    limits: Array
    about: dict[str, Any] = field(default_factory=dict)

    @property
    def observations(self) -> int:
        return int(self.model.observation_space.shape[0])

    def __call__(self, observations: Array) -> Array:
        if self.mean is not None and self.deviation is not None:
            observations = np.clip((observations - self.mean) / self.deviation, -CLIP, CLIP)
        return np.asarray(
            self.model.predict(observations.astype(np.float32), deterministic=True)[0], dtype=float
        )

    def save(self, path: str | Path) -> Path:
        scale = (
            None
            if self.mean is None or self.deviation is None
            else {"mean": self.mean.tolist(), "deviation": self.deviation.tolist()}
        )
        content = {
            "kind": "network",
            "algorithm": self.algorithm,
            "scale": scale,
            "limits": written_limits(self.limits),
        }
        file = write(path, {**content, "about": self.about})
        with atomic_write(file.with_suffix(".zip")) as part:
            self.model.save(part)
        return file

    @classmethod
    def of(
        cls, path: Path, content: dict[str, Any], limits: Array, about: dict[str, Any]
    ) -> "NetworkPolicy":
        """The policy of a JSON file with its zip beside it."""
        algorithm = content["algorithm"]
        scale = content["scale"]
        model = _library()[algorithm].load(path.with_suffix(".zip"), device="cpu")
        mean, deviation = (
            (None, None)
            if scale is None
            else (np.array(scale["mean"]), np.array(scale["deviation"]))
        )
        return cls(model, algorithm, mean, deviation, limits, about)


def _library() -> dict[str, Any]:
    """Name -> algorithm; MissingPackage with the line that installs it."""
    need("stable_baselines3", extra="rl", caller="Training a network")
    import stable_baselines3

    return {"sac": stable_baselines3.SAC, "ppo": stable_baselines3.PPO}


@dataclass(frozen=True, kw_only=True)
class SAC:
    """Soft actor-critic (Haarnoja et al. 2018) with the thesis' networks (section 6.2.4): two
    layers of 256, ReLU, Adam at 1e-3, mini-batches of 256; the rest as in stable-baselines3.

    steps: of training; every: so many steps are lost at most by an interruption.
    """

    steps: int = 300_000
    every: int = 20_000
    name = "sac"

    def __post_init__(self) -> None:
        require(
            min(self.steps, self.every) >= 1,
            "steps, every",
            "at least 1",
            (self.steps, self.every),
            "SAC",
        )

    def train(
        self, setup: TrainingSetup, rng: Generator, folder: Path | None, progress: Progress
    ) -> NetworkPolicy:
        """The policy after `steps` steps on a stage; with a folder, it goes on from what is there.

        progress: called with the share done and a text, after every step.
        """
        settings: dict[str, Any] = {
            "learning_rate": 1e-3,
            "batch_size": 256,
            "buffer_size": self.steps,
            "policy_kwargs": {"net_arch": [256, 256]},
        }
        return _Training(self.name, settings, 1, False, self.steps, self.every).run(
            setup, rng, folder, progress
        )


@dataclass(frozen=True, kw_only=True)
class PPO:
    """Proximal policy optimization (Schulman et al. 2017) with the thesis' networks (section
    6.3.2): two layers of 128 for actor and critic each, tanh; observations and rewards
    normalised; the rest as in stable-baselines3.

    steps: of training; count: of environments side by side; every: so many steps are lost at most
    by an interruption.
    """

    steps: int = 1_000_000
    count: int = 8
    every: int = 50_000
    name = "ppo"

    def __post_init__(self) -> None:
        counts = (self.steps, self.count, self.every)
        require(min(counts) >= 1, "steps, count, every", "at least 1", counts, "PPO")

    def train(
        self, setup: TrainingSetup, rng: Generator, folder: Path | None, progress: Progress
    ) -> NetworkPolicy:
        """The policy after `steps` steps on a stage; with a folder, it goes on from what is there.

        progress: called with the share done and a text, after every step.
        """
        need("torch", "stable_baselines3", extra="rl", caller="Training a network")
        import torch

        kind = {"net_arch": {"pi": [128, 128], "vf": [128, 128]}, "activation_fn": torch.nn.Tanh}
        return _Training(
            self.name, {"policy_kwargs": kind}, self.count, True, self.steps, self.every
        ).run(setup, rng, folder, progress)


@dataclass(frozen=True, eq=False)
class _Training:
    """One run of an algorithm: settings: of stable-baselines3; scaled: whether observations and
    rewards are normalised.
    """

    name: str
    settings: dict[str, Any]
    count: int
    scaled: bool
    steps: int
    every: int

    def run(
        self, setup: TrainingSetup, rng: Generator, folder: Path | None, progress: Progress
    ) -> NetworkPolicy:
        """Trains to the end."""
        library = _library()
        import torch
        from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

        torch.set_num_threads(1)  # such small networks are slower on more
        envs = [setup.env() for _ in range(self.count)]
        if not np.isfinite([envs[0].action_space.low, envs[0].action_space.high]).all():
            raise Incompatible(
                "A network's actions need limits, and some actuators have none. Give them "
                "a ctrlrange, or the task `limits`."
            )
        vector: Any = DummyVecEnv([_given(env) for env in envs])
        seed = int(rng.integers(2**31))
        done = 0
        going_on = folder is not None and (folder / STATE).is_file()
        if going_on and folder is not None:
            done = int(json.loads((folder / STATE).read_text())["steps"])
            vector = VecNormalize.load(str(folder / SCALE), vector) if self.scaled else vector
            model = library[self.name].load(folder / MODEL, env=vector, device="cpu")
            if self.name == "sac":
                model.load_replay_buffer(folder / BUFFER)
        else:
            vector = VecNormalize(vector, clip_obs=CLIP) if self.scaled else vector
            model = library[self.name](
                "MlpPolicy", vector, seed=seed, device="cpu", **self.settings
            )
        vector.seed(seed + done)
        while done < self.steps:
            model.learn(
                min(self.every, self.steps - done),
                reset_num_timesteps=False,
                callback=self._telling(envs, progress),
            )
            done = int(model.num_timesteps)
            if folder is not None:
                self._keep(model, vector, folder, done)
        failures = sum(env.batched_env.failures for env in envs)
        limits = np.array([envs[0].action_space.low, envs[0].action_space.high], dtype=float)
        mean, deviation = _scale(vector) if self.scaled else (None, None)
        vector.close()
        return NetworkPolicy(
            model,
            self.name,
            mean,
            deviation,
            limits,
            {"control_steps": done, "failed_simulations": failures},
        )

    def _telling(
        self, envs: list[Any], progress: Progress
    ) -> Callable[[dict[str, Any], dict[str, Any]], bool]:
        """A callback of stable-baselines3's that tells the environments, whose law may widen, and
        the caller how far it is.
        """

        def tell(here: dict[str, Any], beyond: dict[str, Any]) -> bool:
            model = here["self"]
            for env in envs:
                env.batched_env.steps = model.num_timesteps
            latest = [row["r"] for row in model.ep_info_buffer or ()]
            text = f", return {np.mean(latest):.0f}" if latest else ""
            progress(model.num_timesteps / self.steps, f"{model.num_timesteps:,} steps{text}")
            return True

        return tell

    def _keep(self, model: Any, vector: Any, folder: Path, done: int) -> None:
        """Everything that an interrupted training goes on from; the count of steps last, which
        makes it valid.
        """
        kept = {
            MODEL: model.save,
            **({BUFFER: model.save_replay_buffer} if self.name == "sac" else {}),
        }
        for name, save in {**kept, **({SCALE: vector.save} if self.scaled else {})}.items():
            with atomic_write(folder / name) as part:
                save(str(part))
        write_json(folder / STATE, {"steps": done})


def _given(env: Any) -> Callable[[], Any]:
    """What makes an environment that is there, with stable-baselines3's record of its returns."""
    from stable_baselines3.common.monitor import Monitor

    monitored = Monitor(env)
    return lambda: monitored


def _scale(vector: Any) -> tuple[Array, Array]:
    """Mean and deviation (o,) by which observations were normalised."""
    return vector.obs_rms.mean.astype(float), np.sqrt(vector.obs_rms.var + vector.epsilon)
