"""How well the fitted mean predicts data that no fit has seen, beside the model as it was."""

from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array


def held_out_errors(problem: Problem, run: Run, mean: Array) -> dict[str, Any]:
    """Root mean square errors on the held-out trajectories; {} where there are none.

    rmse: the norm of all signals of one unit ("m", "rad/s", ...) together, at the fitted mean (d,);
    rmse_nominal: with the parameters as they stand in the model; null where a simulation diverged.
    """
    if problem.held_out is None:
        return {}
    segments = problem.cut(problem.held_out)
    nominal = problem.simulator.nominal
    values = np.stack([mean] if nominal is None else [mean, nominal])
    with run.counting(evaluations=1):
        errors = problem.simulator.predict(values, segments) - problem.simulator.targets(segments)
    by_unit = [_norms(problem, squares) for squares in np.mean(errors**2, axis=1)]
    found = {
        "rows": len(segments.rows[0]),
        "steps": int(segments.lengths.max()),
        "rmse": by_unit[0],
    }
    return {"held_out": found if nominal is None else {**found, "rmse_nominal": by_unit[1]}}


def _norms(problem: Problem, squares: Array) -> dict[str, float | None]:
    units = [signal.unit or "-" for signal in problem.simulator.signals]
    sums = {
        unit: float(sum(s for s, u in zip(squares, units, strict=True) if u == unit))
        for unit in dict.fromkeys(units)
    }
    return {
        unit: float(np.sqrt(total)) if np.isfinite(total) else None for unit, total in sums.items()
    }
