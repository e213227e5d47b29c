"""What a diagnosis found: the verdict, the causes, what they gain, what remains."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dropo.core.problem import Problem
from dropo.core.table import number
from dropo.diagnosis.horizons import Horizon

VERDICTS = {
    "consistent": "The simulation explains the data: nothing is missing that they could show.",
    "explained": "After adding it, nothing remains unexplained.",
    "partly": "Something remains unexplained.",
    "unexplained": "Something is missing from the simulation, and no known effect explains it.",
}


@dataclass(frozen=True)
class Cause:
    """An effect that the windows held out confirm. estimate: by quantity {"value", "se", "unit", "model"}, value what is added;
    confused_with: what the data cannot tell from it; acts_like: the regime in which its size differs, where it is no true cause."""

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
        place = "" if self.target is None else f" at {self.target}"
        how = f" ({self.variant})" if self.variant else ""
        told = [f"{name} {e['value']:+.3g} +- {_digits(e['se'])} {e['unit']}" for name, e in self.estimate.items()]
        return f"{self.effect.replace('_', ' ')}{place}{how}, {', '.join(told)}"


@dataclass(frozen=True)
class Diagnosis:
    """verdict: "consistent", "explained", "partly" or "unexplained"; suspects: effects that looked likely and were not confirmed;
    before, after: errors on data held out, by horizon; remaining: what the last check found; problem: the extended one."""

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

    def headline(self) -> str:
        """The finding in a few sentences."""
        parts = [self._error()] if self.before else []
        for cause in self.causes:
            start = "Acts like" if cause.acts_like else "Cause"
            parts.append(f"{start}: {cause.sentence}." + (f" Its size differs with {cause.acts_like}." if cause.acts_like else ""))
            if cause.confused_with:
                others = ", ".join(f"{c['effect']}" + (f":{c['target']}" if c["target"] else "") for c in cause.confused_with)
                parts.append(f"These data cannot tell it from {others}.")
        where = self.remaining.get("where") if self.verdict in ("partly", "unexplained") else None
        return " ".join([*parts, VERDICTS[self.verdict], *([f"It shows in {'; '.join(where)}."] if where else [])])

    def _error(self) -> str:
        """How far the simulation is off, at the horizon and in the unit where that stands out most from the noise."""
        every = [(off / max(noise, 1e-300), h.steps, unit, off, noise) for h in self.before for unit, (off, noise) in h.units.items()]
        _, steps, unit, off, noise = max(every)
        scale, shown = (1e3, f"m{unit}") if unit in ("m", "rad", "m/s", "rad/s") and off < 0.1 else (1.0, unit)
        after = f"{steps} step{'s' if steps > 1 else ''}"
        error = f"off by {number(scale * off, 3)} {shown} after {after}"
        return f"On held-out data the simulation is {error}; sensor noise explains {number(scale * noise, 3)}."

    def to_json(self) -> dict[str, Any]:
        """The content of diagnosis.json."""
        from dropo import __version__

        causes = [
            {"effect": c.effect, "target": c.target, "variant": c.variant, "rank": i + 1, "estimate": c.estimate, "p_value": c.p_value,
             "held_out_gain": c.held_out_gain, "held_out_gain_se": c.held_out_gain_se, "rmse_before": c.rmse_before,
             "rmse_after": c.rmse_after, "confused_with": list(c.confused_with), "acts_like": c.acts_like}
            for i, c in enumerate(self.causes)
        ]  # fmt: skip
        sides = {
            name: {
                "held_out_log_likelihood": value, "rmse": {str(h.steps): h.rmse for h in found}, "horizons": [h.to_json() for h in found],
            }
            for name, value, found in (
                ("baseline", self.baseline_log_likelihood, self.before), ("extended", self.extended_log_likelihood, self.after),
            )
        }  # fmt: skip
        return {
            "verdict": self.verdict, "headline": self.headline(), "problem": self.name, "causes": causes, "suspects": list(self.suspects),
            **sides, "remaining": self.remaining, "noise": self.noise, "extended_problem": "extended/problem.yaml" if self.causes else None,
            "warnings": list(self.warnings), "seed": self.seed, "version": __version__, "simulator_steps": self.simulator_steps,
            "wall_time_s": round(self.wall_time_s, 3), **self.details,
        }  # fmt: skip

    def save(self, folder: str | Path) -> None:
        """Writes diagnosis.json, whole or not at all, and where something was found the extended problem beside it."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        text = folder / ".diagnosis.json"
        text.write_text(json.dumps(self.to_json(), indent=1, allow_nan=False) + "\n")
        text.replace(folder / "diagnosis.json")

    def __str__(self) -> str:
        lines = [self.headline()]
        for before, after in zip(self.before, self.after, strict=True):
            errors = f"{number(before.rmse, 3)} -> {number(after.rmse, 3)} of the motion (noise {number(after.noise, 3)})"
            lines.append(f"  error after {before.steps} steps: {errors}")
        lines += [f"  suspect: {s['effect']}" + (f":{s['target']}" if s["target"] else "") for s in self.suspects]
        return "\n".join([*lines, *(f"warning: {text}" for text in self.warnings)])


def _digits(error: float | None) -> str:
    return "?" if error is None else number(error, 2)
