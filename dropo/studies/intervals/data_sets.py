"""Simulated data for the study of coverage: two machines under many kinds of noise."""

from typing import Any

import numpy as np
from scipy import stats

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array, known
from dropo.problems.hopper.data import simulate as simulate_hopper
from dropo.problems.hopper.model import TRUTH
from dropo.problems.hopper.problem import hopper_simulator
from dropo.simulators.toy import SlidingBlock, simulate

RHO = 0.9  # autocorrelation of the autocorrelated noise from one control step to the next
NOISE = 5e-3  # standard deviation, in each signal's unit
DRY = 0.3  # [N] the friction that the model leaves out
BLOCK = np.array([1.5, 0.8])  # [kg], [N s/m]
OUTLIERS = 0.02  # share of measurements that are outliers
OUTLIER = 20.0  # standard deviation of an outlier, in those of the noise
LATE = 0.1  # what a control step is longer or shorter by, where its timing jitters
JITTER = 0.2  # share of such control steps

SPREAD = np.array([0.2, 0.08])  # [kg], [N s/m], standard deviations from run to run
CORRELATION = 0.6  # of the two where they are correlated

ENDS = ("independent", "autocorrelated", "dry friction", "ends t3", "ends with outliers")
"""Noise on the next observations alone: starts are exact."""
STATES = ("start", "Student t 3", "outliers", "quantised", "jitter")
"""Noise on every measured state, which is the end of one step and the start of the next."""
SPREADS = ("spread", "correlated spread")
"""Noise of a fifth of the others' on the next observations, and parameters that are drawn anew for
each trajectory from a Gaussian.
"""


class DryBlock(SlidingBlock):
    """The sliding block with Coulomb friction beside the viscous one, solved exactly.

    It slides one way until it stops; then it stays if the push is weaker than the friction, or
    slides the other way.
    """

    def _replay(self, value: Array, starts: Array, actions: Array) -> Array:
        """States behind each control step, for one parameter vector."""
        mass, damping = value
        lag = mass / damping
        out = np.empty((*actions.shape[:2], 2))
        x, v = starts.T
        for j, force in enumerate(actions[:, :, 0].T):
            # Until the end of the step, or until the block stops.
            final = (force - DRY * np.sign(v)) / damping
            duration = np.where(v == 0, 0.0, np.minimum(_stop_time(v, final, lag), self.dt))
            x, v = _slide(x, v, final, lag, duration)
            stopped = duration < self.dt
            v = np.where(stopped, 0.0, v)
            # The rest of the step, from rest.
            restart = np.sign(force) * np.maximum(np.abs(force) - DRY, 0.0) / damping
            x, v = _slide(x, v, np.where(stopped, restart, v), lag, self.dt - duration)
            out[:, j] = np.stack([x, v], axis=-1)
        return out


class JitteringBlock(SlidingBlock):
    """The sliding block under control steps that are now and then longer or shorter.

    Parameters
    ----------
    factors : (n, L) array
        Length of each control step of n runs, over the one that the model assumes.
    """

    def __init__(self, factors: Array):
        super().__init__()
        self.factors = factors

    def _replay(self, value: Array, starts: Array, actions: Array) -> Array:
        """States behind each control step of all runs, for one parameter vector."""
        mass, damping = value
        out = np.empty((*actions.shape[:2], 2))
        x, v = starts.T
        for j, force in enumerate(actions[:, :, 0].T):
            time = self.dt * self.factors[:, j]
            x, v = _slide(x, v, force / damping, mass / damping, time)
            out[:, j] = np.stack([x, v], axis=-1)
        return out


def _stop_time(v: Array, final: Array, lag: float) -> Array:
    """When a velocity that approaches a final one of the other sign is 0; infinity if it is not."""
    turns = v * final < 0
    ratio = np.where(turns, -v / np.where(turns, final, 1.0), 0.0)
    return np.where(turns, lag * np.log1p(ratio), np.inf)


def _slide(x: Array, v: Array, final: Array, lag: float, time: Array) -> tuple[Array, Array]:
    """Position and velocity after a time, towards a final velocity with a time constant."""
    decay = np.exp(-time / lag)
    return x + final * time + (v - final) * (1 - decay) * lag, final + (v - final) * decay


def data_set(
    robot: str, noise: str, count: int, steps: int, rng: np.random.Generator
) -> tuple[Problem, Array]:
    """Simulate the data of one case.

    Parameters
    ----------
    robot : str
        "block" or "hopper".
    noise : str
        One of `ENDS`, `STATES` or `SPREADS`; "dry friction" is independent noise, and friction that
        the model does not have.
    count : int
        Number of trajectories.
    steps : int
        Control steps of each.
    rng : numpy.random.Generator
        Source of forces and noise.

    Returns
    -------
    problem : Problem
        The problem on these data.
    truth : (d,) array
        True parameters; the means of those that differ from run to run.

    Raises
    ------
    UnknownName
        If there is no such noise.
    """
    known("noise", noise, (*ENDS, *STATES, *SPREADS))
    model: Any
    if robot == "block":
        model = SlidingBlock()
        truth = BLOCK
        forces = np.repeat(rng.normal(0.0, 3.0, (count, -(-steps // 5), 1)), 5, axis=1)[:, :steps]
        if noise in SPREADS:
            return _spread(noise, forces, rng), truth
        clean = _pushed(noise, forces, rng)
    else:
        model = hopper_simulator(threads=1)
        truth = np.array([TRUTH[name] for name in model.space.names])
        clean, _ = simulate_hopper(steps, count, rng=rng)
    before = clean.observations
    after = clean.next_observations
    p = after.shape[1]
    if noise in STATES:
        first = before[:: len(before) // count].reshape(count, 1, p)
        states = np.concatenate([first, after.reshape(count, steps, p)], axis=1)
        states = measured(noise, states, rng)
        before = states[:, :-1].reshape(before.shape)
        after = states[:, 1:].reshape(after.shape)
    elif noise == "autocorrelated":
        after = after + autocorrelated((count, steps, p), rng).reshape(after.shape)
    else:
        kind = {"ends t3": "Student t 3", "ends with outliers": "outliers"}.get(noise, "start")
        after = measured(kind, after, rng)
    data = Trajectories(before, clean.actions, after, clean.terminals)
    # The first kind is told of its starts; of the others a fit finds out.
    return Problem(f"{robot}, {noise}", model, data, start_noise=noise == "start"), truth


def _spread(noise: str, forces: Array, rng: np.random.Generator) -> Problem:
    """A block of other parameters in each run, under forces (n, L, 1)."""
    correlation = CORRELATION if noise == "correlated spread" else 0.0
    root = np.linalg.cholesky([[1.0, correlation], [correlation, 1.0]])
    values = BLOCK + SPREAD * (rng.standard_normal((len(forces), 2)) @ root.T)
    variance = (NOISE / 5) ** 2
    simulator = SlidingBlock()
    data = simulate(simulator, values, forces, np.zeros(2), noise_variance=variance, rng=rng)
    return Problem(f"block, {noise}", simulator, data, epsilon=variance)


def _pushed(noise: str, forces: Array, rng: np.random.Generator) -> Trajectories:
    """A block under forces (n, L, 1), without noise."""
    values = np.tile(BLOCK, (len(forces), 1))
    if noise != "jitter":
        simulator = DryBlock() if noise == "dry friction" else SlidingBlock()
        return simulate(simulator, values, forces, np.zeros(2))
    shares = [JITTER / 2, 1 - JITTER, JITTER / 2]
    factors = 1 + LATE * rng.choice([-1, 0, 1], forces.shape[:2], p=shares)
    jittering = [JitteringBlock(factors[[i]]) for i in range(len(forces))]
    runs = [simulate(own, values[[i]], forces[[i]], np.zeros(2)) for i, own in enumerate(jittering)]
    return Trajectories(
        np.concatenate([run.observations for run in runs]),
        np.concatenate([run.actions for run in runs]),
        np.concatenate([run.next_observations for run in runs]),
        np.concatenate([run.terminals for run in runs]),
    )


def measured(noise: str, states: Array, rng: np.random.Generator) -> Array:
    """What sensors of a kind make of states; their errors have the standard deviation `NOISE`.

    Parameters
    ----------
    noise : str
        One of `STATES`: Gaussian ("start", "jitter"), Student's t of 3 degrees of freedom, Gaussian
        with outliers beside it, or rounding.
    states : array
        True ones.
    rng : numpy.random.Generator

    Returns
    -------
    array
    """
    if noise == "quantised":
        step = np.sqrt(12) * NOISE
        return np.round(states / step) * step
    if noise == "Student t 3":
        return states + NOISE * stats.t.rvs(3, size=states.shape, random_state=rng) / np.sqrt(3)
    errors = NOISE * rng.standard_normal(states.shape)
    if noise == "outliers":
        errors *= np.where(rng.random(states.shape) < OUTLIERS, OUTLIER, 1.0)
    return states + errors


def autocorrelated(shape: tuple[int, int, int], rng: np.random.Generator) -> Array:
    """Errors of a stationary first-order autoregression along the control steps.

    Parameters
    ----------
    shape : (int, int, int)
        Trajectories, control steps, signals.
    rng : numpy.random.Generator
        Source of the errors.

    Returns
    -------
    array
        Of that shape, with standard deviation `NOISE` and correlation `RHO` of neighbours.
    """
    errors = NOISE * rng.standard_normal(shape)
    for t in range(1, shape[1]):
        errors[:, t] = RHO * errors[:, t - 1] + np.sqrt(1 - RHO**2) * errors[:, t]
    return errors
