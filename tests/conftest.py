"""Tiers of tests: quick ones by default, slow ones by their recorded durations, studies on demand.

`pytest` runs the quick tests, `pytest -m ""` the slow ones too, `pytest -m study` the studies.
"""

import json
import os
from collections import Counter
from pathlib import Path

import pytest

# Workers that each start threads for small matrices take turns on the cores: one thread each, set
# before NumPy is imported, here and in the processes that tests start.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

DURATIONS = Path(__file__).with_name("durations.json")
"""Test -> seconds, of those that took at least RECORDED; written by `--record-durations`."""
RECORDED = 0.2
SLOW = 0.25
"""Seconds from which a test is slow: what is below it takes two cores about two minutes."""


def pytest_addoption(parser):
    parser.addoption(
        "--record-durations", action="store_true", help="write tests/durations.json anew"
    )


def pytest_configure(config):
    if config.getoption("--record-durations") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Recorder())


def pytest_collection_modifyitems(config, items):
    """Mark what is slow; leave studies out unless the expression of -m names them."""
    seconds = json.loads(DURATIONS.read_text()) if DURATIONS.exists() else {}
    for item in items:
        if seconds.get(item.nodeid, 0.0) >= SLOW:
            item.add_marker(pytest.mark.slow)
    if "study" not in config.option.markexpr:
        studies = [item for item in items if item.get_closest_marker("study")]
        items[:] = [item for item in items if not item.get_closest_marker("study")]
        config.hook.pytest_deselected(items=studies)


class Recorder:
    """Adds up what each test takes, with its set-up, and writes it at the end."""

    def __init__(self):
        self.seconds = Counter()

    def pytest_runtest_logreport(self, report):
        self.seconds[report.nodeid] += report.duration

    def pytest_sessionfinish(self):
        long = {name: round(s, 2) for name, s in sorted(self.seconds.items()) if s >= RECORDED}
        DURATIONS.write_text(json.dumps(long, indent=0) + "\n")
