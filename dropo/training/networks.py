"""Policies that are networks: SAC and PPO of stable-baselines3, with the thesis' networks.

The optional dependency is `dropo[rl]`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from dropo.core.services.errors import Incompatible
from dropo.core.services.files.atomic_write import atomic_write, write_json
from dropo.core.services.files.saved_files import read_json, refusing_faults
from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import Array, require
from dropo.training.policy import Policy, refuse_untrusted, write, written_limits
from dropo.training.setup import Progress, TrainingSetup

MODEL_FILE = "model.zip"
BUFFER_FILE = "buffer.pkl"
SCALE_FILE = "scale.pkl"
STATE_FILE = "networks.json"
"""The file that makes the others valid; an interrupted training goes on from them."""
CLIP = 10.0
"""Standard deviations beyond which a normalised observation is clipped, as in stable-baselines3."""


@dataclass(frozen=True, eq=False)
class NetworkPolicy(Policy):
    """A network of stable-baselines3, which acts without exploration.

    Attributes
    ----------
    model : stable_baselines3.common.base_class.BaseAlgorithm
        The trained algorithm.
    algorithm : {"sac", "ppo"}
        Its name.
    mean, deviation : (o,) array or None
        Mean and standard deviation by which observations are normalised; None if they are not.
    limits : (2, q) array
        Lowest and highest actions.
    about : dict
        How the policy was trained, as JSON.
    """

    model: Any
    algorithm: str
    mean: Array | None
    deviation: Array | None
    limits: Array
    about: dict[str, Any] = field(default_factory=dict)

    @property
    def observations(self) -> int:
        """The number o of observations."""
        return int(self.model.observation_space.shape[0])

    def __call__(self, observations: Array) -> Array:
        if self.mean is not None and self.deviation is not None:
            observations = np.clip((observations - self.mean) / self.deviation, -CLIP, CLIP)
        actions, _ = self.model.predict(observations.astype(np.float32), deterministic=True)
        return np.asarray(actions, dtype=float)

    def save(self, path: str | Path) -> Path:
        """Write the policy as JSON, and the network's zip beside it.

        Parameters
        ----------
        path : str or Path
            A .json file, or a folder.

        Returns
        -------
        Path
            The JSON file.
        """
        scale = None
        if self.mean is not None and self.deviation is not None:
            scale = {"mean": self.mean.tolist(), "deviation": self.deviation.tolist()}
        content = {
            "kind": "network",
            "algorithm": self.algorithm,
            "scale": scale,
            "limits": written_limits(self.limits),
            "about": self.about,
        }
        file = write(path, content)
        with atomic_write(file.with_suffix(".zip")) as part:
            self.model.save(part)
        return file

    @classmethod
    def read(
        cls, path: Path, content: dict[str, Any], limits: Array, about: dict[str, Any]
    ) -> "NetworkPolicy":
        """Read the policy of a JSON file with its zip beside it.

        Parameters
        ----------
        path : Path
            The JSON file.
        content : dict
            Its content.
        limits : (2, q) array
            Lowest and highest actions, as in the content.
        about : dict
            How the policy was trained, as in the content.

        Returns
        -------
        NetworkPolicy
            The policy.

        Raises
        ------
        MissingPackage
            If stable-baselines3 is not installed.
        """
        algorithm = content["algorithm"]
        model = _algorithms()[algorithm].load(path.with_suffix(".zip"), device="cpu")
        mean = None
        deviation = None
        scale = content["scale"]
        if scale is not None:
            mean = np.array(scale["mean"])
            deviation = np.array(scale["deviation"])
        return cls(model, algorithm, mean, deviation, limits, about)


def refuse_untrusted_training(folder: Path) -> None:
    """Refuse to go on with a training whose files may hold code.

    Parameters
    ----------
    folder : Path
        Of a training, begun or not.

    Raises
    ------
    Incompatible
        If a network's training was begun there.
    """
    if (folder / STATE_FILE).is_file():
        refuse_untrusted(folder / MODEL_FILE)


def _algorithms() -> dict[str, Any]:
    """Returns stable-baselines3's algorithms by name; refuses where it is not installed."""
    need("stable_baselines3", extra="rl", caller="Training a network")
    import stable_baselines3

    return {"sac": stable_baselines3.SAC, "ppo": stable_baselines3.PPO}


@dataclass(frozen=True, kw_only=True)
class SAC:
    """Soft actor-critic with the thesis' networks (section 6.2.4).

    Two layers of 256, ReLU, Adam at 1e-3, mini-batches of 256; the rest as in stable-baselines3.

    Attributes
    ----------
    steps : int
        Control steps of training.
    every : int
        Control steps between savings of the training: as many are lost at most by an interruption.

    Raises
    ------
    BadArgument
        If `steps` or `every` is below 1.

    References
    ----------
    Haarnoja et al. (2018), "Soft actor-critic: off-policy maximum entropy deep reinforcement
    learning with a stochastic actor", ICML.
    """

    steps: int = 300_000
    every: int = 20_000
    name = "sac"

    def __post_init__(self) -> None:
        counts = (self.steps, self.every)
        require(min(counts) >= 1, "steps, every", "at least 1", counts, "SAC")

    def train(
        self, setup: TrainingSetup, rng: Generator, folder: Path | None, progress: Progress
    ) -> NetworkPolicy:
        """Train a network.

        Parameters
        ----------
        setup : TrainingSetup
            The environments.
        rng : numpy.random.Generator
            Source of the seed of networks, exploration and environments.
        folder : Path or None
            Where the training is saved every `every` steps. It goes on from what is there.
        progress : callable
            Called with the fraction done and a text, after every step.

        Returns
        -------
        NetworkPolicy
            The policy after `steps` steps.

        Raises
        ------
        MissingPackage
            If stable-baselines3 is not installed.
        Incompatible
            If an actuator has no limits.
        """
        settings: dict[str, Any] = {
            "learning_rate": 1e-3,
            "batch_size": 256,
            "buffer_size": self.steps,
            "policy_kwargs": {"net_arch": [256, 256]},
        }
        training = _Training(
            self.name, settings, count=1, scaled=False, steps=self.steps, every=self.every
        )
        return training.run(setup, rng, folder, progress)


@dataclass(frozen=True, kw_only=True)
class PPO:
    """Proximal policy optimization with the thesis' networks (section 6.3.2).

    Two layers of 128 for actor and critic each, tanh; observations and rewards normalised; the rest
    as in stable-baselines3.

    Attributes
    ----------
    steps : int
        Control steps of training.
    count : int
        Number of environments.
    every : int
        Control steps between savings of the training: as many are lost at most by an interruption.

    Raises
    ------
    BadArgument
        If `steps`, `count` or `every` is below 1.

    References
    ----------
    Schulman et al. (2017), "Proximal policy optimization algorithms", arXiv:1707.06347.
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
        """Train a network.

        Parameters
        ----------
        setup : TrainingSetup
            The environments.
        rng : numpy.random.Generator
            Source of the seed of networks, exploration and environments.
        folder : Path or None
            Where the training is saved every `every` steps. It goes on from what is there.
        progress : callable
            Called with the fraction done and a text, after every step.

        Returns
        -------
        NetworkPolicy
            The policy after `steps` steps.

        Raises
        ------
        MissingPackage
            If stable-baselines3 is not installed.
        Incompatible
            If an actuator has no limits.
        """
        need("torch", "stable_baselines3", extra="rl", caller="Training a network")
        import torch

        layers = {"pi": [128, 128], "vf": [128, 128]}
        settings = {"policy_kwargs": {"net_arch": layers, "activation_fn": torch.nn.Tanh}}
        training = _Training(
            self.name, settings, count=self.count, scaled=True, steps=self.steps, every=self.every
        )
        return training.run(setup, rng, folder, progress)


@dataclass(frozen=True, eq=False)
class _Training:
    """One run of an algorithm of stable-baselines3.

    settings: arguments of the algorithm; count: number of environments; scaled: whether
    observations and rewards are normalised; steps: of the whole training; every: steps between
    savings.
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
        """Train to the end and return the policy."""
        _algorithms()  # refuses before anything is made
        import torch

        torch.set_num_threads(1)  # such small networks are slower on more
        envs = [setup.env() for _ in range(self.count)]
        limits = np.array([envs[0].action_space.low, envs[0].action_space.high], dtype=float)
        if not np.isfinite(limits).all():
            raise Incompatible(
                "A network's actions need limits, and some actuators have none. Give them "
                "a ctrlrange, or the task `limits`."
            )
        seed = int(rng.integers(2**31))
        # a new training, or an interrupted one
        if folder is not None and (folder / STATE_FILE).is_file():
            model, vector, done = self._load(envs, folder)
        else:
            model, vector = self._new(envs, seed)
            done = 0
        vector.seed(seed + done)
        # training in parts, each of which is saved
        while done < self.steps:
            model.learn(
                min(self.every, self.steps - done),
                reset_num_timesteps=False,
                callback=self._callback(envs, progress),
            )
            done = int(model.num_timesteps)
            if folder is not None:
                self._save(model, vector, folder, done)
        failures = sum(env.batched_env.failures for env in envs)
        mean, deviation = _scale(vector) if self.scaled else (None, None)
        vector.close()
        about = {"control_steps": done, "failed_simulations": failures}
        return NetworkPolicy(model, self.name, mean, deviation, limits, about)

    def _new(self, envs: list[Any], seed: int) -> tuple[Any, Any]:
        """Returns a new model, and stable-baselines3's vector of the environments."""
        from stable_baselines3.common.vec_env import VecNormalize

        vector = _vector(envs)
        if self.scaled:
            vector = VecNormalize(vector, clip_obs=CLIP)
        algorithm = _algorithms()[self.name]
        model = algorithm("MlpPolicy", vector, seed=seed, device="cpu", **self.settings)
        return model, vector

    def _load(self, envs: list[Any], folder: Path) -> tuple[Any, Any, int]:
        """Returns the model, the vector of environments and the steps made from a folder."""
        from stable_baselines3.common.vec_env import VecNormalize

        what = "a training that was interrupted"
        with refusing_faults(folder / STATE_FILE, what):
            done = int(read_json(folder / STATE_FILE, what)["steps"])
        vector = _vector(envs)
        if self.scaled:
            with refusing_faults(folder / SCALE_FILE, what):
                vector = VecNormalize.load(str(folder / SCALE_FILE), vector)
        with refusing_faults(folder / MODEL_FILE, what):
            model = _algorithms()[self.name].load(folder / MODEL_FILE, env=vector, device="cpu")
        if self.name == "sac":
            with refusing_faults(folder / BUFFER_FILE, what):
                model.load_replay_buffer(folder / BUFFER_FILE)
        return model, vector, done

    def _save(self, model: Any, vector: Any, folder: Path, done: int) -> None:
        """Writes what an interrupted training goes on from; the count of steps last."""
        writers = {MODEL_FILE: model.save}
        if self.name == "sac":
            writers[BUFFER_FILE] = model.save_replay_buffer
        if self.scaled:
            writers[SCALE_FILE] = vector.save
        for name, writer in writers.items():
            with atomic_write(folder / name) as part:
                writer(str(part))
        write_json(folder / STATE_FILE, {"steps": done})

    def _callback(
        self, envs: list[Any], progress: Progress
    ) -> Callable[[dict[str, Any], dict[str, Any]], bool]:
        """Returns a callback for stable-baselines3, which is called after every step.

        It sets the steps made in the environments, on which a curriculum depends, and reports the
        progress.
        """

        def report(local_names: dict[str, Any], global_names: dict[str, Any]) -> bool:
            model = local_names["self"]
            for env in envs:
                env.batched_env.steps = model.num_timesteps
            latest = [episode["r"] for episode in model.ep_info_buffer or ()]
            text = f", return {np.mean(latest):.0f}" if latest else ""
            progress(model.num_timesteps / self.steps, f"{model.num_timesteps:,} steps{text}")
            return True

        return report


def _vector(envs: list[Any]) -> Any:
    """Returns environments as stable-baselines3's vector, with its record of their returns."""
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

    monitored = [Monitor(env) for env in envs]
    return DummyVecEnv([partial(_itself, env) for env in monitored])


def _itself(env: Any) -> Any:
    """Returns the environment, where stable-baselines3 wants a function that makes it."""
    return env


def _scale(vector: Any) -> tuple[Array, Array]:
    """Returns mean and standard deviation (o,) by which observations were normalised."""
    return vector.obs_rms.mean.astype(float), np.sqrt(vector.obs_rms.var + vector.epsilon)
