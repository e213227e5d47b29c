"""How Sphinx builds the documentation: `sphinx-build -W docs docs/_build/html` (extra `docs`)."""

import ast
import dataclasses
import inspect
import re
import sys
import textwrap
from functools import cache
from typing import Any

import dropo

project = "dropo"
author = "dropo's authors"
version = release = dropo.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "**/.ipynb_checkpoints"]
html_theme = "furo"
html_title = "dropo"
html_show_copyright = False
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3
suppress_warnings = ["misc.highlighting_failure"]
nb_execution_mode = "force"  # the notebooks are kept without output: every build runs them
nb_execution_raise_on_error = True
nb_execution_timeout = 300
napoleon_google_docstring = False
napoleon_use_ivar = True  # fields of a dataclass stand once, where its docstring lists them
autodoc_member_order = "bysource"
autodoc_use_type_comments = False  # there are none
autodoc_default_options = {"members": True}
python_maximum_signature_line_length = 100
pygments_style = "friendly"


def own_signature(
    app: Any,
    what: str,
    name: str,
    thing: Any,
    options: Any,
    signature: str | None,
    returned: str | None,
) -> Any:
    """A signature as the source writes it: the names of types stay short."""
    if not str(getattr(thing, "__module__", "")).startswith("dropo."):
        return signature, returned
    if inspect.isclass(thing) and dataclasses.is_dataclass(thing):
        return f"({', '.join(fields_in_source(thing))})", None
    function = thing.__init__ if inspect.isclass(thing) else thing
    if not inspect.isfunction(function):
        return signature, returned
    node = source(function)
    arguments = re.sub(r"^(self|cls)(, )?", "", ast.unparse(node.args))
    return f"({arguments})", ast.unparse(node.returns) if node.returns and not inspect.isclass(
        thing
    ) else None


def source(thing: Any) -> Any:
    """The syntax tree of a function or class."""
    node = definitions(thing.__module__)
    for name in thing.__qualname__.split("."):
        inside = [child for child in node.body if getattr(child, "name", None) == name]
        if len(inside) != 1:  # overloads, or what was made inside of a function
            return ast.parse(textwrap.dedent(inspect.getsource(thing))).body[0]
        node = inside[0]
    return node


@cache
def definitions(module: str) -> ast.Module:
    """The syntax tree of a module, which holds many of them."""
    return ast.parse(inspect.getsource(sys.modules[module]))


def fields_in_source(thing: Any) -> list[str]:
    """ "name: type = default" of every field of a dataclass, as written; those by keyword alone
    behind a star.
    """
    written = {}
    for cls in reversed(thing.__mro__[:-1]):
        if dataclasses.is_dataclass(cls):
            written |= {
                line.target.id: ast.unparse(line)
                for line in source(cls).body
                if isinstance(line, ast.AnnAssign)
            }
    fields = [field for field in dataclasses.fields(thing) if field.init]
    named = [field.name for field in fields if field.kw_only]
    texts = (
        [written[field.name] for field in fields if not field.kw_only]
        + ["*"] * bool(named)
        + [written[name] for name in named]
    )
    return [text.replace("field(default_factory=dict)", "{}") for text in texts]


SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)  # a heading of numpydoc
TEXT = (
    "Notes",
    "References",
    "Examples",
    "Warnings",
    "See Also",
)  # sections without a list of names


def as_written(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """A docstring as it is read in the source: paragraphs of plain text, `code` in backticks,
    indented lines kept. Sections as numpydoc has them are left to napoleon, which comes next.
    """
    head, *sections = SECTION.split("\n".join(lines).strip())
    written = [paragraphs(head)]
    for title, body in zip(sections[::2], sections[1::2], strict=True):
        text = body.strip("\n")
        content = paragraphs(text) if title in TEXT else descriptions(text)
        written.append(f"{title}\n{'-' * len(title)}\n{content}")
    lines[:] = [*"\n\n".join(written).split("\n"), ""]


def paragraphs(text: str) -> str:
    """Paragraphs of a docstring as reStructuredText."""
    return "\n\n".join(map(paragraph, re.split(r"\n\s*\n", text.strip())))


def paragraph(text: str) -> str:
    """One paragraph of a docstring as reStructuredText."""
    if any(line.startswith("    ") for line in text.split("\n")):
        return "::\n\n" + textwrap.indent(text, "    ")
    plain = re.sub(r"^\.\. (?=\[)", "", text, flags=re.MULTILINE)  # a numbered reference
    return re.sub(r"^([-+.#])", r"\\\1", inline(plain).lstrip(), flags=re.MULTILINE)


def descriptions(text: str) -> str:
    """A section of names and indented descriptions, of which the latter are plain text."""
    lines = text.split("\n")
    return "\n".join(inline(line) if line.startswith(" ") else line for line in lines)


def inline(text: str) -> str:
    """Plain text with `code` in backticks as reStructuredText."""
    pieces = text.split("`")
    plain = [re.sub(r"([\\*|_])", r"\\\1", piece) for piece in pieces[::2]]
    code = [f"``{piece}``\\ " for piece in pieces[1::2]]
    return "".join(piece for pair in zip(plain, [*code, ""], strict=False) for piece in pair)


def within(app: Any, page: str, text: list[str]) -> None:
    """Links of the pages to papers/ lead to their copies in the documentation."""
    text[0] = re.sub(r"\]\(\.\./papers/(\w+)/README\.md", r"](papers/\1.md", text[0])


def setup(app: Any) -> None:
    """Sphinx calls this."""
    app.connect("autodoc-process-signature", own_signature)
    app.connect("autodoc-process-docstring", as_written, priority=400)  # napoleon's is 500
    app.connect("source-read", within)
