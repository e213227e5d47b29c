"""The columns of a log by what their names say, their numbers, and which of them are used."""

from collections.abc import Sequence

import numpy as np

from dropo.core.services.errors import BadFile
from dropo.core.services.validation import Array
from dropo.logs.guessing.files_beside import FileBeside
from dropo.logs.guessing.words import ColumnName, read_names
from dropo.logs.readers.reader import Log


class LogColumns:
    """The columns of a log, each read once.

    Parameters
    ----------
    log : Log
        The log.
    names : sequence of str
        Joints and actuators, whose words keep their meaning in names of columns.

    Attributes
    ----------
    log : Log
        The log.
    all : list of ColumnName
        All columns of all topics.
    beside : list of ColumnName
        Columns of files beside the log.
    used : set of ColumnName
        Those that are used already.
    """

    def __init__(self, log: Log, names: Sequence[str]):
        self.log = log
        self.all = read_names(log, names)
        self.beside: list[ColumnName] = []
        self.used: set[ColumnName] = set()
        self._files: dict[str, FileBeside] = {}
        self._values: dict[ColumnName, Array] = {}
        self._rows: dict[tuple[str | None, str | None], int] = {}

    def add_files(self, files: Sequence[FileBeside]) -> None:
        """Take in the columns of files beside the log.

        Parameters
        ----------
        files : sequence of FileBeside
            As they were found.
        """
        for one in files:
            self._files[one.name] = one
            self.beside += one.columns

    def file_of(self, column: ColumnName) -> FileBeside | None:
        """Find the file that a column stands in.

        Parameters
        ----------
        column : ColumnName
            The column.

        Returns
        -------
        FileBeside or None
            None where it stands in the log.
        """
        return None if column.file is None else self._files[column.file]

    def of(self, quantity: str | None) -> list[ColumnName]:
        """List the columns of a quantity that are not used yet.

        Parameters
        ----------
        quantity : str or None
            What names say, as of `dropo.logs.guessing.words`; None for columns whose names say
            none.

        Returns
        -------
        list of ColumnName
            In the log's order.
        """
        return [one for one in self.all if one.quantity == quantity and one not in self.used]

    def read(self, columns: Sequence[ColumnName]) -> list[Array]:
        """Read the numbers of columns.

        Parameters
        ----------
        columns : sequence of ColumnName
            Of any topics.

        Returns
        -------
        list of (n,) array
            As they were logged, NaN where a row has none; all NaN of a column that holds texts.
        """
        wanted: dict[tuple[str | None, str | None], list[ColumnName]] = {}
        for column in columns:
            if column not in self._values:
                wanted.setdefault((column.file, column.topic), []).append(column)
        for (file, topic), of_source in wanted.items():
            log = self.log if file is None else self._files[file].log
            found = self._read_table(log, topic, [column.column for column in of_source])
            for column in of_source:
                values = self._values[column] = found[column.column]
                self._rows[file, topic] = max(self._rows.get((file, topic), 0), len(values))
        return [self._whole(column) for column in columns]

    def _whole(self, column: ColumnName) -> Array:
        """The numbers of a column that was read; NaN in the rows of its table where it has none."""
        values = self._values[column]
        missing = self._rows[column.file, column.topic] - len(values)
        return np.append(values, np.full(missing, np.nan)) if missing else values

    def _read_table(self, log: Log, topic: str | None, names: list[str]) -> dict[str, Array]:
        """Columns of a table as numbers; one that holds texts, too, has none."""
        try:
            found = log.read(topic, names, lambda fraction, text: None)
        except BadFile:
            if len(names) == 1:
                return {names[0]: np.full(1, np.nan)}
            return {name: self._read_table(log, topic, [name])[name] for name in names}
        out = {}
        for name, values in found.items():
            is_number = values.dtype.kind in "biuf"
            out[name] = values.astype(float) if is_number else np.full(len(values), np.nan)
        return out

    def finite(self, column: ColumnName) -> Array:
        """Read the numbers of a column, without rows that have none.

        Parameters
        ----------
        column : ColumnName
            The column.

        Returns
        -------
        (m,) array
            As they were logged.
        """
        values = self.read([column])[0]
        return values[np.isfinite(values)]

    def numeric(self, columns: Sequence[ColumnName]) -> list[ColumnName]:
        """Find the columns that hold numbers.

        Parameters
        ----------
        columns : sequence of ColumnName
            Of any topics.

        Returns
        -------
        list of ColumnName
            Those with at least two numbers.
        """
        self.read(columns)  # all at once
        return [column for column in columns if len(self.finite(column)) > 1]

    def numeric_of(self, quantity: str | None) -> list[ColumnName]:
        """Find the columns of a quantity that hold numbers and are not used yet.

        Parameters
        ----------
        quantity : str or None
            As of `of`.

        Returns
        -------
        list of ColumnName
        """
        return self.numeric(self.of(quantity))
