"""Pushing in small: a search finds a policy, and the study runs."""

import numpy as np

from dropo.problems.panda.pushing import TRUTH, target_model
from dropo.studies.engine.pages import picture
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021 import transfer
from dropo.studies.tiboni_2021.pushing import POLICY, PushingStudySize, ends, pushing_study


def test_where_the_pin_aims_decides():
    """A policy that pushes behind the centre of mass ends near the goal, one that pushes on the
    other side far from it.
    """
    numbers = np.array([[0.03, 0.0, 0.0, 0.0], [-0.05, 0.0, 0.0, 0.0]])
    near, far = ends(target_model(), numbers, {}, np.random.default_rng(0))
    assert near < 0.03 < far


def test_starts_repeat():
    """With `same`, every policy meets the same starts, and noise is its own."""
    numbers = np.tile(POLICY.from_unit(np.full(4, 0.5)), (4, 1))
    first = ends(target_model(), numbers, {}, np.random.default_rng(0), same=2)
    assert np.ptp(first[::2]) < np.ptp(first)


def test_pushing(monkeypatch):
    """A tenth of the data: the centre of mass is found within 5 mm."""
    monkeypatch.setattr(transfer, "FITTED", ("dropo", "droid"))
    small = PushingStudySize(
        transitions=105, fits=1, bounds=1, droid=12, draws=2, evaluations=2, trials=2
    )
    study = pushing_study(Work(threads=1), size=small)
    fit = study.data["runs"][0]
    assert fit["method"] == "dropo"
    assert abs(fit["mean"][4] - TRUTH["com_y"]) < 0.005
    assert [len(run["distances"]) for run in study.data["runs"]] == [2] * 5
    assert any("within 5 mm" in remark for remark in study.remarks)
    assert "<svg" in picture(study.draw)
