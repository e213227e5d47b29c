"""`dropo recover` in Python: runs a study by its name."""

import inspect
from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path

from dropo.core.contracts.estimator import Progress, silent
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import require
from dropo.studies.engine.pages import write
from dropo.studies.engine.study import Study
from dropo.studies.engine.work import Work

LACKS = {
    "published": "has no runs of the published method",
    "problems": "is not one of several problems",
}


def recover(
    name: str,
    *,
    seeds: int | None = None,
    published: bool = False,
    problems: Sequence[str] = (),
    out: str | Path | None = None,
    executor: Executor | None = None,
    threads: int = 0,
    progress: Progress = silent,
) -> Study:
    """Runs the study of that name; see `dropo list studies`.

    seeds: data sets or repetitions, None for the study's own number; published: also the method as
    published, in studies that have it; problems: these alone, in studies of several; out: a folder
    to write into, where an interrupted study goes on; executor: any concurrent.futures.Executor,
    threads where there is none. Results do not depend on either.
    """
    study = find("studies", name)
    require(seeds is None or seeds >= 1, "seeds", "at least 1", seeds, "recover")
    options = {
        option: value
        for option, value in {"published": published, "problems": tuple(problems)}.items()
        if value
    }
    for option in sorted(options.keys() - inspect.signature(study).parameters.keys()):
        raise Incompatible(f"The study {name!r} {LACKS[option]}. Leave --{option} out.")
    folder = None if out is None else Path(out)
    require(
        folder is None or folder.is_dir() or not folder.exists(),
        "out",
        "a folder",
        str(folder),
        "recover",
    )
    path = None if folder is None else folder / f".{name}.jsonl"
    found: Study = study(
        Work(executor, threads=threads, progress=progress, path=path), seeds, **options
    )
    if folder is not None and path is not None:
        write(found, folder)
        path.unlink(missing_ok=True)
    return found
