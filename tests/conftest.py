"""Tiers of tests: quick ones by default, slow ones by their recorded durations, studies on demand.

`pytest` runs the quick tests, `pytest -m ""` the slow ones too, `pytest -m study` the studies.
"""

import gc
import json
import os
import signal
import time
from collections import Counter
from pathlib import Path

import pytest

# Workers that each start threads for small matrices take turns on the cores: one thread each, set
# before NumPy is imported, here and in the processes that tests start.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

DURATIONS = Path(__file__).with_name("durations.json")
"""Test, or fixture that tests share -> processor seconds, of those that took at least RECORDED;
written by `--record-durations`.
"""
ROOT = Path(__file__).resolve().parents[1]
RECORDED = 0.2
GARBAGE = (50_000, 20, 20)
"""Numbers of objects and of collections from which garbage is collected."""
SLOW = 0.25
"""Seconds from which a test is slow: what is below it takes two cores about two minutes."""


def recorded():
    """The seconds of each test as they were written."""
    return json.loads(DURATIONS.read_text()) if DURATIONS.exists() else {}


def file_of(test):
    """The file of a test, from the root."""
    return test.split("::")[0]


def longest(item, seconds):
    """The seconds of a test, or of the longest of the shared fixtures without which it cannot run:
    where the other tests are left out it is the first of them that waits for these.
    """
    file = Path(file_of(item.nodeid))
    places = [file, *file.parents[:-1]]
    shared = [f"{place.as_posix()}::{name}" for place in places for name in item.fixturenames]
    return max(seconds.get(name, 0.0) for name in [item.nodeid, *shared])


def pytest_addoption(parser):
    parser.addoption(
        "--record-durations",
        action="store_true",
        help="write what the files that are run take to tests/durations.json",
    )


def pytest_xdist_auto_num_workers():
    """One more than cores: tests wait for processes that they start."""
    return os.cpu_count() + 1


def pytest_collection_finish():
    """What has been imported stays, and more comes with the tests: looking through all of it for
    garbage as often as usual takes one second in eight.
    """
    gc.freeze()
    gc.set_threshold(*GARBAGE)


def pytest_configure(config):
    if config.getoption("--record-durations") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Recorder())


def pytest_collection_modifyitems(config, items):
    """Mark what is slow; leave studies out unless the expression of -m names them."""
    seconds = recorded()
    for item in items:
        if longest(item, seconds) >= SLOW:
            item.add_marker(pytest.mark.slow)
        if item.get_closest_marker("study"):
            item.add_marker(pytest.mark.timeout(0))
    if "study" not in config.option.markexpr:
        studies = [item for item in items if item.get_closest_marker("study")]
        items[:] = [item for item in items if not item.get_closest_marker("study")]
        config.hook.pytest_deselected(items=studies)
    of_file = Counter()
    for test, own in seconds.items():
        of_file[file_of(test)] += own
    # A worker takes whole files: with the longest first, all workers end at about the same time.
    items.sort(key=lambda item: (-of_file[file_of(item.nodeid)], file_of(item.nodeid)))


SPENT = "processor seconds"
SHARED = "processor seconds of shared fixtures"
"""What they are called in the reports of a test; shared ones are in that of the first test."""
begun = pytest.StashKey()
shared = pytest.StashKey()


def processor_seconds():
    """Of this process and of those that it started and that ended: the same on a busy computer."""
    all_times = os.times()
    return time.process_time() + all_times.children_user + all_times.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """What was before a test is none of its own."""
    item.session.stash[begun] = processor_seconds()
    item.session.stash[shared] = {}
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef, request):
    """Note what a fixture takes that tests share."""
    before = processor_seconds()
    try:
        return (yield)
    finally:
        if fixturedef.scope != "function":
            name = f"{fixturedef.baseid}::{fixturedef.argname}"
            request.session.stash[shared][name] = processor_seconds() - before


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    """Send what a test took since the report before, and what shared fixtures took of it."""
    report = yield
    stash = item.session.stash
    now = processor_seconds()
    own = now - stash[begun] - sum(stash[shared].values())
    report.user_properties += [(SPENT, own), (SHARED, stash[shared])]
    stash[begun] = now
    stash[shared] = {}
    return report


class Recorder:
    """Adds up what each test takes, and what each fixture that tests share, and writes it.

    Files that were not run keep what was written of them, if they are still there.
    """

    def __init__(self):
        self.seconds = Counter()

    def pytest_runtest_logreport(self, report):
        said = dict(report.user_properties)
        self.seconds[report.nodeid] += said[SPENT]
        for name, seconds in said[SHARED].items():
            self.seconds[name] = max(self.seconds[name], seconds)

    def pytest_sessionfinish(self):
        run = {file_of(test) for test in self.seconds}
        found = {
            test: seconds
            for test, seconds in recorded().items()
            if file_of(test) not in run and (ROOT / file_of(test)).exists()
        }
        found |= {test: round(s, 2) for test, s in self.seconds.items() if s >= RECORDED}
        DURATIONS.write_text(json.dumps(dict(sorted(found.items())), indent=0) + "\n")


@pytest.fixture(autouse=True, scope="session")
def _no_lines_of_progress():
    """Commands say nothing of their progress, however slow the computer is."""
    from dropo.cli.support import output

    output.EVERY = float("inf")


@pytest.fixture(autouse=True, scope="session")
def _interrupts_are_heard():
    """Tests that a shell started in the background ignore Ctrl-C, which some of them send."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="module")
def _plug_ins_are_forgotten():
    """What the tests of a file register is no part of what the next file lists or records."""
    from dropo.core.services import plugin_files, registry

    kept = (plugin_files._loaded, plugin_files._sums, plugin_files._parts)
    before = {kind: dict(plugins) for kind, plugins in registry._registered.items()}
    files_before = [dict(files) for files in kept]
    yield
    registry._registered.clear()
    registry._registered.update(before)
    for files, known in zip(kept, files_before, strict=True):
        files.clear()
        files.update(known)
