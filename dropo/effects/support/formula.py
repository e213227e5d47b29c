"""Formulas as text: read by a small grammar, with the units of their constants.

    -c * abs(v) * v
    -k * dead(q, play) - d * tanh(v / w) * abs(load)
    -f * dahl(x) + c * sin(6 * q)
    c * v.shoulder * v - k * lag(motor**2, 20)

Names are variables or constants; operators are + - * / **; functions are those of `FUNCTIONS`.
Nothing else is read, and no code is run.
"""

import ast
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce

import numpy as np

from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, known
from dropo.effects.support.formula_values import Node, Program

FUNCTIONS = {
    "abs": 1,
    "sign": 1,
    "tanh": 1,
    "exp": 1,
    "sin": 1,
    "cos": 1,
    "sqrt": 1,
    "max": 2,
    "min": 2,
    "dead": 2,
    "lag": 2,
    "dahl": 1,
}
"""The functions of formulas, with their numbers of arguments. dead(x, w) is x less w towards 0;
lag(x, T) follows x with the time constant T; dahl(w) is a presliding friction's state between -1
and 1, which follows the joint's position over the distance w.
"""
OPERATORS: dict[type, str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "**",
}
LONGEST = 6000
"""Characters of a formula at most."""
DEEPEST = 100
"""Parts of a formula within each other at most."""
SHOWN = 200
"""Characters of a formula that messages have."""
BASES = ("N", "m", "s", "rad", "command")
"""The units of which all others are products."""

Units = Mapping[tuple[str, str], str]
"""The unit of each variable, by its name and joint ("" for the own one)."""


@dataclass(frozen=True)
class Formula:
    """A formula that was read.

    Attributes
    ----------
    text : str
        In a plain form.
    program : Program
        What is evaluated.
    units : tuple of str
        The unit of each of its constants.
    scales : tuple of bool
        Whether each constant is a scale, which has no sign: by what something is divided, a width,
        a time or a distance.
    """

    text: str
    program: Program
    units: tuple[str, ...]
    scales: tuple[bool, ...]


def read_formula(
    text: str, variables: Units, unit: str, constants: Collection[str] | None = None
) -> Formula:
    """Read a formula.

    Parameters
    ----------
    text : str
        The formula.
    variables : mapping of (str, str) to str
        The variables that there are, with their units.
    unit : str
        The unit that its value must have.
    constants : collection of str, optional
        The names that are constants; all that are no variables if None.

    Returns
    -------
    Formula

    Raises
    ------
    BadArgument
        If it is no formula, or units do not go together, or two constants cannot be distinguished.
    UnknownName
        If a name is neither a variable nor a constant, or a function does not exist; with the
        nearest one.
    """
    said = _shown(text)
    if len(text) > LONGEST:
        raise BadArgument(f"A formula has at most {LONGEST} characters. Got {len(text)}.")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise BadArgument(f"{said} is no formula such as '-c * abs(v) * v'.") from None
    reader = _Reader(text, variables, constants)
    root = reader.read(tree, 0)
    if not reader.constants:
        raise BadArgument(f"The formula {said} has no constant that could be its size.")
    names = tuple(reader.constants)
    if reader.hidden and ("q", "") not in variables:
        raise BadArgument(f"The formula {said} remembers, which takes the position of a joint.")
    needed = dict.fromkeys(reader.variables)
    if reader.hidden:
        needed |= {("t", ""): None, ("q", ""): None}
    program = Program(_with_alike_together(root), names, tuple(needed), len(reader.hidden))
    units = _constant_units(text, root, names, variables, unit)
    scales = tuple(_is_scale(root, name) for name in names)
    return Formula(write_formula(root), program, units, scales)


def _with_alike_together(root: Node) -> Node:
    """A sum whose terms are evaluated at once where they differ by their constants alone."""
    groups: dict[Node, list[tuple[Node, tuple[str, ...]]]] = {}
    for term in _terms(root):
        names: list[str] = []
        groups.setdefault(_shape(term, names), []).append((term, tuple(names)))
    parts = []
    for shape, alike in groups.items():
        first, names_of_first = alike[0]
        if len(alike) == 1 or not names_of_first or _in_memory(shape) & set(names_of_first):
            parts += [term for term, _ in alike]
            continue
        columns = zip(names_of_first, zip(*(names for _, names in alike), strict=True), strict=True)
        parts.append(("alike", first, tuple(columns)))
    return reduce(lambda one, other: ("call", "+", (one, other)), parts)


def _terms(node: Node) -> list[Node]:
    """The terms of a sum."""
    if node[:2] == ("call", "+"):
        return [term for one in node[2] for term in _terms(one)]
    return [node]


def _shape(node: Node, names: list[str]) -> Node:
    """A part without what its constants are called; they are added to a list."""
    if node[0] == "constant":
        if node[1] not in names:
            names.append(node[1])
        return ("constant", names.index(node[1]))
    if node[0] == "call":
        return (*node[:2], tuple(_shape(one, names) for one in node[2]))
    return node


def _in_memory(node: Node) -> set[str]:
    """The constants of the hidden states of a part."""
    if node[0] == "call":
        return {name for one in node[2] for name in _in_memory(one)}
    return _constants(node) if node[0] == "hidden" else set()


def _constants(node: Node) -> set[str]:
    """The constants of a part."""
    if node[0] in ("call", "hidden"):
        return {name for one in node[2] for name in _constants(one)}
    return {node[1]} if node[0] == "constant" else set()


def _shown(text: str) -> str:
    """A text as a message quotes it, without the middle of a long one."""
    half = SHOWN // 2
    return repr(text if len(text) <= SHOWN else f"{text[:half]} ... {text[-half:]}")


class _Reader:
    """Reads Python's syntax tree of a formula into a tree of plain tuples."""

    def __init__(self, text: str, variables: Units, constants: Collection[str] | None):
        self.said = _shown(text)
        self.known = variables
        self.given = constants
        self.constants: dict[str, None] = {}
        self.variables: list[tuple[str, str]] = []
        self.hidden: dict[Node, int] = {}

    def read(self, tree: ast.AST, depth: int) -> Node:
        """Read one part."""
        if depth > DEEPEST:
            raise BadArgument(f"The formula {self.said} has too many parts within each other.")
        if isinstance(tree, ast.Constant) and isinstance(tree.value, int | float):
            number = float(tree.value)
            if not isinstance(tree.value, bool) and np.isfinite(number):
                return ("number", number)
        if isinstance(tree, ast.Name):
            return self._name(tree.id)
        joint = _of_joint(tree)
        if joint is not None:
            return self._variable(*joint)
        if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub | ast.UAdd):
            inside = self.read(tree.operand, depth + 1)
            return ("call", "-", (inside,)) if isinstance(tree.op, ast.USub) else inside
        if isinstance(tree, ast.BinOp) and type(tree.op) in OPERATORS:
            both = (self.read(tree.left, depth + 1), self.read(tree.right, depth + 1))
            return ("call", OPERATORS[type(tree.op)], both)
        if isinstance(tree, ast.Call) and isinstance(tree.func, ast.Name) and not tree.keywords:
            return self._call(tree.func.id, tree.args, depth)
        raise BadArgument(
            f"The formula {self.said} may have numbers, names, + - * / **, and the functions "
            f"{', '.join(FUNCTIONS)}. Got {_shown(ast.unparse(tree))}."
        )

    def _call(self, name: str, arguments: Sequence[ast.expr], depth: int) -> Node:
        """A function."""
        known("function of formulas", name, FUNCTIONS)
        if len(arguments) != FUNCTIONS[name]:
            raise BadArgument(
                f"{name} in the formula {self.said} takes {FUNCTIONS[name]} arguments. "
                f"Got {len(arguments)}."
            )
        inside = tuple(self.read(one, depth + 1) for one in arguments)
        if name in ("lag", "dahl"):
            if inside[-1][0] not in ("number", "constant"):
                raise BadArgument(
                    f"The last argument of {name} in the formula {self.said} must be a number "
                    "or a constant."
                )
            place = self.hidden.setdefault((name, inside), len(self.hidden))
            return ("hidden", name, inside, place)
        is_speed = name == "sign" and inside[0][0] == "variable" and inside[0][1] == "v"
        return ("call", "direction" if is_speed else name, inside)

    def _name(self, name: str) -> Node:
        """A variable or a constant."""
        if (name, "") in self.known:
            return self._variable(name, "")
        if self.given is not None and name not in self.given:
            own = [variable for variable, joint in self.known if not joint]
            known("variable or constant of the formula", name, [*own, *self.given])
        if name in FUNCTIONS:
            raise BadArgument(f"{name} in the formula {self.said} is a function: {name}(...).")
        self.constants.setdefault(name)
        return ("constant", name)

    def _variable(self, name: str, joint: str) -> Node:
        """A variable of the own joint or of another."""
        shown = [f"{own}.{other}" if other else own for own, other in self.known]
        known("variable", f"{name}.{joint}" if joint else name, shown)
        self.variables.append((name, joint))
        return ("variable", name, joint)


def _of_joint(tree: ast.AST) -> tuple[str, str] | None:
    """The name and the joint of a part such as v.elbow or v["left elbow"]."""
    if isinstance(tree, ast.Attribute) and isinstance(tree.value, ast.Name):
        return tree.value.id, tree.attr
    if (
        isinstance(tree, ast.Subscript)
        and isinstance(tree.value, ast.Name)
        and isinstance(tree.slice, ast.Constant)
        and isinstance(tree.slice.value, str)
    ):
        return tree.value.id, tree.slice.value
    return None


STRENGTH = {"+": 1, "-": 1, "*": 2, "/": 2, "**": 4}


def write_formula(root: Node) -> str:
    """Write a formula as text that `read_formula` reads as the same tree.

    Parameters
    ----------
    root : Node
        The tree of the formula.

    Returns
    -------
    str
        With brackets where the order of operations needs them.
    """
    return _write(root)[0]


def _write(node: Node) -> tuple[str, int]:
    """A part as text, and how strongly it holds together."""
    kind = node[0]
    if kind == "number":
        return f"{node[1]:.12g}", 5
    if kind == "constant":
        return node[1], 5
    if kind == "variable":
        name, joint = node[1:]
        if not joint:
            return name, 5
        return (f"{name}.{joint}" if joint.isidentifier() else f'{name}["{joint}"]'), 5
    parts = [_write(one) for one in node[2]]
    name = "sign" if node[1] == "direction" else node[1]
    if name == "-" and len(parts) == 1:
        return f"-{_within(parts[0], 3)}", 3
    if name in STRENGTH:
        strength = STRENGTH[name]
        left = _within(parts[0], strength + (name == "**"))
        right = _within(parts[1], strength + (name != "**"))
        between = "**" if name == "**" else f" {name} "
        return f"{left}{between}{right}", strength
    return f"{name}({', '.join(text for text, _ in parts)})", 5


def _within(part: tuple[str, int], strength: int) -> str:
    """A part, in brackets where it holds together less than what is around it."""
    return part[0] if part[1] >= strength else f"({part[0]})"


def _is_scale(node: Node, name: str) -> bool:
    """Whether a constant is by what something is divided, a width, a time or a distance."""
    if node[0] not in ("call", "hidden"):
        return False
    if node[1] in ("/", "dead", "lag", "dahl") and _has(node[2][-1], name):
        return True
    return any(_is_scale(one, name) for one in node[2])


def _has(node: Node, name: str) -> bool:
    """Whether a constant is in a part."""
    if node[0] == "constant":
        return bool(node[1] == name)
    return node[0] in ("call", "hidden") and any(_has(one, name) for one in node[2])


def exponents(unit: str) -> Array:
    """Read a unit as exponents of the base units.

    Parameters
    ----------
    unit : str
        Such as "N m s^2/rad^2"; "1" or empty for a pure number.

    Returns
    -------
    (5,) array
        The exponents of `BASES`.
    """
    found = np.zeros(len(BASES))
    over, _, under = unit.partition("/")
    for text, sign in ((over, 1.0), (under.replace("/", " "), -1.0)):
        for part in text.split():
            name, _, power = part.partition("^")
            if name != "1":
                found[BASES.index(name)] += sign * float(power or 1)
    return found


def unit_text(powers: Array) -> str:
    """Write a unit.

    Parameters
    ----------
    powers : (5,) array
        The exponents of `BASES`.

    Returns
    -------
    str
        As `exponents` reads it; "1" for a pure number.
    """
    over = [_power(name, power) for name, power in zip(BASES, powers, strict=True) if power > 0]
    under = [_power(name, -power) for name, power in zip(BASES, powers, strict=True) if power < 0]
    return (" ".join(over) or "1") + ("/" + " ".join(under) if under else "")


def _power(name: str, power: float) -> str:
    """Such as rad^2."""
    return name if power == 1 else f"{name}^{Fraction(power).limit_denominator(12)}"


@dataclass(eq=False)
class _UnitEquations:
    """What units of constants must be: rows (known exponents, multiples of the constants')."""

    names: tuple[str, ...]
    variables: Units
    rows: list[tuple[Array, Array]]

    def of(self, node: Node) -> tuple[Array, Array]:
        """The unit of a part: known exponents (5,), and multiples (q,) of the constants' units."""
        none = np.zeros(len(self.names))
        kind = node[0]
        if kind == "number":
            return np.zeros(len(BASES)), none
        if kind == "constant":
            return np.zeros(len(BASES)), np.eye(len(self.names))[self.names.index(node[1])]
        if kind == "variable":
            return exponents(self.variables[node[1], node[2]]), none
        inside = [self.of(one) for one in node[2]]
        name = node[1]
        if name in ("*", "/"):
            sign = 1 if name == "*" else -1
            (one, multiples), (two, others) = inside
            return one + sign * two, multiples + sign * others
        if name == "**":
            return self._power(node[2], inside)
        if name == "sqrt":
            return inside[0][0] / 2, inside[0][1] / 2
        if name in ("direction", "sign"):
            return np.zeros(len(BASES)), none
        if name in ("tanh", "exp", "sin", "cos"):
            self.rows.append(inside[0])
            return np.zeros(len(BASES)), none
        if name == "lag":
            self._equal(inside[1], (exponents("s"), none))
            return inside[0]
        if name == "dahl":
            self._equal(inside[0], (exponents(self.variables["q", ""]), none))
            return np.zeros(len(BASES)), none
        numbers = [one[0] == "number" for one in node[2]]
        if len(inside) == 2 and not any(numbers):
            self._equal(inside[0], inside[1])
        # A number among units takes theirs.
        return inside[numbers.index(False)] if False in numbers else inside[0]

    def _power(
        self, parts: Sequence[Node], inside: Sequence[tuple[Array, Array]]
    ) -> tuple[Array, Array]:
        """The unit of a power."""
        exponent = parts[1]
        if exponent[0] == "call" and exponent[1] == "-" and exponent[2][0][0] == "number":
            exponent = ("number", -exponent[2][0][1])
        if exponent[0] == "number":
            return inside[0][0] * exponent[1], inside[0][1] * exponent[1]
        self.rows += [inside[0], inside[1]]
        return np.zeros(len(BASES)), np.zeros(len(self.names))

    def _equal(self, one: tuple[Array, Array], two: tuple[Array, Array]) -> None:
        """Two parts have the same unit."""
        self.rows.append((one[0] - two[0], one[1] - two[1]))


def _constant_units(
    text: str, root: Node, names: tuple[str, ...], variables: Units, unit: str
) -> tuple[str, ...]:
    """The unit of each constant, so that every sum and the value have one unit."""
    said = _shown(text)
    equations = _UnitEquations(names, variables, [])
    whole, multiples = equations.of(root)
    equations.rows.append((whole - exponents(unit), multiples))
    given = np.stack([row[0] for row in equations.rows])
    matrix = np.stack([row[1] for row in equations.rows])
    if np.linalg.matrix_rank(matrix) < len(names):
        raise BadArgument(
            f"The constants {_shown(', '.join(names))} of the formula {said} cannot be told apart: "
            "write one in place of their product."
        )
    solved = np.linalg.lstsq(matrix, -given, rcond=None)[0]
    left = np.abs(matrix @ solved + given)
    left[:, BASES.index("rad")] = 0.0  # an angle may stand for a number
    if left.max() > 1e-6:
        raise BadArgument(
            f"The units of the formula {said} do not go together: its value must be in {unit}."
        )
    return tuple(unit_text(np.round(row * 12) / 12) for row in solved)
