"""What every estimator returns: printed, saved as JSON and NPZ, and drawn from."""

import json
from dataclasses import dataclass, field
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadFile
from dropo.core.services.registry import find
from dropo.core.services.tables import Printed, Table, estimate, number
from dropo.core.services.validation import Array, require


class Status(str, Enum):
    """How a fit ended."""

    CONVERGED = "converged"
    OUT_OF_BUDGET = "out_of_budget"
    INTERRUPTED = "interrupted"
    DONE = "done"  # nothing was searched (uniform randomization)


@dataclass(frozen=True, repr=False, kw_only=True)
class Fit(Printed):
    """A distribution over the parameters, and what it cost to find.

    method, problem: their names; space: the d parameters; family: the name of the law, phi: (m,)
    its member; mean, scale, sd: (d,) in the parameters' units, scale the family's own and sd the
    distribution's; mean_se, scale_se: (d,) standard errors, NaN where there is none; degrees: (d,)
    of freedom of the Student t behind the means' intervals, None: normal; correlation: (d, d) of
    the law;
    epsilon: (p,) noise variances [signal unit^2]. log_likelihood: [nats] of all rows, as the method
    has it; mse: the mean square of (mean prediction - measured) over rows and signals. transitions:
    those fitted; simulator_steps, failed_simulations, objective_evaluations, wall_time_s [s], seed:
    what it cost, and the seed where `rng` was one. status, message: how it ended;
    warnings: what speaks against it, a sentence each. arrays: whatever else an estimator found, by
    name; details: further entries of fit.json.
    """

    method: str
    problem: str
    space: ParameterSpace
    family: str
    phi: Array
    mean: Array
    scale: Array
    sd: Array
    mean_se: Array
    scale_se: Array
    correlation: Array
    epsilon: Array
    log_likelihood: float
    mse: float
    transitions: int
    simulator_steps: int
    failed_simulations: int
    objective_evaluations: int
    status: Status
    message: str
    warnings: tuple[str, ...] = ()
    wall_time_s: float = 0.0
    seed: int | None = None
    degrees: Array | None = None
    arrays: dict[str, Array] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)

    def sample(self, draws: int, rng: np.random.Generator | int | None = None) -> Array:
        """Parameter vectors (K, d) from the fitted distribution, K = `draws`, all physically
        possible; without `rng` new ones each time.
        """
        require(draws >= 0, "draws", "0 or more", draws, "Fit.sample")
        family = find("families", self.family)(self.space)
        return family.sample(self.phi, draws, np.random.default_rng(rng))

    def randomize(self, target: Any, count: int | None = None, **options: Any) -> Any:
        """A Gymnasium environment that draws its parameters from the fit at the start of every
        episode.

        target: the id of a Gymnasium MuJoCo environment ("Hopper-v5"), such an environment, or a
        Problem with a task. count: so many of them as a gymnasium.vector.VectorEnv, simulated
        together; None: one gymnasium.Env. The observations carry the noise that the fit learned.
        options: those of `dropo.randomize`.
        """
        return import_module("dropo.training.environments").randomize(
            target, self, count, **options
        )

    def interval(self, level: float = 0.95) -> Array:
        """(d, 2) confidence intervals of the means at a level in (0, 1), mean -+ t mean_se, cut at
        the search interval.

        NaN without a standard error, as on a bound, where the data speak against one side alone.
        They cover where `trusted`.
        """
        require(0 < level < 1, "level", "between 0 and 1", level, "Fit.interval")
        degrees = (
            np.full(len(self.mean), np.inf)
            if self.degrees is None
            else np.nan_to_num(self.degrees, nan=np.inf)
        )
        half = stats.t.ppf((1 + level) / 2, degrees) * self.mean_se
        cut = np.clip(
            np.stack([self.mean - half, self.mean + half]), self.space.low, self.space.high
        )
        return np.asarray(cut.T)

    @property
    def trusted(self) -> bool:
        """Whether nothing was found that speaks against the model, on which standard errors and
        intervals rest.
        """
        return bool(self.details.get("model_check", {}).get("passed", True))

    def to_inference_data(
        self, draws: int = 4000, rng: np.random.Generator | int | None = None
    ) -> Any:
        """The fit as arviz.InferenceData: of `Posterior` its chains, with sample_stats,
        observed_data, and log_likelihood where kept.

        Of every other method so many draws from the fitted distribution, as one chain of the group
        posterior: its attribute `draws_of` says so. They show the spread to train under, and not
        how well it is known. Needs the extra `posterior`.
        """
        from dropo._version import __version__
        from dropo.core.records.draws import from_chains, from_sample

        about = {
            "method": self.method,
            "problem": self.problem,
            "seed": self.seed,
            "version": __version__,
        }
        known = {name: value for name, value in about.items() if value is not None}
        if "chain" in self.arrays:
            return from_chains(self.arrays, self.details.get("unknowns", ()), known)
        return from_sample(
            self.sample(draws, rng),
            self.space.names,
            known | {"draws_of": "the fitted distribution"},
        )

    def to_pandas(self) -> Any:
        """A pandas.DataFrame with a row for each parameter: mean, errors, 95 % interval, scale, sd,
        unit, search interval.
        """
        from dropo.core.services.data_frames import frame

        intervals = self.interval()
        rows = [
            {
                "parameter": p.name,
                "unit": p.unit,
                "mean": self.mean[i],
                "mean_se": self.mean_se[i],
                "mean_low": intervals[i, 0],
                "mean_high": intervals[i, 1],
                "scale": self.scale[i],
                "scale_se": self.scale_se[i],
                "sd": self.sd[i],
                "low": p.low,
                "high": p.high,
            }
            for i, p in enumerate(self.space)
        ]
        return frame(rows, "parameter")

    def to_json(self) -> dict[str, Any]:
        """The content of fit.json; numbers that do not exist are null."""
        from dropo._version import __version__

        columns = {
            "mean": self.mean,
            "scale": self.scale,
            "sd": self.sd,
            "mean_se": self.mean_se,
            "scale_se": self.scale_se,
        }
        columns["degrees"] = (
            np.full(len(self.mean), np.inf) if self.degrees is None else self.degrees
        )
        intervals = self.interval()
        places = {p.name: p.place for p in self.space if p.place}
        parameters = {
            p.name: {
                **{key: _number(values[i]) for key, values in columns.items()},
                "mean_interval": [_number(end) for end in intervals[i]],
                "unit": p.unit,
                "low": p.low,
                "high": p.high,
                "lower": _number(p.lower),
                "upper": _number(p.upper),
                "search_scale": p.scale,
            }
            for i, p in enumerate(self.space)
        }
        return {
            "method": self.method,
            "problem": self.problem,
            "seed": self.seed,
            "version": __version__,
            "parameters": parameters,
            "correlation": self.correlation.tolist(),
            "family": self.family,
            "phi": self.phi.tolist(),
            "epsilon": self.epsilon.tolist(),
            "log_likelihood": _number(self.log_likelihood),
            "log_likelihood_per_transition": _number(self.log_likelihood / self.transitions),
            "mse": _number(self.mse),
            "transitions": self.transitions,
            "simulator_steps": self.simulator_steps,
            "failed_simulations": self.failed_simulations,
            "objective_evaluations": self.objective_evaluations,
            "wall_time_s": round(self.wall_time_s, 3),
            "status": self.status.value,
            "message": self.message,
            "warnings": list(self.warnings),
            **({"places": places} if places else {}),
            **self.details,
        }

    def save(self, folder: str | Path) -> None:
        """Writes fit.json and fit.npz into a folder, which is made where it is missing; each
        appears whole or not at all.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        whole = folder / ".fit.npz"
        with whole.open("wb") as file:
            own: dict[str, Any] = {
                "phi": self.phi,
                "correlation": self.correlation,
                "epsilon": self.epsilon,
            }
            np.savez(file, **{**own, **self.arrays})
        whole.replace(folder / "fit.npz")
        text = folder / ".fit.json"
        text.write_text(json.dumps(self.to_json(), indent=1, allow_nan=False) + "\n")
        text.replace(folder / "fit.json")

    @classmethod
    def load(cls, folder: str | Path) -> "Fit":
        """The fit that `save` wrote into a folder; BadFile where there is none, or one that cannot
        be read.
        """
        path = Path(folder) / "fit.json"
        if not path.is_file():
            raise BadFile(path, "", "a fit written by `dropo fit --out`", "no such file")
        try:
            content = json.loads(path.read_text())
            return _from_json(
                cls, content, dict(np.load(Path(folder) / "fit.npz", allow_pickle=False))
            )
        except (json.JSONDecodeError, KeyError, OSError) as error:
            raise BadFile(
                path, "", "a fit written by `dropo fit --out`", f"{type(error).__name__}: {error}"
            ) from None

    def parts(self) -> list[str | Table]:
        """The fit as a table, with what it cost beneath."""
        return fit_parts(self)


_SAVED = (
    "method",
    "problem",
    "family",
    "mse",
    "transitions",
    "simulator_steps",
    "failed_simulations",
    "objective_evaluations",
    "message",
    "wall_time_s",
    "seed",
)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _value(saved: float | None, missing: float = np.nan) -> float:
    return missing if saved is None else float(saved)


def _parameter(name: str, row: dict[str, Any]) -> Parameter:
    lower = _value(row["lower"], -np.inf)
    upper = _value(row["upper"], np.inf)
    return Parameter(
        name,
        row["low"],
        row["high"],
        row["unit"],
        lower=lower,
        upper=upper,
        scale=row["search_scale"],
    )


def _from_json(cls: type[Fit], content: dict[str, Any], arrays: dict[str, Array]) -> Fit:
    rows = content["parameters"]
    columns = {
        key: np.array([_value(row[key]) for row in rows.values()])
        for key in ("mean", "scale", "sd", "mean_se", "scale_se")
    }
    degrees = np.array([_value(row.get("degrees"), np.inf) for row in rows.values()])
    columns["degrees"] = np.where(np.isfinite(columns["mean_se"]), degrees, np.nan)
    own = {key: arrays.pop(key) for key in ("phi", "correlation", "epsilon")}
    known = {
        "version",
        "parameters",
        "log_likelihood",
        "log_likelihood_per_transition",
        "status",
        "warnings",
        *own,
        *_SAVED,
    }
    saved: dict[str, Any] = (
        {key: content[key] for key in _SAVED} | {"mse": _value(content["mse"])} | columns | own
    )
    return cls(
        space=ParameterSpace(tuple(_parameter(name, row) for name, row in rows.items())),
        log_likelihood=_value(content["log_likelihood"]),
        status=Status(content["status"]),
        warnings=tuple(content["warnings"]),
        arrays=arrays,
        details={key: value for key, value in content.items() if key not in known},
        **saved,
    )


def held_out_lines(found: dict[str, Any] | None) -> list[str]:
    """One line on the held-out errors, by unit, with the nominal model's before the arrow."""
    if found is None:
        return []
    before = found.get("rmse_nominal", {})
    shown = [
        (f"{number(_value(before[unit]), 3)} -> " if unit in before else "")
        + f"{number(_value(value), 3)} {unit}"
        for unit, value in found["rmse"].items()
    ]
    return [
        (
            f"held-out error after {found['steps']} steps (RMS, {found['rows']} rows): "
            f"{', '.join(shown)}"
        )
    ]


def span(low: float, high: float) -> str:
    """An interval, with as many digits as its width deserves; a dash where there is none."""
    if not (np.isfinite(low) and np.isfinite(high)):
        return "-"
    size = max(abs(low), abs(high), 1e-300)
    digits = 3 if high <= low else int(np.clip(np.ceil(np.log10(size / (high - low))) + 2, 3, 12))
    return f"{low:.{digits}g} .. {high:.{digits}g}"


def fit_parts(fit: Fit) -> list[str | Table]:
    """The fit as a table, with what it cost beneath."""
    truth = fit.details.get("truth", {})
    ends = "95 % interval" if fit.trusted else "(95 % if the model were right)"
    header = ("parameter", "unit", "mean", "se", ends, "scale", "sd", *(["truth"] if truth else []))
    intervals = fit.interval()
    rows = tuple(
        (
            p.name,
            p.unit,
            estimate(fit.mean[i], fit.mean_se[i]),
            number(fit.mean_se[i], 2),
            span(*intervals[i]),
            number(fit.scale[i], 4),
            number(fit.sd[i], 4),
            *([number(truth[p.name], 7)] if truth else []),
        )
        for i, p in enumerate(fit.space)
    )
    likelihood = (
        f"log-likelihood {fit.log_likelihood:.6g} ({fit.log_likelihood / fit.transitions:.4g} "
        "a transition)"
    )
    return [
        f"{fit.problem}: {fit.method}, {fit.family.replace('_', ' ')}",
        Table("", header, rows),
        *fit.details.get("identifiability", ()),
        f"{likelihood}, mean squared error {fit.mse:.3g}, {fit.transitions} transitions",
        *held_out_lines(fit.details.get("held_out")),
        (
            f"{fit.simulator_steps:,} simulator steps, {fit.objective_evaluations} "
            f"evaluations, {fit.wall_time_s:.1f} s"
        ),
        *f"{fit.status.value}: {fit.message}".split("\n", 1),  # a method's own table stands alone
        *(f"warning: {text}" for text in fit.warnings),
    ]
