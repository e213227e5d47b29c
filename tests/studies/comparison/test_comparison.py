"""`dropo.compare` and `dropo compare`: pairs, costs, targets, refusals, interruptions."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dropo
from dropo.cli.main import main
from dropo.core.services import registry
from dropo.core.services.errors import BadArgument, SimulationFailed, UnknownName
from dropo.estimators.least_squares import LeastSquares
from dropo.studies.comparison import compare as module
from dropo.studies.comparison.compare import compare
from dropo.studies.comparison.data_sets import data_set
from dropo.studies.comparison.summary import SolvedWithin, summarized
from dropo.studies.engine.pages import picture
from dropo.studies.engine.variants import Variant
from dropo.studies.tiboni_2021.hopper_sets import MEAN

SMALL = {"seeds": 2, "transitions": 40}


@dataclass(frozen=True)
class Failing(LeastSquares):
    """Least squares that fails, or returns NaN."""

    how: str = "raises"

    def _fit(self, problem: Any, run: Any) -> Any:
        if self.how == "raises":
            raise SimulationFailed("It was told to fail.")
        fit = super()._fit(problem, run)
        return fit.__class__(**{**vars(fit), "mean": np.full(len(problem.space), np.nan)})


def test_parts_on_the_same_data_sets() -> None:
    """Optimizers of one likelihood find one maximum; only what it costs inside differs."""
    study = compare(["dropo", {"optimizer": "nlopt-bobyqa"}, "least-squares"], ["slide"], **SMALL)
    fits = study.data["fits"]["slide"]
    default, other = fits["dropo"], fits["dropo, optimizer nlopt-bobyqa"]
    for own, row in zip(default, other, strict=True):
        assert own["drawn_mean"] == row["drawn_mean"]
        assert row["log_likelihood"] == pytest.approx(own["log_likelihood"], abs=0.01)
        assert row["inner"] > own["inner"] > 0
        assert row["seconds"] > 0
    assert study.data["solved"]["dropo, optimizer nlopt-bobyqa"].all()
    assert [table.title for table in study.tables] == ["slide, 2 data sets", "over all problems"]
    # Log-likelihoods of least squares are on another scale, and are not compared.
    row = next(row for row in study.tables[0].rows if row[0] == "least-squares")
    assert row[8:10] == ("-", "-")
    assert "<svg" in picture(study.draw)


def test_the_truth_is_that_of_the_transitions_in_use() -> None:
    """Forty rows of the sliding block are two pushes, whose own parameters are meant."""
    whole = data_set("slide", 7)[1]
    part = data_set("slide", 7, 40)[1]
    assert whole is not None
    assert part is not None
    assert not np.allclose(whole, part)
    problem, again = data_set("slide", 7, 40)
    assert len(problem.trajectories) == 40
    np.testing.assert_array_equal(part, again)


def test_data_sets_of_measured_problems_are_pieces_drawn_anew(tmp_path: Path) -> None:
    """A problem file: seed 0 is its data, others as many rows of them; no truth is made up."""
    problem = dropo.hide("torque-arm", (), seed=1, threads=1)
    dropo.write_problem(problem, tmp_path)
    path = str(tmp_path / "problem.yaml")
    first, truth = data_set(path, 0)
    other, _ = data_set(path, 1)
    assert truth is None
    rows = {row.tobytes() for row in first.trajectories.observations}
    assert all(row.tobytes() in rows for row in other.trajectories.observations)
    same = np.array_equal(
        first.trajectories.observations[: len(other.trajectories)],
        other.trajectories.observations[: len(first.trajectories)],
    )
    assert not same


def test_a_fit_that_fails_is_counted_and_its_reason_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(registry._registered["methods"], "failing", Failing)
    given = ["least-squares", {"method": "failing"}, {"method": "failing", "how": "nan"}]
    study = compare(given, ["slide"], **SMALL)
    assert "failing failed: It was told to fail." in study.remarks
    refused = "failing, how nan failed: The 'mean of mass' of method "
    assert any(refused in text for text in study.remarks)
    assert not study.data["solved"]["failing"].any()
    assert study.data["solved"]["least-squares"].all()
    shown = {row[0]: row[-1] for row in study.tables[0].rows}
    assert shown == {"least-squares": "", "failing": "2 of 2", "failing, how nan": "2 of 2"}


def made(mean: float, log_likelihood: float) -> dict[str, Any]:
    """A row whose truth is 0, in standard errors."""
    return {
        "mean": [mean],
        "mean_se": [1.0],
        "drawn_mean": [0.0],
        "log_likelihood": log_likelihood,
        "steps": 10,
        "evaluations": 2,
        "inner": 3,
        "seconds": 0.5,
    }


def test_what_counts_as_solved() -> None:
    """Half a nat below the best of its likelihood, and three standard errors from the truth."""
    variants = [Variant(), Variant("dropo", {"optimizer": "a"}), Variant("dropo", {"family": "b"})]
    rows = {
        variants[0].label: [made(0.0, 10.0), made(0.0, 10.0)],
        variants[1].label: [made(0.0, 9.6), made(0.0, 9.4)],
        variants[2].label: [made(2.9, 10.0), made(3.1, 10.0)],
    }
    study = summarized("t", {"p": rows}, variants, np.array([2.0, 2.0]), 2, SolvedWithin())
    solved = {label: column.tolist() for label, column in study.data["solved"].items()}
    assert list(solved.values()) == [[True, True], [True, False], [True, False]]
    overall = {row[0]: row[1:] for row in study.tables[-1].rows}
    assert overall["dropo, optimizer a"][:3] == ("1 of 2", "20", "10")


def test_a_command_resumes_and_writes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interrupted after two of four fits, then after three, it makes each of them once."""
    real = module.fitted
    done: list[tuple[str, int]] = []
    stops: set[tuple[str, int]] = {("least-squares", 0), ("least-squares", 1)}

    def fitted(item: dict[str, Any]) -> dict[str, Any]:
        fit = (item["variant"]["method"], item["seed"])
        if fit in stops:
            raise KeyboardInterrupt
        done.append(fit)
        return real(item)

    monkeypatch.setattr(module, "fitted", fitted)
    command = ["compare", "--method", "least-squares", "--problem", "slide", "--seeds", "2"]
    command += ["--transitions", "40", "--threads", "1", "--out", str(tmp_path / "out")]
    assert main(command) == 1
    said = "stopping: 2 finished tasks kept, the same command goes on from here.\n"
    assert capsys.readouterr().err.endswith(said)
    stops = {("least-squares", 1)}
    assert main(command) == 1
    stops = set()
    assert main(command) == 0
    assert sorted(done) == [(name, seed) for name in ("dropo", "least-squares") for seed in (0, 1)]
    content = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert list(content["data"]["fits"]["slide"]) == ["dropo", "least-squares"]
    assert (tmp_path / "out" / "comparison.svg").is_file()
    assert not list((tmp_path / "out").glob(".*.jsonl"))


def test_a_problem_file_that_changed_is_fitted_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An interrupted comparison keeps the fits of the file's other content, and uses none."""
    real = module.fitted
    done: list[tuple[str, int]] = []
    stops = {1}

    def fitted(item: dict[str, Any]) -> dict[str, Any]:
        if item["seed"] in stops:
            raise KeyboardInterrupt
        done.append((item["content"], item["seed"]))
        return real(item | {"variant": {"method": "least-squares", "settings": {}}})

    monkeypatch.setattr(module, "fitted", fitted)
    monkeypatch.chdir(tmp_path)
    dropo.write_problem(dropo.hide("torque-arm", (), seed=1, threads=1), tmp_path)
    path = tmp_path / "problem.yaml"
    command = ["compare", "--method", "least-squares", "--problem", str(path)]
    command += ["--seeds", "2", "--transitions", "30", "--threads", "1"]
    command += ["--out", str(tmp_path / "out"), "--quiet"]
    assert main(command) == 1
    before = {content for content, _ in done}
    data = dict(np.load(path.with_name("data.npz")))
    data["observations"][0] += 1e-6
    np.savez(path.with_name("data.npz"), **data)
    stops.clear()
    assert main(command) == 0
    assert str(tmp_path) not in (tmp_path / "out" / "comparison.json").read_text()
    assert len(before) == 1
    assert sorted(seed for content, seed in done if content not in before) == [0, 0, 1, 1]
    assert list((tmp_path / "out").glob(".*.jsonl"))


@pytest.mark.parametrize(
    ("given", "problems", "error", "message"),
    [
        (["dropo"], ["slide"], BadArgument, "at least two different methods or parts"),
        (["dropo", "droid"], ["slid"], UnknownName, "'slide'"),
        (["dropo", "droid"], [], BadArgument, "problems"),
        (["dropo", {"optimiser": "cma-es"}], ["slide"], ValueError, "takes no optimiser"),
        (["dropo", {"optimizer": "cma"}], ["slide"], UnknownName, "'cma-es'"),
    ],
)
def test_refuses_before_anything_is_fitted(
    given: list[Any],
    problems: list[str],
    error: type[Exception],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "fitted", None)
    with pytest.raises(error, match=message):
        compare(given, problems)


def test_data_sets_come_from_their_own_makers() -> None:
    """The thesis' tables have the drawn masses of their seed, simulated robots their true numbers;
    the same seed is the same set, another one another.
    """
    made, mean = data_set("hopper", 1, 40)
    again, _ = data_set("hopper", 1, 40)
    assert len(made.trajectories) == 40
    assert mean is not None
    np.testing.assert_allclose(mean, MEAN, rtol=1e-3)
    np.testing.assert_array_equal(made.trajectories.observations, again.trajectories.observations)
    _, drawn = data_set("table-6.2-noisy", 1, 40)
    _, other = data_set("table-6.2-noisy", 2, 40)
    assert drawn is not None
    assert other is not None
    assert abs(drawn[0] - other[0]) > 1e-3
    arm, true = data_set("torque-arm", 2, 40)
    assert true is not None
    assert dict(zip(arm.space.names, true.tolist(), strict=True)) == arm.truth
    assert (
        data_set("torque-arm", 3, 40)[0].trajectories.observations != arm.trajectories.observations
    ).any()
    with pytest.raises(UnknownName, match="torque-arm"):
        data_set("torquearm", 0)
