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
from dropo.diagnosis.findings.horizons import Horizon
from dropo.diagnosis.search.library import robot_of

RUNS = 40  # that are compared at most: each is fitted by itself


@dataclass(frozen=True)
class LeftOut:
    """Spans that a diagnosis left out, and their share of the data; inside: the errors at its
    horizon of the model as it came, fitted and extended, on all data held out, those spans too.
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
        """Each span, and the errors with all of them."""
        spans = [f"  left out: {span}" for span in self.spans]
        if len(self.inside) < 2:
            return spans
        told = [
            (
                f"{number(first, 3)} {unit} fitted, "
                f"{number(self.inside[-1].units[unit][0], 3)} {unit} extended"
            )
            for unit, (first, _) in self.inside[-2].units.items()
        ]
        return [
            *spans,
            f"  with them, the errors after {self.inside[-1].steps} steps are {'; '.join(told)}",
        ]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        sides = dict(
            zip(
                ("nominal", "baseline", "extended"),
                (one.to_json() for one in self.inside),
                strict=False,
            )
        )
        return {
            "spans": [span.to_json() for span in self.spans],
            "share": self.share,
            "errors_with_them": sides,
        }


def left_out(quiet: WithoutDisturbances, inside: Sequence[Sequence[Horizon]]) -> LeftOut:
    """What was left out, with the errors on all data held out of each model (one horizon each,
    where the data are long enough).
    """
    return LeftOut(quiet.spans, quiet.share, tuple(one for found in inside for one in found))


def outlier_runs(problem: Problem, extended: Problem, values: Array) -> tuple[OutlierRun, ...]:
    """The runs whose own declared parameters or sizes of causes disagree with the others'; none
    where there are few runs or many.
    """
    base = robot_of(problem)
    data = both_sides(problem)
    causes = robot_of(extended).fixed[len(base.fixed) :]
    simulator = base.with_effects([instance for instance, _ in causes])
    if not len(simulator.space) or data.group is None or data.group.max() >= RUNS:
        return ()
    try:
        found = compare_runs(
            simulator,
            data,
            np.concatenate([values, *(sizes for _, sizes in causes)]),
            base.control_step,
        )
    except (BadArgument, SimulationFailed):  # too few runs, or one whose own values are no machine
        return ()
    own = problem.trajectories
    before = 1 + int((own.trajectory if own.group is None else own.group).max())
    return tuple(
        one if one.run < before else replace(one, run=one.run - before, held_out=True)
        for one in found.odd
    )
