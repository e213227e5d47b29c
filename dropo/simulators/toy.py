"""Simulators whose answers are known in closed form."""

import numpy as np

from dropo.core.records.parameters import Parameter
from dropo.core.records.trajectories import Signal, Trajectories
from dropo.core.services.validation import Array, float_array, require
from dropo.simulators.function import ReplaySimulator


class LinearSimulator(ReplaySimulator):
    """o_{t+1} = o_t + M(a_t) xi: linear in the parameters, so every moment and every estimate has a
    closed form.

    matrices: (q, p, d); M(a) = sum_i a_i matrices[i]. Parameters are called "x0", "x1", ... with
    bounds [low, high].
    """

    def __init__(self, matrices: Array, *, low: float = -10.0, high: float = 10.0):
        self.matrices = float_array("matrices", matrices, (None, None, None), "LinearSimulator")
        _, p, d = self.matrices.shape
        super().__init__(
            [Parameter(f"x{i}", low, high) for i in range(d)], [f"y{j}" for j in range(p)]
        )

    def _replay(self, value: Array, starts: Array, actions: Array) -> Array:
        return starts[:, None] + np.cumsum(
            np.einsum("nlq,qpd,d->nlp", actions, self.matrices, value), axis=1
        )


class SlidingBlock(ReplaySimulator):
    """A block pushed along a line with viscous friction: m dv/dt = u - c v, solved exactly over a
    control step.

    Observation (position [m], velocity [m/s]), action (force u [N]), parameters mass m [kg] and
    damping c [N s/m].
    """

    def __init__(self, *, dt: float = 0.05):
        require(dt > 0, "dt", "positive [s]", dt, "SlidingBlock")
        self.dt = dt
        super().__init__(
            [Parameter("mass", 0.5, 4.0, "kg"), Parameter("damping", 0.1, 3.0, "N s/m")],
            [Signal("position", "m"), Signal("velocity", "m/s")],
        )

    def _replay(self, value: Array, starts: Array, actions: Array) -> Array:
        mass, damping = value
        decay = np.exp(-damping / mass * self.dt)
        x, v = starts.T
        out = np.empty((*actions.shape[:2], 2))
        for j, u in enumerate(np.moveaxis(actions[:, :, 0], 1, 0)):
            final = u / damping
            x = x + final * self.dt + (v - final) * (1 - decay) * mass / damping
            v = final + (v - final) * decay
            out[:, j] = np.stack([x, v], axis=-1)
        return out


def simulate(
    simulator: ReplaySimulator,
    values: Array,
    actions: Array,
    start: Array,
    *,
    noise_variance: Array | float = 0.0,
    rng: np.random.Generator | None = None,
) -> Trajectories:
    """Trajectories of a toy simulator, one a row of `values` (E, d), from start (p,) under actions
    (E, T, q).

    noise_variance: of Gaussian noise on the next observations alone, as in the thesis' noisy data;
    group: the trajectory.
    """
    after = np.stack(
        [
            simulator._replay(v, start[None], a[None])[0]
            for v, a in zip(values, actions, strict=True)
        ]
    )  # (E, T, p)
    before = np.concatenate(
        [np.broadcast_to(start, (len(after), 1, len(start))), after[:, :-1]], axis=1
    )
    if rng is not None:
        after = after + np.sqrt(noise_variance) * rng.standard_normal(after.shape)
    episodes, length, p = after.shape
    ends = np.tile(np.arange(length) == length - 1, episodes)
    return Trajectories(
        before.reshape(-1, p),
        actions.reshape(episodes * length, -1),
        after.reshape(-1, p),
        ends,
        group=np.repeat(np.arange(episodes), length),
    )
