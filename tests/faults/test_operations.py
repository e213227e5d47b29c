"""A fit that fails at any of its file operations goes on with the same command as if it had not."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.faults.fuzz import build_inputs

SCRIPT = Path(__file__).with_name("operations.py")


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "step"), [("full", 7), ("kill", 5), ("torn", 4)])
def test_file_operations(tmp_path: Path, kind: str, step: int) -> None:
    """A full disk is one line and status 1; after it, after a kill and after a write that was torn,
    the result and the names of the files are those of an undisturbed run.
    """
    build_inputs(tmp_path)
    command = [sys.executable, str(SCRIPT), str(tmp_path), kind, str(step)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=400)
    *problems, count = done.stdout.splitlines()
    assert problems == []
    assert int(count.split()[0]) > 20 // step
    assert (done.returncode, done.stderr) == (0, "")
