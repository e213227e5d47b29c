"""Folders that runs left: a fit's, a diagnosis', an interrupted fit's."""

import shutil

import pytest

from dropo.cli.main import main
from dropo.problems.file.writer import write_problem
from dropo.report.build import write_report
from tests.models.hidden_in_arm import problem
from tests.models.shared import made_once

EFFECTS = ["--effects", "joint_damping", "joint_friction", "actuator_gain"]


@pytest.fixture(scope="session")
def fit_folder(tmp_path_factory):
    """Of `dropo fit hopper` on a few transitions."""

    def make(folder):
        arguments = ["--transitions", "80", "--out", str(folder / "run"), "--quiet"]
        assert main(["fit", "hopper", *arguments]) == 0

    return made_once(tmp_path_factory, "fit", make) / "run"


@pytest.fixture(scope="session")
def diagnosis_folder(tmp_path_factory):
    """Of `dropo diagnose` on an arm whose elbow has more damping than its model."""

    def make(folder):
        hidden = problem([("joint_damping:elbow", [0.05])], episodes=8)
        path = write_problem(hidden, folder / "problem")
        arguments = [*EFFECTS, "--steps", "5", "--out", str(folder / "run"), "--quiet"]
        assert main(["diagnose", str(path), *arguments]) == 0

    return made_once(tmp_path_factory, "diagnosis", make) / "run"


@pytest.fixture(scope="session")
def unfinished_folder(tmp_path_factory):
    """A search by evaluations whose process was killed in the middle of a line of its evaluation
    log.
    """
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

    def make(folder):
        whole = folder / "whole"
        part = folder / "part"
        assert main(["fit", "slide", *search, "--out", str(whole), "--quiet"]) == 0
        lines = (whole / "evaluations.jsonl").read_text().splitlines(keepends=True)
        part.mkdir()
        (part / "evaluations.jsonl").write_text("".join(lines[:5]) + lines[5][:20])

    return made_once(tmp_path_factory, "unfinished", make) / "part"


@pytest.fixture(scope="session")
def pages(fit_folder, diagnosis_folder, unfinished_folder, tmp_path_factory):
    """The path of each folder's page."""
    folders = {"fit": fit_folder, "diagnosis": diagnosis_folder, "unfinished": unfinished_folder}

    def make(folder):
        for kind, of in folders.items():
            write_report(of, folder / f"{kind}.html")

    found = made_once(tmp_path_factory, "pages", make)
    return {kind: found / f"{kind}.html" for kind in folders}


@pytest.fixture
def copy_of(tmp_path):
    """A function that copies a folder, to be changed."""
    return lambda folder: shutil.copytree(folder, tmp_path / "copy")
