"""Tables of columns: CSV and Parquet, read in blocks."""

import csv
import itertools
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.errors import BadFile
from dropo.logs.readers.reader import (
    Arrays,
    Log,
    Progress,
    expand_columns,
    join_blocks,
    package,
)

BLOCK = 1 << 16
"""Rows that are held as text or as Python objects at a time."""
MAGIC = b"PAR1"
"""With what a Parquet file begins and ends."""
NO_VALUE = ("", "nan", "null", "none", "na")
"""Cells that hold no number, in lower case."""


class CsvLog(Log):
    """Text with a row of names, then a line for each row, separated by , ; tabs or blanks.

    An empty cell, "nan" or "null" is no value. Where no comma separates, numbers may have one in
    the place of their point. Cells may be dates as ISO 8601 writes them, or lists
    such as "[0.1, 0.2]", whose columns are "name[0]", "name[1]"; other texts only tell runs apart.
    """

    @cached_property
    def _header(self) -> tuple[list[str], str]:
        """Names and separator; a leading "#" belongs to neither."""
        with self.path.open("rb") as file:
            line = file.readline()
        try:
            text = line.decode("utf-8-sig").strip().lstrip("#").strip()
        except UnicodeDecodeError as error:
            raise self.broken("a table of text", f"byte {error.start}", "no text") from None
        separator = max(",;\t", key=text.count)
        separator = separator if separator in text else " "
        cells = next(csv.reader([text], delimiter=separator, skipinitialspace=True))
        names = [name.strip() for name in cells]
        if names and all(_number(name) is not None for name in names):
            raise BadFile(self.path, "line 1", "the names of the columns", "numbers")
        twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
        if twice is not None:
            raise BadFile(self.path, "line 1", "every column's name once", f"{twice!r} twice")
        return names, separator

    @cached_property
    def _places(self) -> dict[str, tuple[int, int | None]]:
        """By the name of a column its place in a line, and in the list there, by the first row."""
        names, separator = self._header
        first: list[str] = []
        with self.path.open("rb") as file:
            file.readline()
            rows = csv.reader(self._lines(file), delimiter=separator, skipinitialspace=True)
            first = next((row for row in rows if row), [])
        if not first:
            raise BadFile(self.path, "line 2", "rows below the names", "none")
        places: dict[str, tuple[int, int | None]] = {}
        for i, name in enumerate(names):
            cell = first[i] if i < len(first) else ""
            if cell.strip().startswith("["):
                count = len(_elements(cell))
                places |= {f"{name}[{k}]": (i, k) for k in range(count)}
            else:
                places[name] = (i, None)
        return places

    def columns(self, topic: str | None) -> list[str]:
        """List the names of the columns."""
        return list(self._places)

    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        """Read columns by name."""
        with self.path.open("rb") as file:
            return join_blocks(self._blocks(file, columns, progress), columns)

    def _blocks(
        self, file: IO[bytes], columns: Sequence[str], progress: Progress
    ) -> Iterator[Arrays]:
        """The columns, some rows at a time."""
        names, separator = self._header
        places = [self._places[name] for name in columns]
        size = self.path.stat().st_size
        line = 2
        file.readline()
        rows = csv.reader(self._lines(file), delimiter=separator, skipinitialspace=True)
        while block := list(itertools.islice(rows, BLOCK)):
            for i, row in enumerate(block):
                if row and len(row) != len(names):
                    got = f"{len(row)} cells for {len(names)} columns"
                    raise self.broken("as many cells in every line", f"line {line + i}", got)
            filled = [row for row in block if row]
            arrays = {}
            for name, (place, element) in zip(columns, places, strict=True):
                cells = [row[place] for row in filled]
                if element is not None:
                    cells = self._take(cells, name, block, line, place, element)
                arrays[name] = self._parse_column(cells, name, block, line, place)
            yield arrays
            line += len(block)
            progress(file.tell() / size, f"reading {self.path.name}")

    def _take(
        self,
        cells: list[str],
        name: str,
        block: list[list[str]],
        line: int,
        place: int,
        element: int,
    ) -> list[str]:
        """An element of the list in every cell; a shorter list is refused with its line."""
        for i, row in enumerate(block):
            if row and 0 < len(_elements(row[place])) <= element:
                where = f"line {line + i}, column {name!r}"
                raise BadFile(self.path, where, "a list as long as the first", repr(row[place]))
        lists = [_elements(cell) for cell in cells]
        return [one[element] if one else "" for one in lists]

    def _lines(self, file: IO[bytes]) -> Iterator[str]:
        """The lines of text."""
        for raw in file:
            try:
                yield raw.decode().rstrip(" \r\n") if raw.strip() else "\n"
            except UnicodeDecodeError as error:
                byte = file.tell() - len(raw) + error.start
                raise self.broken("a table of text", f"byte {byte}", "no text") from None

    def _parse_column(
        self, cells: list[str], name: str, block: list[list[str]], line: int, place: int
    ) -> NDArray[Any]:
        """Numbers, else dates, else texts; a text among numbers is refused with its line."""
        try:
            return np.array([cell if cell else "nan" for cell in cells], dtype=float)
        except ValueError:
            pass
        has_commas = self._header[1] != ","
        numbers = [_number(cell, has_commas) for cell in cells]
        if all(number is not None for number in numbers):
            return np.array(numbers, dtype=float)
        if any(number is not None for number in numbers):
            for i, row in enumerate(block):
                if row and _number(row[place], has_commas) is None:
                    where = f"line {line + i}, column {name!r}"
                    raise BadFile(self.path, where, "a number", repr(row[place]))
        try:
            return np.array([cell.rstrip("Z") for cell in cells], dtype="datetime64[ns]")
        except ValueError:
            return np.array(cells)


def _elements(cell: str) -> list[str]:
    """The elements of a list in a cell, as texts."""
    inside = cell.strip().removeprefix("[").removesuffix("]").strip()
    return [part.strip() for part in inside.replace(",", " ").split()]


def _number(cell: str, has_commas: bool = False) -> float | None:
    """The number in a cell, NaN where it holds none, None where it holds another text.

    has_commas: whether a single comma may stand for the point.
    """
    text = cell.strip()
    if has_commas and text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    if text.lower() in NO_VALUE:
        return float("nan")
    try:
        return float(text)
    except ValueError:
        return None


class ParquetLog(Log):
    """A Parquet file, read one group of rows at a time; needs pyarrow.

    Columns of lists of fixed length are expanded.
    """

    expected = "a Parquet file"

    @cached_property
    def _file(self) -> Any:
        """The open file, found whole."""
        parquet = package("pyarrow.parquet", self.path, "logs")
        with self.path.open("rb") as file:
            first = file.read(4)
            size = file.seek(0, 2)
            file.seek(max(0, size - 4))
            last = file.read(4)
        if first != MAGIC:
            expected = f"{self.expected}, which begins with {MAGIC!r}"
            raise BadFile(self.path, "byte 0", expected, repr(first))
        if last != MAGIC:
            reason = "it ends before the table of its contents"
            raise self.broken(self.expected, f"byte {size}", reason)
        try:
            return parquet.ParquetFile(self.path)
        except (OSError, ValueError) as error:
            raise self.broken(self.expected, f"byte {size}", error) from None

    def columns(self, topic: str | None) -> list[str]:
        """List the names of the columns."""
        if self._file.metadata.num_row_groups:
            first = next(self._batches(0, size=1), None)
            if first is not None:
                return list(first)
        return [field.name for field in self._file.schema_arrow]

    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        """Read columns by name."""
        own = [field.name for field in self._file.schema_arrow]
        needed = [name if name in own else name.rsplit("[", 1)[0] for name in columns]
        return join_blocks(self._groups(list(dict.fromkeys(needed)), progress), columns)

    def _groups(self, names: list[str], progress: Progress) -> Iterator[Arrays]:
        """The columns, one group of rows after the other."""
        groups = self._file.metadata.num_row_groups
        for group in range(groups):
            yield from self._batches(group, names)
            progress((group + 1) / groups, f"reading {self.path.name}")

    def _batches(
        self, group: int, names: list[str] | None = None, size: int = BLOCK
    ) -> Iterator[Arrays]:
        """The rows of a group, some at a time."""
        try:
            batches = self._file.iter_batches(batch_size=size, row_groups=[group], columns=names)
            for batch in batches:
                yield expand_columns(_arrays(batch))
        except (OSError, ValueError) as error:
            first = sum(self._file.metadata.row_group(i).num_rows for i in range(group))
            place = f"rows from {first} (row group {group})"
            raise self.broken(self.expected, place, error) from None


def _arrays(batch: Any) -> Arrays:
    """A batch's columns as arrays: lists of one length as (n, k), missing numbers as NaN."""
    out: Arrays = {}
    for name, column in zip(batch.schema.names, batch.columns, strict=True):
        values = column.to_numpy(zero_copy_only=False)
        if values.dtype == object and len(values) and isinstance(values[0], np.ndarray | list):
            values = np.array([np.asarray(row, dtype=float).reshape(-1) for row in values])
        out[name] = values.astype(str) if values.dtype == object else values
    return out
