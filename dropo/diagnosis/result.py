"""What a diagnosis found: the verdict, the causes, what they gain, what remains."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from dropo.core.contracts.problem import Problem
from dropo.core.records.figure_data import Pictures
from dropo.core.records.predictions import Predictions
from dropo.core.services.tables import Printed, Table, number
from dropo.data.outliers.outlier_runs import OutlierRun
from dropo.diagnosis.findings.disturbances import LeftOut
from dropo.diagnosis.findings.horizons import Horizon

VERDICTS = {
    "consistent": "The simulation explains the data: nothing is missing that they could show.",
    "explained": "After adding it, nothing remains unexplained.",
    "partly": "Something remains unexplained.",
    "unexplained": "Something is missing from the simulation, and no known effect explains it.",
}


@dataclass(frozen=True)
class Cause:
    """An effect that the windows held out confirm. estimate: by quantity {"value", "se", "unit",
    "model"}, value what is added; confused_with: what the data cannot tell from it; acts_like:
    the regime in which its size differs, where it is no true cause.
    """

    effect: str
    target: str | None
    variant: str
    estimate: dict[str, dict[str, Any]]
    p_value: float
    held_out_gain: float
    held_out_gain_se: float
    rmse_before: float
    rmse_after: float
    confused_with: tuple[dict[str, Any], ...] = ()
    acts_like: str | None = None

    @property
    def sentence(self) -> str:
        """ "joint damping at leg_joint, damping +0.79 +- 0.01 N m s/rad"."""
        told = [
            f"{name} {e['value']:+.3g} +- {_digits(e['se'])} {e['unit']}".removesuffix(" 1")
            for name, e in self.estimate.items()
        ]
        return f"{_place(vars(self))}, {', '.join(told)}"


@dataclass(frozen=True, repr=False)
class Diagnosis(Printed):
    """What the simulation gets wrong: the verdict, the causes, what they gain, what remains.

    name: the problem's; verdict: "consistent", "explained", "partly" or "unexplained"; causes: the
    most telling first; suspects: effects that looked likely and were not confirmed;
    baseline_log_likelihood, extended_log_likelihood: [nats per transition] on data held out, of the
    model as it is and with the causes; before, after: its errors there, by horizon, and `nominal`
    those of the model whose declared parameters are not fitted, where it has such; undetermined:
    what of the numbers that were fitted the data do not tell, in words; parameters: the declared
    ones as fitted; remaining: what the last check found; disturbances: the spans in which something
    pushes, which were left out; odd_runs: those that disagree with the others; problem: the
    extended one, to fit or diagnose like any other; noise: the standard deviation of each signal,
    in its unit; pictures, motion: what pictures are drawn from. wall_time_s [s], seed,
    simulator_steps: what it cost; warnings: what looked odd in the data; details: further entries
    of diagnosis.json.
    """

    name: str
    verdict: str
    causes: tuple[Cause, ...]
    suspects: tuple[dict[str, Any], ...]
    baseline_log_likelihood: float
    extended_log_likelihood: float
    before: Sequence[Horizon]
    after: Sequence[Horizon]
    remaining: dict[str, Any]
    problem: Problem
    noise: dict[str, float]
    wall_time_s: float = 0.0
    seed: int | None = None
    simulator_steps: int = 0
    warnings: tuple[str, ...] = ()
    details: dict[str, Any] = field(default_factory=dict)
    nominal: Sequence[Horizon] = ()
    undetermined: tuple[str, ...] = ()
    pictures: Pictures | None = None
    motion: Predictions | None = None
    parameters: dict[str, float] = field(default_factory=dict)
    disturbances: LeftOut | None = None
    outlier_runs: tuple[OutlierRun, ...] = ()

    def headline(self) -> str:
        """The finding in a few sentences."""
        parts = [self._error()] if self.before else []
        for cause in self.causes:
            start = "Acts like" if cause.acts_like else "Cause"
            parts.append(
                f"{start}: {cause.sentence}."
                + (f" Its size differs with {cause.acts_like}." if cause.acts_like else "")
            )
            if cause.confused_with:
                parts.append(
                    "These data cannot tell it from "
                    f"{', '.join(dict.fromkeys(map(_place, cause.confused_with)))}."
                )
                parts += [
                    f"To tell it from {_place(c)}, {c['to_tell']}."
                    for c in cause.confused_with[:1]
                    if "to_tell" in c
                ]
        where = self.remaining.get("where") if self.verdict in ("partly", "unexplained") else None
        left = [f"Left out: {self.disturbances}."] if self.disturbances else []
        odd = [f"{str(run).capitalize()}." for run in self.outlier_runs]
        return " ".join(
            [
                *parts,
                VERDICTS[self.verdict],
                *([f"It shows in {'; '.join(where)}."] if where else []),
                *left,
                *odd,
            ]
        )

    def _error(self) -> str:
        """How far the simulation is off, at the horizon and in the unit where that stands out most
        from the noise, as long as it follows the motion at all.
        """
        followed = [h for h in self.before if h.rmse < 1] or self.before
        every = [
            (off / max(noise, 1e-300), h.steps, unit, off, noise)
            for h in followed
            for unit, (off, noise) in h.units.items()
        ]
        _, steps, unit, off, noise = max(every)
        scale, shown = (
            (1e3, f"m{unit}") if unit in ("m", "rad", "m/s", "rad/s") and off < 0.1 else (1.0, unit)
        )
        after = f"{steps} step{'s' if steps > 1 else ''}"
        error = f"off by {number(scale * off, 3)} {shown} after {after}"
        return (
            f"On held-out data the simulation is {error}; sensor noise explains "
            f"{number(scale * noise, 3)}."
        )

    def _errors(self) -> Table:
        """For each horizon a row of the errors of all signals, in units of the motion, and one of
        each physical unit, before and after.
        """
        named = (
            [("as it came", self.nominal), ("fitted", self.before)]
            if self.nominal
            else [("as it is", self.before)]
        )
        named += [("with what was found", self.after)] if self.causes else []
        rows = []
        for at in zip(*(found for _, found in named), strict=True):
            seconds = "" if at[0].seconds is None else f", {number(at[0].seconds, 3)} s"
            label = f"{at[0].steps} step{'s' * (at[0].steps > 1)}{seconds}"
            rows.append(
                (label, "of the motion", *(f"{h.rmse:.2%}" for h in at), f"{at[-1].noise:.2%}")
            )
            rows += [
                (
                    "",
                    unit,
                    *(number(h.units[unit][0], 3) for h in at),
                    number(at[-1].units[unit][1], 3),
                )
                for unit in at[0].units
            ]
        return Table(
            "Errors on held-out data",
            ("after", "unit", *(name for name, _ in named), "by sensor noise"),
            tuple(rows),
        )

    def to_pandas(self) -> Any:
        """A pandas.DataFrame with a row for each quantity of each cause; empty where none was
        found.
        """
        from dropo.core.services.data_frames import frame

        rows = [
            {
                "effect": c.effect,
                "target": c.target,
                "variant": c.variant,
                "quantity": name,
                **told,
                "p_value": c.p_value,
                "held_out_gain": c.held_out_gain,
                "held_out_gain_se": c.held_out_gain_se,
                "acts_like": c.acts_like,
            }
            for c in self.causes
            for name, told in c.estimate.items()
        ]
        return frame(rows, "effect")

    def to_json(self) -> dict[str, Any]:
        """The content of diagnosis.json."""
        from dropo._version import __version__

        causes = [
            {
                "effect": c.effect,
                "target": c.target,
                "variant": c.variant,
                "rank": i + 1,
                "estimate": c.estimate,
                "p_value": c.p_value,
                "held_out_gain": c.held_out_gain,
                "held_out_gain_se": c.held_out_gain_se,
                "rmse_before": c.rmse_before,
                "rmse_after": c.rmse_after,
                "confused_with": list(c.confused_with),
                "acts_like": c.acts_like,
            }
            for i, c in enumerate(self.causes)
        ]
        sides = {
            name: {
                "held_out_log_likelihood": value,
                "rmse": {str(h.steps): h.rmse for h in found},
                "horizons": [h.to_json() for h in found],
            }
            for name, value, found in (
                ("baseline", self.baseline_log_likelihood, self.before),
                ("extended", self.extended_log_likelihood, self.after),
            )
        }
        return {
            "verdict": self.verdict,
            "headline": self.headline(),
            "problem": self.name,
            "causes": causes,
            "suspects": list(self.suspects),
            **sides,
            "remaining": self.remaining,
            "noise": self.noise,
            "extended_problem": "extended/problem.yaml" if self.causes else None,
            "disturbances": self.disturbances.to_json() if self.disturbances else None,
            "odd_runs": [asdict(run) for run in self.outlier_runs],
            "parameters": self.parameters,
            "nominal": {"horizons": [h.to_json() for h in self.nominal]},
            "undetermined": list(self.undetermined),
            "warnings": list(self.warnings),
            "seed": self.seed,
            "version": __version__,
            "simulator_steps": self.simulator_steps,
            "wall_time_s": round(self.wall_time_s, 3),
            **self.details,
            "pictures": None if self.pictures is None else self.pictures.to_json(),
        }

    def save(self, folder: str | Path) -> None:
        """Writes diagnosis.json and predictions.npz into a folder, each whole or not at all."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        if self.motion is not None:
            self.motion.save(folder)
        text = folder / ".diagnosis.json"
        text.write_text(json.dumps(self.to_json(), indent=1, allow_nan=False) + "\n")
        text.replace(folder / "diagnosis.json")

    def parts(self) -> list[str | Table]:
        """The headline, the errors by horizon, and what else is to be said, a line each."""
        lines: list[str | Table] = [self.headline()]
        lines += [self._errors()] if self.before else []
        lines += self.disturbances.lines() if self.disturbances else []
        lines += [f"  {text}" for text in self.undetermined]
        lines += [
            f"  suspect: {s['effect']}" + (f":{s['target']}" if s["target"] else "")
            for s in self.suspects
        ]
        return [*lines, *(f"warning: {text}" for text in self.warnings)]


def _place(entry: Mapping[str, Any]) -> str:
    """ "joint damping at knee", "contact stiffness (margin)"."""
    target = entry["target"]
    variant = entry.get("variant")
    return (
        entry["effect"].replace("_", " ")
        + (f" at {target}" if target else "")
        + (f" ({variant})" if variant else "")
    )


def _digits(error: float | None) -> str:
    return "?" if error is None else number(error, 2)
