"""YAML files read strictly: every refusal names the file, the key, what was expected, what was got
and the nearest valid name.
"""

import difflib
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from dropo.core.services.errors import BadFile, InvalidInput

# share of two names that is the same (Ratcliff and Obershelp), from which one is near the other
ALIKE = 0.5


class BadEntry(BadFile):
    """An entry that another part refused: its sentence, behind the file and the key."""

    def __init__(self, path: object, key: str, sentence: str):
        InvalidInput.__init__(self, f"{path}: {key}: {sentence}")
        self.path = path
        self.key = key


class Entries:
    """One level of a YAML file, a mapping whose keys are all known."""

    def __init__(
        self,
        path: Path,
        content: Mapping[Any, Any],
        keys: Iterable[str] | None = None,
        prefix: str = "",
    ):
        self.path = path
        self.content = content
        self.prefix = prefix
        for key in content:
            if not isinstance(key, str):
                raise BadFile(
                    path, self.key(str(key)), "a word as a key", f"{shown(key)} (quote it)"
                )
            if keys is not None and key not in (valid := tuple(keys)):
                raise BadFile(path, self.key(key), named("a known key", key, valid), shown(key))

    def __contains__(self, key: str) -> bool:
        return key in self.content

    def key(self, name: str) -> str:
        """The key as messages name it, with those of the levels above."""
        return self.prefix + name

    def bad(self, name: str, expected: str, got: str | None = None) -> BadFile:
        """The refusal of an entry; without `got`, what was got is shown."""
        return BadFile(
            self.path,
            self.key(name),
            expected,
            shown(self.content.get(name)) if got is None else got,
        )

    @contextmanager
    def blaming(self, name: str) -> Iterator[None]:
        """Whatever is refused inside is refused with this file and key."""
        try:
            yield
        except InvalidInput as error:
            raise BadEntry(self.path, self.key(name), str(error)) from None

    def text(self, name: str, expected: str = "a text") -> str:
        """A text that must be there."""
        value = self.content.get(name)
        if not isinstance(value, str) or not value:
            raise self.bad(name, expected)
        return value

    def texts(self, name: str, default: tuple[str, ...], expected: str) -> tuple[str, ...]:
        """A list of texts, at least one."""
        value = self.content.get(name, list(default))
        if (
            not isinstance(value, list)
            or not value
            or not all(isinstance(item, str) and item for item in value)
        ):
            raise self.bad(name, expected)
        return tuple(value)

    def number(self, name: str) -> float:
        """A finite number that must be there."""
        return self._number(name, self.content.get(name))

    def _number(self, name: str, value: object, rule: str = "a number") -> float:
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not math.isfinite(value)
        ):
            raise self.bad(name, rule, shown(value))
        return float(value)

    def variance(self, name: str, value: object) -> float:
        """A number of at least 0."""
        number = self._number(name, value, "a variance, 0 or more")
        if number < 0:
            raise self.bad(name, "a variance, 0 or more", shown(value))
        return number

    def whole(self, name: str, least: int, default: int | None) -> int | None:
        """A whole number."""
        if name not in self:
            return default
        value = self.content[name]
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise self.bad(name, f"a whole number of at least {least}")
        return int(value)

    def choice(self, name: str, options: tuple[str, ...], what: str) -> str:
        """One of some words, the first by default."""
        value = self.content.get(name, options[0])
        return self.known(name, value, options, what)

    def known(self, name: str, value: object, valid: Iterable[str], what: str) -> str:
        """`value`, where it is among the valid names."""
        options = list(valid)
        if not isinstance(value, str) or value not in options:
            raise self.bad(name, named(what, value, options), shown(value))
        return value

    def level(
        self, name: str, keys: Iterable[str] | None = None, what: str = "a mapping"
    ) -> "Entries":
        """The mapping under a key; an empty one where the key is missing."""
        value = self.content.get(name, {})
        if not isinstance(value, Mapping):
            raise self.bad(name, what)
        return Entries(self.path, value, keys, f"{self.key(name)}.")


def named(what: str, value: object, valid: Iterable[str]) -> str:
    """What was expected, with the nearest valid name (the first of several), or with all of them
    where none is near.
    """
    options = sorted(valid)
    alike = [
        difflib.SequenceMatcher(None, option, value).ratio() if isinstance(value, str) else 0.0
        for option in options
    ]
    if max(alike, default=0.0) >= ALIKE:
        return f"{what} (the nearest is {options[alike.index(max(alike))]!r})"
    return (
        f"{what} (there is {', '.join(options[:12])}{', ...' if len(options) > 12 else ''})"
        if options
        else f"{what} (there is none)"
    )


def shown(value: object) -> str:
    """A value as messages show it."""
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return "a mapping"
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


class _Strict(yaml.SafeLoader):
    """YAML 1.2's numbers and booleans (1e-8 is a number, `on` a word), and no key twice."""


_OTHERS = ("tag:yaml.org,2002:bool", "tag:yaml.org,2002:float")
_Strict.yaml_implicit_resolvers = {
    first: [(tag, rule) for tag, rule in rules if tag not in _OTHERS]
    for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_FLOAT = re.compile(
    r"^(?:[-+]?(?:\d+\.\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?\d+[eE][-+]?\d+|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
)
_Strict.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+0123456789."))
_Strict.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)


def _mapping(loader: _Strict, node: yaml.MappingNode, deep: bool = True) -> dict[Any, Any]:
    seen: set[str] = set()
    for key, _ in node.value:
        name = str(key.value)
        if name in seen:
            raise yaml.constructor.ConstructorError(
                None, None, f"the key {name!r} twice", key.start_mark
            )
        seen.add(name)
    return loader.construct_mapping(node, deep=True)


_Strict.add_constructor("tag:yaml.org,2002:map", _mapping)


def read_yaml(path: Path, keys: Iterable[str], what: str) -> Entries:
    """A YAML file that is a mapping with known keys. what: the kind of file, for messages ("a
    problem file").
    """
    if not path.is_file():
        raise BadFile(path, "", what, "no such file")
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), _Strict)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise BadFile(path, f"line {mark.line + 1}" if mark else "", "YAML", problem) from None
    except (UnicodeDecodeError, OSError) as error:
        raise BadFile(path, "", what, f"a file that cannot be read as text ({error})") from None
    if not isinstance(content, Mapping):
        raise BadFile(
            path,
            "",
            f"{what}, a mapping of keys",
            "an empty file" if content is None else f"a {type(content).__name__}",
        )
    return Entries(path, content, keys)
