"""Functions of this package as source text that runs without it."""

import ast
import builtins
import inspect
import math
import sys
import textwrap
from collections.abc import Callable, Collection
from dataclasses import fields, is_dataclass
from functools import cache, partial
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

from dropo.core.services.errors import Incompatible

PACKAGE = __name__.partition(".")[0]


class SourceText:
    """Collects functions and classes with all that they need, as one text.

    Those of outside packages are imported there; those of this package and of the modules given are
    copied, under the same names but for private ones, which carry their module's.

    Parameters
    ----------
    modules : collection of str
        Modules outside of this package whose functions and classes are copied too.

    Attributes
    ----------
    imports : set of str
        The import statements at the top of the text.
    """

    def __init__(self, modules: Collection[str] = ()):
        self._modules = modules
        self.imports: set[str] = set()
        self._blocks: list[str] = []
        self._names: dict[tuple[str, str], str] = {}

    def text(self) -> str:
        """Give the whole text.

        Returns
        -------
        str
            Imports, then constants, classes and functions, each behind what it needs.
        """
        return "\n\n\n".join(["\n".join(sorted(self.imports)), *self._blocks])

    def expression(self, value: Any) -> str:
        """Write a value as an expression; what it needs is collected.

        Parameters
        ----------
        value : object
            A number, text, array, container, function, class, partial or dataclass.

        Returns
        -------
        str

        Raises
        ------
        Incompatible
            If it is none of these.
        """
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, float) and not math.isfinite(value):
            return f"float('{value}')"
        if value is None or isinstance(value, bool | int | float | str):
            return repr(value)
        if isinstance(value, np.ndarray):
            self.imports.add("import numpy as np")
            return f"np.array({self.expression(value.tolist())})"
        if isinstance(value, tuple):
            inside = ", ".join(map(self.expression, value))
            return f"({inside},)" if len(value) == 1 else f"({inside})"
        if isinstance(value, list):
            return f"[{', '.join(map(self.expression, value))}]"
        if isinstance(value, dict):
            pairs = (f"{key!r}: {self.expression(one)}" for key, one in value.items())
            return f"{{{', '.join(pairs)}}}"
        if isinstance(value, partial):
            return self._partial(value)
        if isinstance(value, FunctionType | type):
            return self._named(value, value.__module__, value.__qualname__)
        if is_dataclass(value):
            return self._dataclass(value)
        raise Incompatible(
            f"{value!r} cannot be written as source text. Make hooks of module functions, with "
            "functools.partial for numbers, texts and dataclasses."
        )

    def _partial(self, value: "partial[Any]") -> str:
        """A call of functools.partial."""
        self.imports.add("from functools import partial")
        arguments = [self.expression(one) for one in (value.func, *value.args)]
        arguments += [f"{name}={self.expression(one)}" for name, one in value.keywords.items()]
        return f"partial({', '.join(arguments)})"

    def _dataclass(self, value: Any) -> str:
        """A call of its class with all fields."""
        owner = self.expression(type(value))
        given = [f"{f.name}={self.expression(getattr(value, f.name))}" for f in fields(value)]
        return f"{owner}({', '.join(given)})"

    def _named(self, value: Any, module: str, name: str) -> str:
        """The name of a function or class, which is collected."""
        if "." in name or "<" in name:
            raise Incompatible(
                f"{module}.{name} is defined inside of a function or class and cannot be written "
                "as source text. Define it at the top of its module."
            )
        if module.partition(".")[0] != PACKAGE and module not in self._modules:
            self.imports.add(f"from {module} import {name}")
            return name
        return self._collected(module, name, partial(self._copy, value))

    def _collected(self, module: str, name: str, write: Callable[[str], str]) -> str:
        """What is called so in a module is called in the text, where it is written once."""
        key = (module, name)
        if key not in self._names:
            self._names[key] = _unique_name(module, name, set(self._names.values()))
            self._blocks.append(write(self._names[key]))
        return self._names[key]

    def _copy(self, value: Any, name: str) -> str:
        """The source of a function or class, in which names are those of the text."""
        (tree,) = ast.parse(_source(value)).body
        plain = _WithoutAnnotations().visit(tree)
        plain.name = name
        scope = vars(sys.modules[value.__module__])
        found = {node.id for node in ast.walk(plain) if isinstance(node, ast.Name)}
        names = {}
        for used in sorted(found & set(scope) - set(dir(builtins))):
            names[used] = self._global(scope[used], value.__module__, used)
        return ast.unparse(_Renamed(names).visit(plain))

    def _global(self, value: Any, module: str, name: str) -> str:
        """What a global name of a module is called in the text."""
        if isinstance(value, ModuleType):
            alias = "" if name == value.__name__ else f" as {name}"
            self.imports.add(f"import {value.__name__}{alias}")
            return name
        if isinstance(value, FunctionType | type):
            return self._named(value, value.__module__, value.__qualname__)
        if callable(value):  # a function of C
            self.imports.add(f"from {value.__module__} import {name}")
            return name
        return self._collected(module, name, lambda own: f"{own} = {self.expression(value)}")


class _WithoutAnnotations(ast.NodeTransformer):
    """Takes annotations out; fields of dataclasses keep a plain one."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns = None
        return self.generic_visit(node)

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.annotation = None
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = ast.Name("object", ast.Load())
        return self.generic_visit(node)


class _Renamed(ast.NodeTransformer):
    """Gives names their new ones."""

    def __init__(self, names: dict[str, str]):
        self.names = names

    def visit_Name(self, node: ast.Name) -> ast.AST:
        node.id = self.names.get(node.id, node.id)
        return node


@cache
def _source(value: FunctionType | type) -> str:
    """The source of a function or class; of a class, all of its module is read for it."""
    return textwrap.dedent(inspect.getsource(value))


def _unique_name(module: str, name: str, taken: set[str]) -> str:
    """A name that is not taken; a private one carries its module's."""
    own = module.rpartition(".")[2]
    if not name.startswith("_") and name not in taken:
        return name
    return f"{'_' if name.startswith('_') else ''}{own}_{name.lstrip('_')}"
