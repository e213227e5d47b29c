"""Flights of a quadrotor with known faults beside its normal flights.

Which flights served development was written down before any was read (papers/crazypad); all others
are held back, and no rule or threshold was chosen on them.
"""

import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dropo.core.services.tables import number
from dropo.diagnosis.reference.compare import compare_with_reference
from dropo.diagnosis.reference.result import ComparedRun, RunDifference
from dropo.problems.loading import load
from dropo.problems.measured.external_data import find_data, missing
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work

ARCHIVE = "crazypad/runs.npz"
DEVELOPMENT = ("motor00", "normal_flight.motor01")
"""What the names of flights end with that were looked at while this was made."""
LARGE_CUT = 3.0
"""Millimetres off both blades together from which a cut is to be found."""
Result = dict[str, Any]


def crazypad_study(work: Work, seeds: int | None = None) -> Study:
    """Compare every flight with the normal ones, and the answer with what was done to the drone.

    Parameters
    ----------
    work : Work
        Runs the comparison.
    seeds : int or None
        Without effect: nothing is drawn.

    Returns
    -------
    Study
        What was named in each flight, and how often that was right.

    Raises
    ------
    BadFile
        If the external data are not found.
    """
    (found,) = work.map(compared, [[]])
    flights = found["flights"]
    title = (
        f"CrazyPAD: {len(flights)} flights of one quadrotor, each beside its normal flights; "
        f"{sum(not one['development'] for one in flights)} of them held back"
    )
    return Study(
        "crazypad",
        title,
        (
            _flights(flights, development=False),
            _flights(flights, development=True),
            _counts(flights),
        ),
        data=found,
    )


def compared(item: list[Any]) -> Result:
    """The comparison of all flights, as plain numbers.

    Parameters
    ----------
    item : list
        Empty.

    Returns
    -------
    dict
        flights: what was done to the drone and what the comparison says, of each; simulator_steps.
    """
    truth = faults()
    result = compare_with_reference(load("crazypad", threads=1))
    flights = [{**truth[run.name], **_answer(run)} for run in result.runs]
    return {"flights": flights, "simulator_steps": result.simulator_steps}


def faults() -> dict[str, Result]:
    """What was done to the drone in each flight, by the flight's name.

    Raises
    ------
    BadFile
        If the external data are not found.
    """
    path = find_data(ARCHIVE)
    if path is None:
        raise missing(ARCHIVE, "the CrazyPAD flights")
    with np.load(path, allow_pickle=False) as archive:
        runs = json.loads(str(archive["meta"]))["runs"]
    found = {}
    for name, run in runs.items():
        cuts = [sum(cut["off_mm"]) for cut in run.get("cuts", {}).values()]
        off = max(cuts, default=0.0)
        is_weight = "weight" in run["fault"]
        found[name] = {
            "flight": name,
            "development": name.endswith(DEVELOPMENT),
            "fault": "normal" if run["fault"] == "none" else run["fault"],
            "rotors": run["rotors"],
            "off_mm": off,
            "large": is_weight or off >= LARGE_CUT,
        }
    return found


def _answer(run: ComparedRun) -> Result:
    """What was said of a flight."""
    return {
        "p_value": run.p_value,
        "differs": run.differs,
        "named": [_rotor(cause) for cause in run.causes],
        "causes": [cause.to_json() for cause in run.causes],
        "labels": [cause.label for cause in run.causes],
        "sizes": [str(cause.estimate) for cause in run.causes],
    }


def _rotor(cause: RunDifference) -> str:
    """The rotor that a cause is at; "all" of a gain of all rotors."""
    return cause.variant or cause.target or "all"


def _flights(flights: Sequence[Result], *, development: bool) -> Table:
    """A row for each flight."""
    rows = []
    for one in flights:
        if one["development"] != development:
            continue
        done = ", ".join(one["rotors"]) + (f", {one['off_mm']:g} mm off" if one["off_mm"] else "")
        short = one["flight"].removeprefix("E8.")
        rows.append(
            (
                short,
                one["fault"],
                done,
                number(one["p_value"], 1),
                ", ".join(one["labels"]) or "-",
                ", ".join(one["sizes"]),
            )
        )
    part = "Development" if development else "Held back"
    return Table(part, ("flight", "fault", "at", "p", "named", "by"), tuple(rows))


def _counts(flights: Sequence[Result]) -> Table:
    """How many flights of each kind were named rightly."""
    held_back = [one for one in flights if not one["development"]]
    normal: Callable[[Result], bool] = lambda one: one["fault"] == "normal"
    kinds: tuple[tuple[str, Callable[[Result], bool]], ...] = (
        (f"a weight, or {LARGE_CUT:g} mm and more cut off", lambda one: one["large"]),
        ("less cut off", lambda one: one["off_mm"] > 0 and not one["large"]),
        ("tape", lambda one: "tape" in one["fault"]),
        ("normal", normal),
    )
    rows = []
    for part, chosen in (("held back", held_back), ("all flights", flights)):
        for text, belongs in kinds:
            own = [one for one in chosen if belongs(one)]
            right = sum(set(one["named"]) == set(one["rotors"]) for one in own)
            differs = sum(one["differs"] for one in own)
            false = sum(bool(set(one["named"]) - set(one["rotors"])) for one in own)
            rows.append((part, text, str(len(own)), str(differs), str(right), str(false)))
    header = ("flights", "with", "number", "differ", "named: the rotors, no other", "a false one")
    return Table("How often", header, tuple(rows))
