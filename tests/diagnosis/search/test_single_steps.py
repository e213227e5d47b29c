"""Effects of the commands that are in windows only because a closed loop answers to chance."""

import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.diagnosis.search import selection as search
from dropo.diagnosis.search.single_steps import magnitude_in_single_steps
from tests.models.linear_mass import DT, GAIN, instances, selection

# sd of the random forces [m/s^2]
RUNS = 8
FORCE = 1.0


def closed_loop(seed, *, gain=GAIN, force=FORCE):
    """A mass held by feedback that random forces push, in every step another; sensors see it to
    1e-4.
    """
    rng = np.random.default_rng(seed)
    count = 24
    steps = 60
    x, v = rng.uniform(-1, 1, (2, count))
    path = [np.stack([x, v], axis=1)]
    commands = []
    for _ in range(steps):
        u = -3 * x - 2 * v + 0.1 * rng.standard_normal(count)
        x = x + DT * v
        v = v + DT * (gain * u + force * rng.standard_normal(count))
        path.append(np.stack([x, v], axis=1))
        commands.append(u[:, None])
    seen = np.stack(path, axis=1) + 1e-4 * rng.standard_normal((count, steps + 1, 2))
    rows = [
        np.concatenate(part) for part in (seen[:, :-1], np.stack(commands, axis=1), seen[:, 1:])
    ]
    return Trajectories(*rows, np.arange(count * steps) % steps == steps - 1)


def named(data):
    finder, first = selection(data, length=10)
    return [instance.effect for instance in finder.run(first, first, instances()).accepted]


def test_answers_to_chance_are_not_named(monkeypatch):
    """Eight data sets with random forces alone: no effect is named; without the look at single
    steps, one is in some of them.
    """
    assert sum(bool(named(closed_loop(seed))) for seed in range(RUNS)) == 0
    monkeypatch.setattr(search, "absent_in_single_steps", lambda *_: False)
    assert sum(bool(named(closed_loop(seed))) for seed in range(RUNS)) >= 2


@pytest.mark.parametrize("seed", range(3))
def test_a_true_gain_is_named_beside_random_forces(seed):
    """It is named, and in single steps it has its size, within a tenth."""
    finder, first = selection(closed_loop(seed, gain=1.3 * GAIN, force=0.05 * FORCE), length=10)
    found = finder.run(first, first, instances())
    assert [instance.effect for instance in found.accepted] == ["gain"]
    share, error = magnitude_in_single_steps(
        finder.library, (found.train, found.test), found.accepted[0], finder.floor
    )
    assert share == pytest.approx(1.0, abs=0.1)
    assert error < 0.03
