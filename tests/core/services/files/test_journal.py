"""Journals: what was added is read again, whatever was cut off, damaged, doubled or exchanged."""

import re

import numpy as np
import pytest

from dropo.core.services.errors import BadFile
from dropo.core.services.files.journal import (
    MADE_WITH,
    Journal,
    format_line,
    read_lines,
    require_same,
    versions,
)
from dropo.core.services.run_warning import DropoWarning

WHAT = "a journal of a test"
HEADER = {"seed": 0, "bounds": [0.1, 1e-300]}


@pytest.fixture
def path(tmp_path):
    """A journal with five entries."""
    path = tmp_path / "journal.jsonl"
    journal = Journal(path, HEADER, WHAT)
    for i in range(5):
        journal.append({"value": i / 3})
    return path


def values(path):
    return [round(3 * entry["value"]) for entry in Journal(path, HEADER, WHAT).entries]


def test_nothing_is_written_before_the_first_entry(tmp_path):
    Journal(tmp_path / "folder" / "journal.jsonl", HEADER, WHAT)
    assert list(tmp_path.iterdir()) == []


def test_what_was_added_is_read_bit_for_bit(path):
    assert Journal(path, HEADER, WHAT).entries == [{"value": i / 3} for i in range(5)]
    assert read_lines(path, WHAT)[0] == HEADER | {MADE_WITH: versions()}


@pytest.mark.parametrize("line", range(1, 6))
def test_it_counts_up_to_the_first_damaged_line(path, line):
    """A flipped bit, a line cut short, a line that is gone: those before count alone. What was lost
    is added at the end, and all count again; what was there stays as it was.
    """
    whole = path.read_bytes()
    lines = whole.splitlines(keepends=True)
    for broken in (lines[line].replace(b"value", b"valve"), lines[line][:20] + b"\n", b""):
        damaged = b"".join([*lines[:line], broken, *lines[line + 1 :]])
        path.write_bytes(damaged)
        assert values(path) == list(range(line - 1))
        journal = Journal(path, HEADER, WHAT)
        for i in range(line - 1, 5):
            journal.append({"value": i / 3})
        assert values(path) == list(range(5))
        assert path.read_bytes().startswith(damaged)


@pytest.mark.parametrize("cut", [1, 30])
def test_a_last_line_that_was_cut_off_stands_alone(path, cut):
    path.write_bytes(path.read_bytes()[:-cut])
    assert values(path) == [0, 1, 2, 3]
    Journal(path, HEADER, WHAT).append({"value": 4 / 3})
    assert values(path) == [0, 1, 2, 3, 4]


def test_a_first_line_that_was_cut_off_is_written_again(path):
    path.write_bytes(path.read_bytes()[:30])
    journal = Journal(path, HEADER, WHAT)
    assert journal.entries == []
    journal.append({"value": 0.0})
    assert values(path) == [0]


def test_lines_that_stand_twice_count_once(path):
    whole = path.read_bytes()
    path.write_bytes(whole + whole)
    assert values(path) == list(range(5))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("words\nmore\n", "expected a journal of a test, got a file without a whole first line"),
        (format_line(1, {"value": 0}), "without a whole first line"),
        (format_line(0, {"seed": 1}), "bounds, seed: expected the settings of this run"),
        (format_line(0, [1]), "bounds, seed: expected"),
        (format_line(0, {**HEADER, "version": "99"}), "version: expected .* or older"),
    ],
)
def test_other_files_are_refused(tmp_path, text, message):
    path = tmp_path / "journal.jsonl"
    path.write_text(text)
    with pytest.raises(BadFile, match=message):
        Journal(path, HEADER, WHAT)
    assert path.read_text() == text


def test_other_versions_go_on_with_a_warning(tmp_path, monkeypatch):
    """The first line says which versions and kernel a run began with; another is named beside."""
    path = tmp_path / "journal.jsonl"
    Journal(path, {"a": 1}, "a journal").append(1)
    made_with = read_lines(path, "a journal")[0][MADE_WITH]
    assert set(made_with) == {"numpy", "scipy", "mujoco", "BLAS kernel"}
    assert made_with["numpy"] == np.__version__
    assert Journal(path, {"a": 1}, "a journal").entries == [1]  # warnings are errors here
    others = made_with | {"numpy": "1.0", "BLAS kernel": "Other"}
    monkeypatch.setattr("dropo.core.services.files.journal.versions", lambda: others)
    kernel = made_with["BLAS kernel"]
    words = f"numpy {np.__version__} then and 1.0 now, BLAS kernel {kernel} then and Other now"
    with pytest.warns(DropoWarning, match=re.escape(words)):
        journal = Journal(path, {"a": 1}, "a journal")
    journal.append(2)
    assert len(read_lines(path, "a journal")) == 3


def test_an_interrupted_line_may_be_added_again(tmp_path, monkeypatch):
    """Before it is on disk as after: no number is left out, so that nothing behind it is lost."""
    path = tmp_path / "journal.jsonl"
    journal = Journal(path, {}, "a journal")
    journal.append("first")

    def interrupted(_):
        raise KeyboardInterrupt

    for place in ("dropo.core.services.files.journal._end_of_cut_line", "os.fsync"):
        with monkeypatch.context() as patch:
            patch.setattr(place, interrupted)
            with pytest.raises(KeyboardInterrupt):
                journal.append(place)
        journal.append(place)
    journal.append("last")
    kept = Journal(path, {}, "a journal").entries
    assert kept == [
        "first",
        "dropo.core.services.files.journal._end_of_cut_line",
        "os.fsync",
        "last",
    ]


def test_settings_that_differ_are_shown(tmp_path):
    """Those that are short, with both values."""
    ours = {"seeds": 5, "sum": "a" * 64, "same": 1}
    theirs = {"seeds": 3, "sum": "b" * 64, "same": 1}
    with pytest.raises(BadFile, match=r"seeds, sum: .*run: seeds 3 there and 5 here .use another"):
        require_same(tmp_path / "run.json", ours, theirs)


def test_of_many_settings_that_differ_a_few_are_shown(tmp_path):
    """And how many others there are."""
    ours = {f"key_{i}": i for i in range(20)}
    with pytest.raises(BadFile, match=r"key_1, .* and 16 more: .* there and .* and 16 more .use"):
        require_same(tmp_path / "run.json", ours, {})
