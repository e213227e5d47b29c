"""The benchmarks run, the slow twin agrees with the fast likelihood, and `predict` costs little
beside bare rollout.
"""

import ast
import json
import re
import subprocess
import sys
import time
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from benchmarks import (
    cost,
    diagnosis,
    goals,
    gpu,
    meshes,
    methods,
    page,
    readme,
    shares,
    tables,
    walk,
)
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
from dropo.diagnosis.regression.result import WiringFault
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


@pytest.mark.study
def test_shares_of_the_main_job_add_up(monkeypatch):
    """Imports, simulation and the rest are the whole, and none of them is all of it."""
    found = shares.fit(["hopper", "--transitions", "80"])
    parts = [found[part] for part in ("imports", "simulation", "rest")]
    assert sum(parts) == pytest.approx(found["total"])
    assert min(parts[:2]) > 0
    assert max(parts) < found["total"]
    monkeypatch.setattr(shares, "fit", lambda arguments: found)
    text = shares.report(["hopper", "--transitions", "80"])
    assert text.count("\n") == 10
    assert readme.numbers_in(text)["steps"] == found["steps"]


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


@pytest.mark.study
def test_a_walk_ends_with_a_page(tmp_path, capsys):
    """A log of 6 s goes through every command; what fails says what the command said."""
    walk.walk("arm", tmp_path, rows=600)
    rows = [line.split(" | ")[1] for line in capsys.readouterr().out.splitlines()]
    assert rows == ["init", "data check", "diagnose", "report", "export", "all"]
    assert (tmp_path / "found" / "report.html").exists()
    with pytest.raises(RuntimeError, match="dropo report nothing: "):
        walk.timed(["report", "nothing"], tmp_path)


@pytest.fixture
def own_page(tmp_path, monkeypatch):
    """A folder with a page of two blocks and their scripts, in the place of the benchmarks'."""
    (tmp_path / "README.md").write_text(
        "# Page\n<!-- goals -->\n<!-- end -->\n<!-- one -->\nold\n<!-- end -->\n"
        "<!-- two -->\n<!-- end -->\n"
    )
    (tmp_path / "one.py").write_text("import sys; print('| first |', *sys.argv[1:])")
    (tmp_path / "two.py").write_text("raise SystemExit(3)")
    blocks = {"one": page.Block(("one.py",), 1, ("x",)), "two": page.Block(("two.py",), 2)}
    monkeypatch.setattr(page, "BLOCKS", blocks)
    monkeypatch.setattr(page, "HERE", tmp_path)
    monkeypatch.setattr(page, "KEPT", tmp_path / "page.json")
    monkeypatch.setattr(readme, "README", tmp_path / "README.md")
    return tmp_path


def test_a_page_goes_on_where_it_was(own_page, monkeypatch, capsys):
    """A block that was measured stays when the next one fails, and is not measured again; one that
    is named is; what there is and is not can be listed.
    """
    monkeypatch.setattr("sys.argv", ["page.py"])
    with pytest.raises(subprocess.CalledProcessError):
        page.main()
    text = (own_page / "README.md").read_text()
    assert "<!-- one -->\n| first |\n\nMeasured on " in text
    (own_page / "one.py").write_text("print('| again |')")
    (own_page / "two.py").write_text("print('| second |')")
    page.main()
    text = (own_page / "README.md").read_text()
    assert "| first |" in text
    assert "| second |" in text
    assert "| goal | measured |" in text
    monkeypatch.setattr("sys.argv", ["page.py", "one"])
    page.main()
    assert "| again |" in (own_page / "README.md").read_text()
    (own_page / "one.py").write_text("import sys; print('| kept |', *sys.argv[1:])")
    monkeypatch.setattr("sys.argv", ["page.py", "--kept", "one", "two"])
    page.main()
    text = (own_page / "README.md").read_text()
    assert "| kept | x\n\nPrinted on " in text
    assert "| second |" in text
    monkeypatch.setattr("sys.argv", ["page.py", "--list"])
    capsys.readouterr()
    page.main()
    assert capsys.readouterr().out.count("min  20") == 2
    monkeypatch.setattr("sys.argv", ["page.py", "three"])
    with pytest.raises(SystemExit):
        page.main()


def test_every_block_has_its_place_and_its_script():
    """The page has a place for each block that the command knows, and no other."""
    text = readme.README.read_text()
    places = re.findall(r"^<!-- (\w+) -->$", text, flags=re.MULTILINE)
    assert sorted(one for one in places if one != "end") == sorted([*page.BLOCKS, "goals"])
    for block in page.BLOCKS.values():
        assert (readme.README.parent / block.command[0]).exists()


def test_goals_stand_beside_what_was_measured():
    """Met or not as the numbers say, with a reason where not; what was not measured says so."""
    job = {"total": 2.0, "simulation": 1.3, "imports": 0.5, "steps": 90_000}
    one = {
        "steps": 1e6,
        "seconds": 4.0,
        "simulator": 3.0,
        "stages": {"screening": 0.4, "trials": 0.3},
    }
    texts = {
        "shares": readme.numbers(job),
        "diagnosis": readme.numbers({"hopper, one": one}),
        "gpu": readme.numbers({"published": {"noisy": 198.0}}),
    }
    rows = [line.strip("| ").split(" | ") for line in goals.table(texts).splitlines()]
    said = {row[0]: row[1:] for row in rows}
    assert said["100,000 simulator steps"][:2] == ["90,000", "met"]
    assert said["diagnosis of a hopper: 5 s"][1] == "met"
    steps = said["diagnosis of a hopper: 533,333 steps"]
    assert steps[1:] == ["not met", "most in screening 40%, trials 30%"]
    assert said["diagnosis of a half-cheetah: 30 s"][1] == "not measured"
    gpu = "the published method unabridged, 2e9 steps, on one GPU: 5 minutes"
    assert said[gpu][:2] == ["3.3 min", "met"]


@pytest.mark.parametrize("name", ["DROPO", "least squares of mujoco.sysid"])
def test_methods_are_measured_on_the_same_data(name):
    """Their masses are right within a tenth of a kilogram with a hundred transitions."""
    found = methods.measured(name, 100)
    assert found["error"] < 0.1
    assert found["steps"] >= 100 * FRAME_SKIP
    assert f"| {name} | {found['steps']:,} |" in methods.table({name: found})


@pytest.mark.parametrize(("name", "joints"), [("quadruped", 12), ("humanoid", 29)])
def test_robots_of_the_gpus_table(name, joints):
    """They have their joints, stay finite, and MuJoCo simulates as many steps as are counted."""
    made = next(make for title, make in gpu.PROBLEMS.items() if title.startswith(name))
    problem = made()
    assert problem.simulator.model.nu == joints
    some = problem.segments.take(np.arange(4))
    assert np.isfinite(problem.simulator.predict(problem.simulator.nominal[None], some)).all()
    problem.simulator.steps = 0
    assert gpu.rate(problem.simulator, problem.using(transitions=8), 8) > 0
    assert problem.simulator.steps == 2 * 8 * problem.simulator.steps_per_action


def test_runs_of_a_diagnosis_are_kept(tmp_path, monkeypatch, capsys):
    """Counts come back from JSON as they were, and a run that is kept is not made again."""
    stages = diagnosis.Stages()
    stages.steps["screening"] = stages.operations["other"] = stages.evaluations["screening"] = 100
    stages.repeats["screening"] = 5
    stages.seconds["screening"] = 0.5
    said = {"hidden": "-", "said": "nothing", "steps": 100, "seconds": 1.0}
    made = []
    monkeypatch.setattr(
        diagnosis, "measured", lambda *asked: made.append(asked) or (stages, dict(said))
    )
    monkeypatch.setattr(diagnosis, "KEPT", tmp_path / "diagnosis.json")
    for argv, runs in ((["hopper", "one", "1", "2"], 2), (["hopper", "one", "2"], 2)):
        monkeypatch.setattr("sys.argv", ["diagnosis.py", *argv])
        diagnosis.main()
        assert len(made) == runs
    text = capsys.readouterr().out
    assert "hopper, one: 2 runs, median 100 steps, 1.0 s of processor time" in text
    assert "| screening | 100 | 100% | 100 | 5% | 0.50 |" in text
    assert readme.numbers_in(text)["hopper, one"]["stages"] == {"screening": 1.0}


@pytest.mark.study
def test_a_machine_of_random_shape_is_diagnosed():
    """Friction beside velocity servos whose forces are noisy: no gain that shrinks all of them.

    A machine that rules may be chosen on; nothing else is named, and its size is right.
    """
    command = [sys.executable, str(readme.README.parent / "random_machines"), "1", "66"]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    (answer,) = re.findall(r"^66 (\{.*\})$", printed, flags=re.MULTILINE)
    found = ast.literal_eval(answer)
    assert found["hidden"] == [["joint_damping", "joint0"]]
    assert found["right"]
    assert re.search(r"^all +1 +1 ", printed, flags=re.MULTILINE)


def test_spoiled_logs_are_told(monkeypatch):
    """A sign of one column: right if it is named with its joint and column, or with either of two
    that explain the same; the controls: silence, another joint, another column.
    """
    monkeypatch.syspath_prepend(readme.README.parent / "random_machines")
    wiring = import_module("wiring")
    case = wiring.Spoiled(None, "sign", frozenset({"joint1"}), ("angle",))
    fault = WiringFault("sign", "joint1", "", of="angle")
    assert case.is_right([fault])
    assert case.is_right([replace(fault, of="")])
    assert not case.is_right([])
    assert not case.is_right([replace(fault, target="joint0")])
    assert not case.is_right([replace(fault, of="command")])
    unit = wiring.Spoiled(None, "unit_factor", frozenset({"joint1"}), ("angle",))
    degrees = WiringFault("unit_factor", "joint1", "", of="angle", factor=np.pi / 180)
    assert unit.is_right([degrees])
    assert unit.is_right([replace(degrees, of="", factor=180 / np.pi)])
    assert not unit.is_right([replace(degrees, factor=1e-3)])
    assert wiring.Spoiled(None, "", frozenset(), ()).is_right([])


def test_what_a_log_says_grows_with_what_is_missing(monkeypatch):
    """Nothing of what has no size; of half a payload a quarter as much as of the whole, within 20
    %: nats are squares of small differences.
    """
    monkeypatch.syspath_prepend(readme.README.parent / "random_machines")
    hidden, logs, worth = (import_module(name) for name in ("hidden", "logs", "worth"))
    rng = np.random.default_rng(6)
    design = import_module("design").random_design(rng)
    load = hidden.Hidden("payload", "link1", 0.02, np.array([0.0, 0.0, 0.05]))
    log = logs.random_log(design, hidden.built(design, [load]), rng)
    short = replace(log, runs=log.runs[:1])
    nats = []
    for factor in (1e-6, 0.5, 1.0):
        machine = hidden.built(design, [replace(load, size=factor * load.size)])
        nats += worth.worth(design, machine, short, [("payload", "link1")]).values()
    assert nats[0] < 1e-6 * nats[2]
    assert nats[1] == pytest.approx(nats[2] / 4, rel=0.2)


def test_what_a_gpu_measured_is_kept(monkeypatch, tmp_path):
    """Row by row with device and date, in the table and for the goals; the rest is not measured."""
    monkeypatch.setattr(gpu, "KEPT", tmp_path / "gpu.json")
    monkeypatch.setattr(gpu, "device", lambda: "a GPU")
    masses = [3.53, 3.93, 2.71, 5.09]
    row = {"evaluations": 5000, "steps": 2_000_000_000, "seconds": 400.0, "mean": masses}
    gpu.keep("published", "noisy", row | {"drawn": masses})
    gpu.keep("rates", "hopper-noisy | 1,000", [1e5, 1e6])
    said = gpu.table()
    assert said.startswith("a GPU, 20")
    assert "| hopper-noisy | 1,000 | 100,000 | 1,000,000 |" in said
    assert "| hopper-noisy | 10,000 | not measured | not measured |" in said
    assert "| noisy | 5,000 | 2e+09 | 400 | 5,000,000 | 3.530, 3.930, 2.710, 5.090 |" in said
    assert readme.numbers_in(said) == {"published": {"noisy": 400.0}}


def test_without_a_gpu_nothing_is_measured(monkeypatch, tmp_path, capsys):
    """It says so, and prints the table of what is kept."""
    monkeypatch.setattr(gpu, "KEPT", tmp_path / "gpu.json")
    monkeypatch.setattr(gpu, "device", lambda: None)
    monkeypatch.setattr(gpu, "write_block", lambda name, text: text)
    monkeypatch.setattr(sys, "argv", ["gpu.py", "rates", "published"])
    gpu.main()
    said = capsys.readouterr()
    assert "finds no GPU" in said.err
    assert "No GPU was at hand." in said.out
    assert "| noisy | not measured |" in said.out
    assert not gpu.KEPT.exists()
