"""Columns and coordinates of observations: rotations agree with MuJoCo's own, names and units,
refusals.
"""

import mujoco
import numpy as np
import pytest

from dropo.core.services.errors import BadArgument, UnknownName
from dropo.mjmodel.observation import Layout, exponential, logarithm, multiply
from tests.models.cases import BALL, BOX, CART, SENSED, VALVE


def layout(xml, items):
    """The model and its layout."""
    model = mujoco.MjModel.from_xml_string(xml)
    return model, Layout(model, items)


def rotations(n, rng, longest=3.1):
    """(n, 3) rotation vectors of lengths up to `longest`, some tiny and some zero."""
    directions = rng.normal(size=(n, 3))
    lengths = (
        rng.uniform(0, longest, n)
        * np.where(np.arange(n) % 5 == 0, 1e-12, 1.0)
        * (np.arange(n) % 7 > 0)
    )
    return directions / np.linalg.norm(directions, axis=1, keepdims=True) * lengths[:, None]


def positions(model, n, rng):
    """(n, nq) positions anywhere, with unit quaternions."""
    out = np.tile(model.qpos0, (n, 1))
    for row in out:
        mujoco.mj_integratePos(model, row, 2 * rng.normal(size=model.nv), 1.0)
    return out


@pytest.mark.parametrize("xml", [BOX, BALL], ids=["free joint", "ball joint"])
def test_differences_are_mujocos(xml):
    """coordinates(predicted, measured) - coordinates(measured, measured) is mj_differentiatePos;
    signs do not matter.
    """
    rng = np.random.default_rng(0)
    model, mine = layout(xml, ["qpos"])
    predicted = positions(model, 200, rng)
    measured = positions(model, 200, rng)
    found = mine.coordinates(predicted, measured) - mine.coordinates(measured, measured)
    expected = np.zeros((200, model.nv))
    for out, a, b in zip(expected, measured, predicted, strict=True):
        mujoco.mj_differentiatePos(model, out, 1.0, a, b)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    flipped = measured.copy()
    flipped[::2, mine.quaternions[0]] *= -1
    np.testing.assert_allclose(
        mine.coordinates(predicted, flipped), mine.coordinates(predicted, measured), atol=1e-12
    )


@pytest.mark.parametrize("xml", [BOX, BALL], ids=["free joint", "ball joint"])
def test_moves_are_mujocos(xml):
    """`move` is mj_integratePos, and `coordinates` takes it back."""
    rng = np.random.default_rng(1)
    model, mine = layout(xml, ["qpos"])
    # turns below pi
    rows = positions(model, 200, rng)
    offsets = 0.6 * rng.normal(size=(200, model.nv))
    expected = rows.copy()
    for row, offset in zip(expected, offsets, strict=True):
        mujoco.mj_integratePos(model, row, offset, 1.0)
    moved = mine.move(rows, offsets)
    np.testing.assert_allclose(moved, expected, atol=1e-12)
    np.testing.assert_allclose(
        mine.coordinates(moved, rows) - mine.coordinates(rows, rows), offsets, atol=1e-12
    )


def test_logarithm_undoes_exponential():
    """For every length up to pi, the tiny ones and zero too, and for quaternions that are not of
    length 1.
    """
    rng = np.random.default_rng(2)
    vectors = rotations(500, rng)
    quaternions = exponential(vectors)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, rtol=1e-14)
    np.testing.assert_allclose(logarithm(quaternions), vectors, rtol=1e-9, atol=1e-25)
    np.testing.assert_allclose(logarithm(-3.0 * quaternions), vectors, rtol=1e-9, atol=1e-25)


def test_half_turn_has_length_pi():
    """A rotation by pi has no shorter way round."""
    np.testing.assert_allclose(logarithm(np.array([0.0, 0.0, 1.0, 0.0])), [0.0, np.pi, 0.0])
    np.testing.assert_allclose(
        logarithm(exponential(np.array([4.0, 0.0, 0.0]))), [4.0 - 2 * np.pi, 0.0, 0.0]
    )


def test_product_is_mujocos():
    """multiply(a, b) is mju_mulQuat."""
    a, b = np.random.default_rng(3).normal(size=(2, 50, 4))
    expected = np.zeros((50, 4))
    for out, one, other in zip(expected, a, b, strict=True):
        mujoco.mju_mulQuat(out, one, other)
    np.testing.assert_allclose(multiply(a, b), expected, atol=1e-14)


@pytest.mark.parametrize(
    ("xml", "items", "columns", "signals"),
    [
        (
            CART,
            ["qpos[1:]", "qvel"],
            ["qpos.hinge", "qvel.rail", "qvel.hinge"],
            [("qpos.hinge", "rad"), ("qvel.rail", "m/s"), ("qvel.hinge", "rad/s")],
        ),
        (
            CART,
            ["qvel.hinge", "qpos[-2]"],
            ["qvel.hinge", "qpos.rail"],
            [("qvel.hinge", "rad/s"), ("qpos.rail", "m")],
        ),
        (
            BALL,
            ["qpos.elbow", "qpos.shoulder"],
            ["qpos.elbow", *(f"qpos.shoulder[{i}]" for i in range(4))],
            [("qpos.elbow", "rad"), *((f"qpos.shoulder.r{axis}", "rad") for axis in "xyz")],
        ),
        (
            BOX,
            ["qpos.box"],
            [f"qpos.box[{i}]" for i in range(7)],
            [
                *((f"qpos.box[{i}]", "m") for i in range(3)),
                *((f"qpos.box.r{axis}", "rad") for axis in "xyz"),
            ],
        ),
        (VALVE, ["act", "qpos"], ["act.lag", "qpos.slide"], [("act.lag", ""), ("qpos.slide", "m")]),
        (
            SENSED,
            ["sensordata.angle", "sensordata.imu"],
            ["sensordata.angle", *(f"sensordata.imu[{i}]" for i in range(3))],
            [("sensordata.angle", "rad"), *((f"sensordata.imu[{i}]", "m/s^2") for i in range(3))],
        ),
    ],
)
def test_names_and_units(xml, items, columns, signals):
    """Columns by their joint, a joint without a name by its body, a quaternion compared as three
    rotations.
    """
    _, mine = layout(xml, items)
    assert mine.names == columns
    assert [(signal.name, signal.unit) for signal in mine.signals] == signals
    assert len(mine) == len(columns)


def test_partial_columns_by_item():
    """`places_of` marks the columns that items name, whatever their order."""
    model, mine = layout(BALL, ["qvel", "qpos"])
    np.testing.assert_array_equal(
        np.flatnonzero(mine.places_of(["qpos.shoulder", "qvel[1]"], model)), [1, 4, 5, 6, 7]
    )


WHOLE = (
    r"The observation must hold all four numbers of the quaternion "
    r"at qpos\[0:4\], in order, or none."
)


@pytest.mark.parametrize(
    ("xml", "items", "error", "words"),
    [
        (BALL, ["qpos[:3]"], BadArgument, WHOLE),
        (BALL, ["qpos[1:4]", "qpos[0]"], BadArgument, WHOLE),
        (BALL, ["qpos[0:2]", "qvel", "qpos[2:4]"], BadArgument, WHOLE),
        (CART, [], BadArgument, r"The observation must have at least one column. Got none."),
        (CART, ["qpso"], UnknownName, r"No field called 'qpso'. Did you mean 'qpos'\?"),
        (
            CART,
            ["qpos.hing"],
            UnknownName,
            r"No element of qpos called 'hing'. Did you mean 'hinge'\?",
        ),
        (
            CART,
            ["qpos[2]"],
            BadArgument,
            r"The item 'qpos\[2\]' is outside of qpos, which has 2 numbers.",
        ),
        (
            CART,
            ["qpos[1:3]"],
            BadArgument,
            r"The item 'qpos\[1:3\]' is outside of qpos, which has 2 numbers.",
        ),
        (CART, ["act"], BadArgument, r"The observation must have at least one column. Got none."),
        (
            CART,
            ["qpos(1)"],
            BadArgument,
            r"The item 'qpos\(1\)' must be a field, with a slice or an element's name, "
            r"such as 'qpos\[1:\]' or 'qpos.thigh_joint'.",
        ),
        (VALVE, ["act.direct"], UnknownName, r"No element of act called 'direct'. There is lag."),
    ],
)
def test_refusals(xml, items, error, words):
    """The message names the item, the rule and the nearest valid name."""
    with pytest.raises(error, match=f"^{words}$"):
        layout(xml, items)
