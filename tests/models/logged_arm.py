"""The log of an arm whose velocities are known."""

import numpy as np


def arm(time):
    """An angle [rad] and its velocity: three tones between 0.3 and 2.3 Hz."""
    parts = [(1.0, 0.31, 0.0), (0.5, 1.1, 1.0), (0.15, 2.3, 2.0)]
    angle = sum(a * np.sin(2 * np.pi * f * time + phase) for a, f, phase in parts)
    return angle, sum(
        2 * np.pi * f * a * np.cos(2 * np.pi * f * time + phase) for a, f, phase in parts
    )
