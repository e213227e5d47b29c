"""Sliding in small: a policy aims where it is told, and the study runs."""

import numpy as np
import pytest

from dropo.estimators.uniform_randomization import UniformRandomization
from dropo.problems.panda.sliding import STEPS, TRUTH, sliding_simulator, stops
from dropo.studies.engine.pages import picture
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021 import sliding, transfer
from dropo.studies.tiboni_2021.sliding import SlidingStudySize, on_target, policy, sliding_study

SMALL = SlidingStudySize(
    transitions=STEPS, fits=1, bounds=1, droid=12, published=14, draws=2, grid=4
)


def test_a_policy_for_known_numbers_hits():
    """On the model that it was made for, the puck stops within 2 cm of the goals; the control: on
    other friction it does not.
    """
    simulator = sliding_simulator(1)
    true = simulator.space.vector(TRUTH)
    goals = np.array([[0.0, 0.25], [-0.05, 0.35]])
    latents = policy(simulator, true[None], goals, 11)
    rough = true.copy()
    rough[simulator.space.names.index("friction_y")] *= 1.6
    ends = stops(simulator, [true, rough], latents)
    assert np.linalg.norm(ends[0] - goals, axis=1).max() < 0.02
    assert np.linalg.norm(ends[1] - goals, axis=1).min() > 0.04
    assert on_target(latents, goals).max() < 0.05


def test_sliding(monkeypatch):
    """One hit as data and bounds at random in DROPO's place: its run, the published method's, and
    those that fit nothing, in tables and a picture.
    """
    monkeypatch.setattr(transfer, "FITTED", ("dropo",))
    monkeypatch.setattr(sliding, "DRAWS", 4)
    as_it_is = transfer.DROPO
    quick = lambda **settings: (
        as_it_is(**settings) if "draws" in settings else UniformRandomization(draws=2)
    )
    monkeypatch.setattr(transfer, "DROPO", quick)
    study = sliding_study(Work(threads=1), published=True, size=SMALL)
    distance = {row[0]: float(row[2]) for row in study.tables[0].rows}
    assert list(distance) == [
        "dropo",
        transfer.PUBLISHED,
        transfer.UNIFORM,
        transfer.NOMINAL,
        transfer.TRUE,
    ]
    assert distance["the target's numbers"] < 3 < 5 < distance["the model as it is"]
    assert len(study.tables[2].rows) == 18
    assert "<svg" in picture(study.draw)


@pytest.mark.study
def test_one_hit_is_enough_for_dropo(monkeypatch):
    """From one hit alone, DROPO's policy comes to within 5 cm of the goals on average."""
    monkeypatch.setattr(transfer, "FITTED", ("dropo",))
    study = sliding_study(Work(threads=1), size=SMALL)
    assert np.mean(study.data["runs"][0]["distances"]) < 0.05
