"""A diagnosis of the published hopper data against Gymnasium's Hopper-v5 as it is.

What it finds stands beside what is known to be different.
"""

from typing import Any

from dropo import Diagnose
from dropo.core.services.tables import number
from dropo.core.services.validation import require
from dropo.problems.hopper.v5 import differences, hopper_v5
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work


def hopper_v5_study(work: Work, seeds: int | None = None) -> Study:
    """What the unchanged Hopper-v5 gets wrong about the published data.

    Parameters
    ----------
    work : Work
        Runs the diagnosis.
    seeds : int or None
        None or 1, as there is one data set.

    Returns
    -------
    Study
        The causes named, their magnitudes, and the errors before and after.

    Raises
    ------
    BadArgument
        If `seeds` is another number.
    BadFile
        If the published data are neither found nor fetched.
    """
    require(seeds in (None, 1), "seeds", "1, as there is one data set", seeds, "hopper-v5")
    (found,) = work.map(diagnosed, ["hopper-v5"])
    cost = f"{found['simulator_steps']:,} simulator steps."
    return Study(
        "hopper-v5",
        "The published hopper data against Hopper-v5",
        (_causes(found), _errors(found)),
        (f"Verdict: {found['verdict']}.", cost),
        found,
    )


def _causes(found: dict[str, Any]) -> Table:
    """The causes named beside the true differences, and the differences that were missed."""
    true = differences()
    rows = []
    for cause in found["causes"]:
        (estimate,) = cause["estimate"].values()
        difference = true.pop((cause["effect"], cause["target"]), None)
        rows.append(
            (
                cause["effect"],
                cause["target"] or "all",
                "-" if difference is None else number(difference, 6),
                number(estimate["value"], 6),
                number(estimate["se"], 2),
                estimate["unit"],
            )
        )
    for (effect, place), difference in true.items():
        rows.append((effect, place or "all", number(difference, 6), "-", "-", ""))
    header = ("effect", "place", "is different by", "found", "standard error", "unit")
    return Table("Causes", header, tuple(rows))


def _errors(found: dict[str, Any]) -> Table:
    """Errors by horizon before and after."""
    rows = []
    sides = zip(found["baseline"]["horizons"], found["extended"]["horizons"], strict=True)
    for before, after in sides:
        ratio = before["rmse"] / after["rmse"]
        rows.append(
            (
                str(before["steps"]),
                number(before["rmse"], 3),
                number(after["rmse"], 3),
                number(ratio, 3),
            )
        )
    return Table(
        "Errors on trajectories held out, in units of each signal's spread",
        ("control steps", "Hopper-v5", "with the causes", "times smaller"),
        tuple(rows),
    )


def diagnosed(name: str) -> dict[str, Any]:
    """The content of `diagnosis.json`, without figures.

    Parameters
    ----------
    name : str
        Name of the problem, for the list of finished tasks.

    Returns
    -------
    dict
        Plain values by key.
    """
    found = Diagnose().run(hopper_v5(threads=1), rng=0).to_json()
    return {key: value for key, value in found.items() if key != "pictures"}
