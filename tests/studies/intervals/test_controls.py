"""The study of the statistical tests' controls."""

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument
from dropo.studies.engine.work import Work
from dropo.studies.intervals.controls import CONTROLS, TESTS, ControlSettings, controls, p_values_of


def test_wrong_posteriors_are_rejected_and_the_right_one_is_not():
    """Half the spread by all tests, one that is too narrow and a bias by coverage and ranks."""
    assert max(p_values_of(["half the spread", 200, 1])["p"]) < 1e-3
    assert max(p_values_of(["biased by an sd", 200, 1])["p"][:2]) < 1e-3
    assert min(p_values_of(["right", 200, 1])["p"]) > 1e-3


def test_the_table_counts_rejections(monkeypatch):
    """p-values that are made up: one in four below 0.05 is 25 %, none of them below 0.001."""

    def given(self, task, items):
        return [{"p": [0.04 if item[2] % 4 == 0 else 0.5] * len(TESTS)} for item in items]

    monkeypatch.setattr(Work, "map", given)
    study = controls(Work(threads=1), 8)
    (table,) = study.tables
    assert len(table.rows) == len(CONTROLS) * len(TESTS)
    assert table.rows[0] == ("right", "coverage", "25%", "3%-65%", "0%", "0.5", "0.5")
    assert np.shape(study.data["right"]["p"]) == (8, len(TESTS))
    with pytest.raises(BadArgument, match="'replications' of controls must be at least 50"):
        controls(Work(threads=1), settings=ControlSettings(replications=20))
