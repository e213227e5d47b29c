"""What no cause explains since it is there at times alone: spans in which something pushes, and
runs that disagree with the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.services.errors import BadArgument, SimulationFailed
from dropo.core.services.tables import number
from dropo.core.services.validation import Array
from dropo.data.outliers.disturbances import Span
from dropo.data.outliers.outlier_runs import OutlierRun, compare_runs
from dropo.data.outliers.without_disturbances import WithoutDisturbances, both_sides
from dropo.diagnosis.findings.accuracy.horizons import Horizon
from dropo.diagnosis.search.library import robot_of


@dataclass(frozen=True)
class LeftOut:
    """Spans that a diagnosis left out.

    Attributes
    ----------
    spans : tuple of Span
        The spans.
    share : float
        The fraction of the data that lies in them.
    inside : sequence of Horizon
        The errors at the windows' horizon on all data held out, those spans too, of the model as
        it came, fitted, and extended.
    """

    spans: tuple[Span, ...]
    share: float
    inside: Sequence[Horizon] = ()

    def __str__(self) -> str:
        count = f"{len(self.spans)} span{'s' * (len(self.spans) > 1)} of time"
        return (
            f"{count}, {self.share:.2%} of the data, in which something acts that no command "
            "explains"
        )

    def lines(self) -> list[str]:
        """Say what was left out, a line each.

        Returns
        -------
        list of str
            Each span, and the errors with all of them.
        """
        spans = [f"  left out: {span}" for span in self.spans]
        if len(self.inside) < 2:
            return spans
        fitted = self.inside[-2].units
        extended = self.inside[-1].units
        errors = []
        for unit, (before, _) in fitted.items():
            after = number(extended[unit][0], 3)
            errors.append(f"{number(before, 3)} {unit} fitted, {after} {unit} extended")
        steps = self.inside[-1].steps
        return [*spans, f"  with them, the errors after {steps} steps are {'; '.join(errors)}"]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers.

        Returns
        -------
        dict
            Plain numbers and texts, by key.
        """
        models = ("nominal", "baseline", "extended")
        errors = {}
        for name, horizon in zip(models, self.inside, strict=False):
            errors[name] = horizon.to_json()
        return {
            "spans": [span.to_json() for span in self.spans],
            "share": self.share,
            "errors_with_them": errors,
        }


def left_out(undisturbed: WithoutDisturbances, inside: Sequence[Sequence[Horizon]]) -> LeftOut:
    """Return what was left out.

    Parameters
    ----------
    undisturbed : WithoutDisturbances
        The problem without the spans.
    inside : sequence of sequence of Horizon
        For each model, the errors on all data held out; empty where the data are too short.

    Returns
    -------
    LeftOut
    """
    errors = tuple(horizon for horizons in inside for horizon in horizons)
    return LeftOut(undisturbed.spans, undisturbed.share, errors)


def outlier_runs(
    problem: Problem, extended: Problem, values: Array, maximum: int = 40
) -> tuple[OutlierRun, ...]:
    """Return the runs that disagree with the others.

    Parameters
    ----------
    problem : Problem
        That was diagnosed.
    extended : Problem
        With the causes.
    values : (d,) array
        Its declared parameters.
    maximum : int
        Runs that are compared at most, as each is fitted by itself.

    Returns
    -------
    tuple of OutlierRun
        By a declared parameter of their own, or a magnitude of a cause. None where there are few
        runs or too many.
    """
    base = robot_of(problem)
    data = both_sides(problem)
    # The causes become parameters beside the declared ones.
    fixed = robot_of(extended).fixed[len(base.fixed) :]
    simulator = base.with_effects([instance for instance, _ in fixed])
    if not len(simulator.space) or data.group is None or data.group.max() >= maximum:
        return ()
    common = np.concatenate([values, *(sizes for _, sizes in fixed)])
    try:
        found = compare_runs(simulator, data, common, base.control_step)
    except (BadArgument, SimulationFailed):
        # Too few runs, or one whose own values make no machine.
        return ()
    # Runs held out are numbered from 0 again.
    train = problem.trajectories
    labels = train.trajectory if train.group is None else train.group
    fitted = 1 + int(labels.max())
    runs = []
    for run in found.outliers:
        if run.run >= fitted:
            run = replace(run, run=run.run - fitted, held_out=True)
        runs.append(run)
    return tuple(runs)
