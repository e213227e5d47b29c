"""Logs of positions that are imported and fitted as they come: the truth is found, or doubted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dropo import init, load
from dropo.core.contracts.problem import Problem
from dropo.estimators.dropo import DROPO
from dropo.estimators.support.whole_runs import ASKED_FOR, NOT_MEASURED, may_follow_runs
from dropo.problems.simulated.example_log import MACHINE, ExampleMachine, write_example

PARAMETERS = """
parameters:
  armature: {field: dof_armature, name: "*", low: 0, high: 0.1, unit: kg m^2}
  friction: {field: dof_frictionloss, name: "*", low: 0, high: 1, unit: N m}
"""
TRUTH = np.array([*MACHINE.armature, *MACHINE.friction])


def imported(folder: Path, machine: ExampleMachine, change: tuple[str, str] = ("", "")) -> Problem:
    """The example's logs of a machine, imported as they come, with what may be fitted.

    change: a text of the problem file, and what stands in its place.
    """
    model, *logs = write_example(folder, runs=2, machine=machine)
    init(str(model), [str(log) for log in logs], str(folder / "arm"))
    path = folder / "arm" / "problem.yaml"
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change) + PARAMETERS)
    return load(path)


def test_an_imported_log_is_fitted_along_whole_runs(tmp_path: Path) -> None:
    """The default fit of positions alone, with the model's own physics step: within 3 standard
    errors of the truth, which are below 2 % of it, no parameter varies, and nothing is said
    against it.
    """
    problem = imported(tmp_path, replace(MACHINE, finer=1, rows=700))
    fit = DROPO().fit(problem, rng=0)
    assert fit.likelihood == "trajectory"
    assert NOT_MEASURED in fit.message
    assert (fit.mean_se < 0.02 * TRUTH).all()
    assert (np.abs(fit.mean - TRUTH) < 3 * fit.mean_se).all(), (fit.mean, fit.mean_se)
    assert (fit.sd < fit.mean_se).all()
    assert fit.trusted
    assert fit.warnings == ()


def test_what_the_physics_step_made_is_said(tmp_path: Path) -> None:
    """A machine in physics steps four times finer than the model's: friction ends more than 3
    standard errors off, and residuals follow changes of a command. The fit names the physics step,
    by the size of the move at half of it within a half, and is not trusted.
    """
    problem = imported(tmp_path, replace(MACHINE, rows=700))
    fit = DROPO().fit(problem, rng=0)
    off = np.abs(fit.mean - TRUTH) > 3 * fit.mean_se
    assert off[2:].all()
    assert fit.trusted is False
    (sentence,) = [text for text in fit.warnings if "physics steps" in text]
    assert 'timestep="0.001"' in sentence
    for name, error in zip(fit.names, fit.mean - TRUTH, strict=True):
        if name.endswith("friction"):
            moved = float(sentence.split(f"{name} by ")[1].split()[0])
            # Of an error by 3 quarters of a step, half a step takes 2 thirds.
            assert moved == pytest.approx(-error * 2 / 3, rel=0.5)


def test_segments_are_asked_for_by_their_length(tmp_path: Path) -> None:
    """`lambda` is that of segments without `whole_runs`, and where a length is asked for; with it
    whole runs are in place.
    """
    problem = imported(tmp_path, replace(MACHINE, rows=300))
    assert problem.whole_runs
    assert problem.horizon == 20
    assert may_follow_runs(problem)
    assert not may_follow_runs(problem.using(horizon=20))
    (tmp_path / "b").mkdir()
    apart = imported(tmp_path / "b", replace(MACHINE, rows=300), ("whole_runs: true", ""))
    assert not may_follow_runs(apart)
    assert apart.horizon == 20


def test_logged_velocities_are_followed_too(tmp_path: Path) -> None:
    """Where the log has noisy velocities, states are whole: the problem file asks for whole runs,
    and the fit says so.
    """
    problem = imported(tmp_path, replace(MACHINE, finer=1, rows=300))
    whole = replace(problem, estimated={})
    fit = DROPO().fit(whole, rng=0)
    assert fit.likelihood == "trajectory"
    assert ASKED_FOR in fit.message
