"""Tasks: the same answers on any executor, finished ones kept, unfinished ones made."""

import json
import multiprocessing
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

from dropo.core.services.files.journal import read_lines
from dropo.estimators.dropo import DROPO
from dropo.estimators.least_squares import LeastSquares
from dropo.executors.named import executor_named
from dropo.problems.simulated.slide import slide
from dropo.studies.engine.long_fits import long_fit
from dropo.studies.engine.work import Work

CALLS: list[int] = []


def square(item):
    """A task that counts its calls, and fails for 13."""
    CALLS.append(item)
    if item == 13:
        raise ValueError("thirteen")
    return {"square": item**2, "tenth": item / 10, "nothing": float("nan")}


def fit_slide(seed):
    """A whole fit."""
    fit = DROPO().fit(slide(), rng=seed)
    return {
        "phi": fit.phi.tolist(),
        "se": fit.mean_se.tolist(),
        "log_likelihood": fit.log_likelihood,
    }


def point_of_slide(seed):
    """A quicker fit."""
    fit = LeastSquares().fit(slide(), rng=seed)
    return {"mean": fit.mean.tolist(), "se": fit.mean_se.tolist()}


@pytest.fixture(autouse=True)
def _no_calls():
    CALLS.clear()


def test_in_order_and_with_progress():
    """Answers come in the order of the items, whichever finished first; progress ends at 1."""
    shares = []
    work = Work(threads=3, progress=lambda share, text: shares.append((share, text)))
    found = work.map(square, range(10))
    assert [row["square"] for row in found] == [i**2 for i in range(10)]
    assert np.isnan(found[0]["nothing"])
    assert shares[-1] == (1.0, "square, 10 of 10")


def test_what_is_finished_is_not_done_again(tmp_path):
    """A study that failed, or was killed in the middle of a line, goes on with what is missing
    alone.
    """
    path = tmp_path / "kept.jsonl"
    with pytest.raises(ValueError, match="thirteen"):
        Work(threads=1, path=path).map(square, [1, 2, 13])
    assert len(read_lines(path, "answers")) == 1 + 2
    path.write_text(path.read_text() + '{"n": 3, "half a li')
    CALLS.clear()
    again = Work(threads=1, path=path).map(square, [1, 2, 3])
    assert CALLS == [3]
    fresh = Work().map(square, [1, 2, 3])
    assert json.dumps(again) == json.dumps(fresh)
    assert len(read_lines(path, "answers")) == 1 + 3


def test_an_own_executor_does_the_work():
    """The tasks run on the executor that is given, and it stays open."""
    with ThreadPoolExecutor(1, thread_name_prefix="mine") as pool:
        assert Work(pool).map(square, [3])[0]["square"] == 9
        assert pool.submit(square, 2).result()["square"] == 4


def test_the_same_numbers_on_threads_and_processes():
    """Fits on threads, and in a spawned process, bit for bit; the control: seeds differ."""
    on_threads = Work(threads=2).map(fit_slide, [0, 1])
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert Work(pool).map(fit_slide, [0, 1]) == on_threads
    assert on_threads[0] != on_threads[1]


def test_the_same_numbers_on_a_dask_cluster(monkeypatch):
    """A local cluster of one process: a study's tasks, and a fit whose simulations go there."""
    pytest.importorskip("distributed")
    monkeypatch.setattr("dropo.executors.clusters.cores", lambda: 1)
    alone = LeastSquares().fit(slide(), rng=0)
    with executor_named("dask") as executor:
        tasks = Work(executor).map(point_of_slide, [0, 1])
        spread = LeastSquares().fit(slide().using(executor=executor), rng=0)
    assert tasks == Work(threads=1).map(point_of_slide, [0, 1])
    assert tasks[0] == {"mean": alone.mean.tolist(), "se": alone.mean_se.tolist()}
    np.testing.assert_array_equal(alone.mean, spread.mean)
    np.testing.assert_array_equal(alone.mean_se, spread.mean_se)


def test_an_interrupted_long_fit_simulates_nothing_more(monkeypatch):
    """It is not summarized: its best so far is no answer of a study."""
    problem = slide().using(transitions=20)
    real = problem.simulator._predict
    calls = []

    def predict(*given):
        calls.append(given)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return real(*given)

    monkeypatch.setattr(problem.simulator, "_predict", predict)
    settings = {"likelihood": "monte-carlo", "optimizer": "cma-es-once", "draws": 4, "budget": 60}
    with pytest.raises(KeyboardInterrupt):
        long_fit(Work(), "a key", DROPO(**settings, epsilon=1e-4), problem)
    assert len(calls) == 4
