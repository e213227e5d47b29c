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
        hidden = problem([("joint_damping:elbow", [0.05])], episodes=5)
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


class Pages:
    """The path of each kind of folder's page, made when it is asked for.

    So two workers that ask for pages of two kinds do not wait for each other.
    """

    def __init__(self, request, factory):
        self.request = request
        self.factory = factory

    def __getitem__(self, kind):
        folder = self.request.getfixturevalue(f"{kind}_folder")
        page = lambda place: write_report(folder, place / "page.html")
        return made_once(self.factory, f"page_of_{kind}", page) / "page.html"


@pytest.fixture(scope="session")
def pages(request, tmp_path_factory):
    """The pages by their kinds: "fit", "diagnosis" and "unfinished"."""
    return Pages(request, tmp_path_factory)


@pytest.fixture
def copy_of(tmp_path):
    """A function that copies a folder, to be changed."""
    return lambda folder: shutil.copytree(folder, tmp_path / "copy")
