"""Files broken in any way: one line or a result, at once, and nothing written by a refusal."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("fuzz.py")
SEED = 0
CASES = 40


@pytest.mark.slow
def test_broken_files() -> None:
    """In a process of its own, which ends itself where a command hangs."""
    options = {"cases": CASES, "seed": SEED}
    arguments = [str(one) for name, value in options.items() for one in (f"--{name}", value)]
    command = [sys.executable, str(SCRIPT), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == (f"0 of {CASES} cases broke a rule.\n", "")
