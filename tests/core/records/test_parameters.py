"""Parameters and their box."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument, UnknownName

LINEAR = st.tuples(st.floats(-1e3, 1e3), st.floats(1e-2, 1e4)).map(
    lambda x: (x[0], x[0] + x[1], "linear")
)
LOG = st.tuples(st.floats(1e-9, 1e3), st.floats(1.1, 1e9)).map(lambda x: (x[0], x[0] * x[1], "log"))
SPACES = st.lists(st.one_of(LINEAR, LOG), min_size=1, max_size=6).map(
    lambda rows: ParameterSpace(
        tuple(
            Parameter(f"p{i}", low, high, scale=scale) for i, (low, high, scale) in enumerate(rows)
        )
    )
)


@settings(deadline=None, derandomize=True)
@given(SPACES, st.data())
def test_unit_box_and_back(space, data):
    """to_unit inverts from_unit, whose points lie in the box; the corners are exact."""
    unit = np.array(data.draw(st.lists(st.floats(0, 1), min_size=len(space), max_size=len(space))))
    values = space.from_unit(unit)
    assert ((values >= space.low) & (values <= space.high)).all()
    np.testing.assert_allclose(space.to_unit(values), unit, atol=1e-9)
    np.testing.assert_allclose(space.from_unit(np.zeros(len(space))), space.low)
    np.testing.assert_allclose(space.from_unit(np.ones(len(space))), space.high)


@settings(deadline=None, derandomize=True)
@given(SPACES)
def test_many_points_at_once(space):
    """Leading axes go through: (4, 3, d) -> (4, 3, d), point by point the same."""
    unit = np.random.default_rng(0).random((4, 3, len(space)))
    values = space.from_unit(unit)
    assert values.shape == unit.shape
    np.testing.assert_array_equal(values[2, 1], space.from_unit(unit[2, 1]))
    np.testing.assert_allclose(space.to_unit(values), unit, atol=1e-9)


def test_middle_of_a_log_scale():
    """The middle is the arithmetic mean on a linear scale, the geometric one on a log scale."""
    space = ParameterSpace(
        (Parameter("mass", 1.0, 4.0), Parameter("damping", 1.0, 4.0, scale="log"))
    )
    np.testing.assert_allclose(space.from_unit([0.5, 0.5]), [2.5, 2.0])


@pytest.mark.parametrize(("low", "lower"), [(2.0, 0.2), (0.0, 0.0), (-1.0, -np.inf)])
def test_what_is_physically_possible_by_default(low, lower):
    """A tenth of a positive low, 0 where low is 0, and no limit below a negative one."""
    assert Parameter("x", low, 3.0).lower == lower
    space = ParameterSpace((Parameter("x", low, 3.0),))
    np.testing.assert_array_equal(
        space.feasible(np.array([[-5.0], [9.0]])), [[max(lower, -5.0)], [9.0]]
    )


def test_vectors_from_names():
    """Values by name come in the space's order; a typo gets the nearest name, a gap is named."""
    space = ParameterSpace((Parameter("mass", 1.0, 4.0), Parameter("damping", 0.1, 1.0)))
    np.testing.assert_array_equal(space.vector({"damping": 0.5, "mass": 2.0}), [2.0, 0.5])
    assert space["damping"] == space[1]
    with pytest.raises(UnknownName, match=r"No parameter called 'dampin'. Did you mean 'damping'?"):
        space.vector({"mass": 2.0, "dampin": 0.5})
    with pytest.raises(
        BadArgument, match=r"given for every parameter. Got \"none for \['damping'\]\""
    ):
        space.vector({"mass": 2.0})


@pytest.mark.parametrize(
    ("arguments", "settings", "words"),
    [
        (("", 0.0, 1.0), {}, "'name' of Parameter must be a word"),
        (("x", 3.0, 0.5), {}, "'low' of Parameter 'x' must be below high = 0.5. Got 3.0"),
        (("x", 1.0, np.nan), {}, "'low, high' of Parameter 'x' must be finite"),
        (
            ("x", 0.0, 1.0),
            {"scale": "log"},
            "'low' of Parameter 'x' must be positive on a log scale",
        ),
        (("x", 0.0, 1.0), {"scale": "ln"}, "'linear' or 'log'"),
        (("x", 0.0, 1.0), {"lower": 0.5}, "'lower' of Parameter 'x' must be at most low = 0"),
        (
            ("x", 0.0, 1.0),
            {"lower": 0.0, "upper": 0.5},
            "'upper' of Parameter 'x' must be at least high = 1",
        ),
    ],
)
def test_refusals(arguments, settings, words):
    """Bounds that make no interval, or do not hold the interval, name parameter and rule."""
    with pytest.raises(BadArgument, match=words):
        Parameter(*arguments, **settings)


def test_names_differ():
    """Two parameters of one name are refused."""
    with pytest.raises(
        BadArgument,
        match=r"'names' of ParameterSpace must be different from each other. Got \['x'\]",
    ):
        ParameterSpace((Parameter("x", 0.0, 1.0), Parameter("x", 0.0, 2.0)))


def test_points_outside_go_to_the_nearest_of_the_box():
    """Each parameter by itself, of many vectors at once; points inside stay as they are."""
    space = ParameterSpace((Parameter("a", 0.0, 1.0), Parameter("b", -2.0, 2.0)))
    np.testing.assert_array_equal(space.clip([[0.5, 3.0], [-1.0, -3.0]]), [[0.5, 2.0], [0.0, -2.0]])
