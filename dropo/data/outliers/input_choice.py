"""Which of several logged inputs to trust, the commanded torque or the one from the current: by
held-out likelihood.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import t as student_t

from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Ints, Segments, Trajectories
from dropo.core.services.tables import Report, Table, number
from dropo.core.services.validation import Array, require
from dropo.data.outliers.disturbances import cut, robust_values

DEGREES = 4.0  # of freedom of the errors' Student t
BLOCKS = 24  # of time whose gains are taken as independent
SURE = 2.5  # standard errors of the gain from which one is called better


@dataclass(frozen=True, repr=False)
class InputChoice(Report):
    """The candidates, best first. gain, se: of the best over each, in nats per window held out (0
    for the best itself), with the standard error; rmse: of each, by signal, over the windows;
    values: of the parameters, fitted under each.
    """

    names: tuple[str, ...]
    gain: tuple[float, ...]
    se: tuple[float, ...]
    rmse: dict[str, dict[str, float]]
    values: dict[str, dict[str, float]]

    @property
    def best(self) -> str:
        """The input under which the model predicts best."""
        return self.names[0]

    @property
    def sure(self) -> bool:
        """Whether it is better than the second by more than chance."""
        return self.gain[1] > SURE * self.se[1]

    def parts(self) -> list[str | Table]:
        """Which one to trust, and a table of all."""
        rows = tuple(
            (
                name,
                "-" if i == 0 else f"{gain:.3g} +- {se:.2g}",
                *(number(error, 3) for error in self.rmse[name].values()),
            )
            for i, (name, gain, se) in enumerate(zip(self.names, self.gain, self.se, strict=True))
        )
        return [
            self._sentence(),
            Table("", ("input", "less likely [nats a window]", *self.rmse[self.best]), rows),
        ]

    def _sentence(self) -> str:
        if self.sure:
            return f"The input to trust is {self.best!r}: data held out are most likely under it."
        return f"The data do not tell {self.names[0]!r} from {self.names[1]!r}."

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {**asdict(self), "sure": self.sure}


def choose_input(
    simulator: Simulator,
    candidates: Mapping[str, Trajectories],
    start: ArrayLike,
    step: float,
    *,
    seconds: float = 0.1,
) -> InputChoice:
    """The candidate under which the simulator, fitted anew for each, predicts windows best that the
    fit has not seen.

    candidates: the same trajectories with other actions, by name; start: (d,) where the fits begin;
    step: of the control [s];
    seconds: of a window. Fitted on the even blocks (trajectories, or blocks of time where there are
    fewer than four) and judged on the odd ones, and the other way round. The parameters must be
    able to make up for a gain where an input is only scaled.
    """
    require(
        len(candidates) >= 2, "candidates", "at least two inputs", list(candidates), "choose_input"
    )
    first = next(iter(candidates.values()))
    for name, data in candidates.items():
        same = np.array_equal(data.observations, first.observations) and np.array_equal(
            data.terminals, first.terminals
        )
        require(
            same, "candidates", "of the same observations", f"others under {name!r}", "choose_input"
        )
    length = max(1, round(seconds / step))
    block = _blocks(first)
    judged = _judged(
        simulator, candidates, block, np.asarray(start, dtype=float), step, seconds, length
    )
    windows = cut(first, length)
    where = block[windows.steps[:, 0]]
    whole = where == block[windows.steps[:, -1]]
    order = sorted(candidates, key=lambda name: -judged[name][0][whole].sum())
    gains = [judged[order[0]][0] - judged[name][0] for name in order]
    sums = np.array(
        [[gain[whole & (where == b)].sum() for b in np.unique(where[whole])] for gain in gains]
    )
    n = int(whole.sum())
    se = np.sqrt(sums.shape[1]) * sums.std(axis=1, ddof=1) / n
    signals = [signal.name for signal in simulator.signals]
    rmse = {
        name: dict(
            zip(
                signals, np.sqrt(np.mean(judged[name][1][whole] ** 2, axis=0)).tolist(), strict=True
            )
        )
        for name in order
    }
    values = {
        name: dict(zip(simulator.space.names, judged[name][2].tolist(), strict=True))
        for name in order
    }
    return InputChoice(
        tuple(order), tuple((sums.sum(axis=1) / n).tolist()), tuple(se.tolist()), rmse, values
    )


def _blocks(data: Trajectories) -> Ints:
    """(N,) trajectories, or blocks of time where there are fewer than four."""
    if len(data.spans) >= 4:
        return data.trajectory
    return np.arange(len(data)) * BLOCKS // len(data)


def _judged(
    simulator: Simulator,
    candidates: Mapping[str, Trajectories],
    block: Ints,
    start: Array,
    step: float,
    seconds: float,
    length: int,
) -> dict[str, tuple[Array, Array, Array]]:
    """Of each candidate, log densities (W,) and errors (W, p) of all windows, each under its fit to
    the other half, and the mean of its two fits (d,).

    The noise is of one scale for all, that of their errors on the half that they were fitted to: of
    a scale of its own, a candidate that explains the calmer half better would be thought less
    likely in the wilder one.
    """
    windows = {name: cut(data, length) for name, data in candidates.items()}
    odd = block[next(iter(windows.values())).steps[:, 0]] % 2
    found = {
        name: (
            np.empty(len(odd)),
            np.empty((len(odd), len(simulator.signals))),
            np.zeros(len(start)),
        )
        for name in candidates
    }
    for half in (0, 1):
        seen = np.flatnonzero(block % 2 != half)
        mine = np.flatnonzero(odd == half)
        rest = []
        for name, data in candidates.items():
            value = (
                robust_values(simulator, data.rows(seen), step, start, seconds=seconds)
                if len(start)
                else start
            )
            rest.append(_errors(simulator, cut(data.rows(seen), length), value))
            found[name][1][mine] = _errors(simulator, windows[name].take(mine), value)
            found[name][2][:] += value / 2
        scale = np.nanmedian(np.abs(np.concatenate(rest)), axis=0) / student_t.ppf(0.75, DEGREES)
        for log, errors, _ in found.values():
            log[mine] = np.asarray(
                student_t.logpdf(np.nan_to_num(errors[mine], nan=1e6), DEGREES, scale=scale)
            ).sum(axis=1)
    return found


def _errors(simulator: Simulator, windows: Segments, value: Array) -> Array:
    return np.asarray(simulator.targets(windows) - simulator.predict(value[None], windows)[0])
