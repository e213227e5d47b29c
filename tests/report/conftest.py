"""Folders that runs left: a fit's, a diagnosis', an interrupted fit's."""

import shutil

import pytest

from dropo.cli.main import main
from dropo.problems.file.writer import write_problem
from dropo.report.build import write_report
from tests.models.hidden_in_arm import problem

EFFECTS = ["--effects", "joint_damping", "joint_friction", "actuator_gain"]


@pytest.fixture(scope="session")
def fit_folder(tmp_path_factory):
    """Of `dropo fit hopper` on a few transitions."""
    out = tmp_path_factory.mktemp("fit") / "run"
    assert main(["fit", "hopper", "--transitions", "80", "--out", str(out), "--quiet"]) == 0
    return out


@pytest.fixture(scope="session")
def diagnosis_folder(tmp_path_factory):
    """Of `dropo diagnose` on an arm whose elbow has more damping than its model."""
    folder = tmp_path_factory.mktemp("diagnosis")
    path = write_problem(problem([("joint_damping:elbow", [0.05])], episodes=8), folder / "problem")
    out = folder / "run"
    assert (
        main(["diagnose", str(path), *EFFECTS, "--steps", "5", "--out", str(out), "--quiet"]) == 0
    )
    return out


@pytest.fixture(scope="session")
def unfinished_folder(tmp_path_factory):
    """A search by evaluations whose process was killed in the middle of a line of its evaluation
    log.
    """
    whole = tmp_path_factory.mktemp("whole") / "run"
    part = tmp_path_factory.mktemp("part")
    search = [
        "--likelihood",
        "monte-carlo",
        "--draws",
        "5",
        "--optimizer",
        "cma-es",
        "--budget",
        "60",
    ]
    assert main(["fit", "slide", *search, "--out", str(whole), "--quiet"]) == 0
    lines = (whole / "evaluations.jsonl").read_text().splitlines(keepends=True)
    (part / "evaluations.jsonl").write_text("".join(lines[:5]) + lines[5][:20])
    return part


@pytest.fixture(scope="session")
def pages(fit_folder, diagnosis_folder, unfinished_folder, tmp_path_factory):
    """The path of each folder's page."""
    folders = {"fit": fit_folder, "diagnosis": diagnosis_folder, "unfinished": unfinished_folder}
    return {
        kind: write_report(folder, tmp_path_factory.mktemp(kind) / "page.html")
        for kind, folder in folders.items()
    }


@pytest.fixture
def copy_of(tmp_path):
    """A function that copies a folder, to be changed."""
    return lambda folder: shutil.copytree(folder, tmp_path / "copy")
