"""Whether an effect has one magnitude in all regimes, as a true cause has.

What only acts like the cause has another magnitude where the motion is fast, late in the data, in
contact, or under large commands.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.numerics.tails import chi2_tail
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library, LinearizedWindows
from dropo.diagnosis.search.windows import Windows
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True)
class InvarianceSettings:
    """How magnitudes are compared between regimes.

    Attributes
    ----------
    bins : int
        Quantile bins of each variable.
    level : float
        The magnitude differs if the p-value, corrected for the number of variables, is below this.
    fewest : int
        Windows of a bin below which it is left out.
    z : float
        Standard errors by which a bin must differ from the rest to be named.
    step : float
        Relative change of the magnitude by which responses are differentiated.
    """

    bins: int = 4
    level: float = 0.01
    fewest: int = 5
    z: float = 3.0
    step: float = 0.05


SETTINGS = InvarianceSettings()


@dataclass(frozen=True)
class Invariance:
    """The regime variable in which a magnitude differs most.

    Attributes
    ----------
    variable : str
        A key of `regimes`.
    p_value : float
        That the magnitude is the same in all bins, with the Bonferroni correction.
    sizes : tuple of float
        The magnitude's relative change in each bin, in ascending order of the variable.
    errors : tuple of float
        Their standard errors; 0 where a bin says nothing.
    level : float
        Of the test.
    """

    variable: str
    p_value: float
    sizes: tuple[float, ...]
    errors: tuple[float, ...]
    level: float = SETTINGS.level

    @property
    def constant(self) -> bool:
        """Whether nothing speaks against one magnitude in all regimes."""
        return self.p_value > self.level


def invariance(
    library: Library,
    linearized: LinearizedWindows,
    instance: EffectInstance,
    settings: InvarianceSettings = SETTINGS,
) -> Invariance:
    """Test whether an effect has one magnitude in all regimes.

    The magnitude in each bin is estimated by one Gauss-Newton step; the estimates are compared by
    chi-square.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    linearized : LinearizedWindows
        Windows that the effect was not fitted to.
    instance : EffectInstance
        The effect.
    settings : InvarianceSettings
        Bins and level.

    Returns
    -------
    Invariance
        Of the variable in which the magnitude differs most.
    """
    response = response_of(library, linearized, instance, settings)
    return differing(linearized, response, regimes(linearized.windows, library), settings)


def response_of(
    library: Library,
    linearized: LinearizedWindows,
    instance: EffectInstance,
    settings: InvarianceSettings = SETTINGS,
) -> Array:
    """Return the change of the predictions as an effect's magnitude doubles, by its derivative.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    linearized : LinearizedWindows
        W windows of n measurements under the model with the effect.
    instance : EffectInstance
        The effect.
    settings : InvarianceSettings
        The step of the difference.

    Returns
    -------
    (W, n) array
        0 where a simulation diverges.
    """
    indices = library.indices_of[instance.label]
    space = library.simulator.space
    thetas = np.stack([linearized.theta, linearized.theta])
    thetas[:, indices] *= np.array([[1 + settings.step], [1 - settings.step]])
    upper, lower = library.predict(space.clip(thetas), linearized.windows)
    return np.asarray(np.nan_to_num(upper - lower) / (2 * settings.step))


def drifting(
    library: Library,
    linearized: LinearizedWindows,
    names: tuple[str, ...],
    settings: InvarianceSettings = SETTINGS,
) -> list[str]:
    """Return the declared parameters that change with time in the data.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    linearized : LinearizedWindows
        Windows that they were not fitted to.
    names : tuple of str
        The declared parameters.
    settings : InvarianceSettings
        Bins and level.

    Returns
    -------
    list of str
        Some of the names.
    """
    if not names:
        return []
    windows = linearized.windows
    jacobian = library.jacobian(linearized.theta, np.arange(len(names)), windows)
    time = {"time": regimes(windows, library)["time"]}
    found = []
    for name, response in zip(names, jacobian, strict=True):
        p_value = differing(linearized, response, time, settings).p_value
        if p_value * len(names) < settings.level:
            found.append(name)
    return found


def differing(
    linearized: LinearizedWindows,
    response: Array,
    variables: Mapping[str, Array],
    settings: InvarianceSettings = SETTINGS,
) -> Invariance:
    """Find the variable over whose bins the residuals follow a response differently.

    Parameters
    ----------
    linearized : LinearizedWindows
        W windows of n measurements.
    response : (W, n) array
        Change of the predictions.
    variables : mapping of str to (W,) array
        The variables.
    settings : InvarianceSettings
        Bins and level.

    Returns
    -------
    Invariance
        Of the variable with the smallest p-value.
    """
    score, weight = scores_by_window(linearized, response)
    tests = [_test(name, values, score, weight, settings) for name, values in variables.items()]
    worst = min(tests, key=lambda test: test.p_value)
    p_value = min(1.0, worst.p_value * len(tests))
    return Invariance(worst.variable, p_value, worst.sizes, worst.errors, settings.level)


def scores_by_window(linearized: LinearizedWindows, response: Array) -> tuple[Array, Array]:
    """Return what each window says of the multiple of a response in its residuals.

    Parameters
    ----------
    linearized : LinearizedWindows
        W windows of n measurements.
    response : (W, n) array
        Change of the predictions.

    Returns
    -------
    score, weight : (W,) array
        The estimate from some windows is the sum of their scores over the sum of their weights.
    """
    count = len(linearized.windows)
    along = linearized.flat(response).reshape(count, -1)
    residuals = linearized.flat(linearized.residuals).reshape(count, -1)
    return (along * residuals).sum(axis=1), (along**2).sum(axis=1)


def _test(
    name: str, values: Array, score: Array, weight: Array, settings: InvarianceSettings
) -> Invariance:
    """The test of one variable (W,), without the Bonferroni correction."""
    masks = bins_of(values, settings.bins)
    counts = np.array([mask.sum() for mask in masks])
    total = np.array([weight[mask].sum() for mask in masks])
    sizes = np.array([score[mask].sum() for mask in masks]) / np.maximum(total, 1e-300)
    errors = np.array([_standard_error(score[mask], weight[mask]) for mask in masks])
    used = (total > 1e-6 * total.sum()) & (errors > 0) & (counts >= settings.fewest)
    p_value = 1.0
    if used.sum() >= 2:
        precision = 1 / errors[used] ** 2
        mean = (precision @ sizes[used]) / precision.sum()
        spread = (precision * (sizes[used] - mean) ** 2).sum()
        p_value = float(chi2_tail(spread, used.sum() - 1))
    return Invariance(name, p_value, tuple(sizes.tolist()), tuple(errors.tolist()))


def _standard_error(score: Array, weight: Array) -> float:
    """The standard error of sum(score) / sum(weight), robust to unequal variances.

    By the scores' spread corrected for leverage (MacKinnon and White 1985, HC3), and no less than
    by the weights, which are the scores' variances under the model.
    """
    total = float(weight.sum())
    if not total > 0:
        return 0.0
    left = score - score.sum() / total * weight
    squares = (left / np.maximum(1 - weight / total, 0.05)) ** 2
    return float(np.sqrt(max(squares.sum(), total)) / total)


def bins_of(values: Array, bins: int = SETTINGS.bins) -> list[np.ndarray]:
    """Split windows into quantile bins of a variable.

    Parameters
    ----------
    values : (W,) array
        The variable.
    bins : int
        How many; fewer where values repeat.

    Returns
    -------
    list of (W,) bool array
        In ascending order of the variable.
    """
    if len(np.unique(values)) > 2:
        edges = np.unique(np.quantile(values, np.linspace(0, 1, bins + 1)))
        last = max(len(edges) - 2, 0)
        values = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, last)
    return [values == one for one in np.unique(values)]


def command_variable(actuator: str) -> str:
    """Return the name among `regimes` of an actuator's mean command.

    Parameters
    ----------
    actuator : str
        Its name among the simulator's actions.

    Returns
    -------
    str
    """
    return f"the command of {actuator}"


def command_change_variable(actuator: str) -> str:
    """Return the name among `regimes` of the mean change of an actuator's command.

    Parameters
    ----------
    actuator : str
        Its name among the simulator's actions.

    Returns
    -------
    str
    """
    return f"the change of {command_variable(actuator)}"


def regimes(windows: Windows, library: Library) -> dict[str, Array]:
    """Return what may distinguish windows from each other.

    Parameters
    ----------
    windows : Windows
        W windows.
    library : Library
        Its simulator names signals and actuators, and knows contacts.

    Returns
    -------
    dict of str to (W,) array
        Place in the data, contact, signals at the start, speeds, commands and their changes;
        without those that never change.
    """
    segments = windows.segments
    starts = segments.starts
    actions = segments.actions
    simulator = library.simulator
    if isinstance(simulator, RobotSimulator):
        names = simulator.layout.names
        actuators = simulator.action_names
    else:
        names = [f"signal {i}" for i in range(starts.shape[1])]
        actuators = [f"column {i}" for i in range(actions.shape[2])]

    found = {
        "time": segments.steps[:, 0].astype(float),
        "contact": simulator.in_contact(segments).astype(float),
    }
    for i, name in enumerate(names):
        found[name] = starts[:, i]
    for i, name in enumerate(names):
        if name.startswith("qvel"):
            found[f"|{name}|"] = np.abs(starts[:, i])
    for i, name in enumerate(actuators):
        command = actions[:, :, i]
        change = np.abs(np.diff(command, axis=1, prepend=command[:, :1]))
        found[command_variable(name)] = command.mean(axis=1)
        found[command_change_variable(name)] = change.mean(axis=1)
    return {name: values for name, values in found.items() if np.ptp(values) > 0}


def standing_out(
    windows: Windows, library: Library, excess: Array, settings: InvarianceSettings = SETTINGS
) -> str | None:
    """Return the regime in which an excess is largest, in words.

    Parameters
    ----------
    windows : Windows
        W windows.
    library : Library
        As of `regimes`.
    excess : (W,) array
        A number of each window.
    settings : InvarianceSettings
        Bins, and how much a regime must differ.

    Returns
    -------
    str or None
        None where the excess is the same in all.
    """
    largest = settings.z
    named = None
    for variable, values in regimes(windows, library).items():
        masks = bins_of(values, settings.bins)
        for high, mask in ((False, masks[0]), (len(masks) > 1, masks[-1])):
            inside = excess[mask]
            outside = excess[~mask]
            if min(len(inside), len(outside)) < settings.fewest:
                continue
            variance = inside.var(ddof=1) / len(inside) + outside.var(ddof=1) / len(outside)
            error = np.sqrt(variance)
            z = (inside.mean() - outside.mean()) / error if error > 0 else 0.0
            if z > largest:
                largest = float(z)
                named = _in_words(variable, high)
    return named


def _in_words(variable: str, high: bool) -> str:
    """The regime in which a variable is large, or small."""
    if variable == "contact":
        return "in contact" if high else "out of contact"
    if variable == "time":
        return "late in the data" if high else "early in the data"
    return f"where {variable} is {'large' if high else 'small'}"
