"""A run that was interrupted goes on on another kind of processor."""

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dropo.core.services.errors import InvalidInput
from dropo.core.services.files.evaluation_log import EvaluationLog

FIT = ("fit", "slide", "--likelihood", "monte-carlo", "--draws", "10", "--budget", "60", "--quiet")


def run(folder: Path, kernel: str) -> dict[str, float]:
    """The means of a fit with OpenBLAS's kernel for a processor."""
    command = [sys.executable, "-m", "dropo", *FIT, "--out", str(folder)]
    environment = os.environ | {"OPENBLAS_CORETYPE": kernel}
    subprocess.run(command, env=environment, check=True, capture_output=True)
    content = json.loads((folder / "fit.json").read_text())
    return {name: row["mean"] for name, row in content["parameters"].items()}


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the kernels are of x86")
def test_it_goes_on_to_the_same_fit_but_for_rounding(tmp_path: Path) -> None:
    """Half of the evaluations by one kernel, the rest by another, which rounds otherwise."""
    whole = run(tmp_path, "Haswell")
    log = tmp_path / "evaluations.jsonl"
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[: len(lines) // 2]))
    (tmp_path / "fit.json").unlink()
    again = run(tmp_path, "Prescott")
    for name, mean in whole.items():
        assert again[name] == pytest.approx(mean, rel=1e-9)
    assert log.read_text().startswith("".join(lines[: len(lines) // 2]))


def test_other_points_are_refused(tmp_path: Path) -> None:
    """The control: what is off by more than rounding is another run's."""
    points = np.array([[0.25, 0.5]])
    answer = (np.array([1.0]), {"steps": 3})
    path = tmp_path / "log.jsonl"
    EvaluationLog(path, {}).evaluate(points, lambda _: answer)
    again = EvaluationLog(path, {})
    values, counts = again.evaluate(points * (1 + 1e-12), lambda _: pytest.fail("not recorded"))
    assert (values.tolist(), counts) == ([1.0], {"steps": 3})
    for other in (points * (1 + 1e-6), points[:, :1]):
        with pytest.raises(InvalidInput, match="asked for at other points"):
            EvaluationLog(path, {}).evaluate(other, lambda _: answer)
