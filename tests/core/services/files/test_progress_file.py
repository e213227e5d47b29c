"""How far a run is, for those who look at its folder."""

import pytest

from dropo.core.services.files import progress_file
from dropo.core.services.files.progress_file import KEPT, PROGRESS, ProgressFile, read_progress


def test_the_last_steps_are_kept_while_it_works(tmp_path, monkeypatch):
    """No more than a few, none sooner than the others; the file goes when the work ends."""
    now = [100.0]
    monkeypatch.setattr(progress_file.time, "time", lambda: now[0])
    file = ProgressFile(tmp_path / PROGRESS)
    for k in range(20):
        file(k / 20, f"step {k}", "")
        now[0] += progress_file.EVERY / 2
    steps = read_progress(tmp_path)
    assert [step.text for step in steps] == [f"step {k}" for k in range(4, 20, 2)]
    assert len(steps) == KEPT
    assert (steps[-1].fraction, steps[-1].at) == (0.9, 118.0)
    file.close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"steps": [{"at": 1}]}'])
def test_a_broken_file_says_nothing(tmp_path, text):
    """And a missing one; without a path nothing is written."""
    (tmp_path / PROGRESS).write_text(text)
    assert read_progress(tmp_path) == ()
    assert read_progress(tmp_path / "none") == ()
    ProgressFile(None)(0.5, "half", "")


def test_a_disk_that_is_full_ends_no_run(tmp_path, monkeypatch):
    """Nor does a folder that is gone."""

    def full(*arguments):
        raise OSError("no space left")

    monkeypatch.setattr(progress_file, "write_json", full)
    ProgressFile(tmp_path / PROGRESS)(0.5, "half", "")
    assert list(tmp_path.iterdir()) == []
