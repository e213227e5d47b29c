"""How a fit is kept in a folder: fit.json, and fit.npz for its arrays."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.fits.fit_choices import ExcludedSpans, HorizonChoice, NoiseTuning
from dropo.core.records.fits.fit_parts import (
    EmulatorCheck,
    FitPart,
    GroupEffects,
    HeldOutErrors,
    ModelCheck,
    PosteriorDraws,
    PriorUse,
    StartFilter,
    number_or_nan,
    number_or_null,
)
from dropo.core.records.fits.search_records import SEARCH_RECORDS
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadFile, UnknownName
from dropo.core.services.files.atomic_write import write_json, write_npz
from dropo.core.services.files.saved_files import read_npz, refusing_faults, require_shapes
from dropo.core.services.registry import find
from dropo.core.services.validation import Array

PARTS: Mapping[str, type[FitPart]] = {
    "emulator_check": EmulatorCheck,
    "start_filter": StartFilter,
    "posterior": PosteriorDraws,
    "model_check": ModelCheck,
    "priors": PriorUse,
    "held_out": HeldOutErrors,
    "groups": GroupEffects,
    "noise_tuning": NoiseTuning,
    "horizon_choice": HorizonChoice,
    "excluded": ExcludedSpans,
}
"""The fields of a fit that are parts of one kind each; its search record has a kind by method."""

SCALARS = (
    "method",
    "problem",
    "family",
    "transitions",
    "simulator_steps",
    "failed_simulations",
    "objective_evaluations",
    "inner_evaluations",
    "message",
    "wall_time_s",
    "seed",
)
COLUMNS = ("mean", "scale", "sd", "mean_se", "scale_se")
ARRAYS: Mapping[str, str] = {"phi": "finite m", "correlation": "finite d d", "epsilon": "finite p"}
"""The arrays of every fit, with their kinds and axes."""
WRITTEN = "a fit written by `dropo fit --out`"
MADE = "made.json"
"""How the run was made that left the fit, and of which problem."""


def content_of(fit: Fit) -> dict[str, Any]:
    """The content of fit.json.

    Parameters
    ----------
    fit : Fit

    Returns
    -------
    dict
        Plain numbers, texts, lists and dicts; numbers that do not exist are None.
    """
    from dropo._version import __version__

    content: dict[str, Any] = {
        "method": fit.method,
        "problem": fit.problem,
        "seed": fit.seed,
        "version": __version__,
        "parameters": _rows_of(fit),
        "correlation": fit.correlation.tolist(),
        "family": fit.family,
        "phi": fit.phi.tolist(),
        "epsilon": fit.epsilon.tolist(),
        "log_likelihood": number_or_null(fit.log_likelihood),
        "log_likelihood_per_transition": number_or_null(fit.log_likelihood / fit.transitions),
        "mse": number_or_null(fit.mse),
        "transitions": fit.transitions,
        "simulator_steps": fit.simulator_steps,
        "failed_simulations": fit.failed_simulations,
        "objective_evaluations": fit.objective_evaluations,
        "inner_evaluations": fit.inner_evaluations,
        "wall_time_s": round(fit.wall_time_s, 3),
        "status": fit.status.value,
        "message": fit.message,
        "warnings": list(fit.warnings),
    }
    return {**content, **_further_entries(fit), **fit.details}


def save_fit(fit: Fit, folder: Path) -> None:
    """Write fit.json and fit.npz; each appears whole or not at all.

    Parameters
    ----------
    fit : Fit
    folder : Path
        Made where it is missing.
    """
    arrays: dict[str, Any] = {name: getattr(fit, name) for name in ARRAYS}
    for part in _parts_of(fit):
        arrays |= part.to_arrays()
    write_npz(folder / "fit.npz", {**arrays, **fit.arrays})
    write_json(folder / "fit.json", content_of(fit))


def load_fit(folder: Path) -> Fit:
    """Read the fit that `save_fit` wrote.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    Fit
        With its typed parts; its parameters are bare, and `places` says where they are.

    Raises
    ------
    BadFile
        Where there is none, or one that was cut off, is of a newer version or of wrong types.
    """
    from dropo.core.records.saved_schema import SavedFit
    from dropo.core.services.files.file_schema import read_saved

    path = folder / "fit.json"
    content = read_saved(path, SavedFit, WRITTEN)
    arrays = read_npz(folder / "fit.npz", "the arrays of a fit")
    require_shapes(folder / "fit.npz", arrays, ARRAYS)
    with refusing_faults(path, WRITTEN):
        fit = replace(_fit_from(content, arrays), source=_source_of(folder))
        _check_member(folder / "fit.npz", fit)
    return fit


def _check_member(path: Path, fit: Fit) -> None:
    """Refuse numbers of which the fit's family has more or fewer, where it is known here."""
    try:
        family = find("families", fit.family)(fit.space)
    except UnknownName:
        return
    count = len(family.unknowns)
    if len(fit.phi) != count:
        rule = f"{count} numbers, which name a member of the family {fit.family}"
        raise BadFile(path, "phi", rule, f"{len(fit.phi)}")


def _source_of(folder: Path) -> str:
    """The problem of the run that left a fit: a file by its path, or a built-in name."""
    from dropo.core.records.saved_schema import SavedMade
    from dropo.core.services.files.file_schema import read_saved

    path = folder / MADE
    if not path.is_file():
        return ""
    named = str(read_saved(path, SavedMade, "how a run of dropo was made")["problem"])
    place = (folder / named).resolve()
    return str(place) if place.is_file() else named


def _rows_of(fit: Fit) -> dict[str, dict[str, Any]]:
    """The entry of each parameter."""
    columns = {name: getattr(fit, name) for name in COLUMNS}
    degrees = fit.degrees_of_freedom
    if fit.variance_se is not None:
        columns["variance_se"] = fit.variance_se
    columns["degrees"] = np.full(len(fit.mean), np.inf) if degrees is None else degrees
    intervals = fit.interval()
    of_sd = fit.sd_interval()
    rows = {}
    for i, p in enumerate(fit.space):
        numbers = {key: number_or_null(values[i]) for key, values in columns.items()}
        rows[p.name] = numbers | {
            "mean_interval": [number_or_null(end) for end in intervals[i]],
            "sd_interval": [number_or_null(end) for end in of_sd[i]],
            "unit": p.unit,
            "low": p.low,
            "high": p.high,
            "lower": number_or_null(p.lower),
            "upper": number_or_null(p.upper),
            "search_scale": p.scale,
        }
    return rows


def _further_entries(fit: Fit) -> dict[str, Any]:
    """The entries of what not every fit has."""
    found: dict[str, Any] = {}
    if fit.correlation_se is not None:
        rows = fit.correlation_se.tolist()
        found["correlation_se"] = [[number_or_null(error) for error in row] for row in rows]
    if fit.model_places:
        found["places"] = fit.model_places
    if fit.likelihood:
        found |= {"likelihood": fit.likelihood, "optimizer": fit.optimizer}
    found |= _entries(fit.emulator_check) | _entries(fit.start_filter)
    if fit.constant_parameters is not None:
        found["certified"] = list(fit.constant_parameters)
    found |= _entries(fit.search_record) | _entries(fit.posterior)
    if fit.identifiability is not None:
        found["identifiability"] = list(fit.identifiability)
    found |= _entries(fit.model_check) | _entries(fit.priors)
    if fit.truth:
        found["truth"] = dict(fit.truth)
    for part in (fit.held_out, fit.groups, fit.noise_tuning, fit.horizon_choice, fit.excluded):
        found |= _entries(part)
    return found


def _entries(part: FitPart | None) -> dict[str, Any]:
    """A part's entries of fit.json; none where it is missing."""
    return {} if part is None else part.to_json()


def _parts_of(fit: Fit) -> list[FitPart]:
    """The parts that a fit has."""
    found = [getattr(fit, name) for name in ("search_record", *PARTS)]
    return [part for part in found if part is not None]


def _fit_from(content: dict[str, Any], arrays: dict[str, Array]) -> Fit:
    """The fit from the content of both files."""
    rows = content["parameters"]
    columns = {key: np.array([number_or_nan(row[key]) for row in rows.values()]) for key in COLUMNS}
    space = ParameterSpace(tuple(_parameter(name, row) for name, row in rows.items()))
    saved: dict[str, Any] = {key: content[key] for key in SCALARS}
    saved |= {key: arrays[key] for key in ARRAYS}
    saved |= columns
    saved |= _read_parts(content, arrays)
    fit = Fit(
        **saved,
        variance_se=_variance_errors(rows),
        degrees_of_freedom=_degrees(rows, columns["mean_se"]),
        space=space,
        mse=number_or_nan(content["mse"]),
        log_likelihood=number_or_nan(content["log_likelihood"]),
        status=Status(content["status"]),
        warnings=tuple(content["warnings"]),
        correlation_se=_matrix(content.get("correlation_se")),
        places=content.get("places", {}),
        likelihood=content.get("likelihood", ""),
        optimizer=content.get("optimizer", ""),
        constant_parameters=_texts(content.get("certified")),
        identifiability=_texts(content.get("identifiability")),
        truth=content.get("truth", {}),
    )
    return _with_outside_entries(fit, content, arrays)


def _read_parts(content: dict[str, Any], arrays: dict[str, Array]) -> dict[str, FitPart]:
    """The parts that the files hold, by the fit's field."""
    kinds = {name: kind for name, kind in PARTS.items() if kind.keys[0] in content}
    record = SEARCH_RECORDS.get(content["method"])
    if record is not None:
        kinds["search_record"] = record
    return {name: kind.from_json(content, arrays) for name, kind in kinds.items()}


def _with_outside_entries(fit: Fit, content: dict[str, Any], arrays: dict[str, Array]) -> Fit:
    """The fit with the entries and arrays that none of its own fields holds."""
    known_entries = set(content_of(fit))
    known_arrays = set(ARRAYS).union(*(part.array_names for part in _parts_of(fit)))
    return replace(
        fit,
        details={key: value for key, value in content.items() if key not in known_entries},
        arrays={name: array for name, array in arrays.items() if name not in known_arrays},
    )


def _texts(saved: list[str] | None) -> tuple[str, ...] | None:
    """A list of texts that may be missing."""
    return None if saved is None else tuple(saved)


def _matrix(saved: list[list[float | None]] | None) -> Array | None:
    """A matrix of numbers that may be null, which may be missing."""
    if saved is None:
        return None
    return np.array([[number_or_nan(value) for value in row] for row in saved])


def _variance_errors(rows: dict[str, Any]) -> Array | None:
    """The standard errors of variances, which may be missing."""
    if not all("variance_se" in row for row in rows.values()):
        return None
    return np.array([number_or_nan(row["variance_se"]) for row in rows.values()])


def _degrees(rows: dict[str, Any], mean_se: Array) -> Array:
    """(d,) degrees of freedom, infinite where null, NaN without a standard error."""
    saved = [row.get("degrees") for row in rows.values()]
    degrees = np.array([np.inf if value is None else float(value) for value in saved])
    return np.where(np.isfinite(mean_se), degrees, np.nan)


def _parameter(name: str, row: dict[str, Any]) -> Parameter:
    """A bare parameter from its entry."""
    return Parameter(
        name,
        row["low"],
        row["high"],
        row["unit"],
        lower=-np.inf if row["lower"] is None else float(row["lower"]),
        upper=np.inf if row["upper"] is None else float(row["upper"]),
        scale=row["search_scale"],
    )
