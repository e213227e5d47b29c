"""A mass on a line whose effects are linear in their magnitudes: fast enough for many data sets."""

import numpy as np

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.records.trajectories import Signal, Trajectories
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.whitening import white
from dropo.diagnosis.search.windows import split

DT = 0.1
GAIN = 2.0
SIGNALS = (Signal("x", "m"), Signal("v", "m/s"))
EFFECTS = {
    "damping": lambda x, v, u: -v,
    "spring": lambda x, v, u: -x,
    "bias": lambda x, v, u: 1.0 + 0 * x,
    "gain": lambda x, v, u: u,
    "friction": lambda x, v, u: -np.tanh(v / 0.05),
    "drag": lambda x, v, u: -v * np.abs(v),
}
"""Accelerations by which a magnitude is multiplied."""


class Mass(Simulator):
    """x'' = gain u + sum of magnitudes times EFFECTS, by Euler's method; gain may be declared."""

    def __init__(self, declared=False, effects=tuple(EFFECTS)):
        own = [Parameter("gain of the motor", 1.0, 4.0)] if declared else []
        self.declared = declared
        self.effects = effects
        self.signals = SIGNALS
        self.space = ParameterSpace(
            (*own, *(Parameter(f"{name}/size", -20.0, 20.0) for name in effects))
        )
        self.nominal = np.array([GAIN] * declared)

    def _predict(self, values, segments, offsets):
        starts = segments.starts[None] + (0 if offsets is None else offsets)
        x, v = (
            np.broadcast_to(part, (len(values), len(segments))).copy()
            for part in np.moveaxis(starts, 2, 0)
        )
        gain, sizes = (values[:, :1], values[:, 1:]) if self.declared else (GAIN, values)
        out = np.empty((*x.shape, segments.actions.shape[1], 2))
        for t in range(out.shape[2]):
            u = segments.actions[:, t, 0]
            force = gain * u + sum(
                sizes[:, [j]] * EFFECTS[name](x, v, u) for j, name in enumerate(self.effects)
            )
            x = x + DT * v
            v = v + DT * force
            out[:, :, t] = np.stack([x, v], axis=2)
        return out.reshape(len(values), -1, 2) if segments.every_step else out[:, :, -1]


def instances(effects=tuple(EFFECTS)):
    """One instance an effect, found between -20 and 20."""
    return [
        EffectInstance(name, "mass", (Quantity("size", "1", -20.0, 20.0, (-0.1, 0.1)),))
        for name in effects
    ]


def measured(hidden, sigma=1e-3, seed=0, episodes=20, steps=40, shake=0.0):
    """Data of the mass with magnitudes hidden, by name; shake: the sd of a random acceleration in
    each step.
    """
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.normal(size=(episodes, -(-steps // 4))), 4, axis=1)[:, :steps]
    x, v = rng.normal(size=(2, episodes)) * 0.5
    states = [np.stack([x, v], axis=1)]
    for t in range(steps):
        u = force[:, t]
        push = (
            GAIN * u
            + sum(size * EFFECTS[name](x, v, u) for name, size in hidden.items())
            + shake * rng.normal(size=episodes)
        )
        x = x + DT * v
        v = v + DT * push
        states.append(np.stack([x, v], axis=1))
    seen = np.stack(states, axis=1) + sigma * rng.normal(size=(episodes, steps + 1, 2))
    ends = np.tile(np.arange(steps) == steps - 1, episodes)
    return Trajectories(
        seen[:, :-1].reshape(-1, 2), force.reshape(-1, 1), seen[:, 1:].reshape(-1, 2), ends
    )


def loaded_spring():
    """A spring with a load: the first two effects of a mass, as one of two numbers."""
    probes = (-0.1, 0.1)
    sizes = [Quantity(name, "1", -20.0, 20.0, probes) for name in ("stiffness", "load")]
    return EffectInstance("spring", "mass", tuple(sizes), "rest")


def selection(data, declared=False, effects=tuple(EFFECTS), length=5, windows=60, offered=None):
    """A search about to begin, and its first state; offered: other instances of the effects."""
    simulator = Mass(declared, effects)
    library = Library(simulator, offered or instances(effects), int(declared))
    train, test = split(Problem("mass", simulator, data), length, windows)
    search = Selection(library, np.full(2, 1e-9))
    start = np.concatenate([simulator.nominal, np.zeros(len(effects))])
    return search, search.begin(
        train, test, start, white(np.full(2, 2e-3)), np.arange(int(declared))
    )
