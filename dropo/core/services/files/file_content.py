"""The content of a file that a user wrote, and refusals of it by key and nearest valid name."""

import difflib
import reprlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from dropo.core.services.errors import BadEntry, BadFile, InvalidInput

ALIKE = 0.5
"""Share of two names that must be the same for them to be near (Ratcliff and Obershelp)."""
BEGUN = 4
"""Letters from which on a name may be the beginning of another."""
LISTED = 12
"""Valid names that a message lists where none is near."""
SHOWN = 80
"""Characters of a value that a message shows."""

Content = TypeVar("Content", covariant=True)


@dataclass(frozen=True)
class FileContent(Generic[Content]):
    """The content of a file, checked by its schema, for checks that need more than the file.

    Attributes
    ----------
    path
        The file.
    content
        What stands in it.
    """

    path: Path
    content: Content

    def refusal(self, key: str, expected: str, got: str) -> BadFile:
        """Make the error for an entry.

        Parameters
        ----------
        key
            The entry's keys from the top of the file, joined by dots.
        expected, got
            What had to stand there, and what stands there.

        Returns
        -------
        BadFile
            To be raised by the caller.
        """
        return BadFile(self.path, key, expected, got)

    def require_known(self, key: str, value: object, valid: Iterable[str], what: str) -> str:
        """Return a name that must be among valid ones.

        Parameters
        ----------
        key
            As in `refusal`.
        value
            The name.
        valid
            The valid names.
        what
            What they name, such as "the name of a joint".

        Returns
        -------
        str
            The name itself.

        Raises
        ------
        BadFile
            If it is none of them; the message gives the nearest.
        """
        options = list(valid)
        if isinstance(value, str) and value in options:
            return value
        raise self.refusal(key, describe_options(what, value, options), describe_value(value))

    @contextmanager
    def at(self, key: str) -> Iterator[None]:
        """Refuse with this file and key whatever is refused inside.

        Parameters
        ----------
        key
            As in `refusal`.

        Raises
        ------
        BadEntry
            In place of any `InvalidInput`.
        """
        try:
            yield
        except InvalidInput as error:
            raise BadEntry(self.path, key, str(error)) from None


def describe_options(what: str, value: object, valid: Iterable[str]) -> str:
    """Describe which name was expected.

    Parameters
    ----------
    what
        What the names stand for.
    value
        The name that was got.
    valid
        The valid names.

    Returns
    -------
    str
        `what`, with the nearest valid name, or with all of them where none is near.
    """
    options = sorted(valid)
    if not options:
        return f"{what} (there is none)"
    alike = [_similarity(option, value) for option in options]
    if max(alike) >= ALIKE:
        return f"{what} (the nearest is {options[alike.index(max(alike))]!r})"
    rest = ", ..." if len(options) > LISTED else ""
    return f"{what} (there is {', '.join(options[:LISTED])}{rest})"


def describe_value(value: object) -> str:
    """Describe a value of a file for a message, in at most `SHOWN` characters.

    Parameters
    ----------
    value
        The value.

    Returns
    -------
    str
        As Python writes it; "nothing" for None, "a mapping" for a dictionary.
    """
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return "a mapping"
    try:
        text = _printer().repr(value)
    except ValueError:  # Python prints no whole number of more than 4300 digits
        return "a number of very many digits"
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."


def _similarity(option: str, value: object) -> float:
    """Share of two names that is the same; 0 for what is no name.

    A name that begins as another one, in `BEGUN` letters or more, is most of it.
    """
    if not isinstance(value, str):
        return 0.0
    if len(value) >= BEGUN and option.startswith(value):
        return 1.0
    return difflib.SequenceMatcher(None, option, value).ratio()


def _printer() -> reprlib.Repr:
    """A `repr` whose work is bounded: lists in a file may contain each other many times over."""
    printer = reprlib.Repr()
    printer.maxlevel = 4
    printer.maxlist = printer.maxtuple = printer.maxset = printer.maxdict = 20
    printer.maxstring = printer.maxlong = printer.maxother = 2 * SHOWN
    return printer
