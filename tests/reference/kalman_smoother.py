"""A Kalman filter and Rauch-Tung-Striebel smoother written step by step, for comparison with banded
matrices.
"""

import numpy as np
from scipy.integrate import quad_vec
from scipy.linalg import expm


def smooth(time, measured, order, q, r, start=1e10):
    """Smoothed states (n, m), filtered states (n, m) and the log likelihood of motion as m-fold
    integrated white noise.
    """
    generator = np.diag(np.ones(order - 1), 1)
    steps = []
    for h in np.diff(time):
        noise = quad_vec(
            lambda s: np.outer(expm(generator * s)[:, -1], expm(generator * s)[:, -1]), 0, h
        )[0]
        steps.append((expm(generator * h), q * noise))
    states = np.zeros(order)
    covariance = start * np.eye(order)
    see = np.eye(order)[0]
    filtered = []
    predicted = []
    log_likelihood = 0.0
    for k, y in enumerate(measured):
        if k:
            a, noise = steps[k - 1]
            states = a @ states
            covariance = a @ covariance @ a.T + noise
        predicted.append((states, covariance))
        total = see @ covariance @ see + r
        log_likelihood -= 0.5 * (np.log(2 * np.pi * total) + (y - states[0]) ** 2 / total)
        gain = covariance @ see / total
        states = states + gain * (y - states[0])
        covariance = (np.eye(order) - np.outer(gain, see)) @ covariance @ (
            np.eye(order) - np.outer(gain, see)
        ).T + r * np.outer(gain, gain)
        filtered.append((states, covariance))
    smoothed = [filtered[-1][0]]
    for k in range(len(measured) - 2, -1, -1):
        gain = filtered[k][1] @ steps[k][0].T @ np.linalg.inv(predicted[k + 1][1])
        smoothed.append(filtered[k][0] + gain @ (smoothed[-1] - predicted[k + 1][0]))
    return np.array(smoothed[::-1]), np.array([state for state, _ in filtered]), log_likelihood
