"""Schemas of files in pydantic, whose types say what they expect; faults become `BadFile`."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, NoReturn, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    Tag,
    ValidationError,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from dropo.core.services.errors import BadFile
from dropo.core.services.files.file_content import FileContent, describe_options, describe_value
from dropo.core.services.files.saved_files import read_json
from dropo.core.services.files.strict_yaml import read_yaml

DIALECT = "https://json-schema.org/draft/2020-12/schema"
"""The kind of JSON Schema that `json_schema` writes."""
LARGEST = 2**53
"""The largest whole number in a file; every whole number up to it is a float64 too."""
DESCRIBED = "described"
"""The type of pydantic errors that already say what was expected."""


class Expected:
    """Says in an `Annotated` type what an entry expects, for messages.

    A fault deeper inside that has its own description keeps it.

    Parameters
    ----------
    text
        The end of "expected ...".
    """

    def __init__(self, text: str):
        self.text = text

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_wrap_validator_function(self._check, handler(source))

    def _check(self, value: Any, validate: core_schema.ValidatorFunctionWrapHandler) -> Any:
        """The validated value, or this description of what it should be."""
        try:
            return validate(value)
        except ValidationError as error:
            if all(fault["type"] == DESCRIBED for fault in error.errors(include_url=False)):
                raise
            refuse(self.describe(value))

    def describe(self, value: object) -> str:
        """Say what had to stand there: the end of "expected ...".

        Parameters
        ----------
        value : object
            The value that is refused.

        Returns
        -------
        str
            The text of this description; subclasses may suggest what is near the value.
        """
        return self.text


class ExpectedName(Expected):
    """Says what an entry of a `Literal` type expects; the message gives the nearest name.

    Parameters
    ----------
    text
        What the names stand for.
    """

    def __init__(self, text: str):
        super().__init__(text)
        self.names: tuple[str, ...] = ()

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        self.names = get_args(source)
        return super().__get_pydantic_core_schema__(source, handler)

    def describe(self, value: object) -> str:
        """The end of "expected ...", with the nearest name."""
        return describe_options(self.text, value, self.names)


def refuse(expected: str, *, key: str = "", got: str | None = None) -> NoReturn:
    """Refuse an entry, inside a validator of a schema.

    Parameters
    ----------
    expected
        What had to stand there.
    key
        A key below the entry, where the fault is one of that key.
    got
        What stands there; by default the value that is being validated.

    Raises
    ------
    PydanticCustomError
        Always.
    """
    context = {"expected": expected, "key": key, "got": got}
    raise PydanticCustomError(DESCRIBED, "{expected}", context)


class Entry(BaseModel):
    """A mapping in a file whose keys are all known; null only where `nullable` names the key."""

    model_config = ConfigDict(
        strict=True,
        extra="forbid",
        frozen=True,
        use_attribute_docstrings=True,
        validate_by_name=True,
        validate_by_alias=True,
    )
    nullable: ClassVar[frozenset[str]] = frozenset()

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, content: Any) -> Any:
        """Refuse keys that are unknown, missing, or null."""
        if not isinstance(content, dict):
            return content
        fields = {field.alias or name: field for name, field in cls.model_fields.items()}
        for key, value in content.items():
            if not isinstance(key, str):
                refuse("a word as a key", key=str(key), got=f"{describe_value(key)} (quote it)")
            if key not in fields:
                expected = describe_options("a known key", key, fields)
                refuse(expected, key=key, got=describe_value(key))
            if value is None and key not in cls.nullable:
                refuse(_expectation(fields[key]), key=key, got=describe_value(None))
        for key, field in fields.items():
            if field.is_required() and key not in content:
                refuse(_expectation(field), key=key, got=describe_value(None))
        return content


class Saved(BaseModel):
    """An object in a file that a run wrote; other keys may stand beside those that are known."""

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True, allow_inf_nan=False)


def _expectation(field: FieldInfo) -> str:
    """What a field expects, which may stand inside `... | None`."""
    metadata = [*field.metadata]
    for inside in get_args(field.annotation)[:1]:
        metadata.extend(getattr(inside, "__metadata__", ()))
    found = [item.describe(None) for item in metadata if isinstance(item, Expected)]
    return found[-1]


# Types that several files use

SINGLE = Tag("<single>")
LIST = Tag("<list>")
MAPPING = Tag("<mapping>")


def _shape_of(value: object) -> str:
    """Which of the three tags an entry's value has."""
    if isinstance(value, dict | BaseModel):
        return MAPPING.tag
    return LIST.tag if isinstance(value, list) else SINGLE.tag


BY_SHAPE = Discriminator(_shape_of)
"""Marks a union whose members are tagged SINGLE, LIST and MAPPING."""
Finite = Annotated[float, Field(allow_inf_nan=False)]
Number = Annotated[Finite, Expected("a number")]
Positive = Annotated[Finite, Field(gt=0), Expected("a number above 0")]
NonNegative = Annotated[Finite, Field(ge=0), Expected("a number, 0 or more")]


def _check_size(number: int) -> int:
    """The whole number, where a program can count as far."""
    if abs(number) > LARGEST:
        refuse(f"a whole number of at most {LARGEST}")
    return number


Whole = Annotated[int, AfterValidator(_check_size)]
Count = Annotated[
    int, Field(ge=1), AfterValidator(_check_size), Expected("a whole number of at least 1")
]
Place = Annotated[
    int, Field(ge=0), AfterValidator(_check_size), Expected("a whole number of at least 0")
]
Word = Annotated[str, Field(min_length=1)]
Key = Annotated[str, Expected("a word as a key")]


# Reading

Checked = TypeVar("Checked", bound=Entry)


def read_file(path: Path, schema: type[Checked], what: str) -> FileContent[Checked]:
    """Read a YAML file by its schema.

    Parameters
    ----------
    path
        The file.
    schema
        The class that its content must fit.
    what
        The kind of file, for messages, such as "a problem file".

    Returns
    -------
    FileContent
        The file with its content as an object of `schema`.

    Raises
    ------
    BadFile
        If the file cannot be read or does not fit, for the first fault in the file's order, with
        its key, what was expected, what was got and the nearest valid name.
    """
    return validated(path, read_yaml(path, what), schema)


def validated(path: Path, content: dict[Any, Any], schema: type[Checked]) -> FileContent[Checked]:
    """Check the content of a YAML file by its schema.

    Parameters
    ----------
    path
        The file, for messages.
    content
        What stands in it.
    schema
        The class that it must fit.

    Returns
    -------
    FileContent
        The file with its content as an object of `schema`.

    Raises
    ------
    BadFile
        If it does not fit, as of `read_file`.
    """
    try:
        return FileContent(path, schema.model_validate(content))
    except ValidationError as error:
        raise _first_refusal(path, content, error) from None


def read_saved(path: Path, schema: type[Saved], what: str) -> dict[str, Any]:
    """Read a JSON file that a run wrote, and check it by its schema.

    Parameters
    ----------
    path
        The file.
    schema
        The class that its content must fit.
    what
        What it should be, for messages, such as "a fit written by `dropo fit --out`".

    Returns
    -------
    dict
        Its content as it stands there.

    Raises
    ------
    BadFile
        If there is no such file, it is of a newer version, or it does not fit, for the first
        fault in the file's order.
    """
    content = read_json(path, what)
    check_content(path, content, schema)
    return content


def check_content(path: Path, content: dict[str, Any], schema: type[Saved]) -> None:
    """Check the content of a JSON file by its schema, as `read_saved` does.

    Parameters
    ----------
    path
        The file.
    content
        What stands in it.
    schema
        The class that it must fit.

    Raises
    ------
    BadFile
        If it does not fit.
    """
    try:
        schema.model_validate_json(json.dumps(content), strict=True)
    except ValidationError as error:
        raise _first_refusal(path, content, error) from None


def _first_refusal(path: Path, content: dict[Any, Any], error: ValidationError) -> BadFile:
    """The fault that comes first in the file, in the project's words."""
    faults = error.errors(include_url=False)
    first = min(faults, key=lambda fault: _position(content, fault["loc"]))
    details = first.get("ctx", {})
    key = "".join(_dotted(content, first["loc"])).removeprefix(".")
    if details.get("key"):
        key = f"{key}.{details['key']}".removeprefix(".")
    got = details.get("got") or describe_value(first["input"])
    if first["loc"][-1:] == ("[key]",):
        got = f"{got} (quote it)"
    expected = details.get("expected") or first["msg"].removeprefix("Input should be ")
    if first["type"] == "missing":
        expected = "what a run writes"
        got = describe_value(None)
    return BadFile(path, key, expected, got)


def _steps(content: Any, location: tuple[int | str, ...]) -> Iterator[tuple[Any, int | str]]:
    """The containers on the way to a fault, each with the key or index in it; tags are left out."""
    for part in location:
        if isinstance(content, list) and isinstance(part, int):
            yield content, part
            content = content[part] if part < len(content) else None
        elif isinstance(content, dict) and not str(part).startswith("<") and part != "[key]":
            yield content, part
            content = content.get(part)


def _position(content: dict[Any, Any], location: tuple[int | str, ...]) -> list[int]:
    """Where a fault stands in the file: its place in every container on the way."""
    places = []
    for container, part in _steps(content, location):
        keys = range(len(container)) if isinstance(container, list) else list(container)
        places.append(keys.index(part) if part in keys else len(keys))  # type: ignore[arg-type]
    return places


def _dotted(content: dict[Any, Any], location: tuple[int | str, ...]) -> Iterator[str]:
    """The pieces of a key as messages show it, such as ".effects", "[0]", ".fit"."""
    for container, part in _steps(content, location):
        yield f"[{part}]" if isinstance(container, list) else f".{part}"


# JSON Schema


class _EditorSchema(GenerateJsonSchema):
    """Without titles made of names, and without null for what may be left out."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        default = schema.get("default")
        if default is None or isinstance(default, BaseModel):
            return self.generate_inner(schema["schema"])
        return super().default_schema(schema)


def json_schema(schema: type[Entry]) -> dict[str, Any]:
    """Describe a kind of file as JSON Schema, for editors.

    Parameters
    ----------
    schema
        The class that the content of such a file fits.

    Returns
    -------
    dict
        The JSON Schema, of draft 2020-12.
    """
    content = schema.model_json_schema(by_alias=True, schema_generator=_EditorSchema)
    return {"$schema": DIALECT, **content}
