"""Velocities that are not those of their positions are named; others are not."""

import numpy as np
import pytest

from dropo.core.services.validation import Array
from dropo.data.checks.findings import Finding
from dropo.data.checks.kinematics import Displacements, check_motions, displacement_noise

STEP = 0.01
TIME = np.arange(1200) * STEP
SPEED = 2.0 * np.cos(2 * TIME) * (TIME > 1)  # at rest first


def said(velocity: Array) -> list[Finding]:
    """What is said of a logged velocity of a joint that moves with SPEED."""
    rng = np.random.default_rng(0)
    position = np.cumsum(SPEED) * STEP + rng.normal(0, 1e-4, len(TIME))
    moved = np.diff(position)
    motion = Displacements(
        name="qpos.elbow",
        velocity="qvel.elbow",
        displacement=moved,
        integral=STEP * (velocity[1:] + velocity[:-1]) / 2,
        noise=displacement_noise(moved),
        step=STEP,
        rows=np.arange(len(moved)),
        time=TIME[:-1],
        pieces=np.zeros(len(moved), dtype=int),
    )
    return check_motions([motion])


@pytest.mark.parametrize(("from_row", "value"), [(0, 0.0), (0, 0.4), (900, 1.2)])
def test_a_velocity_that_stands_still(from_row: int, value: float) -> None:
    """All along, or from a row on: an error, with its value and its first row."""
    velocity = np.where(np.arange(len(TIME)) < from_row, SPEED, value)
    (found,) = said(velocity)
    assert found.level == "error"
    assert f"it stands at {value:.4g} while qpos.elbow moves" in found.sentence
    assert found.row is not None
    assert max(100, from_row) - 20 <= found.row <= max(100, from_row) + 60


def test_velocities_that_rest_or_are_coarse() -> None:
    """A joint at rest has a velocity that stands; so have steps of a sensor, and rows kept long."""
    assert said(SPEED) == []
    assert said(np.round(SPEED / 0.5) * 0.5) == []
    assert said(np.repeat(SPEED[::10], 10)) == []
