"""The slow, obvious twin of the `monte-carlo` likelihood on the hopper: the published way, one
transition and one step at a time.
"""

import mujoco
import numpy as np
from scipy.stats import multivariate_normal


def log_likelihood(model, bodies, masses, trajectories, epsilon, frame_skip):
    """(sum of log densities [nats], physics steps made) for masses (K, d) of the named bodies.

    Each transition is put to its measured observation and stepped under each draw; the moments of
    the K ends make its Gaussian density (thesis, eq. 5.3 to 5.5). The observation is all of the
    state but the first position.
    """
    data = mujoco.MjData(model)
    total = 0.0
    steps = 0
    for before, action, after in zip(
        trajectories.observations, trajectories.actions, trajectories.next_observations, strict=True
    ):
        ends = []
        for draw in masses:
            mujoco.mj_resetData(model, data)
            for body, mass in zip(bodies, draw, strict=True):
                model.body(body).mass[0] = mass
            data.qpos[1:], data.qvel[:] = before[: model.nq - 1], before[model.nq - 1 :]
            data.ctrl[:] = action
            for _ in range(frame_skip):
                mujoco.mj_step(model, data)
                steps += 1
            ends.append(np.concatenate([data.qpos[1:], data.qvel]))
        covariance = np.cov(np.array(ends).T) + epsilon * np.eye(len(after))
        total += multivariate_normal.logpdf(after, np.mean(ends, axis=0), covariance)
    return float(total), steps
