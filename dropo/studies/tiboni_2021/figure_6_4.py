"""Figure 6.4: what epsilon does to the fitted distribution."""

from typing import Any

import numpy as np

from dropo.core.services.tables import number
from dropo.estimators.dropo import DROPO, SWEEP
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021.hopper_fits import Item, item, problem_of
from dropo.studies.tiboni_2021.hopper_sets import EPSILON, FULL, Size


def figure_6_4(work: Work, seeds: int | None = None, *, size: Size = FULL) -> Study:
    """Total variance and mean squared error against epsilon, and the one that section 5.3 chooses
    (thesis, figure 6.4).
    """
    count = seeds or size.seeds
    swept = work.map(tuned, [item("6.1", "noisy", seed, size) for seed in range(count)])
    columns = {
        name: np.array([[row[name] for row in one["tuning"]] for one in swept])
        for name in ("total_variance", "mse")
    }
    chosen = np.array([one["chosen"] for one in swept])
    shares = [int((chosen == epsilon).sum()) for epsilon in SWEEP]
    lines = [
        (
            f"{epsilon:.0e}",
            *(number(v, 3) for name in columns for v in _spread(columns[name][:, i])),
            str(shares[i]),
        )
        for i, epsilon in enumerate(SWEEP)
    ]
    header = (
        "epsilon",
        "total variance [kg^2]",
        "least",
        "most",
        "mean squared error",
        "least",
        "most",
        "chosen",
    )
    title = (
        f"figure 6.4, noise of variance {EPSILON['noisy']:.0e}: median, least and most of "
        f"{count} data sets"
    )
    remarks = (
        (
            "Chosen is the smallest epsilon whose mean squared error is at most 1.1 times the "
            "least of the sweep; the thesis chooses 1e-5."
        ),
        f"From epsilon {SWEEP[0]:.0e} to 1e-5 the median mean squared error falls by "
        f"{_fall(columns['mse']):.3g} times, the median total"
        f" variance by {_fall(columns['total_variance']):.3g} times.",
    )
    data = {
        "epsilon": list(SWEEP),
        **columns,
        "chosen": chosen,
        "steps": [one["steps"] for one in swept],
    }
    draw = lambda figure: _draw(figure, columns)
    return Study(
        "figure-6.4",
        f"Figure 6.4: the choice of epsilon; {count} data sets",
        (Table(title, header, tuple(lines)),),
        remarks,
        data,
        draw,
    )


def tuned(item: Item) -> dict[str, Any]:
    """The sweep over epsilon on one data set, and the epsilon that it chooses."""
    problem, _ = problem_of(item)
    fit = DROPO(epsilon="tune", sweep=SWEEP).fit(problem, rng=0)
    assert fit.noise_tuning is not None
    return {
        "tuning": [dict(vars(trial)) for trial in fit.noise_tuning.trials],
        "chosen": float(fit.epsilon[0]),
        "steps": fit.simulator_steps,
        "seconds": fit.wall_time_s,
    }


def _spread(values: np.ndarray) -> tuple[float, float, float]:
    return float(np.median(values)), float(values.min()), float(values.max())


def _fall(values: np.ndarray) -> float:
    """The median at epsilon 1e-8 over that at 1e-5."""
    middle = np.median(values, axis=0)
    return float(middle[0] / middle[SWEEP.index(1e-5)])


def _draw(figure: Any, columns: dict[str, np.ndarray]) -> None:
    for axes, (name, values) in zip(figure.subplots(1, 2), columns.items(), strict=True):
        axes.fill_between(SWEEP, values.min(axis=0), values.max(axis=0), alpha=0.2, linewidth=0)
        axes.plot(SWEEP, np.median(values, axis=0), "o-", markersize=4)
        axes.axvline(EPSILON["noisy"], color="gray", linestyle=":", linewidth=1)
        axes.set(
            xscale="log",
            yscale="log",
            xlabel="epsilon",
            title=name.replace("_", " ").replace("mse", "mean squared error"),
        )
