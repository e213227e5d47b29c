"""What every reader of logs must keep to."""

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dropo.core.services.errors import BadFile
from dropo.logs.readers.reader import Arrays, Log

KINDS = "biufMU"  # numpy's kinds of numbers, dates and texts
STAMPS = "iufM"  # those of time stamps


def check_log_reader(reader: Callable[[Path], Log], path: str | Path) -> None:
    """Check that a reader of logs keeps to the contract, on a log that it can read.

    Parameters
    ----------
    reader : callable
        Makes the `Log` of a path: its class, or a function.
    path : str or Path
        A file or folder with at least two rows. It is not changed; a copy of a file is read, cut
        in half, too.

    Raises
    ------
    AssertionError
        If columns have no or two meanings, rows are not the same each time, the column of stamps or
        of runs is none of the columns, or a file that is cut in half raises anything but `BadFile`.
        The message says which rule is broken.
    """
    place = Path(path)
    log = reader(place)
    name = getattr(reader, "__name__", type(log).__name__)
    assert isinstance(log, Log), f"{name} makes {type(log).__name__}, which is no Log"
    for topic in log.topics() or [None]:
        _check_table(reader, place, topic, name)
    if place.is_file():
        with tempfile.TemporaryDirectory() as folder:
            _check_cut(reader, Path(folder), place, name)


def _check_table(reader: Callable[[Path], Log], place: Path, topic: str | None, name: str) -> None:
    """Checks the columns of one topic: all, in another order, and alone."""
    log = reader(place)
    columns = log.columns(topic)
    assert isinstance(columns, list), (
        f"{name}.columns gives {type(columns).__name__}, not a list of names"
    )
    assert columns, f"{name}.columns gives no names"
    assert len(set(columns)) == len(columns), f"{name}.columns gives a name twice: {columns}"
    stamps = log.stamps(topic)
    for what, column in (("stamps", stamps), ("runs", log.run_column)):
        assert column is None or column in columns, (
            f"{name} names the column of {what} {column!r}, which is none of its columns {columns}"
        )
    whole = _read(log, topic, columns, name)
    assert stamps is None or whole[stamps].dtype.kind in STAMPS, (
        f"the column of stamps {stamps!r} of {name} must be numbers, in s, or dates, not "
        f"{whole[stamps].dtype}"
    )
    again = _read(reader(place), topic, columns[::-1], name)
    for column in columns:
        alone = _read(log, topic, [column], name)[column]
        for other in (again[column], alone):
            same = np.array_equal(whole[column].astype(str), other.astype(str))
            assert same, f"{name} reads {column!r} differently a second time"


def _read(log: Log, topic: str | None, columns: list[str], name: str) -> Arrays:
    """Reads columns and checks names, shapes, types and the progress that is reported."""
    shares: list[float] = []
    found = log.read(topic, columns, lambda share, text: shares.append(share))
    assert isinstance(found, dict), (
        f"{name}.read gives {type(found).__name__}, not a dict of arrays"
    )
    assert set(found) == set(columns), f"{name}.read gives {sorted(found)}, not {sorted(columns)}"
    for column, array in found.items():
        assert isinstance(array, np.ndarray), (
            f"{name} reads {column!r} as {type(array).__name__}, not as a NumPy array"
        )
    shapes = {column: np.shape(array) for column, array in found.items()}
    rows = set(shapes.values())
    assert len(rows) == 1, f"{name}.read gives columns of several lengths: {shapes}"
    assert len(next(iter(rows))) == 1, f"{name}.read gives arrays of shape {rows}, not (n,)"
    assert next(iter(rows))[0] >= 2, f"{name}.read gives fewer than 2 rows"
    for column, array in found.items():
        kind = array.dtype.kind
        assert kind in KINDS, (
            f"{name} reads {column!r} as {array.dtype}, no numbers, dates or texts"
        )
    assert shares, f"{name}.read never reports its progress"
    assert shares == sorted(shares), f"{name}.read reports a progress that goes back: {shares}"
    assert shares[0] >= 0, f"{name}.read reports a progress of {shares[0]}, below 0"
    assert shares[-1] <= 1, f"{name}.read reports a progress of {shares[-1]}, above 1"
    return found


def _check_cut(reader: Callable[[Path], Log], folder: Path, place: Path, name: str) -> None:
    """Checks that a file that ends too early is refused as `BadFile`, or read as far as it goes."""
    copy = folder / place.name
    shutil.copyfile(place, copy)
    whole = copy.read_bytes()
    copy.write_bytes(whole[: len(whole) // 2])
    try:
        log = reader(copy)
        for topic in log.topics() or [None]:
            log.read(topic, log.columns(topic), lambda share, text: None)
    except BadFile:
        return
    except Exception as error:
        raise AssertionError(
            f"{name} meets a file that is cut in half with {type(error).__name__}: {error}; "
            "raise BadFile (`self.broken`), which names the file and the place"
        ) from error
