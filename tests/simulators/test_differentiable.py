"""The closed-form robots: the contract, their equations against MuJoCo and SciPy, and fits by
gradients.
"""

import mujoco
import numpy as np
import pytest
import scipy.integrate

from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Status
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument
from dropo.core.services.registry import find
from dropo.estimators.dropo import DROPO
from dropo.estimators.least_squares import LeastSquares
from dropo.testing import check_simulator
from tests.models.cases import CUTS

pytest.importorskip("torch")

ROBOTS = {"pendulum": 1, "cart-pole": 1, "sliding-puck": 2}  # name -> actions
FAST = {
    "pendulum": {"dt": 0.1, "substeps": 1},
    "cart-pole": {"dt": 0.1, "substeps": 1},
    "sliding-puck": {"dt": 0.02, "substeps": 4},
}
TRUTH = {
    "pendulum": [0.7, 0.9, 0.2],
    "cart-pole": [1.0, 0.3, 0.5, 0.4],
    "sliding-puck": [0.6, 0.5, 0.2],
}


def robot(name, **options):
    """The robot of that name."""
    return find("simulators", name)(**options)


def simulated(simulator, values, *, steps=1, epsilon=0.0, seed=0):
    """Trajectories of one set of values (E, d) each from random starts under random actions, noise
    on what follows alone.
    """
    rng = np.random.default_rng(seed)
    count = len(values)
    p = len(simulator.signals)
    actions = 4 * rng.normal(
        size=(count * steps, p // 2 if p == 4 and len(simulator.space) == 3 else 1)
    )
    before = np.zeros((count, steps, p))
    before[:, 0] = rng.normal(size=(count, p))
    ends = np.tile(np.arange(steps) == steps - 1, count)
    empty = Trajectories(before.reshape(-1, p), actions, before.reshape(-1, p), ends)
    after = simulator.predict(np.asarray(values)[None], empty.segments(reset="start"))[0]
    before[:, 1:] = after.reshape(count, steps, p)[:, :-1]
    return Trajectories(
        before.reshape(-1, p),
        actions,
        after + np.sqrt(epsilon) * rng.normal(size=after.shape),
        ends,
    )


def transitions(name, count=20):
    """Unrelated states, and actions."""
    rng = np.random.default_rng(3)
    p = len(robot(name).signals)
    following = np.zeros((count, p))
    return Trajectories(
        rng.normal(size=(count, p)),
        rng.normal(size=(count, ROBOTS[name])),
        following,
        np.ones(count, dtype=bool),
    )


@pytest.mark.parametrize("cut", CUTS)
@pytest.mark.parametrize("name", ROBOTS)
def test_keeps_to_the_contract(name, cut):
    """The checks that plug-in authors call are silent, gradients included."""
    simulator = robot(name, **FAST[name])
    p = len(simulator.signals)
    rng = np.random.default_rng(0)
    ends = np.isin(np.arange(9), [3, 6, 8])
    data = Trajectories(
        rng.normal(size=(9, p)), rng.normal(size=(9, ROBOTS[name])), rng.normal(size=(9, p)), ends
    )
    options = {"horizon": 2} if cut == "every step" else {}
    partly = {"set_columns": np.arange(p) % 2 == 0} if "partial" in cut else {}
    check_simulator(simulator, data.segments(**CUTS[cut] | options | partly))


def pendulum_model(length, mass, damping):
    """A point mass on a hinge."""
    return f"""<mujoco><option timestep="0.001" integrator="RK4"/><worldbody><body>
      <joint name="j" axis="0 1 0" damping="{damping}"/>
      <inertial pos="0 0 {-length}" mass="{mass}" diaginertia="1e-12 1e-12 1e-12"/>
    </body></worldbody><actuator><motor joint="j"/></actuator></mujoco>"""


def cart_pole_model(cart, pole, half, friction):
    """A cart on a rail along x, and a uniform thin rod, upright at 0."""
    inertia = pole * half**2 / 3
    return f"""<mujoco><option timestep="0.001" integrator="RK4"/><worldbody><body>
      <joint name="j" type="slide" axis="1 0 0" damping="{friction}"/>
      <inertial pos="0 0 0" mass="{cart}" diaginertia="1 1 1"/>
      <body><joint axis="0 1 0"/>
        <inertial pos="0 0 {half}" mass="{pole}" diaginertia="{inertia} {inertia} 1e-12"/></body>
    </body></worldbody><actuator><motor joint="j"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("name", "xml"), [("pendulum", pendulum_model), ("cart-pole", cart_pole_model)]
)
def test_agrees_with_mujoco(name, xml):
    """20 steps of 1 ms by Runge-Kutta agree to 1e-10; the control, 0.1 % more of the first
    parameter, is 1e-6 away.
    """
    data = transitions(name)
    value = np.array(TRUTH[name])
    model = mujoco.MjModel.from_xml_string(xml(*value))
    state = mujoco.MjData(model)
    expected = []
    for observation, action in zip(data.observations, data.actions, strict=True):
        mujoco.mj_resetData(model, state)
        state.qpos[:], state.qvel[:], state.ctrl[:] = (
            observation[: model.nq],
            observation[model.nq :],
            action,
        )
        mujoco.mj_step(model, state, nstep=20)
        expected.append([*state.qpos, *state.qvel])
    found = robot(name, dt=0.02, substeps=20).predict(
        [value, value * np.where(np.arange(len(value)) == 0, 1.001, 1)], data.segments()
    )
    np.testing.assert_allclose(found[0], expected, rtol=0, atol=1e-10)
    assert np.abs(found[1] - expected).max() > 1e-6


def puck_slope(t, state, mass, damping, friction, force, creep):
    """The puck's equation of motion, one at a time."""
    speed = np.sqrt(state[2] ** 2 + state[3] ** 2 + creep**2)
    return [
        *state[2:],
        *((force - damping * state[2:]) / mass - friction * 9.81 * state[2:] / speed),
    ]


def test_sliding_puck_solves_its_equation():
    """Against SciPy's integrator of order 8 to 1e-8; the control is 1 % more friction."""
    data = transitions("sliding-puck")
    (mass, damping, friction) = TRUTH["sliding-puck"]
    expected = []
    for start, force in zip(data.observations, data.actions, strict=True):
        given = mass, damping, friction, force, 0.01
        path = scipy.integrate.solve_ivp(
            puck_slope, (0, 0.05), start, "DOP853", args=given, rtol=1e-12, atol=1e-13
        )
        expected.append(path.y[:, -1])
    found = robot("sliding-puck", substeps=200).predict(
        [[mass, damping, friction], [mass, damping, 1.01 * friction]], data.segments()
    )
    np.testing.assert_allclose(found[0], expected, rtol=0, atol=1e-8)
    assert np.abs(found[1] - expected).max() > 1e-4


def test_sliding_puck_stops_where_coulomb_says():
    """Without a push and without damping it slides v^2 / (2 mu g), but for the creep, and then
    rests.
    """
    simulator = robot("sliding-puck")
    speed = 1.5
    start = np.array([[0.0, 0.0, speed, 0.0]])
    still = Trajectories(
        np.repeat(start, 60, axis=0),
        np.zeros((60, 2)),
        np.repeat(start, 60, axis=0),
        np.arange(60) == 59,
    )
    after = simulator.predict([[1.0, 0.0, 0.3]], still.segments(reset="start"))[0]
    assert after[-1, 0] == pytest.approx(speed**2 / (2 * 0.3 * 9.81), rel=2e-3)
    assert np.abs(after[-1, 2:]).max() < 1e-12


@pytest.mark.parametrize("name", ["pendulum", "cart-pole"])
def test_integration_is_of_fourth_order(name):
    """Half the step, a sixteenth of the error; a pendulum's tells, and a cart-pole's, at the
    default step below 1e-6.
    """
    segments = transitions(name).segments()
    value = np.array([TRUTH[name]])
    exact = robot(name, dt=0.1, substeps=256).predict(value, segments)
    coarse, fine = (
        np.abs(robot(name, dt=0.1, substeps=n).predict(value, segments) - exact).max()
        for n in (4, 8)
    )
    assert coarse / fine == pytest.approx(16, rel=0.25)
    default = robot(name)
    assert (
        np.abs(
            default.predict(value, segments) - robot(name, substeps=100).predict(value, segments)
        ).max()
        < 1e-6
    )


@pytest.mark.parametrize("name", ROBOTS)
def test_least_squares_on_exact_jacobians(name):
    """Data without noise give the true parameters to 1e-9 of the box."""
    simulator = robot(name, **FAST[name])
    data = simulated(simulator, np.tile(TRUTH[name], (10, 1)), steps=3)
    fit = LeastSquares().fit(Problem(name, simulator, data, horizon=3))
    np.testing.assert_allclose(fit.mean, TRUTH[name], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "optimizer"),
    list(zip(ROBOTS, ("nlopt-lbfgs", "nlopt-slsqp", "scipy-l-bfgs-b"), strict=True)),
)
def test_dropo_by_gradients(name, optimizer):
    """Each gradient optimizer, on one of the robots, converges at the truth, within 4.5 of the
    fit's own standard errors; the control is the box's middle.
    """
    simulator = robot(name, **FAST[name])
    truth = np.array(TRUTH[name])
    values = truth * (1 + 0.06 * np.random.default_rng(5).normal(size=(40, len(truth))))
    problem = Problem(name, simulator, simulated(simulator, values, epsilon=1e-3), epsilon=1e-3)
    fit = DROPO(
        likelihood="monte-carlo", optimizer=optimizer, draws=16, budget=200, start="least-squares"
    ).fit(problem)
    assert fit.status is Status.CONVERGED, fit.message
    assert (np.abs(fit.mean - truth) < 4.5 * fit.mean_se).all()
    assert (
        np.abs(fit.mean - simulator.space.from_unit(np.full(len(truth), 0.5))) > 4.5 * fit.mean_se
    ).any()


def test_refusals():
    """Time steps that are none."""
    with pytest.raises(
        BadArgument, match=r"^The 'dt' of Pendulum must be positive \[s\]. Got 0 instead.$"
    ):
        robot("pendulum", dt=0)
    with pytest.raises(
        BadArgument, match=r"^The 'substeps' of CartPole must be at least 1. Got 0 instead.$"
    ):
        robot("cart-pole", substeps=0)
