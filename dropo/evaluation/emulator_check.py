"""Checks a local likelihood against the true simulator at the fit, at the same draws, so that the
comparison is not lost in noise.
"""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit_parts import EmulatorCheck
from dropo.core.services.registry import find
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class EmulatorCheckSettings:
    """How the check is made.

    Attributes
    ----------
    draws : int
        Draws of the fitted distribution.
    alike : int
        Draws of one in which nothing varies.
    segments : int
        About how many segments are simulated.
    tolerance : float
        Nats a row by which emulator and simulator may differ.
    """

    draws: int = 32
    alike: int = 8
    segments: int = 100
    tolerance: float = 0.1


SETTINGS = EmulatorCheckSettings()


def check_emulator(
    problem: Problem,
    run: Run,
    family: Family,
    local: LocalLogLikelihood,
    phi: Array,
    rng: np.random.Generator,
    *,
    alike: bool = False,
    confirmed: bool = False,
    settings: EmulatorCheckSettings = SETTINGS,
) -> tuple[EmulatorCheck, list[str]]:
    """Compare the log-likelihoods of an emulator and of its simulator at a fit.

    Both predict the same draws of the fitted distribution on the same rows; the log-likelihoods
    are those of the Gaussian with their sample moments.

    Parameters
    ----------
    problem : Problem
        Its simulator is the true one.
    run : Run
        Counts the simulations.
    family : Family
        Of the fitted distribution.
    local : LocalLogLikelihood
        The emulator's likelihood.
    phi : (m,) array
        The fit's unknowns, those of the family first.
    rng : numpy.random.Generator
        Draws the parameters.
    alike : bool
        Whether no parameter varies.
    confirmed : bool
        Whether simulations have confirmed the local model where the likelihood uses it, as at the
        groups of random effects: a difference at draws is then recorded alone.
    settings : EmulatorCheckSettings
        How many draws and rows, and which difference is reported.

    Returns
    -------
    check : EmulatorCheck
        Both log-likelihoods.
    warnings : list of str
        Where simulator and emulator differ too much, or draws are physically impossible.
    """
    family_phi = phi[: len(family.unknowns)]
    count = settings.alike if alike else settings.draws
    base = family.base(count, rng)
    values = family.draw(family_phi, base)
    warnings = _impossible_draws(family, family.map(family_phi, base[0]))
    chosen = problem.segments.thin(settings.segments)
    segments = problem.segments.take(chosen)
    rows = np.flatnonzero(np.isin(problem.segments.rows[0], chosen))
    compared = len(rows)
    with run.counting(evaluations=1):
        simulated = problem.simulator.predict(values, segments)
    gaussian = find("likelihoods", "monte-carlo")(draws=count)
    targets = problem.simulator.targets(segments)
    epsilon = local.epsilon(phi)
    true = gaussian.log_density(simulated, targets, epsilon).sum()
    emulated = gaussian.log_density(local.predict_rows(values, rows), targets, epsilon).sum()
    difference = float(true - emulated)
    check = EmulatorCheck(count, compared, _or_nan(true), _or_nan(emulated))
    agree = np.isfinite(difference) and abs(difference) <= settings.tolerance * compared
    if not (agree or confirmed):
        apart = f"the simulator and its emulator differ by {difference / compared:.2g} nat a row"
        warnings.append(f"at the fit {apart}: check with likelihood 'monte-carlo'")
    return check, warnings


def _impossible_draws(family: Family, values: Array) -> list[str]:
    """A warning where draws (K, d), as they come, leave what is physically possible: local
    likelihoods take the distribution without redraws.
    """
    space = family.space
    fraction = ((values < space.lower) | (values > space.upper)).mean(axis=0)
    pairs = zip(space.names, fraction, strict=True)
    names = [f"{name} ({100 * part:.0f} %)" for name, part in pairs if part > 0]
    if not names:
        return []
    remedy = "take family 'log_normal', or likelihood 'monte-carlo'"
    return [f"draws of {', '.join(names)} lie beyond what is possible: {remedy}"]


def _or_nan(value: float) -> float:
    """The value, or NaN where it is not finite."""
    return float(value) if np.isfinite(value) else np.nan


def parameters_without_spread(
    family: Family, local: LocalLogLikelihood, phi: Array, tolerance: float = 1e-6
) -> list[str]:
    """Return the parameters of which the likelihood itself says that they do not vary.

    Parameters
    ----------
    family : Family
        Of the fitted distribution.
    local : LocalLogLikelihood
        A local likelihood, which has scores.
    phi : (m,) array
        Its maximum.
    tolerance : float
        Relative distance to the lower bound at which a scale is on it.

    Returns
    -------
    list of str
        Names of those whose scale is at its lower bound with a negative score.
    """
    score = local.value_score_information(phi)[1].sum(axis=0)
    unknowns = local.unknowns.names
    found = []
    for name in family.space.names:
        scale = f"scale.{name}"
        if scale not in unknowns:
            continue
        place = unknowns.index(scale)
        lowest = family.unknowns[scale].low * (1 + tolerance)
        if phi[place] <= lowest and score[place] < 0:
            found.append(name)
    return found
