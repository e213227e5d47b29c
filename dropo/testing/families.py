"""Checks that every distribution family must pass."""

from collections.abc import Callable

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.validation import Array

MAX_Z = 4.5
"""Standard errors between a moment and its estimate: chance alone exceeds it once in 150,000."""


def _spaces() -> tuple[ParameterSpace, ParameterSpace]:
    """Returns a space whose draws are all feasible, and one with feasible bounds near the box."""
    wide = []
    tight = []
    for name, low in (("a", 1.0), ("b", 0.2), ("c", 30.0)):
        high = 3 * low
        wide.append(Parameter(name, low, high, "kg", lower=-np.inf))
        tight.append(Parameter(name, low, high, "kg", lower=0.95 * low, upper=1.05 * high))
    return ParameterSpace(tuple(wide)), ParameterSpace(tuple(tight))


def check_family(
    factory: Callable[[ParameterSpace], Family], *, draws: int = 20_000, max_z: float = MAX_Z
) -> None:
    """Check that the families which a factory makes keep to the contract of `Family`.

    Parameters
    ----------
    factory : callable
        The family's class, or a function from a ParameterSpace to a family.
    draws : int
        Number of draws from which moments are estimated.
    max_z : float
        Largest difference of a moment from its estimate, in standard errors.

    Raises
    ------
    AssertionError
        If a rule is broken; the message says which.
    """
    wide, tight = _spaces()
    family = factory(wide)
    _check_kinds(family, factory)
    _check_unknowns(family)
    _check_base(family)
    rng = np.random.default_rng(0)
    size = len(family.unknowns)
    for unit in (np.full(size, 0.5), *rng.uniform(0.2, 0.9, (3, size))):
        phi = family.unknowns.from_unit(unit)
        _check_draws(family, phi)
        _check_standard(family, phi)
        _check_moments(family, phi, family.sample(phi, draws, rng), max_z)
    _check_feasible(factory(tight))


def _check_kinds(family: object, factory: Callable[[ParameterSpace], Family]) -> None:
    """There is a family with unknowns, and its methods give arrays."""
    made_by = getattr(factory, "__name__", type(factory).__name__)
    assert isinstance(family, Family), (
        f"{made_by} gives {type(family).__name__}, which is no Family"
    )
    name = type(family).__name__
    unknowns = getattr(family, "unknowns", None)
    assert unknowns is not None, (
        f"{name} sets no `unknowns`, the ParameterSpace of phi, such as means_and_scales(space)"
    )
    assert isinstance(unknowns, ParameterSpace), (
        f"{name}.unknowns is {type(unknowns).__name__}, not the ParameterSpace of phi, such as "
        "means_and_scales(space)"
    )
    _check_names(family)
    phi = unknowns.from_unit(np.full(len(unknowns), 0.5))
    base = np.full((2, len(family.space)), 0.4)
    for method, arguments in (("mean", (phi,)), ("sd", (phi,)), ("_draw", (phi, base))):
        given = getattr(family, method)(*arguments)
        assert isinstance(given, np.ndarray), (
            f"{name}.{method} gives {type(given).__name__}, not an array"
        )


def _check_names(family: Family) -> None:
    """The unknowns have a mean and a scale for each parameter."""
    for parameter in family.space.names:
        for kind in ("mean", "scale"):
            assert f"{kind}.{parameter}" in family.unknowns.names, (
                f"{type(family).__name__}.unknowns has no '{kind}.{parameter}'"
            )


def _check_unknowns(family: Family) -> None:
    """`phi` inverts mean and scale."""
    name = type(family).__name__
    mean = family.space.from_unit(np.full(len(family.space), 0.4))
    boxes = [family.unknowns[f"scale.{parameter}"] for parameter in family.space.names]
    scale = np.array([np.sqrt(box.low * box.high) for box in boxes])
    phi = family.phi(mean, scale)
    assert phi.shape == (len(family.unknowns),), (
        f"{name}.phi gives shape {phi.shape}, not ({len(family.unknowns)},)"
    )
    assert np.allclose(family.mean(phi), mean), (
        f"{name}.mean(phi(mean, scale)) is {family.mean(phi)}, not {mean}"
    )
    assert np.allclose(family.scale(phi), scale), (
        f"{name}.scale(phi(mean, scale)) is {family.scale(phi)}, not {scale}"
    )


def _check_base(family: Family) -> None:
    """Base points have the right shape and lie in (0, 1)."""
    base = family.base(50, np.random.default_rng(0))
    expected = (1 + family.redraws, 50, len(family.space))
    assert base.shape == expected, (
        f"{type(family).__name__}.base gives shape {base.shape}, not {expected}"
    )
    assert ((base > 0) & (base < 1)).all(), f"{type(family).__name__}.base leaves (0, 1)"


def _check_draws(family: Family, phi: Array) -> None:
    """Draws are finite, deterministic and independent of each other, and the base is unchanged."""
    name = type(family).__name__
    base = family.base(64, np.random.default_rng(1))
    original = base.copy()
    drawn = family.draw(phi, base)
    assert drawn.shape == (64, len(family.space)), (
        f"{name}.draw gives shape {drawn.shape}, not {(64, len(family.space))}"
    )
    assert np.isfinite(drawn).all(), f"{name}.draw gives values that are not finite"
    assert np.array_equal(original, base), f"{name}.draw changes the base points it is given"
    assert np.array_equal(drawn, family.draw(phi, base)), (
        f"{name}.draw is not deterministic: the same base points gave other draws"
    )
    split = np.concatenate([family.draw(phi, base[:, :9]), family.draw(phi, base[:, 9:])])
    assert np.allclose(drawn, split, rtol=1e-12, atol=0), (
        f"a draw of {name} depends on the base points of other draws"
    )


def _check_standard(family: Family, phi: Array) -> None:
    """Draws, or their logarithms, are an affine map of the standard distribution's quantiles."""
    if family.standard is None:
        return
    base = family.base(64, np.random.default_rng(1))[0]
    values = np.log(family.map(phi, base)) if family.logarithmic else family.map(phi, base)
    design = np.column_stack([np.ones(len(base)), family.standard.quantile(base)])
    residuals = values - design @ np.linalg.lstsq(design, values)[0]
    fraction = float((residuals.std(axis=0) / values.std(axis=0)).max())
    kind = "logarithms of draws" if family.logarithmic else "draws"
    assert fraction < 1e-6, (
        f"{type(family).__name__} names a standard distribution, but its {kind} are no affine "
        "map of that distribution's values"
    )


def _check_moments(family: Family, phi: Array, values: Array, max_z: float) -> None:
    """Mean, standard deviation and correlation are those of the draws `values` (K, d)."""
    name = type(family).__name__
    mean = family.mean(phi)
    sd = family.sd(phi)
    correlation = family.correlation(phi)
    for what, claimed in (("mean", mean), ("sd", sd), ("scale", family.scale(phi))):
        assert np.shape(claimed) == (len(family.space),), (
            f"{name}.{what} has shape {np.shape(claimed)}, not ({len(family.space)},)"
        )
    for what, z, claimed in (
        ("mean", z_of_mean(values, mean), mean),
        ("sd", z_of_sd(values, sd), sd),
        ("correlation", z_of_correlation(values, correlation), correlation),
    ):
        worst = float(np.abs(z).max())
        assert worst < max_z, (
            f"the {what} of {len(values)} draws of {name} is {worst:.1f} standard errors "
            f"from {name}.{what} = {claimed}"
        )
    # a control: a mean or sd that is wrong by a fifth of the sd would have been noticed
    z_wrong_mean = np.abs(z_of_mean(values, mean + 0.2 * sd)).min()
    z_wrong_sd = np.abs(z_of_sd(values, 1.2 * sd)).min()
    assert min(z_wrong_mean, z_wrong_sd) > max_z, (
        f"{len(values)} draws of {name} are too few to tell a wrong mean or sd: give more `draws`"
    )


def _check_feasible(family: Family) -> None:
    """All draws are physically possible, and almost none of them is put on a bound."""
    name = type(family).__name__
    space = family.space
    widest = [family.unknowns[f"scale.{parameter}"].high for parameter in space.names]
    phi = family.phi(space.from_unit(np.full(len(space), 0.5)), widest)
    values = family.draw(phi, family.base(2000, np.random.default_rng(2)))
    assert ((values >= space.lower) & (values <= space.upper)).all(), (
        f"{name}.draw leaves what is physically possible"
    )
    fraction = float(((values == space.lower) | (values == space.upper)).mean())
    assert fraction < 0.01, (
        f"{name} puts {fraction:.0%} of its draws on a bound instead of drawing them again"
    )


def z_of_mean(values: Array, claimed: Array) -> Array:
    """Return the error of a claimed mean in standard errors.

    Parameters
    ----------
    values : (K, d) array
        Independent draws.
    claimed : (d,) array
        The mean that is claimed for them.

    Returns
    -------
    (d,) array
        Estimate minus claim, divided by the standard error of the estimate.
    """
    z: Array = (values.mean(axis=0) - claimed) * np.sqrt(len(values)) / values.std(axis=0)
    return z


def z_of_sd(values: Array, claimed: Array) -> Array:
    """Return the error of a claimed standard deviation in standard errors.

    Parameters
    ----------
    values : (K, d) array
        Independent draws.
    claimed : (d,) array
        The standard deviation that is claimed for them.

    Returns
    -------
    (d,) array
        Estimate minus claim, divided by the standard error of the estimate.

    Notes
    -----
    By the delta method, the standard error is sd sqrt((kurtosis - 1) / K) / 2.
    """
    sd = values.std(axis=0)
    kurtosis = (((values - values.mean(axis=0)) / sd) ** 4).mean(axis=0)
    z: Array = (sd - claimed) / (0.5 * sd * np.sqrt((kurtosis - 1) / len(values)))
    return z


def z_of_correlation(values: Array, claimed: Array) -> Array:
    """Return the error of a claimed correlation matrix in standard errors.

    Parameters
    ----------
    values : (K, d) array
        Independent draws.
    claimed : (d, d) array
        The correlation matrix that is claimed for them.

    Returns
    -------
    (d, d) array
        Estimate minus claim, divided by the standard error of the estimate by the delta method; 0
        on the diagonal where 1 is claimed.
    """
    white = (values - values.mean(axis=0)) / values.std(axis=0)
    estimate = white.T @ white / len(white)
    squares = white**2
    products = white[:, :, None] * white[:, None]
    influence = products - 0.5 * estimate * (squares[:, :, None] + squares[:, None])  # (K, d, d)
    error = influence.std(axis=0) / np.sqrt(len(white)) + 1e-12
    z: Array = (estimate - claimed) / error
    return z
