"""A diagnosis of the published hopper data against Gymnasium's Hopper-v5 as it is, beside what is
known to be different.
"""

from typing import Any

from dropo import Diagnose
from dropo.core.services.tables import number
from dropo.core.services.validation import require
from dropo.problems.hopper.v5 import differences, hopper_v5
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work


def hopper_v5_study(work: Work, seeds: int | None = None) -> Study:
    """What the unchanged Hopper-v5 gets wrong about the published data: the causes named, their
    sizes, and the errors before and after.
    """
    require(seeds in (None, 1), "seeds", "1, as there is one data set", seeds, "hopper-v5")
    (found,) = work.map(diagnosed, ["hopper-v5"])
    known = differences()
    header = ("effect", "place", "is different by", "found", "standard error", "unit")
    rows = []
    for cause in found["causes"]:
        (told,) = cause["estimate"].values()
        true = known.get((cause["effect"], cause["target"]))
        rows.append(
            (
                cause["effect"],
                cause["target"] or "all",
                "-" if true is None else number(true, 6),
                number(told["value"], 6),
                number(told["se"], 2),
                told["unit"],
            )
        )
    named = {(cause["effect"], cause["target"]) for cause in found["causes"]}
    missed = tuple(
        (effect, place or "all", number(size, 6), "-", "-", "")
        for (effect, place), size in known.items()
        if (effect, place) not in named
    )
    errors = tuple(
        (
            str(before["steps"]),
            number(before["rmse"], 3),
            number(after["rmse"], 3),
            number(before["rmse"] / after["rmse"], 3),
        )
        for before, after in zip(
            found["baseline"]["horizons"], found["extended"]["horizons"], strict=True
        )
    )
    tables = (
        Table("Causes", header, (*rows, *missed)),
        Table(
            "Errors on trajectories held out, in units of each signal's spread",
            ("control steps", "Hopper-v5", "with the causes", "times smaller"),
            errors,
        ),
    )
    cost = f"{found['simulator_steps']:,} simulator steps."
    return Study(
        "hopper-v5",
        "The published hopper data against Hopper-v5",
        tables,
        (f"Verdict: {found['verdict']}.", cost),
        found,
    )


def diagnosed(name: str) -> dict[str, Any]:
    """diagnosis.json of the problem, without pictures."""
    found = Diagnose().run(hopper_v5(threads=1), rng=0).to_json()
    return {key: value for key, value in found.items() if key != "pictures"}
