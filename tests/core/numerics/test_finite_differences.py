"""Difference quotients of an axial design."""

import numpy as np

from dropo.core.numerics.finite_differences import axial_design, difference_quotients


def test_quotients_of_an_axial_design():
    """x^2 + 3 y at (1, 1): 2 and 3, exact for central differences of uneven widths too where a
    function is linear.
    """
    design = 1 + axial_design(np.array([0.1, 0.2]), np.array([-0.1, -0.4]))
    values = (design[:, 0] ** 2 + 3 * design[:, 1])[:, None, None]
    np.testing.assert_allclose(
        difference_quotients(values, np.array([0.2, 0.6])), [[[2, 3]]], rtol=1e-12
    )
