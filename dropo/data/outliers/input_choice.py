"""Which of several logged inputs to trust, the commanded torque or the one from the current: by
held-out likelihood.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.tails import student_quantile
from dropo.core.records.trajectories import Ints, Segments, Trajectories
from dropo.core.services.tables import Report, Table, number
from dropo.core.services.validation import Array, require
from dropo.data.outliers.disturbances import cut, robust_values


@dataclass(frozen=True)
class InputChoiceSettings:
    """How inputs are compared.

    Attributes
    ----------
    degrees : float
        Degrees of freedom of the errors' Student t.
    few_trajectories : int
        Number of trajectories below which blocks of time take their place.
    blocks : int
        Blocks of time, whose gains count as independent.
    sure : float
        Standard errors of the gain from which an input is better.
    """

    degrees: float = 4.0
    few_trajectories: int = 4
    blocks: int = 24
    sure: float = 2.5


SETTINGS = InputChoiceSettings()


@dataclass(frozen=True, repr=False)
class InputChoice(Report):
    """The candidate inputs, best first.

    Attributes
    ----------
    names : tuple of str
        The inputs.
    gain, se : tuple of float
        Of the best over each, and its standard error [nats per window held out]; 0 for the best
        itself.
    rmse : dict of str to dict
        For each input the root mean square error of each signal over the windows, in its unit.
    values : dict of str to dict
        For each input the fitted parameters.
    settings : InputChoiceSettings
        How they were compared.
    """

    names: tuple[str, ...]
    gain: tuple[float, ...]
    se: tuple[float, ...]
    rmse: dict[str, dict[str, float]]
    values: dict[str, dict[str, float]]
    settings: InputChoiceSettings = SETTINGS

    @property
    def best(self) -> str:
        """The input under which the model predicts best."""
        return self.names[0]

    @property
    def sure(self) -> bool:
        """Whether it is better than the second by more than chance."""
        return self.gain[1] > self.settings.sure * self.se[1]

    def parts(self) -> list[str | Table]:
        """Return a sentence on which one to trust, and a table of all."""
        rows = []
        for name, gain, se in zip(self.names, self.gain, self.se, strict=True):
            deficit = "-" if name == self.best else f"{gain:.3g} +- {se:.2g}"
            errors = [number(error, 3) for error in self.rmse[name].values()]
            rows.append((name, deficit, *errors))
        header = ("input", "less likely [nats a window]", *self.rmse[self.best])
        return [self._sentence(), Table("", header, tuple(rows))]

    def _sentence(self) -> str:
        """Which one to trust."""
        if self.sure:
            return f"The input to trust is {self.best!r}: data held out are most likely under it."
        return f"The data do not tell {self.names[0]!r} from {self.names[1]!r}."

    def to_json(self) -> dict[str, Any]:
        """Plain numbers.

        Returns
        -------
        dict
            Plain numbers and texts, by key.
        """
        found = asdict(self)
        del found["settings"]
        return {**found, "sure": self.sure}


@dataclass(frozen=True, eq=False)
class _Evaluation:
    """One input: log densities (W,) and errors (W, p) of all windows, and parameters (d,)."""

    log_density: Array
    errors: Array
    value: Array


def choose_input(
    simulator: Simulator,
    candidates: Mapping[str, Trajectories],
    start: ArrayLike,
    step: float,
    *,
    seconds: float = 0.1,
    settings: InputChoiceSettings = SETTINGS,
) -> InputChoice:
    """Choose the input under which a simulator, fitted anew for each, predicts unseen windows best.

    Fitted on the even blocks (trajectories, or blocks of time where there are few) and evaluated on
    the odd ones, and the other way round.

    Parameters
    ----------
    simulator : Simulator
        Its d parameters must be able to compensate a gain where an input is only scaled.
    candidates : mapping of str to Trajectories
        The same trajectories with other actions, by name.
    start : (d,) array
        Where the fits begin.
    step : float
        Of the control [s].
    seconds : float
        Horizon of the windows [s].
    settings : InputChoiceSettings
        How inputs are compared.

    Returns
    -------
    InputChoice

    Raises
    ------
    BadArgument
        If there are fewer than two inputs, or their observations or terminals differ.
    """
    two = "at least two inputs"
    require(len(candidates) >= 2, "candidates", two, list(candidates), "choose_input")
    first = next(iter(candidates.values()))
    for name, data in candidates.items():
        observations = np.array_equal(data.observations, first.observations)
        same = observations and np.array_equal(data.terminals, first.terminals)
        others = f"others under {name!r}"
        require(same, "candidates", "of the same observations", others, "choose_input")
    length = max(1, round(seconds / step))
    block = _blocks(first, settings)
    value = np.asarray(start, dtype=float)
    found = _evaluate(simulator, candidates, block, value, step, seconds, length, settings)

    # The gain of the best over each, summed over blocks; windows across two blocks do not count.
    windows = cut(first, length)
    block_of = block[windows.steps[:, 0]]
    whole = block_of == block[windows.steps[:, -1]]
    order = sorted(candidates, key=lambda name: -found[name].log_density[whole].sum())
    sums = []
    for name in order:
        gain = found[order[0]].log_density - found[name].log_density
        sums.append([gain[whole & (block_of == b)].sum() for b in np.unique(block_of[whole])])
    by_block = np.array(sums)
    count = int(whole.sum())
    gains = by_block.sum(axis=1) / count
    errors = np.sqrt(by_block.shape[1]) * by_block.std(axis=1, ddof=1) / count

    # Errors by signal, and parameters.
    signals = [signal.name for signal in simulator.signals]
    rmse = {}
    values = {}
    for name in order:
        own = np.sqrt(np.mean(found[name].errors[whole] ** 2, axis=0))
        rmse[name] = dict(zip(signals, own.tolist(), strict=True))
        fitted = found[name].value.tolist()
        values[name] = dict(zip(simulator.space.names, fitted, strict=True))
    return InputChoice(
        names=tuple(order),
        gain=tuple(gains.tolist()),
        se=tuple(errors.tolist()),
        rmse=rmse,
        values=values,
        settings=settings,
    )


def _blocks(data: Trajectories, settings: InputChoiceSettings) -> Ints:
    """(N,) trajectories, or blocks of time where they are few."""
    if len(data.spans) >= settings.few_trajectories:
        return data.trajectory
    return np.arange(len(data)) * settings.blocks // len(data)


def _evaluate(
    simulator: Simulator,
    candidates: Mapping[str, Trajectories],
    block: Ints,
    start: Array,
    step: float,
    seconds: float,
    length: int,
    settings: InputChoiceSettings,
) -> dict[str, _Evaluation]:
    """Each input's windows, each under the fit to the other half, and the mean of its two fits.

    The noise is of one scale for all, that of their errors on the half that they were fitted to: of
    a scale of its own, an input that explains the calmer half better would be thought less likely
    in the wilder one.
    """
    from scipy.stats import t as student_t  # slow to import

    windows = {name: cut(data, length) for name, data in candidates.items()}
    any_windows = next(iter(windows.values()))
    half_of = block[any_windows.steps[:, 0]] % 2
    shape = (len(half_of), len(simulator.signals))
    found = {
        name: _Evaluation(np.empty(shape[0]), np.empty(shape), np.zeros(len(start)))
        for name in candidates
    }
    for half in (0, 1):
        fitted_rows = np.flatnonzero(block % 2 != half)
        held_out = np.flatnonzero(half_of == half)
        fitted_errors = []
        for name, data in candidates.items():
            part = data.rows(fitted_rows)
            value = start
            if len(start):
                value = robust_values(simulator, part, step, start, seconds=seconds)
            fitted_errors.append(_errors(simulator, cut(part, length), value))
            errors = _errors(simulator, windows[name].take(held_out), value)
            found[name].errors[held_out] = errors
            found[name].value[:] += value / 2
        median = np.nanmedian(np.abs(np.concatenate(fitted_errors)), axis=0)
        scale = median / student_quantile(0.75, settings.degrees)
        for own in found.values():
            errors = np.nan_to_num(own.errors[held_out], nan=1e6)
            density = np.asarray(student_t.logpdf(errors, settings.degrees, scale=scale))
            own.log_density[held_out] = density.sum(axis=1)
    return found


def _errors(simulator: Simulator, windows: Segments, value: Array) -> Array:
    """(W, p) measured less predicted at the ends of windows."""
    return np.asarray(simulator.targets(windows) - simulator.predict(value[None], windows)[0])
