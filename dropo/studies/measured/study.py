"""Logs of real machines, from a first model to a judged one: what it gets wrong, the cause, and the
gain on runs that no fit saw.
"""

from collections.abc import Sequence
from typing import Any

from dropo import Diagnose, Diagnosis
from dropo.core.services.tables import number
from dropo.core.services.validation import known
from dropo.problems.loading import load
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work

JUDGED = {
    "cube-toss": ("m", 1e3, "mm", 15),
    "double-pendulum": ("rad", 1e3, "mrad", 10),
    "double-pendulum-c0": ("rad", 1e3, "mrad", 10),
    "simple-pendulum": ("rad", 1e3, "mrad", 25),
    "swinging-pendulum": ("rad", 1e3, "mrad", 400),
}
"""Problem -> the unit in which errors are told, its scale and name, and the control steps after
which.
"""


def measured(
    work: Work, seeds: int | None = None, *, problems: Sequence[str] = tuple(JUDGED)
) -> Study:
    """Each built-in problem of measured data diagnosed; seeds: of the only random test, the last
    one.
    """
    chosen = [known("problem of measured data", name, JUDGED) for name in problems]
    runs = work.map(run, [[name, seed] for name in chosen for seed in range(seeds or 1)])
    judged = (
        "problem",
        "after",
        "first model",
        "parameters fitted",
        "extended",
        "noise",
        "verdict",
    )
    left = ("problem", "of the data", "spans [s]", "fitted, with them", "extended, with them")
    named = ("problem", "cause", "nats per transition", "cannot be told from", "differs with")
    tables = (
        Table("Errors on runs held out", judged, tuple(_errors(r) for r in runs)),
        Table("Causes", named, tuple(row for r in runs for row in _causes(r))),
        Table(
            "Left out, since something pushes",
            left,
            tuple(row for r in runs for row in _left_out(r)),
        ),
        Table(
            "Runs that disagree with the others",
            ("problem", "run"),
            tuple((r["problem"], text) for r in runs for text in r["odd_runs"]),
        ),
        Table(
            "What remains",
            ("problem", "where"),
            tuple((r["problem"], "; ".join(r["remaining"]) or "-") for r in runs),
        ),
        Table(
            "What the data do not tell",
            ("problem", "what"),
            tuple((r["problem"], text) for r in runs for text in r["undetermined"]),
        ),
    )
    return Study(
        "measured",
        (
            "Measured data: every third run held out, windows of the horizon at which signals "
            "stand out from noise"
        ),
        tables,
        data={"runs": runs},
        draw=lambda figure: _draw(figure, runs),
    )


def run(item: list[Any]) -> dict[str, Any]:
    """One diagnosis, as plain numbers."""
    name = str(item[0])
    seed = int(item[1])
    found: Diagnosis = Diagnose().run(load(name, threads=1), rng=seed)
    told = found.to_json()
    return {
        "problem": name,
        "seed": seed,
        "verdict": found.verdict,
        "remaining": list(found.remaining.where),
        "disturbances": told["disturbances"],
        "odd_runs": [str(one) for one in found.outlier_runs],
        "undetermined": list(found.undetermined),
        "seconds": found.wall_time_s,
        "causes": told["causes"],
        "sentences": [cause.sentence for cause in found.causes],
        "horizons": _horizons(told, JUDGED[name][0]),
    }


def _horizons(told: dict[str, Any], unit: str) -> list[dict[str, Any]]:
    """By horizon: the error of each model in one unit, and the noise's."""
    sides = {
        "first": told["nominal"]["horizons"],
        "fitted": told["baseline"]["horizons"],
        "extended": told["extended"]["horizons"],
    }
    sides["first"] = sides["first"] or sides["fitted"]
    out = []
    for i, last in enumerate(sides["extended"]):
        errors = {side: found[i]["units"][unit]["rmse"] for side, found in sides.items()}
        out.append(
            {
                "steps": last["steps"],
                "seconds": last["seconds"],
                "noise": last["units"][unit]["noise"],
                **errors,
            }
        )
    return out


def _judged(result: dict[str, Any]) -> dict[str, Any]:
    steps = JUDGED[result["problem"]][3]
    return next(h for h in reversed(result["horizons"]) if h["steps"] <= steps)


def _errors(result: dict[str, Any]) -> tuple[str, ...]:
    _, scale, unit, _ = JUDGED[result["problem"]]
    at = _judged(result)
    errors = [
        f"{number(scale * at[side], 3)} {unit}" for side in ("first", "fitted", "extended", "noise")
    ]
    return (result["problem"], f"{number(at['seconds'], 3)} s", *errors, result["verdict"])


def _causes(result: dict[str, Any]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for cause, sentence in zip(result["causes"], result["sentences"], strict=True):
        others = dict.fromkeys(
            c["effect"] + (f":{c['target']}" if c["target"] else "") for c in cause["confused_with"]
        )
        rows.append(
            (
                result["problem"],
                sentence,
                number(cause["held_out_gain"], 3),
                ", ".join(others) or "-",
                cause["acts_like"] or "-",
            )
        )
    return rows


def _left_out(result: dict[str, Any]) -> list[tuple[str, ...]]:
    """The spans, and the errors at the windows' horizon on all data held out, those spans too."""
    base, scale, unit, _ = JUDGED[result["problem"]]
    found = result["disturbances"]
    if found is None:
        return []
    spans = [
        f"{'held-out ' * one['held_out']}run {one['run']}: {one['from']:.2f} to {one['to']:.2f}"
        for one in found["spans"]
    ]
    sides = (found["errors_with_them"].get(side) for side in ("baseline", "extended"))
    errors = [
        f"{number(scale * side['units'][base]['rmse'], 3)} {unit}" if side else "-"
        for side in sides
    ]
    return [(result["problem"], f"{found['share']:.1%}", "; ".join(spans), *errors)]


def _draw(figure: Any, runs: list[dict[str, Any]]) -> None:
    """Errors against the horizon, a panel each."""
    figure.set_size_inches(11, 5.6)
    for axes, result in zip(figure.subplots(2, 3).ravel(), runs, strict=False):
        _, scale, unit, _ = JUDGED[result["problem"]]
        seconds = [h["seconds"] for h in result["horizons"]]
        for side, style in (
            ("first", "C3o-"),
            ("fitted", "C1s-"),
            ("extended", "C0D-"),
            ("noise", "k:"),
        ):
            axes.loglog(
                seconds,
                [scale * h[side] for h in result["horizons"]],
                style,
                label=side,
                markersize=3,
            )
        axes.set(title=result["problem"], xlabel="horizon [s]", ylabel=f"error held out [{unit}]")
    figure.axes[0].legend()
    for axes in figure.axes[len(runs) :]:
        axes.set_visible(False)
