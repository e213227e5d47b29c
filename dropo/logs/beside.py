"""Files that stand beside a log: which one an entry means, and which of several logs are such.

A mapping names them once for all logs, as "{stem}_imu.csv" or "commands_{number}.csv".
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

STEM = "{stem}"
"""Stands for the log's name without its ending."""
NUMBER = "{number}"
"""Stands for the last number in the log's name."""
_DIGITS = re.compile(r"\d+")


def file_beside(log: Path, file: str) -> Path:
    """Find the file that an entry of a mapping means.

    Parameters
    ----------
    log : Path
        The log.
    file : str
        Its name, in which `STEM` and `NUMBER` stand for parts of the log's.

    Returns
    -------
    Path
        Beside the log, whether it is there or not.
    """
    name = file.replace(STEM, log.stem)
    digits = _DIGITS.findall(log.stem)
    return log.parent / (name.replace(NUMBER, digits[-1]) if digits else name)


def name_beside(log: Path, other: Path) -> str:
    """Name a file beside a log so that it fits the logs of other numbers, too.

    Parameters
    ----------
    log, other : Path
        The log, and the file in the same folder.

    Returns
    -------
    str
        A name from which `file_beside` finds the file.
    """
    if log.stem in other.name:
        return other.name.replace(log.stem, STEM)
    digits = _DIGITS.findall(log.stem)
    theirs = _DIGITS.findall(other.stem)
    if digits and theirs and digits[-1] == theirs[-1]:
        start = other.stem.rindex(digits[-1])
        end = start + len(digits[-1])
        return f"{other.stem[:start]}{NUMBER}{other.stem[end:]}{other.suffix}"
    return other.name


def logs_alone(logs: Sequence[str | Path], files: Iterable[str]) -> list[str | Path]:
    """Leave out the logs that stand beside another one and hold a part of it.

    Parameters
    ----------
    logs : sequence of str or Path
        As they were named.
    files : iterable of str
        The files that the mapping looks for beside each log.

    Returns
    -------
    list of str or Path
        Those that are recordings of their own.
    """
    named = list(files)
    parts = {file_beside(Path(log), file).resolve() for log in logs for file in named}
    return [log for log in logs if Path(log).resolve() not in parts]
