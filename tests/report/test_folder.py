"""Folders that are no result, or none that this version reads, are refused by name."""

import json

import numpy as np
import pytest

from dropo.core.services.errors import BadFile
from dropo.core.services.files.evaluation_log import read_log
from dropo.core.services.files.journal import format_line
from dropo.report.build import write_report
from dropo.report.folder import read_result
from dropo.report.history import read_history


def test_folders_that_are_no_result(tmp_path):
    """Missing, a file, empty, or with something else in it; nothing is written."""
    with pytest.raises(BadFile, match="no such folder"):
        write_report(tmp_path / "none")
    (tmp_path / "file").write_text("")
    with pytest.raises(
        BadFile,
        match=r"a folder that `dropo fit --out` or `dropo diagnose --out` wrote, got a file",
    ):
        write_report(tmp_path / "file")
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadFile, match="an empty one"):
        write_report(tmp_path / "empty")
    with pytest.raises(BadFile, match="one with empty, file"):
        write_report(tmp_path)
    assert list((tmp_path / "empty").iterdir()) == []


def test_a_newer_versions_result(fit_folder, diagnosis_folder, unfinished_folder, copy_of):
    """Said so, with the way out; the same version with a local suffix is read."""
    folder = copy_of(fit_folder)
    content = json.loads((folder / "fit.json").read_text())
    for version, newer in (("99.0.0", True), (content["version"] + "+local", False)):
        (folder / "fit.json").write_text(json.dumps(content | {"version": version}))
        if newer:
            with pytest.raises(
                BadFile,
                match=r"fit.json: version: expected .* or older .*pip install -U dropo.*, "
                r"got 99.0.0",
            ):
                read_result(folder)
        else:
            assert read_result(folder).kind == "fit"
    (folder / "fit.json").unlink()
    header, _ = read_log(folder / "evaluations.jsonl")
    (folder / "evaluations.jsonl").write_text(format_line(0, {**header, "version": "99.0.0"}))
    with pytest.raises(BadFile, match=r"got 99\.0\.0"):
        read_result(folder)
    assert (read_result(diagnosis_folder).kind, read_result(unfinished_folder).kind) == (
        "diagnosis",
        "unfinished",
    )


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("fit.json", "{"),
        ("fit.json", "[]"),
        ("fit.json", "{}"),
        ("diagnosis.json", '{"verdict": "explained"}'),
        (
            "diagnosis.json",
            (
                '{"verdict": "", "headline": "", "causes": [], "remaining": {}, "pictures": '
                '{"rounds": 1}}'
            ),
        ),
        ("evaluations.jsonl", "words\nmore\n"),
        ("evaluations.jsonl", format_line(0, {}) + format_line(1, {"points": 1})),
        ("evaluations.jsonl", format_line(0, {"parameters": 3})),
        ("run.json", "words"),
    ],
)
def test_broken_files(tmp_path, name, text):
    """A sentence with the file's name."""
    (tmp_path / name).write_text(text)
    with pytest.raises(BadFile, match=name.replace(".", r"\.")):
        read_result(tmp_path)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("baseline", None, "baseline: expected"),
        ("causes", [{"effect": "wind"}], r"causes\[0\]\.target: expected what a run writes"),
        ("wall_time_s", "long", "wall_time_s: expected .*number, got 'long'"),
        ("pictures", {"rounds": 1}, r"pictures\.rounds: expected .*array, got 1"),
        ("remaining", {"where": "x"}, r"remaining\.where: expected .*array, got 'x'"),
    ],
)
def test_entries_of_other_types(diagnosis_folder, copy_of, key, value, message):
    """diagnosis.json is refused by its name and key."""
    path = copy_of(diagnosis_folder) / "diagnosis.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(BadFile, match=rf"diagnosis\.json: {message}"):
        read_result(path.parent)


def test_parts_that_do_not_fit_together(diagnosis_folder, copy_of):
    """Of the right types, but no page can be made of them: a sentence, and no page."""
    path = copy_of(diagnosis_folder) / "diagnosis.json"
    content = json.loads(path.read_text())
    content["baseline"]["horizons"].pop()
    path.write_text(json.dumps(content))
    with pytest.raises(BadFile, match=r"expected a folder that .*, got ValueError"):
        write_report(path.parent)
    assert not (path.parent / "report.html").exists()


def test_a_run_killed_at_once(tmp_path):
    """An evaluation log with its header alone is a run of no evaluations."""
    (tmp_path / "evaluations.jsonl").write_text(format_line(0, {"problem": "p", "parameters": []}))
    assert "after 0 evaluations" in write_report(tmp_path).read_text()


def test_history_of_rounds_and_of_evaluations(tmp_path):
    """Rounds of a local likelihood give means; evaluations give values over simulator steps; a half
    line is left out.
    """
    header = {"parameters": [{"name": "a"}]}
    one_round = {
        "points": [[2.0, 0.5]],
        "answers": [[0.5, 0.1, 7.0, 1.0, 2.2, 0.3]],
        "counts": {"steps": 10},
    }
    batch = {
        "points": [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]],
        "answers": [-3.0, -1.0],
        "counts": {"steps": 20},
    }
    path = tmp_path / "evaluations.jsonl"
    path.write_text(format_line(0, header) + format_line(1, one_round) + '{"n": 2')
    np.testing.assert_array_equal(read_history(path, None)[1].means, [[2.2]])
    path.write_text("".join(format_line(i, one) for i, one in enumerate((header, batch, batch))))
    found = read_history(path, 1)[1]
    assert found.means is None
    np.testing.assert_array_equal(found.values, [-3, -1, -3, -1])
    np.testing.assert_array_equal(found.steps, [10, 20, 30, 40])
