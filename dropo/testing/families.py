"""What every family must keep to."""

from collections.abc import Callable

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.validation import Array

LIMIT = 4.5  # standard errors: chance alone goes beyond once in 150,000
OPEN = ParameterSpace(
    tuple(
        Parameter(name, low, 3 * low, "kg", lower=-np.inf)
        for name, low in (("a", 1.0), ("b", 0.2), ("c", 30.0))
    )
)
TIGHT = ParameterSpace(
    tuple(
        Parameter(p.name, p.low, p.high, p.unit, lower=0.95 * p.low, upper=1.05 * p.high)
        for p in OPEN
    )
)


def check_family(factory: Callable[[ParameterSpace], Family], *, draws: int = 20_000) -> None:
    """Raises AssertionError, saying what is wrong, unless the families that `factory` makes keep to
    the contract.
    """
    family = factory(OPEN)
    _check_unknowns(family)
    _check_base(family)
    rng = np.random.default_rng(0)
    for unit in (
        np.full(len(family.unknowns), 0.5),
        *rng.uniform(0.2, 0.9, (3, len(family.unknowns))),
    ):
        phi = family.unknowns.from_unit(unit)
        _check_draws(family, phi)
        _check_standard(family, phi)
        _check_moments(family, phi, family.sample(phi, draws, rng))
    _check_feasible(factory(TIGHT))


def _check_unknowns(family: Family) -> None:
    name = type(family).__name__
    for parameter in family.space.names:
        for kind in ("mean", "scale"):
            assert f"{kind}.{parameter}" in family.unknowns.names, (
                f"{name}.unknowns has no '{kind}.{parameter}'"
            )
    mean = family.space.from_unit(np.full(len(family.space), 0.4))
    scale = np.array(
        [
            np.sqrt(family.unknowns[f"scale.{n}"].low * family.unknowns[f"scale.{n}"].high)
            for n in family.space.names
        ]
    )
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
    base = family.base(50, np.random.default_rng(0))
    wanted = (1 + family.redraws, 50, len(family.space))
    assert base.shape == wanted, (
        f"{type(family).__name__}.base gives shape {base.shape}, not {wanted}"
    )
    assert ((base > 0) & (base < 1)).all(), f"{type(family).__name__}.base leaves (0, 1)"


def _check_draws(family: Family, phi: Array) -> None:
    name = type(family).__name__
    base = family.base(64, np.random.default_rng(1))
    given = base.copy()
    drawn = family.draw(phi, base)
    assert drawn.shape == (64, len(family.space)), (
        f"{name}.draw gives shape {drawn.shape}, not {(64, len(family.space))}"
    )
    assert np.isfinite(drawn).all(), f"{name}.draw gives values that are not finite"
    assert np.array_equal(given, base), f"{name}.draw changes the base points it is given"
    assert np.array_equal(drawn, family.draw(phi, base)), (
        f"{name}.draw is not deterministic: the same base points gave other draws"
    )
    alone = np.concatenate([family.draw(phi, base[:, :9]), family.draw(phi, base[:, 9:])])
    assert np.allclose(drawn, alone, rtol=1e-12, atol=0), (
        f"a draw of {name} depends on the base points of other draws"
    )


def _check_standard(family: Family, phi: Array) -> None:
    """Where a standard law is named, draws (or their logarithms) must be an affine map of its
    quantiles.
    """
    if family.standard is not None:
        base = family.base(64, np.random.default_rng(1))[0]
        values = np.log(family.map(phi, base)) if family.logarithmic else family.map(phi, base)
        design = np.column_stack([np.ones(len(base)), family.standard.quantile(base)])
        left = values - design @ np.linalg.lstsq(design, values)[0]
        share = float((left.std(axis=0) / values.std(axis=0)).max())
        kind = "logarithms of draws" if family.logarithmic else "draws"
        assert share < 1e-6, (
            f"{type(family).__name__} names a standard law, but its {kind} are no affine "
            "map of that law's values"
        )


def _check_moments(family: Family, phi: Array, values: Array) -> None:
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
        assert worst < LIMIT, (
            f"the {what} of {len(values)} draws of {name} is {worst:.1f} standard errors "
            f"from {name}.{what} = {claimed}"
        )
    seen = np.abs(z_of_mean(values, mean + 0.2 * sd)).min(), np.abs(z_of_sd(values, 1.2 * sd)).min()
    assert min(seen) > LIMIT, (
        f"{len(values)} draws of {name} are too few to tell a wrong mean or sd: give more `draws`"
    )


def _check_feasible(family: Family) -> None:
    name = type(family).__name__
    space = family.space
    phi = family.phi(
        space.from_unit(np.full(len(space), 0.5)),
        [family.unknowns[f"scale.{n}"].high for n in space.names],
    )
    values = family.draw(phi, family.base(2000, np.random.default_rng(2)))
    assert ((values >= space.lower) & (values <= space.upper)).all(), (
        f"{name}.draw leaves what is physically possible"
    )
    held = float(((values == space.lower) | (values == space.upper)).mean())
    assert held < 0.01, (
        f"{name} puts {held:.0%} of its draws on a bound instead of drawing them again"
    )


def z_of_mean(values: Array, claimed: Array) -> Array:
    """(d,) how many standard errors the mean of draws (K, d) is from the claimed one (d,)."""
    z: Array = (values.mean(axis=0) - claimed) * np.sqrt(len(values)) / values.std(axis=0)
    return z


def z_of_sd(values: Array, claimed: Array) -> Array:
    """(d,) likewise of the standard deviation: its standard error, by the delta method, is sd
    sqrt((kurtosis - 1) / K) / 2.
    """
    sd = values.std(axis=0)
    kurtosis = (((values - values.mean(axis=0)) / sd) ** 4).mean(axis=0)
    z: Array = (sd - claimed) / (0.5 * sd * np.sqrt((kurtosis - 1) / len(values)))
    return z


def z_of_correlation(values: Array, claimed: Array) -> Array:
    """(d, d) likewise of the correlations, by the delta method; 0 on the diagonal where 1 is
    claimed.
    """
    white = (values - values.mean(axis=0)) / values.std(axis=0)
    found = white.T @ white / len(white)
    influence = white[:, :, None] * white[:, None] - 0.5 * found * (
        white[:, :, None] ** 2 + white[:, None] ** 2
    )  # (K, d, d)
    error = influence.std(axis=0) / np.sqrt(len(white)) + 1e-12
    z: Array = (found - claimed) / error
    return z
