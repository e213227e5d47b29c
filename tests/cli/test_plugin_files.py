"""`--plugin FILE`: parts from a file of one's own, on every command."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from dropo.cli.main import main
from dropo.core.services import registry
from dropo.core.services.errors import BadFile
from dropo.core.services.plugin_files import load_plugins

PART = '''
"""An optimizer of one's own."""
from dropo import register
from dropo.optimizers.cma_es import CMAES


class Mine(CMAES):
    """CMA-ES under another name."""


register("optimizers", "mine", Mine)
'''
FIT = ("fit", "slide", "--likelihood", "monte-carlo", "--draws", "10", "--budget", "40")


@pytest.fixture
def part(tmp_path: Path) -> Iterator[Path]:
    """A file that registers the optimizer "mine", forgotten afterwards."""
    path = tmp_path / "my_part_of_the_test.py"
    path.write_text(PART)
    yield path
    registry._registered["optimizers"].pop("mine", None)
    sys.modules.pop(path.stem, None)


def test_a_command_finds_the_part_and_its_record_names_the_file(
    part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*FIT, "--optimizer", "mine", "--out", str(tmp_path / "out")]) == 2
    assert "mine" in capsys.readouterr().err
    options = ["--plugin", str(part), "--optimizer", "mine", "--out", str(tmp_path / "out")]
    assert main([*FIT, *options, "--quiet"]) == 0
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert list(record["plugins"]) == [part.name]


def test_a_changed_part_does_not_resume_the_run_of_the_old_one(
    part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--plugin", str(part), "--optimizer", "mine", "--out", str(tmp_path / "out")]
    assert main([*FIT, *options, "--quiet"]) == 0
    part.write_text(f"{PART}\n# another content\n")
    assert main([*FIT, *options, "--quiet"]) == 2
    assert "plugins" in capsys.readouterr().err


def test_it_is_listed(part: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "optimizers", "--plugin", str(part)]) == 0
    assert "CMA-ES under another name." in capsys.readouterr().out
    assert load_plugins(part) == ["optimizers: mine"]  # again


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("missing.py", None, "expected a Python file, got no file"),
        ("parts.txt", "", "which Python can import, got parts.txt"),
        ("my-parts.py", "", "which Python can import, got my-parts.py"),
        ("random.py", "", "a name that no imported module has, got random"),
        ("nothing_here.py", "x = 1\n", r"a call of dropo.register\(kind, name, plugin\)"),
        (
            "wrong_kind.py",
            "import dropo\ndropo.register('optimizer', 'x', 1)\n",
            "line 2.*Unknown",
        ),
        ("broken_part.py", "\n\nx = = 1\n", "line 3.*SyntaxError"),
        ("failing_part.py", "import no_such_module\n", "line 1.*No module named"),
    ],
)
def test_what_cannot_be_used_is_refused(
    tmp_path: Path, name: str, content: str | None, message: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(BadFile, match=message):
        load_plugins(tmp_path / name)
