"""What the documentation shows is true: its Python runs, its commands parse, its names exist, its output is what is printed.

`python tests/test_docs.py` prints the README's output blocks anew, into the README.
"""

import re
import shlex
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from dropo.cli.main import _parser, main
from dropo.core import catalogue

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "papers").glob("*/README.md"))]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"(?:#|<!--) ([\w.-]+\.(?:yaml|xml))")  # the first line of a block that is a file
WITH_PYTHON = [page for page in PAGES if any(kind == "python" for kind, _ in BLOCK.findall(page.read_text()))]


def named(page: Path) -> str:
    """The page's path from the root, as a test's name."""
    return str(page.relative_to(ROOT))


@pytest.fixture(autouse=True)
def _fresh_catalogue(monkeypatch):
    """What a page registers is gone after it."""
    monkeypatch.setattr(catalogue, "_registered", {kind: {} for kind in catalogue.BUILT_IN})


@pytest.mark.parametrize("page", WITH_PYTHON, ids=named)
def test_python_blocks_run(page, tmp_path, monkeypatch):
    """The Python blocks of a page run in order, in one namespace, in a folder that holds nothing but the files it shows."""
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "page"}
    for found in BLOCK.finditer(page.read_text()):
        kind, text = found.groups()
        first = FILE.match(text)
        if kind in ("yaml", "xml") and first:
            (tmp_path / first[1]).write_text(text)
        elif kind == "python":
            lines_before = page.read_text()[: found.start(2)].count("\n")
            exec(compile("\n" * lines_before + text, str(page), "exec"), namespace)


def commands(text: str) -> list[str]:
    """Every `dropo ...` command line of a page: in shell blocks, after `&&` too, and in backticks with two words behind `dropo`."""
    lines = [line for kind, block in BLOCK.findall(text) if kind in ("bash", "console") for line in block.splitlines()]
    pieces = [piece.split("#")[0].strip().removeprefix("$ ") for line in lines for piece in line.split("&&")]
    inline = re.findall(r"`([^`\n]+)`", BLOCK.sub("", text))
    pieces += [piece.strip() for span in inline for piece in span.split("&&") if len(piece.split()) > 2]
    return [piece for piece in pieces if re.match(r"dropo \S", piece)]


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_command_lines_parse(page):
    """The command line's own parser takes every command shown; names in them exist."""
    shown = commands(page.read_text())
    for line in shown:
        arguments = vars(_parser().parse_args(shlex.split(line)[1:]))
        for option, kind in (("method", "methods"), ("likelihood", "likelihoods"), ("optimizer", "optimizers"), ("family", "families")):
            if arguments.get(option) not in (None, "NAME"):
                catalogue.find(kind, arguments[option])
    assert shown or page != ROOT / "README.md"


def tables(text: str) -> list[tuple[str, list[str]]]:
    """(kind, names) of every table below a comment `<!-- names: KIND -->`: the words in backticks in its first column."""
    out = []
    for kind, table in re.findall(r"<!-- names: (\w+) -->\n((?:\|.*\n)+)", text):
        rows = table.splitlines()[2:]
        out.append((kind, [name for row in rows for name in re.findall(r"`([^`]+)`", row.split("|")[1])]))
    return out


def test_names_in_tables_exist():
    """The README's tables of names hold the catalogue's names and no others."""
    found = tables((ROOT / "README.md").read_text())
    assert {kind for kind, _ in found} == {"problems", "methods", "likelihoods", "families", "optimizers", "samplers"}
    for kind, names in found:
        assert names, f"the table of {kind} is empty"
        unknown = set(names) - set(catalogue.names(kind))
        assert not unknown, f"the README's table of {kind} names {unknown}, which do not exist"


OUTPUT = re.compile(r"<!-- output: (.*?) -->\n```text\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def outputs() -> dict[str, str]:
    """The text of every block below a comment `<!-- output: COMMAND -->` in the README, by its command."""
    return dict(OUTPUT.findall((ROOT / "README.md").read_text()))


def numeric(word: str) -> float | None:
    """The number in a word, without what stands around it."""
    try:
        return float(word.strip(".,;()").replace(",", ""))
    except ValueError:
        return None


def compare(new: list[str], old: list[str]) -> None:
    """Two lines say the same: words equal; a mass' mean to a millionth, +- estimates to a fiftieth; other numbers vary by machine."""
    assert [numeric(word) is None and word for word in new] == [numeric(word) is None and word for word in old]
    if old[0].endswith("_mass"):
        assert float(new[2]) == pytest.approx(float(old[2]), rel=1e-6)
    for i in (i for i, word in enumerate(old) if word == "+-"):
        assert numeric(new[i - 1]) == pytest.approx(numeric(old[i - 1]), rel=0.02)


@pytest.mark.parametrize("command", outputs())
def test_output_shown_is_printed(command, capsys):
    """A command prints the README's block."""
    assert main(shlex.split(command)[1:]) == 0
    printed, shown = ([line.split() for line in text.splitlines()] for text in (capsys.readouterr().out, outputs()[command]))
    assert len(printed) == len(shown) > 0
    for new, old in zip(printed, shown, strict=True):
        compare(new, old)


@pytest.mark.parametrize("line", [
    "torso_mass kg 3.6 1e-9", "thigh_mass kg 3.5 1e-9", "torso_mass kg 3.5", "damping +0.62 +- 0.003 N", "friction +0.6 +- 0.003 N",
])  # fmt: skip
def test_other_output_is_noticed(line):
    """A changed number, word or length."""
    shown = "damping +0.6 +- 0.003 N" if "+-" in line else "torso_mass kg 3.5 1e-9"
    with pytest.raises(AssertionError):
        compare(line.split(), shown.split())


def print_anew() -> None:
    """Runs the README's commands and puts what they print into it."""
    readme, dropo = ROOT / "README.md", [sys.executable, "-m", "dropo"]

    def block(found: re.Match[str]) -> str:
        text = subprocess.run([*dropo, *shlex.split(found[1])[1:]], check=True, capture_output=True, text=True).stdout
        return f"<!-- output: {found[1]} -->\n```text\n{text}```"

    readme.write_text(OUTPUT.sub(block, readme.read_text()))


def test_links_and_pictures_exist():
    """Relative links lead to files."""
    for page in PAGES:
        text = BLOCK.sub("", page.read_text())
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{named(page)} links to {target}, which is not there"


def test_xml_blocks_are_well_formed():
    """MJCF shown is XML."""
    for page in PAGES:
        for kind, text in BLOCK.findall(page.read_text()):
            if kind == "xml":
                ET.fromstring(text)


if __name__ == "__main__":
    print_anew()
