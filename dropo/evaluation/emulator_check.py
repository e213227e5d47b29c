"""Holds a local likelihood against the true simulator at the fit, at the same draws, so that the
comparison is not lost in noise.
"""

from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.local_likelihood import LocalLogLikelihood
from dropo.core.contracts.problem import Problem
from dropo.core.services.registry import find
from dropo.core.services.validation import Array

# draws of the fitted law, on about so many segments
DRAWS = 32
ROWS = 100
SUSPICIOUS = 0.1  # nats a row: beyond it the local model misleads


def paired_check(
    problem: Problem,
    run: Run,
    family: Family,
    local: LocalLogLikelihood,
    phi: Array,
    rng: np.random.Generator,
) -> tuple[dict[str, Any], list[str]]:
    """What the check found, for fit.json, and warnings where simulator and local model differ too
    much, or draws are impossible.

    Both predict the same draws of the fitted law on the same rows; the log-likelihoods are those of
    the Gaussian with their sample moments.
    """
    family_phi = phi[: len(family.unknowns)]
    base = family.base(DRAWS, rng)
    values = family.draw(family_phi, base)
    warnings = _outside(family, family.map(family_phi, base[0]))
    chosen = problem.segments.thin(ROWS)
    segments = problem.segments.take(chosen)
    rows = np.isin(problem.segments.rows[0], chosen)
    with run.counting(evaluations=1):
        simulated = problem.simulator.predict(values, segments)
    gaussian = find("likelihoods", "monte-carlo")(draws=DRAWS)
    targets = problem.simulator.targets(segments)
    epsilon = local.epsilon(phi)
    true, emulated = (
        gaussian.log_density(predictions, targets, epsilon).sum()
        for predictions in (simulated, local.predict(values)[:, rows])
    )
    difference = float(true - emulated)
    found = {
        "draws": DRAWS,
        "rows": int(rows.sum()),
        "simulator": _finite(true),
        "emulator": _finite(emulated),
    }
    if np.isfinite(difference) and abs(difference) <= SUSPICIOUS * rows.sum():
        return {"emulator_check": found}, warnings
    apart = (
        f"at the fit the simulator and its emulator differ by {difference / rows.sum():.2g} "
        "nat a row"
    )
    return {"emulator_check": found}, [*warnings, f"{apart}: check with likelihood 'monte-carlo'"]


def _outside(family: Family, values: Array) -> list[str]:
    """A warning where draws (K, d), as they come, leave what is physically possible: local
    likelihoods take the law without redraws.
    """
    share = ((values < family.space.lower) | (values > family.space.upper)).mean(axis=0)
    names = [
        f"{name} ({100 * part:.0f} %)"
        for name, part in zip(family.space.names, share, strict=True)
        if part > 0
    ]
    return (
        [
            (
                f"draws of {', '.join(names)} lie beyond what is possible: take family "
                "'log_normal', or likelihood 'monte-carlo'"
            )
        ]
        if names
        else []
    )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def certified_scales(family: Family, local: LocalLogLikelihood, phi: Array) -> list[str]:
    """The parameters whose scale is at its lower bound with a negative score: the likelihood itself
    says that they do not vary.
    """
    score = local.value_score_information(phi)[1].sum(axis=0)
    places = {
        name: local.unknowns.names.index(f"scale.{name}")
        for name in family.space.names
        if f"scale.{name}" in local.unknowns.names
    }
    low = {name: family.unknowns[f"scale.{name}"].low for name in places}
    return [name for name, i in places.items() if phi[i] <= low[name] * (1 + 1e-6) and score[i] < 0]
