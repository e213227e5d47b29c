"""What the documentation shows is true: its Python runs, its commands parse, its names exist, its
output is what is printed.

`python tests/test_docs.py` prints the output blocks anew, into the pages.
"""

import ast
import contextlib
import importlib
import importlib.util
import io
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
import tokenize
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from dropo.cli.main import _parser, main
from dropo.core.services import registry as catalogue
from dropo.problems.measured.external_data import find_data

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "papers").glob("*/README.md")),
]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(
    r"(?:#|<!--) ([\w.-]+\.(?:yaml|xml|py))\b"
)  # the first line of a block that is a file
WITH_PYTHON = [
    page for page in PAGES if any(kind == "python" for kind, _ in BLOCK.findall(page.read_text()))
]


def named(page: Path) -> str:
    """The page's path from the root, as a test's name."""
    return str(page.relative_to(ROOT))


@pytest.fixture(autouse=True)
def _fresh_catalogue(monkeypatch):
    """What a page registers is gone after it."""
    monkeypatch.setattr(catalogue, "_registered", {kind: {} for kind in catalogue.BUILT_IN})


@contextlib.contextmanager
def importable_folder():
    """Modules of the present folder can be imported, and are forgotten afterwards."""
    folder = str(Path.cwd())
    sys.path.insert(0, folder)
    importlib.invalidate_caches()
    try:
        yield
    finally:
        sys.path.remove(folder)
        for name, module in list(sys.modules.items()):
            if str(getattr(module, "__file__", None)).startswith(folder):
                del sys.modules[name]


def run_page(page: Path) -> list[tuple[re.Match[str], str]]:
    """Runs the Python blocks of a page in order, in one namespace, in the present folder, with the
    files that the page shows; those of Python are there to be imported.

    The blocks below a comment `<!-- printed -->`, each with what the Python block before it
    printed.
    """
    namespace = {"__name__": "page"}
    output = ""
    shown = []
    whole = page.read_text()
    for found in BLOCK.finditer(whole):
        kind, text = found.groups()
        first = FILE.match(text)
        if first:
            Path(first[1]).write_text(text)
        elif kind == "python":
            with importable_folder(), contextlib.redirect_stdout(io.StringIO()) as stream:
                exec(
                    compile("\n" * whole[: found.start(2)].count("\n") + text, str(page), "exec"),
                    namespace,
                )
            output = stream.getvalue()
        elif whole[: found.start()].endswith("<!-- printed -->\n"):
            shown.append((found, output))
    return shown


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.study) if page.stem == "start" else page
        for page in WITH_PYTHON
    ],
    ids=named,
)
def test_python_blocks_run(page, tmp_path, monkeypatch):
    """The Python blocks of a page run, in a folder that holds nothing but the files it shows, and
    print what it says; that which begins with a log and ends with a fit, in the studies.
    """
    monkeypatch.chdir(tmp_path)
    for found, printed in run_page(page):
        same_lines(printed, found[2])


def code_lines(source: str) -> int:
    """How many lines hold code: no docstring, no comment, not blank."""
    passive = {
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    }
    lines = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in passive:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if text and isinstance(node.value.value, str):
            lines.difference_update(range(node.lineno, node.end_lineno + 1))
    return len(lines)


def test_plugin_files_are_short():
    """The page about plug-ins has four files, each of at most 20 lines of code."""
    page = (ROOT / "docs" / "plugins.md").read_text()
    files = {
        FILE.match(text)[1]: code_lines(text)
        for kind, text in BLOCK.findall(page)
        if kind == "python" and FILE.match(text)
    }
    assert len(files) == 4
    assert max(files.values()) <= 20, files
    assert code_lines('"""Text."""\n\n# why\na = (\n    1,\n)\n') == 3


GROUPS = {f"dropo.{kind}" for kind in catalogue.BUILT_IN}
"""Groups of entry points, which are called like rooms, but are none."""


def unresolved(text: str) -> list[str]:
    """The dotted names beginning with `dropo.` that lead to no module, class or function."""
    return sorted({name for name in re.findall(r"\bdropo(?:\.\w+)+", text) if not resolves(name)})


def resolves(name: str) -> bool:
    """Whether a dotted name is a module, or an attribute of one."""
    if name in GROUPS:
        return True
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for part in parts[cut:]:
            if not hasattr(thing, part):
                return False
            thing = getattr(thing, part)
        return True
    return False


@pytest.mark.parametrize(
    "page",
    [
        *PAGES,
        *sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")),
        *(ROOT / name for name in ("CHANGELOG.md", "CONTRIBUTING.md", "AGENTS.md")),
        ROOT / "benchmarks" / "README.md",
    ],
    ids=named,
)
def test_modules_named_exist(page):
    """Every `dropo.<room>.<module>` that a page names is there; the control: a false one is not."""
    assert unresolved(page.read_text()) == []
    assert unresolved("see `dropo.core.nothing.here`") == ["dropo.core.nothing.here"]


def commands(text: str) -> list[str]:
    """Every `dropo ...` command line of a page: in shell blocks, after `&&` too, and in backticks
    with an argument behind its name.
    """
    lines = [
        line
        for kind, block in BLOCK.findall(text)
        if kind in ("bash", "console")
        for line in block.splitlines()
    ]
    pieces = [
        piece.split("#")[0].split(" > ")[0].strip().removeprefix("$ ")
        for line in lines
        for piece in line.split("&&")
    ]
    inline = re.findall(r"`([^`\n]+)`", BLOCK.sub("", text))
    pieces += [
        piece.strip()
        for span in inline
        for piece in span.split("&&")
        if len(piece.split()) > 2 + ("dropo data" in piece)
    ]
    return [piece for piece in pieces if re.match(r"dropo \S", piece)]


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_command_lines_parse(page):
    """The command line's own parser takes every command shown; names in them exist, but for those
    of the plug-in files that they load.
    """
    shown = commands(page.read_text())
    for line in shown:
        arguments = vars(_parser().parse_args(shlex.split(line)[1:]))
        for option, kind in (
            ("method", "methods"),
            ("likelihood", "likelihoods"),
            ("optimizer", "optimizers"),
            ("family", "families"),
        ):
            given = arguments.get(option) or ()
            for name in [given] if isinstance(given, str) else given:
                if name != "NAME" and not arguments["plugin"]:
                    catalogue.find(kind, name)
    assert shown or page != ROOT / "README.md"


def tables(text: str) -> list[tuple[str, list[str]]]:
    """(kind, names) of every table below a comment `<!-- names: KIND -->`: the words in backticks
    in its first column.
    """
    out = []
    for kind, table in re.findall(r"<!-- names: (\w+) -->\n((?:\|.*\n)+)", text):
        rows = table.splitlines()[2:]
        out.append(
            (kind, [name for row in rows for name in re.findall(r"`([^`]+)`", row.split("|")[1])])
        )
    return out


def test_names_in_tables_exist():
    """The README's tables of names hold the catalogue's names and no others."""
    found = tables((ROOT / "README.md").read_text())
    assert {kind for kind, _ in found} == {
        "problems",
        "methods",
        "likelihoods",
        "families",
        "optimizers",
        "samplers",
    }
    for kind, names in found:
        assert names, f"the table of {kind} is empty"
        unknown = set(names) - set(catalogue.names(kind))
        assert not unknown, f"the README's table of {kind} names {unknown}, which do not exist"


OUTPUT = re.compile(
    r"<!-- (output|measured): (.*?) -->\n```text\n(.*?)^```$", re.MULTILINE | re.DOTALL
)


def outputs(kind: str = "output") -> dict[str, str]:
    """The text of every block below a comment `<!-- output: COMMAND -->` in the README, by its
    command; "measured": takes the measured data, and minutes.
    """
    return {
        command: text
        for found, command, text in OUTPUT.findall((ROOT / "README.md").read_text())
        if found == kind
    }


def numeric(word: str) -> float | None:
    """The number in a word, without what stands around it."""
    try:
        return float(word.strip(".,;()").replace(",", ""))
    except ValueError:
        return None


def literal(word: str) -> str:
    """A word that is the same on every machine: no number, and no line under a table's header,
    which is as long as its numbers.
    """
    return "" if numeric(word) is not None or set(word) == {"-"} else word


def compare(new: list[str], old: list[str]) -> None:
    """Two lines say the same: words equal; a mass' mean to a millionth, +- estimates to a fiftieth;
    other numbers vary by machine.
    """
    assert [literal(word) for word in new] == [literal(word) for word in old]
    if old and old[0].endswith("_mass"):
        assert float(new[2]) == pytest.approx(float(old[2]), rel=1e-6)
    for i in (i for i, word in enumerate(old) if word == "+-"):
        assert numeric(new[i - 1]) == pytest.approx(numeric(old[i - 1]), rel=0.02)


def same_lines(printed: str, shown: str) -> None:
    """Two texts say the same, line by line, and something."""
    new, old = ([line.split() for line in text.splitlines()] for text in (printed, shown))
    assert len(new) == len(old) > 0
    for one, other in zip(new, old, strict=True):
        compare(one, other)


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(line, marks=pytest.mark.study) if "diagnose" in line else line
        for line in outputs()
    ],
)
def test_output_shown_is_printed(command, capsys):
    """A command prints the README's block; a diagnosis among all effects takes half a minute."""
    assert main(shlex.split(command)[1:]) == 0
    same_lines(capsys.readouterr().out, outputs()[command])


@pytest.mark.study
@pytest.mark.skipif(
    find_data("cube-toss/runs.npz") is None,
    reason="the measured data are not at hand (DROPO_DATA names their folder)",
)
@pytest.mark.parametrize("command", outputs("measured"))
def test_output_of_measured_data_is_printed(command, capsys):
    """Likewise."""
    assert main(shlex.split(command)[1:]) == 0
    same_lines(capsys.readouterr().out, outputs("measured")[command])


@pytest.mark.parametrize(
    "line",
    [
        "torso_mass kg 3.6 1e-9",
        "thigh_mass kg 3.5 1e-9",
        "torso_mass kg 3.5",
        "damping +0.62 +- 0.003 N",
        "friction +0.6 +- 0.003 N",
    ],
)
def test_other_output_is_noticed(line):
    """A changed number, word or length."""
    shown = "damping +0.6 +- 0.003 N" if "+-" in line else "torso_mass kg 3.5 1e-9"
    with pytest.raises(AssertionError):
        compare(line.split(), shown.split())


def print_anew() -> None:
    """Runs the README's commands and the pages' Python, and puts what they print into them."""
    readme = ROOT / "README.md"
    dropo = [sys.executable, "-m", "dropo"]

    def block(found: re.Match[str]) -> str:
        if found[1] == "measured" and find_data("cube-toss/runs.npz") is None:
            return found[0]
        text = subprocess.run(
            [*dropo, *shlex.split(found[2])[1:]], check=True, capture_output=True, text=True
        ).stdout
        return f"<!-- {found[1]}: {found[2]} -->\n```text\n{text}```"

    readme.write_text(OUTPUT.sub(block, readme.read_text()))
    for page in WITH_PYTHON:
        print_page(page)


def print_page(page: Path) -> None:
    """One page's blocks below `<!-- printed -->`."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        text = page.read_text()
        for found, printed in reversed(run_page(page)):
            text = text[: found.start(2)] + printed + text[found.end(2) :]
        page.write_text(text)


def test_links_and_pictures_exist():
    """Relative links lead to files."""
    for page in PAGES:
        text = BLOCK.sub("", page.read_text())
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
            if "://" not in target:
                assert (page.parent / target).exists(), (
                    f"{named(page)} links to {target}, which is not there"
                )


def test_xml_blocks_are_well_formed():
    """MJCF shown is XML."""
    for page in PAGES:
        for kind, text in BLOCK.findall(page.read_text()):
            if kind == "xml":
                ET.fromstring(text)


def build(source: Path, out: Path, builder: str, *more: str) -> subprocess.CompletedProcess[str]:
    """Sphinx with warnings as errors, and more options."""
    if importlib.util.find_spec("furo") is None or importlib.util.find_spec("myst_nb") is None:
        pytest.skip("the documentation needs the extra 'docs'")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-b",
        builder,
        *more,
        "-d",
        str(out / "trees"),
        str(source),
        str(out / "html"),
    ]
    return subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
    )


SHOWN = ("index", "notebooks/fit", "notebooks/diagnosis", "papers/tiboni_2021")
"""Some of the documentation's pages."""


def test_the_documentation_is_whole(tmp_path):
    """Every page is read and its references are resolved without a warning; HTML is written, which
    takes as long again, by the studies.
    """
    done = build(
        ROOT / "docs", tmp_path, "dummy", "-D", "nb_execution_mode=off", "-D", "smartquotes=0"
    )
    assert done.returncode == 0, done.stderr
    for page in SHOWN:
        assert (tmp_path / "trees" / f"{page}.doctree").stat().st_size > 5000


@pytest.mark.study
def test_the_documentation_builds(tmp_path):
    """Without a warning, with notebooks that run on the way."""
    done = build(ROOT / "docs", tmp_path, "html", "-D", "nb_execution_mode=force")
    assert done.returncode == 0, done.stderr
    for page in SHOWN:
        assert (tmp_path / "html" / f"{page}.html").stat().st_size > 5000


def test_a_broken_page_is_noticed(tmp_path):
    """A link to nowhere fails the build: the control of the test above."""
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "conf.py").write_text((ROOT / "docs" / "conf.py").read_text())
    (tmp_path / "docs" / "index.md").write_text("# Index\n\n[nowhere](nowhere.md)\n")
    done = build(tmp_path / "docs", tmp_path, "dummy")
    assert done.returncode != 0
    assert "nowhere" in done.stderr


NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=pytest.mark.study) if path.stem == "diagnosis" else path
        for path in NOTEBOOKS
    ],
    ids=named,
)
def test_notebooks_run(path, tmp_path, monkeypatch):
    """Their cells run in order, in a folder that holds nothing; what ends a cell can be shown.

    That of the diagnosis, which takes all effects, in the studies; docs/diagnosis.md is the same
    with some of them.
    """
    pyplot = pytest.importorskip("matplotlib.pyplot")
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "notebook"}
    for cell in json.loads(path.read_text())["cells"]:
        if cell["cell_type"] == "code":
            code = ast.parse("".join(cell["source"]))
            last = code.body.pop() if isinstance(code.body[-1], ast.Expr) else None
            exec(compile(code, str(path), "exec"), namespace)
            if last is not None:
                assert repr(eval(compile(ast.Expression(last.value), str(path), "eval"), namespace))
    pyplot.close("all")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=named)
def test_notebooks_are_kept_without_output(path):
    """What they show is made by every build, so that no figure is older than the code."""
    cells = json.loads(path.read_text())["cells"]
    assert all(
        cell.get("outputs", []) == [] and cell.get("execution_count") is None for cell in cells
    )


if __name__ == "__main__":
    print_anew()
