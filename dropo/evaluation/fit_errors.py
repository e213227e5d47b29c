"""How well the fitted mean predicts data that no fit has seen, beside the model as it was."""

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit_parts import HeldOutErrors
from dropo.core.services.validation import Array


def held_out_errors(problem: Problem, run: Run, mean: Array) -> HeldOutErrors | None:
    """Root mean square errors on the held-out trajectories; None where there are none.

    rmse: the norm of all signals of one unit ("m", "rad/s", ...) together, at the fitted mean (d,);
    rmse_nominal: with the parameters as they stand in the model; NaN where a simulation diverged.
    """
    if problem.held_out is None:
        return None
    segments = problem.cut(problem.held_out)
    nominal = problem.simulator.nominal
    values = np.stack([mean] if nominal is None else [mean, nominal])
    with run.counting(evaluations=1):
        errors = problem.simulator.predict(values, segments) - problem.simulator.targets(segments)
    by_unit = [_norms(problem, squares) for squares in np.mean(errors**2, axis=1)]
    return HeldOutErrors(
        rows=len(segments.rows[0]),
        steps=int(segments.lengths.max()),
        rmse=by_unit[0],
        rmse_nominal=None if nominal is None else by_unit[1],
    )


def _norms(problem: Problem, squares: Array) -> dict[str, float]:
    units = [signal.unit or "-" for signal in problem.simulator.signals]
    sums = {
        unit: float(sum(s for s, u in zip(squares, units, strict=True) if u == unit))
        for unit in dict.fromkeys(units)
    }
    return {
        unit: float(np.sqrt(total)) if np.isfinite(total) else np.nan
        for unit, total in sums.items()
    }
