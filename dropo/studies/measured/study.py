"""Logs of real machines diagnosed: what a first model gets wrong, the cause, and the gain.

Errors are those on runs that no fit saw.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from dropo import Diagnose, Diagnosis
from dropo.core.services.tables import number
from dropo.core.services.validation import known
from dropo.problems.loading import load
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work


class Evaluated(NamedTuple):
    """In which unit, and how far ahead, a problem's errors are shown.

    Attributes
    ----------
    group : str
        Unit of the signals whose errors are shown.
    scale : float
        Factor from that unit to the shown one.
    unit : str
        The shown unit.
    steps : int
        Control steps ahead; the longest horizon up to them is taken.
    """

    group: str
    scale: float
    unit: str
    steps: int


EVALUATED = {
    "cube-toss": Evaluated("m", 1e3, "mm", 15),
    "double-pendulum": Evaluated("rad", 1e3, "mrad", 10),
    "double-pendulum-c0": Evaluated("rad", 1e3, "mrad", 10),
    "simple-pendulum": Evaluated("rad", 1e3, "mrad", 25),
    "swinging-pendulum": Evaluated("rad", 1e3, "mrad", 400),
}
"""Problem -> how its errors are shown."""
STYLES = {"first": "C3o-", "fitted": "C1s-", "extended": "C0D-", "noise": "k:"}
"""Line of each model, and of the noise, in the figure."""
Result = dict[str, Any]
"""What `run` gives."""


def measured(
    work: Work, seeds: int | None = None, *, problems: Sequence[str] = tuple(EVALUATED)
) -> Study:
    """Diagnoses each built-in problem of measured data.

    Parameters
    ----------
    work : Work
        Runs the diagnoses.
    seeds : int or None
        Number of seeds of the only random test, the last one; None for one.
    problems : sequence of str
        Names of the problems.

    Returns
    -------
    Study
        Errors, causes, and what remains.

    Raises
    ------
    UnknownName
        If there is no such problem.
    BadFile
        If the external data are not found.
    """
    chosen = [known("problem of measured data", name, EVALUATED) for name in problems]
    items = [[name, seed] for name in chosen for seed in range(seeds or 1)]
    runs = work.map(run, items)
    title = (
        "Measured data: every third run held out, windows of the horizon at which signals "
        "stand out from noise"
    )
    return Study(
        "measured",
        title,
        _tables(runs),
        data={"runs": runs},
        draw=lambda figure: _draw(figure, runs),
    )


def _tables(runs: Sequence[Result]) -> tuple[Table, ...]:
    """Everything that the diagnoses say."""
    errors = tuple(_errors(result) for result in runs)
    causes = tuple(row for result in runs for row in _causes(result))
    left_out = tuple(row for result in runs for row in _left_out(result))
    remaining = tuple((r["problem"], "; ".join(r["remaining"]) or "-") for r in runs)
    return (
        Table(
            "Errors on runs held out",
            (
                "problem",
                "after",
                "first model",
                "parameters fitted",
                "extended",
                "noise",
                "verdict",
            ),
            errors,
        ),
        Table(
            "Causes",
            ("problem", "cause", "nats per transition", "cannot be told from", "differs with"),
            causes,
        ),
        Table(
            "Left out, since something pushes",
            ("problem", "of the data", "spans [s]", "fitted, with them", "extended, with them"),
            left_out,
        ),
        Table("Runs that disagree with the others", ("problem", "run"), _texts(runs, "odd_runs")),
        Table("What remains", ("problem", "where"), remaining),
        Table("What the data do not tell", ("problem", "what"), _texts(runs, "undetermined")),
    )


def _texts(runs: Sequence[Result], key: str) -> tuple[tuple[str, str], ...]:
    """A row for each of the texts that runs have under a key."""
    return tuple((result["problem"], text) for result in runs for text in result[key])


def run(item: list[Any]) -> Result:
    """One diagnosis, as plain numbers and texts.

    Parameters
    ----------
    item : list
        Name of the problem, and seed.

    Returns
    -------
    dict
        The verdict, the causes with their sentences, and held-out errors by horizon.
    """
    name = str(item[0])
    seed = int(item[1])
    found: Diagnosis = Diagnose().run(load(name, threads=1), rng=seed)
    content = found.to_json()
    return {
        "problem": name,
        "seed": seed,
        "verdict": found.verdict,
        "remaining": list(found.remaining.where),
        "disturbances": content["disturbances"],
        "odd_runs": [str(one) for one in found.outlier_runs],
        "undetermined": list(found.undetermined),
        "seconds": found.wall_time_s,
        "causes": content["causes"],
        "sentences": [cause.sentence for cause in found.causes],
        "horizons": _horizons(content, EVALUATED[name].group),
    }


def _horizons(content: dict[str, Any], group: str) -> list[dict[str, Any]]:
    """By horizon: the error of each model in one unit, and the noise's."""
    fitted = content["baseline"]["horizons"]
    extended = content["extended"]["horizons"]
    sides = {
        "first": content["nominal"]["horizons"] or fitted,
        "fitted": fitted,
        "extended": extended,
    }
    out = []
    for i, last in enumerate(extended):
        row = {
            "steps": last["steps"],
            "seconds": last["seconds"],
            "noise": last["units"][group]["noise"],
        }
        for side, horizons in sides.items():
            row[side] = horizons[i]["units"][group]["rmse"]
        out.append(row)
    return out


def _evaluated(result: Result) -> dict[str, Any]:
    """The errors at the horizon that is shown."""
    steps = EVALUATED[result["problem"]].steps
    return next(h for h in reversed(result["horizons"]) if h["steps"] <= steps)


def _errors(result: Result) -> tuple[str, ...]:
    """The errors of each model as a row."""
    shown = EVALUATED[result["problem"]]
    at = _evaluated(result)
    errors = [
        f"{number(shown.scale * at[side], 3)} {shown.unit}"
        for side in ("first", "fitted", "extended", "noise")
    ]
    return (result["problem"], f"{number(at['seconds'], 3)} s", *errors, result["verdict"])


def _causes(result: Result) -> list[tuple[str, ...]]:
    """A row for each cause."""
    rows: list[tuple[str, ...]] = []
    for cause, sentence in zip(result["causes"], result["sentences"], strict=True):
        others = []
        for other in cause["confused_with"]:
            target = f":{other['target']}" if other["target"] else ""
            others.append(other["effect"] + target)
        rows.append(
            (
                result["problem"],
                sentence,
                number(cause["held_out_gain"], 3),
                ", ".join(dict.fromkeys(others)) or "-",
                cause["acts_like"] or "-",
            )
        )
    return rows


def _left_out(result: Result) -> list[tuple[str, ...]]:
    """The spans left out, and the errors on all held-out data with those spans."""
    shown = EVALUATED[result["problem"]]
    found = result["disturbances"]
    if found is None:
        return []
    spans = []
    for span in found["spans"]:
        held_out = "held-out " if span["held_out"] else ""
        spans.append(f"{held_out}run {span['run']}: {span['from']:.2f} to {span['to']:.2f}")
    errors = []
    for name in ("baseline", "extended"):
        side = found["errors_with_them"].get(name)
        if side:
            rmse = side["units"][shown.group]["rmse"]
            errors.append(f"{number(shown.scale * rmse, 3)} {shown.unit}")
        else:
            errors.append("-")
    return [(result["problem"], f"{found['share']:.1%}", "; ".join(spans), *errors)]


def _draw(figure: Any, runs: Sequence[Result]) -> None:
    """Errors against the horizon, a panel for each problem."""
    figure.set_size_inches(11, 5.6)
    for axes, result in zip(figure.subplots(2, 3).ravel(), runs, strict=False):
        shown = EVALUATED[result["problem"]]
        seconds = [h["seconds"] for h in result["horizons"]]
        for side, style in STYLES.items():
            errors = [shown.scale * h[side] for h in result["horizons"]]
            axes.loglog(seconds, errors, style, label=side, markersize=3)
        axes.set(
            title=result["problem"], xlabel="horizon [s]", ylabel=f"error held out [{shown.unit}]"
        )
    figure.axes[0].legend()
    for axes in figure.axes[len(runs) :]:
        axes.set_visible(False)
