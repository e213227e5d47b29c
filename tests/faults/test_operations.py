"""A command that fails at any of its file operations goes on as if it had not."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("operations.py")


@pytest.mark.slow
def test_file_operations() -> None:
    """A disk that is full or fails is one line and status 1; after it, after a kill and after a
    write that was torn, all that the folder holds is what an undisturbed run leaves: of fits,
    posteriors, diagnoses, studies, comparisons, trainings, imports, exports, new robots.
    """
    command = [sys.executable, str(SCRIPT), "--seed", "0", "--faults", "5"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=400)
    *problems, count = done.stdout.splitlines()
    assert problems == []
    assert count.startswith("5 faults in")
    assert int(count.split()[-2]) > 200
    assert (done.returncode, done.stderr) == (0, "")
