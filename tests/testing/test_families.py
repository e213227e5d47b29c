"""`check_family` meets families broken on purpose."""

import numpy as np
import pytest
from scipy.special import ndtri

from dropo.core.contracts.family import Family
from dropo.core.numerics.standard_distributions import NORMAL
from dropo.core.records.parameters import ParameterSpace
from dropo.families.full_gaussian import FullGaussian
from dropo.families.truncated_gaussian import SD, TruncatedGaussian
from dropo.families.uniform import Uniform
from dropo.testing import check_family


class SigmaForSd(TruncatedGaussian):
    """Forgets that truncation makes the standard deviation smaller than sigma."""

    def sd(self, phi):
        return self.scale(phi)


class NotTruncated(TruncatedGaussian):
    """Draws from the whole Gaussian."""

    standard = NORMAL

    def _draw(self, phi, base):
        return self.mean(phi) + self.scale(phi) * ndtri(base)


class OffCentre(Uniform):
    """Takes the mean for the lower end."""

    def _draw(self, phi, base):
        return self.mean(phi) + 2 * self.scale(phi) * base


class OwnStream(Uniform):
    """Ignores the base points."""

    stream = np.random.default_rng(0)

    def _draw(self, phi, base):
        return super()._draw(phi, self.stream.random(base.shape))


class Standardised(Uniform):
    """Moves the sample to the exact mean, so that draws depend on each other."""

    def _draw(self, phi, base):
        return super()._draw(phi, np.clip(base - base.mean(axis=0) + 0.5, 0, 1))


class Clipped(TruncatedGaussian):
    """Puts infeasible draws on the bound at once."""

    def _draw(self, phi, base):
        return self.space.feasible(super()._draw(phi, base))


class Escapes(TruncatedGaussian):
    """Ignores the feasible bounds."""

    def draw(self, phi, base):
        return self._draw(phi, base[0])


class WrongSign(FullGaussian):
    """Reports the correlations with the other sign."""

    def correlation(self, phi):
        return 2 * np.eye(len(self.space)) - super().correlation(phi)


class ScaleNotNamed(Uniform):
    """Calls its half widths something else."""

    def __init__(self, space):
        super().__init__(space)
        self.unknowns = ParameterSpace(self.unknowns[: len(space)])


class Overwrites(Uniform):
    """Works in the array it is given."""

    def _draw(self, phi, base):
        base -= 0.5
        return self.mean(phi) + 2 * self.scale(phi) * base


class NamesAnother(Uniform):
    """Uniform draws under the name of a normal distribution."""

    standard = NORMAL


class OneColumn(Uniform):
    """Gives the first parameter alone."""

    def draw(self, phi, base):
        return super().draw(phi, base)[:, :1]


class NoUnknowns(Uniform):
    """Names no unknowns."""

    def __init__(self, space):
        Family.__init__(self, space)


class ListOfUnknowns(Uniform):
    """Gives a list of names."""

    def __init__(self, space):
        super().__init__(space)
        self.unknowns = list(self.unknowns.names)


class NoDraws(Uniform):
    """Forgets to return its draws."""

    def _draw(self, phi, base):
        super()._draw(phi, base)


class NoMean(Uniform):
    """Forgets to return its mean."""

    def mean(self, phi):
        super().mean(phi)


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (NoUnknowns, "NoUnknowns sets no `unknowns`, the ParameterSpace of phi"),
        (ListOfUnknowns, "ListOfUnknowns.unknowns is list, not the ParameterSpace of phi"),
        (NoDraws, "NoDraws._draw gives NoneType, not an array"),
        (NoMean, "NoMean.mean gives NoneType, not an array"),
        (lambda space: None, "gives NoneType, which is no Family"),
        (SigmaForSd, "the sd of 20000 draws of SigmaForSd is .* standard errors"),
        (NotTruncated, "the sd of 20000 draws of NotTruncated"),
        (OffCentre, "the mean of 20000 draws of OffCentre"),
        (OwnStream, "OwnStream.draw is not deterministic"),
        (Standardised, "a draw of Standardised depends on the base points of other draws"),
        (Clipped, "Clipped puts .* of its draws on a bound instead of drawing them again"),
        (Escapes, "Escapes.draw leaves what is physically possible"),
        (WrongSign, "the correlation of 20000 draws of WrongSign"),
        (ScaleNotNamed, "ScaleNotNamed.unknowns has no 'scale.a'"),
        (Overwrites, "Overwrites.draw changes the base points"),
        (NamesAnother, "NamesAnother names a standard distribution, but its draws are no affine"),
        (OneColumn, r"OneColumn.draw gives shape \(64, 1\), not \(64, 3\)"),
    ],
)
def test_broken_families_are_caught(broken: type[Family], words):
    """Each defect gets the message that names it."""
    with pytest.raises(AssertionError, match=words):
        check_family(broken)


def test_too_few_draws_are_reported():
    """A check that could not tell a wrong mean says so, instead of passing."""
    with pytest.raises(AssertionError, match="30 draws of Uniform are too few"):
        check_family(Uniform, draws=30)


def test_the_forgotten_factor_is_small():
    """What SigmaForSd gets wrong is 12 %: the check sees that much."""
    assert 0.11 < 1 - SD < 0.13
