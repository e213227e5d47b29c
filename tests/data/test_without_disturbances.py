"""A problem without the spans in which it is pushed; and no problem is cut where the model is
rather at fault.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from dropo.cli.main import main
from dropo.core.contracts.problem import Problem
from dropo.data.outliers.without_disturbances import (
    both_sides,
    remove_disturbances,
    without_disturbances,
)
from dropo.problems.file.writer import write_problem
from tests.models.pushed_arm import PUSHES, recorded


@pytest.fixture(scope="module")
def pushed(simulator):
    """Three runs of which two are pushed, and three others held out of which one is."""
    held_out = recorded(simulator, {(1, 300, 340): 2.0}, seed=1)
    return Problem("pendulum", simulator, recorded(simulator, PUSHES), held_out=held_out)


def test_both_sides_lose_their_spans(pushed):
    """Spans of data held out are numbered by their own trajectories, and said to be such."""
    found = remove_disturbances(pushed)
    assert [(span.trajectory, span.held_out) for span in found.spans] == [
        (0, False),
        (2, False),
        (1, True),
    ]
    lost = [
        sum(span.last - span.first for span in found.spans if span.held_out == side)
        for side in (False, True)
    ]
    assert len(found.problem.trajectories) == len(pushed.trajectories) - lost[0]
    assert len(found.problem.held_out) == len(pushed.held_out) - lost[1]
    assert found.share == pytest.approx(
        sum(lost) / (len(pushed.trajectories) + len(pushed.held_out))
    )
    assert "held-out trajectory 1, " in str(found.spans[-1])
    assert both_sides(pushed).group.max() == 5


def test_nothing_is_left_out_of_quiet_data(pushed, simulator):
    """No pushes; and no search where segments cannot begin anew behind a span."""
    assert (
        remove_disturbances(replace(pushed, trajectories=recorded(simulator, {}), held_out=None))
        is None
    )
    assert remove_disturbances(replace(pushed, reset="start")) is None


def test_what_most_runs_show_is_the_models(simulator):
    """A push in five of nine runs is taken for the model's; in two of nine it is one."""
    for count, expected in ((5, 0), (2, 2)):
        data = [
            recorded(simulator, {(i, 250, 290): 2.0 for i in range(3) if 3 * k + i < count}, seed=k)
            for k in range(3)
        ]
        joined = both_sides(
            Problem(
                "p",
                simulator,
                both_sides(Problem("p", simulator, data[0], held_out=data[1])),
                held_out=data[2],
            )
        )
        found = without_disturbances(Problem("p", simulator, joined), simulator, simulator.nominal)
        assert (0 if found is None else len(found.spans)) == expected


def test_a_fit_of_a_log_lists_and_leaves_out(pushed, tmp_path, capsys):
    """`dropo fit` warns of each span and keeps them in fit.json; `--disturbances off` and data
    without time stamps are fitted whole.
    """
    stamped = replace(pushed.trajectories, time=np.tile(0.01 * np.arange(800.0), 3))
    log = write_problem(
        replace(pushed, trajectories=stamped, held_out=None, horizon=10), tmp_path / "log"
    )
    plain = write_problem(replace(pushed, held_out=None, horizon=10), tmp_path / "plain")
    told = []
    for path, more in ((log, []), (log, ["--disturbances", "off"]), (plain, [])):
        assert (
            main(["fit", str(path), "--method", "least-squares", "--budget", "12", "--json", *more])
            == 0
        )
        told.append(json.loads(capsys.readouterr().out))
    assert [len(one.get("disturbances", ())) for one in told] == [2, 0, 0]
    assert (
        sum("left out, since no command explains it" in text for text in told[0]["warnings"]) == 2
    )
    assert told[0]["transitions"] < told[1]["transitions"] == told[2]["transitions"]
    errors = [abs(one["parameters"]["friction"]["mean"] - 0.15) for one in told]
    assert errors[0] < 0.02
    assert errors[0] < errors[1]
