"""What the data cannot tell, in words: on a motor and its arm, on sums, on parameters without
influence, and where all is well.
"""

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.records.parameters import Parameter
from dropo.core.records.trajectories import Trajectories
from dropo.estimators.least_squares import LeastSquares
from dropo.evaluation.identifiability import identify
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.function import FunctionSimulator
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.simulators.toy import LinearSimulator, simulate
from tests.reference.pushes import pushes

ARM = """<mujoco><option timestep="0.01"/><worldbody>
  <body name="arm" pos="0 0 1"><joint name="hinge" axis="0 1 0"/>
  <inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 0.05"/>{bob}</body></worldbody>
  <actuator><motor name="motor" joint="hinge" gear="2"/></actuator></mujoco>"""
BOB = """<body name="bob" pos="0.3 0 0"><geom type="sphere" size="0.03" mass="0.5"/></body>"""


def arm(bob):
    """A driven arm balanced on its hinge: its motor's gear and its inertia show as gear / inertia;
    a bob that hangs on it weighs.
    """
    parameters = [
        FieldParameter("gear", 0.5, 4.0, field="actuator_gear", element="motor", index=0),
        FieldParameter(
            "inertia", 0.02, 0.2, "kg m^2", field="body_inertia", element="arm", index=1
        ),
    ]
    return MujocoSimulator(mujoco.MjSpec.from_string(ARM.format(bob=bob)), parameters, threads=1)


def driven(simulator, seed=0):
    """60 transitions of the arm from random states under random commands, with noise of sd 1e-4."""
    rng = np.random.default_rng(seed)
    before = rng.normal(0, 1, (60, 2))
    actions = rng.normal(0, 1, (60, 1))
    blank = Trajectories(before, actions, before, np.ones(60, dtype=bool))
    after = simulator.predict(simulator.nominal[None], blank.segments())[0] + 1e-4 * rng.normal(
        size=(60, 2)
    )
    return Problem("arm", simulator, Trajectories(before, actions, after, np.ones(60, dtype=bool)))


def linear(matrix, names=("a", "b"), low=0.5, seed=0):
    """y = matrix @ parameters, times a random action: parameters by name, 40 rows with noise of sd
    0.01.
    """
    rng = np.random.default_rng(seed)
    matrix = np.asarray(matrix, dtype=float)
    parameters = [Parameter(name, low, 3.0) for name in names]
    answer = lambda value, starts, actions: starts[:, None] + actions * (matrix @ value)
    simulator = FunctionSimulator(answer, parameters, [f"y{i}" for i in range(len(matrix))])
    actions = rng.normal(size=(40, 1, 1))
    data = simulate(
        simulator,
        np.tile(np.linspace(1.0, 1.6, len(names)), (40, 1)),
        actions,
        np.zeros(len(matrix)),
        noise_variance=1e-4,
        rng=rng,
    )
    return Problem("linear", simulator, data)


def test_gear_and_inertia_of_a_motor():
    """On a balanced arm only their ratio, and neither has a standard error; where gravity acts on a
    known bob, both are told.
    """
    balanced, heavy = (driven(arm(bob)) for bob in ("", BOB))
    fit = LeastSquares().fit(balanced)
    assert "only gear / inertia is determined by the data, not each of them" in fit.identifiability
    assert np.isnan(fit.mean_se).all()
    fit = LeastSquares().fit(heavy)
    assert not any("gear" in sentence or "inertia" in sentence for sentence in fit.identifiability)
    np.testing.assert_allclose(fit.mean, [2.0, 0.05], rtol=0.02)
    assert np.isfinite(fit.mean_se).all()


def test_products_sums_and_differences():
    """a b, a + b and a - b, each from data that show nothing else; the ratio is a control in the
    test above.
    """
    rng = np.random.default_rng(0)
    product = FunctionSimulator(
        lambda v, s, a: s[:, None] + a * v[0] * v[1],
        [Parameter("a", 0.5, 3), Parameter("b", 0.5, 3)],
        ["y"],
    )
    data = simulate(
        product,
        np.tile([1.0, 1.6], (40, 1)),
        rng.normal(size=(40, 1, 1)),
        np.zeros(1),
        noise_variance=1e-4,
        rng=rng,
    )
    assert told(Problem("product", product, data)) == [
        "only a * b is determined by the data, not each of them"
    ]
    assert told(linear([[1, 1]], low=-3.0)) == [
        "only a + b is determined by the data, not each of them"
    ]
    assert told(linear([[1, -1]], low=-3.0)) == [
        "only a - b is determined by the data, not each of them"
    ]


def told(problem):
    fit = LeastSquares().fit(problem)
    return [sentence for sentence in identify(problem, fit) if "bound" not in sentence]


def test_three_parameters_and_one_without_influence():
    """c does nothing; a + 2 b + d leaves two directions, each told with its proportions."""
    found = told(linear([[1, 2, 0, 3]], ("a", "b", "c", "d"), low=-3.0))
    assert found[0] == "the data do not determine c"
    assert len(found) == 3
    assert all("only together" in sentence for sentence in found[1:])


def test_nothing_is_said_where_all_is_well():
    """The sliding block, and two linear parameters with a signal each."""
    problem = pushes(0, sd=0.0)
    assert identify(problem, LeastSquares().fit(problem)) == []
    assert told(linear([[1, 0], [0, 1]])) == []


def test_signals_actions_and_bounds():
    """A signal that no parameter moves, one that stands still, an action that never changes, a mean
    on its bound.
    """
    rng = np.random.default_rng(0)
    simulator = LinearSimulator(np.array([[[1.0], [0.0], [0.0]], [[0.0], [0.0], [0.0]]]), high=1.0)
    actions = np.concatenate([rng.normal(size=(30, 1, 1)), np.ones((30, 1, 1))], axis=2)
    noise = np.array([1e-4, 1e-4, 0.0])
    data = simulate(
        simulator, np.full((30, 1), 2.0), actions, np.zeros(3), noise_variance=noise, rng=rng
    )
    problem = Problem("still", simulator, data)
    fit = LeastSquares().fit(problem)
    assert identify(problem, fit) == [
        "y2 does not move",
        "y1 carries no information on any parameter",
        "action[1] never changes",
        "x0 is on its upper bound 1, and has no interval there",
    ]
    assert np.isnan(fit.interval()).all()
    assert "y2 does not move" in str(fit)


@pytest.mark.parametrize("count", [1, 2])
def test_fewer_rows_than_parameters(count):
    """One row for two parameters: only their combination is told, and nothing fails."""
    problem = linear([[1, 1]], low=-3.0)
    few = Problem("few", problem.simulator, problem.trajectories.head(count))
    assert any("only a + b" in sentence for sentence in told(few))
