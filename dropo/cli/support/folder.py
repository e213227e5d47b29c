"""The folder of a run: tried before anything is computed, locked, and refused where it is another
run's.
"""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from dropo.core.services.errors import BadFile, DropoError, Incompatible, InvalidInput

RECORD = "run.json"
"""What the run is."""
RESULTS = ("fit.json", "diagnosis.json", "policy.json")
"""Files by which a folder holds a result."""


class RunFolder:
    """A folder that belongs to one run, or none.

    Parameters
    ----------
    path : Path or None
        The folder; None where nothing is written.
    """

    def __init__(self, path: Path | None):
        self.path = path
        self._new: list[Path] = []

    def claim(self, record: dict[str, Any]) -> None:
        """Take the folder for a run, or go on with it.

        Parameters
        ----------
        record : dict
            Everything that decides the run's result.

        Raises
        ------
        BadFile
            If the folder holds another run, or a result without a record of its run.
        """
        from dropo.core.services.files.atomic_write import write_json
        from dropo.core.services.files.journal import require_same
        from dropo.core.services.files.saved_files import read_json

        if self.path is None:
            return
        kept = self.path / RECORD
        if kept.is_file():
            require_same(kept, record, read_json(kept, "what a run of dropo decided"))
            return
        for name in RESULTS:
            if (self.path / name).exists():
                expected = "a folder of this run or a new one"
                raise BadFile(self.path, "--out", expected, f"one with {name} of another")
        self.file(RECORD)
        write_json(kept, record)

    def file(self, name: str) -> Path | None:
        """Give the path of a file that the run writes while it computes.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        Path or None
            None without a folder.
        """
        if self.path is None:
            return None
        path = self.path / name
        if not path.exists():
            self._new.append(path)
        return path

    @contextmanager
    def going_on_from(self, name: str) -> Iterator[None]:
        """Say of an interruption inside the block that the same command goes on from a file.

        Parameters
        ----------
        name : str
            Of the file to which the run adds what it has finished.

        Raises
        ------
        DropoError
            In place of `KeyboardInterrupt`, where there is such a file.
        """
        try:
            yield
        except KeyboardInterrupt:
            if self.path is None or not (self.path / name).exists():
                raise
            kept = "Interrupted before there was a result: the same command goes on from here."
            raise DropoError(kept) from None

    def clear(self) -> None:
        """Remove what a refused run has begun to write."""
        for path in self._new:
            path.unlink(missing_ok=True)


@contextmanager
def run_folder(path: Path | None) -> Iterator[RunFolder]:
    """Lock a folder for a run, which shows that it can be written.

    Parameters
    ----------
    path : Path or None
        The folder, made where it is missing; None where nothing is written.

    Yields
    ------
    RunFolder
        What the run may do with it. Where the run is refused, nothing of it is left.

    Raises
    ------
    BadFile
        If the path is no folder.
    Incompatible
        If another run lives in it.
    OSError
        If it cannot be written.
    """
    folder = RunFolder(path)
    if path is None:
        yield folder
        return
    if path.exists() and not path.is_dir():
        raise BadFile(path, "--out", "a folder", "a file")
    missing = [place for place in (path, *path.parents) if not place.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        with _locked(path):
            try:
                yield folder
            except InvalidInput:
                folder.clear()
                raise
    finally:
        for place in missing:
            if place.is_dir() and not any(place.iterdir()):
                place.rmdir()


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """A lock on a folder, which ends with the block or with the process."""
    from dropo.core.services.files.progress_file import LOCK

    path = folder / LOCK
    with path.open("a+", encoding="utf-8") as file:
        if not _lock(file):
            file.seek(0)
            other = file.read(200).strip() or "whose process is unknown"
            raise Incompatible(
                f"{folder}: another dropo, {other}, is at work here. Wait for it, or use another "
                "--out."
            )
        try:
            file.truncate(0)
            file.write(f"process {os.getpid()} on {socket.gethostname()}")
            file.flush()
            yield
        finally:
            path.unlink(missing_ok=True)


def _lock(file: IO[str]) -> bool:
    """Whether the file could be locked; True also where the system knows no locks."""
    try:
        import fcntl
    except ImportError:  # Windows
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return os.fstat(file.fileno()).st_nlink > 0
