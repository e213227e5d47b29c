"""The house rules, read from the source: who may import whom, lengths, docstrings, and names that
resolve.
"""

import ast
import importlib
import inspect
import io
import re
import subprocess
import sys
import tokenize
from pathlib import Path

import pytest

from dropo.core.services.registry import BUILT_IN

ROOT = Path(__file__).parents[1]
SOURCES = {
    str(path.relative_to(ROOT / "dropo")): path.read_text()
    for path in sorted((ROOT / "dropo").rglob("*.py"))
}

# What each room may import beside itself and the version; "" is dropo/__init__.py (public names,
# imported when asked for),
# __main__.py and _version.py.
MAY_IMPORT = {
    "core": set(),
    "mjmodel": {"core"},
    "distributions": {"core"},
    "likelihoods": {"core"},
    "optimizers": {"core"},
    "estimators": {"core", "analysis"},
    "analysis": {"core"},
    "effects": {"core", "mjmodel"},
    "diagnosis": {"core", "mjmodel", "analysis"},
    "simulators": {"core", "mjmodel"},
    "data": {"core", "mjmodel"},
    "testing": {"core"},
    "problems": {"core", "mjmodel", "simulators", "data"},
    "studies": {
        "core",
        "data",
        "distributions",
        "estimators",
        "likelihoods",
        "problems",
        "simulators",
        "analysis",
        "training",
        "",
    },
    "training": {"core", "mjmodel", "simulators", "problems", "data"},
    "plots": {"core"},
    "report": {"core", "mjmodel", "plots"},
    "cli": {
        "analysis",
        "core",
        "data",
        "diagnosis",
        "estimators",
        "mjmodel",
        "problems",
        "report",
        "studies",
        "training",
        "",
    },
    "": {
        "analysis",
        "cli",
        "core",
        "data",
        "diagnosis",
        "estimators",
        "mjmodel",
        "problems",
        "report",
        "simulators",
        "training",
    },
}
HEAVY = {
    "torch",
    "pyro",
    "arviz",
    "sbi",
    "botorch",
    "gpytorch",
    "matplotlib",
    "cma",
    "nlopt",
    "emcee",
    "pooch",
    "gymnasium",
    "minari",
    "rich",
    "pandas",
    "imageio_ffmpeg",
    "stable_baselines3",
    "pydantic",
    "pydantic_core",
    "ruamel",
}
UNAVOIDABLE = {  # nothing goes without it there
    "simulators/gymnasium.py": {"gymnasium"},
    "training/environments.py": {"gymnasium"},
    "core/file_schema.py": {"pydantic", "pydantic_core"},
    "problems/file/schema.py": {"pydantic"},
    "data/mapping_schema.py": {"pydantic"},
}
FILE_LINES = 250
FUNCTION_LINES = 60
LARGE_FILES: dict[str, int] = {}


def room_of(name):
    """ "core" of "core/data.py"; "" of "__init__.py"."""
    return name.split("/")[0] if "/" in name else ""


def imported(tree):
    """The modules that a piece of source imports, inside functions too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide their room: write dropo. ..."
            yield from (
                (f"{node.module}.{alias.name}" for alias in node.names)
                if node.module == "dropo"
                else [node.module]
            )


def rooms_imported(source):
    """The rooms of dropo that a source imports; the version belongs to none."""
    found = set()
    for module in imported(ast.parse(source)):
        parts = module.split(".")
        if parts[0] == "dropo" and parts[1:] != ["_version"]:
            found.add(parts[1] if len(parts) > 1 and (ROOT / "dropo" / parts[1]).is_dir() else "")
    return found


def strangers(name, source):
    """The rooms that a file must not import, and does."""
    return rooms_imported(source) - MAY_IMPORT[room_of(name)] - {room_of(name)}


def heavy_at_top(source):
    """Heavy modules that are imported when the file is: everything outside functions."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        for_types = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
        if for_types or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = []
    return {module.split(".")[0] for module in imported(tree)} & HEAVY


def code_lines(source, first=1, last=10**9):
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
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            lines.difference_update(range(node.lineno, node.end_lineno + 1))
    return sum(first <= line <= last for line in lines)


def long_functions(source):
    """name -> lines of code, of functions that are too long."""
    functions = [
        node
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    sizes = {node.name: code_lines(source, node.lineno, node.end_lineno) for node in functions}
    return {name: size for name, size in sizes.items() if size > FUNCTION_LINES}


def undocumented(name, source):
    """The public module, classes and functions without a docstring; a script's `main` is what its
    module says.
    """
    tree = ast.parse(source)
    found = [name] if tree.body and not ast.get_docstring(tree) else []
    for node in tree.body:
        public = (
            isinstance(node, ast.ClassDef | ast.FunctionDef)
            and not node.name.startswith("_")
            and node.name != "main"
        )
        if public and not ast.get_docstring(node):
            found.append(f"{name}: {node.name}")
    return found


def undocumented_methods(cls):
    """Public methods that neither they, nor the contract above them, nor their class's docstring
    explains.
    """
    own = {
        name: getattr(member, "__func__", member)
        for name, member in vars(cls).items()
        if not name.startswith("_")
    }
    methods = [name for name, member in own.items() if inspect.isfunction(member)]
    return [
        f"{cls.__qualname__}.{name}"
        for name in methods
        if not inspect.getdoc(getattr(cls, name)) and name not in (cls.__doc__ or "")
    ]


@pytest.mark.parametrize("name", SOURCES)
def test_imports_keep_their_direction(name):
    """core <- every room; plug-in rooms import core alone, never each other; the command line comes
    last.
    """
    assert room_of(name) in MAY_IMPORT, (
        f"the room of {name} has no rule yet: say in MAY_IMPORT what it may import"
    )
    assert strangers(name, SOURCES[name]) == set(), f"{name} reaches too far"


@pytest.mark.parametrize("name", SOURCES)
def test_heavy_modules_are_imported_where_they_are_used(name):
    """`dropo list` must not wait for torch or matplotlib, and works without them."""
    assert heavy_at_top(SOURCES[name]) <= UNAVOIDABLE.get(name, set()), (
        f"{name}: import it inside the function that uses it"
    )


def test_rules_catch_what_they_forbid():
    """The functions above can fail: each is shown a source that breaks its rule."""
    assert strangers(
        "likelihoods/a.py",
        "from dropo.core import data\ndef f():\n    from dropo.simulators.toy import X",
    ) == {"simulators"}
    assert strangers("core/a.py", "import dropo.optimizers.nlopt") == {"optimizers"}
    assert strangers("estimators/a.py", "from dropo import likelihoods") == {"likelihoods"}
    assert strangers("core/a.py", "from dropo._version import __version__") == set()
    assert strangers("core/a.py", "from dropo import __version__") == {""}
    assert heavy_at_top("try:\n    import torch.nn as nn\nexcept ImportError:\n    pass") == {
        "torch"
    }
    assert heavy_at_top("class A:\n    def f(self):\n        import torch") == set()
    long = "def f():\n" + "    a = 1\n" * FUNCTION_LINES
    assert long_functions(long) == {"f": FUNCTION_LINES + 1}
    assert code_lines('"""Text.\n\nMore."""\n\n# why\na = (\n    1,\n)\n') == 3
    assert undocumented("a.py", "def f(): pass\ndef _g(): pass\nclass C: pass") == [
        "a.py",
        "a.py: f",
        "a.py: C",
    ]
    assert undocumented("a/__init__.py", "") == []


@pytest.mark.parametrize("name", SOURCES)
def test_lengths(name):
    """No file of more than 250 lines of code and no function of more than 60; a file beyond it is
    listed with its own limit.
    """
    assert code_lines(SOURCES[name]) <= LARGE_FILES.get(name, FILE_LINES)
    assert long_functions(SOURCES[name]) == {}


@pytest.mark.parametrize("name", SOURCES)
def test_everything_public_is_documented(name):
    """Modules, classes and functions by their own docstring, methods by theirs or that of the
    contract above.
    """
    assert undocumented(name, SOURCES[name]) == []
    if name == "__main__.py":
        return
    needs = {module.split(".")[0] for module in imported(ast.parse(SOURCES[name]))} & {
        "torch",
        "pyro",
        "arviz",
        "minari",
    }
    missing = [need for need in needs if importlib.util.find_spec(need) is None]
    if missing and heavy_at_top(SOURCES[name]):
        pytest.skip(f"{missing} not installed")
    module = importlib.import_module(
        ".".join(["dropo", *Path(name).with_suffix("").parts]).removesuffix(".__init__")
    )
    for cls in vars(module).values():
        if (
            inspect.isclass(cls)
            and cls.__module__ == module.__name__
            and not cls.__name__.startswith("_")
        ):
            assert undocumented_methods(cls) == []


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, plugins in BUILT_IN.items() for name in plugins]
)
def test_built_in_names_resolve(kind, name):
    """Every name of the catalogue is something that can be called, in its own module."""
    module, attribute = BUILT_IN[kind][name].split(":")
    assert f"{module.removeprefix('dropo.').replace('.', '/')}.py" in SOURCES
    plugin = getattr(importlib.import_module(module), attribute)
    assert callable(plugin)
    assert plugin.__module__ == module


def test_starting_is_light():
    """The command line and the contracts load none of the heavy modules, nor MuJoCo."""
    light = [
        name
        for name in SOURCES
        if name.startswith("core/") and "__init__" not in name and name not in UNAVOIDABLE
    ]
    core = [f"dropo.core.{Path(name).stem}" for name in light]
    script = (
        f"import {', '.join([*core, 'dropo.cli.main', 'dropo.cli.list', 'dropo.testing'])}, "
        "sys; print(*sys.modules)"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    ).stdout.split()
    assert {module.split(".")[0] for module in loaded} & (HEAVY | {"mujoco"}) == set()


MACHINE = re.compile(
    r"(?<![\w.~)\]}-])/(?:wor" + r"k|roo" + r"t|hom" + r"e|tm" + r"p)(?:/|\b)"
)  # in pieces: this file is read too
TEXTS = {
    ".py",
    ".md",
    ".toml",
    ".yaml",
    ".yml",
    ".txt",
    ".json",
    ".sh",
    ".cff",
    ".xml",
    ".html",
    "",
}


def texts():
    """Every text of the repository's own: its root, and the folders that hold source and documents."""
    folders = [ROOT / name for name in ("dropo", "tests", "benchmarks", "papers", "docs", ".ci")]
    inside = [
        path for folder in folders for path in folder.rglob("*") if "__pycache__" not in path.parts
    ]
    return [
        path
        for path in [*ROOT.glob("*"), *inside]
        if path.is_file() and path.suffix in TEXTS and path.name != "MUJOCO_LOG.TXT"
    ]


def test_no_path_of_a_machine():
    """Nothing names a folder of the machine it was written on; the control: such a path is found."""
    assert MACHINE.search('"' + "/wor" + 'k/main"')
    assert MACHINE.search("see " + "/tm" + "p/x")
    assert not MACHINE.search("https://example.org" + "/hom" + "e and a/wor" + "k")
    lines = [
        (path.name, line[:100])
        for path in texts()
        for line in path.read_text().splitlines()
        if MACHINE.search(line)
    ]
    assert lines == []


def test_public_names_resolve_and_cost_nothing():
    """Each name of dropo.__all__ is there, and `import dropo` alone brings neither numpy nor
    mujoco.
    """
    import dropo

    assert [name for name in dropo.__all__ if not hasattr(dropo, name)] == []
    with pytest.raises(AttributeError, match="no attribute 'DROPPO'"):
        dropo.DROPPO  # noqa: B018
    command = [sys.executable, "-c", "import dropo, sys; print(sorted(sys.modules))"]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "'numpy'" not in loaded.stdout
    assert "'mujoco'" not in loaded.stdout
