"""The benchmarks run, the slow twin agrees with the fast likelihood, and `predict` costs little
beside bare rollout.
"""

import json
import time

import numpy as np
import pytest

from benchmarks import cost, meshes, shares, tables, walk
from benchmarks.objective import (
    EPSILON,
    TINY,
    Bare,
    Sizes,
    draws_near_truth,
    predict_beside_bare,
    problem_of,
    report,
)
from benchmarks.robots import problem_of as problem_with
from dropo.likelihoods.monte_carlo import MonteCarlo
from dropo.problems.hopper.model import BODIES, FRAME_SKIP
from tests.reference.published_loop import log_likelihood

SMALL = Sizes(
    draws=5,
    transitions=40,
    loop_draws=5,
    loop_transitions=5,
    predict_draws=5,
    repeats=1,
    predict_repeats=1,
)


def test_loop_and_likelihood_are_the_same_number():
    """What is timed on both sides is the same work: the same log-likelihood to 1e-9, the same
    steps.
    """
    problem = problem_of(SMALL, 1)
    masses = draws_near_truth(problem, 20)
    total, steps = log_likelihood(
        problem.simulator.model, BODIES, masses, problem.trajectories, EPSILON, FRAME_SKIP
    )
    predictions = problem.simulator.predict(masses, problem.segments)
    rows = MonteCarlo().log_density(
        predictions, problem.simulator.targets(problem.segments), EPSILON
    )
    assert total == pytest.approx(rows.sum(), rel=1e-9)
    assert steps == problem.simulator.steps == 20 * 40 * FRAME_SKIP


def test_bare_rollout_does_the_same_work():
    """The bare call ends in the states that `predict` compares."""
    problem = problem_of(SMALL, 1)
    values = draws_near_truth(problem, 1)
    bare = Bare(problem.simulator, problem.segments, values, 1)
    states, _ = bare.rollout.rollout(bare.models[0], bare.data, bare.states, bare.controls)
    np.testing.assert_array_equal(
        states[:, -1, 2:], problem.simulator.predict(values, problem.segments)[0]
    )


def test_predict_keeps_most_of_the_bare_throughput():
    """With one thread, at least 0.8 of bare rollout's steps per second of processor time, in the
    median of nine.
    """
    sizes = Sizes(transitions=TINY.transitions, predict_draws=TINY.predict_draws, predict_repeats=9)
    *_, ratio = predict_beside_bare(sizes, 1, clock=time.process_time)
    assert ratio >= 0.8


def test_report_has_every_line():
    """One run prints the whole table and the three sentences below it."""
    text = report(SMALL)
    for words in (
        "published loop, Python",
        "monte-carlo, 1 thread",
        "monte-carlo, 2 threads",
        "bare rollout, K = 5, 2 threads",
        "of bare rollout with 1 thread.",
        "of bare rollout with 2 threads.",
        "times fewer than the",
    ):
        assert words in text


@pytest.mark.parametrize("parameters", cost.PARAMETERS)
def test_a_cell_of_the_cost_table(parameters):
    """Many parameters and transitions; steps and simulation time are those of the round alone."""
    problem = problem_with(parameters, 40, 1)
    assert len(problem.space) == parameters
    assert len(problem.trajectories) == 40
    truth = problem.space.vector(problem.truth)
    np.testing.assert_allclose(truth, problem.simulator.nominal)
    assert np.isfinite(problem.simulator.predict(truth[None], problem.segments)).all()
    if parameters < 100:  # a round of those takes seconds
        found = cost.measured(("round", parameters, 40, 1))
        assert found["steps"] >= (2 * parameters + 1) * 40 * FRAME_SKIP
        assert 0 < found["simulation"] < found["seconds"]


def test_cost_table_and_picture():
    """Cells that were measured are shown, the others are left out."""
    from dropo.studies.engine.pages import picture

    row = {"seconds": 4.0, "simulation": 3.0, "steps": 1000, "memory_mb": 50.0}
    found = {json.dumps(cell): row for cell in cost.CELLS if cell[2] == 1000}
    text = cost.table(found)
    assert text.count("\n") == 1 + len(found)
    assert "| round, linear | 18 | 1,000 | 2 | 1,000 | 4.0 | 3.0 | 25% | 50 | - |" in text
    assert "<svg" in picture(lambda figure: cost.draw(figure, found))


def test_every_row_takes_a_thousandth_of_the_steps():
    """At 40 transitions already; the reference's steps are counted, not assumed."""
    row = tables.row("6.1", "noisy", 40)
    assert row.reference_steps == 100 * 40 * FRAME_SKIP
    assert row.fewer > 1000
    assert 0 < row.fitting < 1


@pytest.mark.study
def test_every_row_at_its_full_size():
    """Tables 6.1 to 6.3: a thousand times fewer steps, and fitting under a third of the time on a
    free machine.
    """
    text, rows = tables.report()
    print(text)
    assert len(rows) == 6
    for row in rows:
        assert row.fewer > 1000
        assert row.fitting < 1 / 3


@pytest.mark.slow
def test_shares_of_the_main_job_add_up(monkeypatch):
    """Imports, simulation and the rest are the whole, and none of them is all of it."""
    found = shares.fit(["hopper", "--transitions", "80"])
    parts = [found[part] for part in ("imports", "simulation", "rest")]
    assert sum(parts) == pytest.approx(found["total"])
    assert min(parts[:2]) > 0
    assert max(parts) < found["total"]
    monkeypatch.setattr(shares, "fit", lambda arguments: found)
    assert shares.report(["hopper", "--transitions", "80"]).count("\n") == 9


def test_meshes_prints_a_row_for_each_arm(capsys):
    """With small meshes the table has its three rows, and a number in every cell."""
    meshes.main(["400"])
    head, _, *rows = capsys.readouterr().out.splitlines()
    assert [row.split(" | ")[0] for row in rows] == ["| none", "| seen", "| colliding"]
    for row in rows:
        cells = row.strip("| ").split(" | ")[1:]
        assert len(cells) == head.count(" | ")
        assert all(float(cell) >= 0 for cell in cells)
        assert float(cells[-1]) > 10  # MB


def test_a_walk_ends_with_a_page(tmp_path, capsys):
    """A log of 6 s goes through every command; what fails says what the command said."""
    walk.walk("arm", tmp_path, rows=600)
    rows = [line.split(" | ")[1] for line in capsys.readouterr().out.splitlines()]
    assert rows == ["init", "data check", "diagnose", "report", "export", "all"]
    assert (tmp_path / "found" / "report.html").exists()
    with pytest.raises(RuntimeError, match="dropo report nothing: "):
        walk.timed(["report", "nothing"], tmp_path)
