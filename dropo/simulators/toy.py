"""Simulators whose answers are known in closed form."""

import numpy as np

from dropo.core.records.parameters import Parameter
from dropo.core.records.trajectories import Signal, Trajectories
from dropo.core.services.validation import Array, float_array, require
from dropo.simulators.function import ReplaySimulator


class LinearSimulator(ReplaySimulator):
    """A simulator that is linear in its parameters: moments and estimates have closed forms.

    o_{t+1} = o_t + M(a_t) xi with M(a) = sum_i a_i matrices[i]. The parameters are called "x0",
    "x1", ..., the signals "y0", "y1", ....

    Parameters
    ----------
    matrices : (q, p, d) array
        What each action adds to the observation, for a unit of each parameter.
    low, high : float
        The bounds of all parameters.

    Raises
    ------
    BadArgument
        If the matrices have another number of dimensions, or are not finite.
    """

    def __init__(self, matrices: Array, *, low: float = -10.0, high: float = 10.0):
        self.matrices = float_array("matrices", matrices, (None, None, None), "LinearSimulator")
        _, p, d = self.matrices.shape
        parameters = [Parameter(f"x{i}", low, high) for i in range(d)]
        super().__init__(parameters, [f"y{j}" for j in range(p)])

    def _replay(self, value: Array, starts: Array, actions: Array) -> Array:
        steps = np.einsum("nlq,qpd,d->nlp", actions, self.matrices, value)
        return starts[:, None] + np.cumsum(steps, axis=1)


class SlidingBlock(ReplaySimulator):
    """A block pushed along a line with viscous friction, solved exactly over a control step.

    m dv/dt = u - c v. Observation (position [m], velocity [m/s]), action (force u [N]), parameters
    mass m [kg] and damping c [N s/m].

    Parameters
    ----------
    dt : float
        The control step [s].

    Raises
    ------
    BadArgument
        If `dt` is not positive.
    """

    def __init__(self, *, dt: float = 0.05):
        require(dt > 0, "dt", "positive [s]", dt, "SlidingBlock")
        self.dt = dt
        parameters = [Parameter("mass", 0.5, 4.0, "kg"), Parameter("damping", 0.1, 3.0, "N s/m")]
        super().__init__(parameters, [Signal("position", "m"), Signal("velocity", "m/s")])

    def _replay(self, value: Array, starts: Array, actions: Array) -> Array:
        mass, damping = value
        decay = np.exp(-damping / mass * self.dt)
        x, v = starts.T
        out = np.empty((*actions.shape[:2], 2))
        for j, u in enumerate(np.moveaxis(actions[:, :, 0], 1, 0)):
            final = u / damping
            x = x + final * self.dt + (v - final) * (1 - decay) * mass / damping
            v = final + (v - final) * decay
            out[:, j, 0] = x
            out[:, j, 1] = v
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
    """Simulate trajectories of a toy simulator.

    Parameters
    ----------
    simulator : ReplaySimulator
        The simulator.
    values : (E, d) array
        The parameters of each trajectory.
    actions : (E, T, q) array
        The actions of each trajectory.
    start : (p,) array
        The first observation of all trajectories.
    noise_variance : (p,) array or float
        Variance of the Gaussian noise on the next observations alone, as in the thesis' noisy data.
    rng : Generator, optional
        Without one there is no noise.

    Returns
    -------
    Trajectories
        E T transitions, whose group is the trajectory.
    """
    replayed = []
    for value, own in zip(values, actions, strict=True):
        replayed.append(simulator._replay(value, start[None], own[None])[0])
    after = np.stack(replayed)  # (E, T, p)
    first = np.broadcast_to(start, (len(after), 1, len(start)))
    before = np.concatenate([first, after[:, :-1]], axis=1)
    if rng is not None:
        after = after + np.sqrt(noise_variance) * rng.standard_normal(after.shape)
    episodes, steps, p = after.shape
    ends = np.tile(np.arange(steps) == steps - 1, episodes)
    return Trajectories(
        before.reshape(-1, p),
        actions.reshape(episodes * steps, -1),
        after.reshape(-1, p),
        ends,
        group=np.repeat(np.arange(episodes), steps),
    )
