"""MuJoCo Warp on the CPU against MuJoCo; skipped where the package is not installed."""

import sys
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.noise import Noise
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services import optional_dependencies
from dropo.core.services.errors import Incompatible, MissingPackage
from dropo.core.services.registry import find
from dropo.core.services.run_warning import DropoWarning
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.linear import Linear
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.loading import load
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.simulators.toy import SlidingBlock
from dropo.simulators.warp import simulator as warp_module
from dropo.simulators.warp.simulator import WarpSimulator
from dropo.testing import check_simulator

pytestmark = pytest.mark.filterwarnings("ignore:Warp finds no CUDA device")
NEEDED = ("warp", "mujoco_warp")
BALL = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <body name="ball" pos="0 0 .3">
      <joint name="up" type="slide" axis="0 0 1"/>
      <geom name="ball" size=".1" mass="1"/>
      {more}
    </body>
  </worldbody>
  <actuator><motor name="push" joint="up"/></actuator>
</mujoco>
"""
MASS = FieldParameter("mass", 0.5, 2.0, field="body_mass", element="ball")
DAMPING = FieldParameter("damping", 0.5, 5.0, field="dof_damping", element="up")


@pytest.fixture(scope="module")
def warp():
    """The packages, without which a test is skipped; they compile faster what runs once."""
    packages = [pytest.importorskip(name) for name in NEEDED]
    if not packages[0].is_cuda_available():
        packages[0].config.optimization_level = 0
    return packages


@pytest.fixture(scope="module")
def hopper():
    """The noisy hopper, on one thread."""
    return load("hopper-noisy", threads=1)


def ball(more="", parameters=()):
    """A ball above a floor, with its data: falling, and thrown."""
    model = mujoco.MjSpec.from_string(BALL.format(more=more))
    simulator = MujocoSimulator(model, parameters, frame_skip=5, threads=1)
    states = np.array([[0.0, 0.0], [-0.25, -1.0], [0.2, 2.0]])
    ends = np.array([True, True, True])
    return simulator, Trajectories(states, np.array([[0.0], [5.0], [-2.0]]), states, ends)


def test_keeps_the_contract(warp):
    """Whole predictions, in parts, by groups, of every step, chained, from ends: all the same."""
    on_cpu, _ = ball(parameters=[MASS, DAMPING])
    rng = np.random.default_rng(0)
    paths = rng.uniform(-0.22, 0.1, (2, 5, 2))
    rows = [part.reshape(8, 2) for part in (paths[:, :-1], paths[:, 1:])]
    ends = np.arange(8) % 4 == 3
    data = Trajectories(rows[0], rng.uniform(-5.0, 5.0, (8, 1)), rows[1], ends)
    simulator = WarpSimulator(on_cpu)
    values = on_cpu.space.from_unit(rng.uniform(0.2, 0.8, (3, 2)))
    check_simulator(simulator, data.segments(2), values=values, rtol=0.05)
    partial = data.segments(2, reset="partial", set_columns=np.array([True, False]))
    expected = on_cpu.predict(values, partial)
    np.testing.assert_allclose(simulator.predict(values, partial), expected, atol=2e-4)


@pytest.mark.parametrize("name", ["hopper-noisy", "half-cheetah"])
def test_log_likelihood_is_the_cpus(warp, name):
    """Within 0.01 nat a transition of MuJoCo's, at a noise of variance 1e-6; a model of a tenth of
    a percent more mass is further off.
    """
    problem = load(name, threads=1)
    truth = problem.space.vector(problem.truth)
    chosen = problem.segments.take(problem.segments.thin(40))
    noise = 1e-3 * np.random.default_rng(1).standard_normal(chosen.targets.shape)
    measured = problem.simulator.predict(truth[None], chosen)[0] + noise
    ends = np.ones(len(chosen), dtype=bool)
    segments = Trajectories(chosen.starts, chosen.actions[:, 0], measured, ends).segments()
    family = TruncatedGaussian(problem.space)
    width = 0.01 * (problem.space.high - problem.space.low)

    def value(simulator, mean):
        rng = np.random.default_rng(0)
        local = Linear().linearize_at(simulator, segments, family, Noise(1e-6), mean, width, rng)
        point = family.phi(mean, 0.05 * width)
        return local(np.clip(point, local.unknowns.low, local.unknowns.high)) / len(segments)

    on_cpu = value(problem.simulator, truth)
    assert abs(value(WarpSimulator(problem.simulator), truth) - on_cpu) < 0.01
    assert abs(value(problem.simulator, 1.001 * truth) - on_cpu) > 0.01


def test_parameters_are_those_of_the_model(warp):
    """Numbers of the model and its options, with what follows from them, in every world its own."""
    gravity = FieldParameter("gravity", -20.0, -1.0, field="gravity", index=2)
    stiff = FieldParameter("stiff", 0.01, 0.05, field="geom_solref", element="ball", index=0)
    gear = FieldParameter("gear", 0.5, 2.0, field="actuator_gear", element="push", index=0)
    simulator, data = ball(parameters=[MASS, gravity, stiff, gear])
    values = simulator.space.from_unit(np.random.default_rng(0).uniform(size=(6, 4)))
    expected = simulator.predict(values, data.segments())
    found = WarpSimulator(simulator).predict(values, data.segments())
    assert np.ptp(expected, axis=0).max() > 0.1
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=2e-5)


def test_memory_that_ends_halves_the_batch(warp, monkeypatch):
    """It says so, and predicts the same bit for bit."""
    simulator, data = ball(parameters=[MASS])
    values = np.linspace(0.6, 1.8, 5)[:, None]
    expected = WarpSimulator(simulator).predict(values, data.segments())
    make_data = warp[1].make_data

    def with_room_for_four(model, nworld, **more):
        if nworld > 4:
            raise RuntimeError("Failed to allocate 1000 bytes on device 'cuda:0'")
        return make_data(model, nworld=nworld, **more)

    monkeypatch.setattr(warp[1], "make_data", with_room_for_four)
    small = WarpSimulator(simulator)
    with pytest.warns(RuntimeWarning, match="no memory for") as said:
        found = small.predict(values, data.segments())
    assert str(said[0].message) == f"{small.device} has no memory for 15 worlds: going on with 8."
    assert small.worlds == 3
    assert np.array_equal(found, expected)
    with_less = WarpSimulator(simulator, worlds=3)
    assert np.array_equal(with_less.predict(values, data.segments()), expected)


def test_a_fit_is_that_of_the_cpu(warp):
    """Means within half a standard error of those by MuJoCo, on the same data."""
    truth = {"mass": 1.0, "damping": 2.0}
    on_cpu, _ = ball(parameters=[MASS, DAMPING])
    rng = np.random.default_rng(0)
    starts = rng.uniform([-0.22, -2.0], [0.1, 2.0], (60, 2))
    pushes = rng.uniform(-20.0, 20.0, (60, 1))
    segments = Trajectories(starts, pushes, starts, np.ones(60, dtype=bool)).segments()
    measured = on_cpu.predict(np.array([[1.0, 2.0]]), segments)[0]
    measured += 1e-3 * rng.standard_normal(measured.shape)
    data = Trajectories(starts, pushes, measured, np.ones(60, dtype=bool))
    problem = Problem("ball", on_cpu, data, epsilon=1e-6, truth=truth)
    estimator = find("methods", "dropo")(likelihood="linear", start=problem.truth)
    expected = estimator.fit(problem, rng=0)
    fit = estimator.fit(problem.using(simulator="warp"), rng=0)
    assert (np.abs(fit.mean - expected.mean) < 0.5 * expected.mean_se).all()


def test_what_it_cannot_hold_is_refused(warp, hopper):
    """A sentence that names the effect, the parameter, the element, the device or the simulator."""
    simulator, _ = ball(parameters=[MASS])
    friction = next(iter(find("effects", "joint_friction")(simulator.effect_context)))
    with pytest.raises(Incompatible, match=r"joint_friction.* Use the simulator 'mujoco'"):
        WarpSimulator(simulator.with_effects([friction]))
    shared = FieldParameter("ratio", 1.0, 10.0, field="impratio")
    with pytest.raises(Incompatible, match=r"'ratio': in Warp all worlds share one 'opt.impratio'"):
        WarpSimulator(ball(parameters=[shared])[0])
    with pytest.raises(Incompatible, match="finds no device 'cuda:9'"):
        WarpSimulator(simulator, device="cuda:9")
    with pytest.raises(Incompatible, match="SlidingBlock has none"):
        WarpSimulator(SlidingBlock())
    with pytest.raises(Incompatible, match="'gymnasium' takes over no other's model"):
        hopper.using(simulator="gymnasium")


def test_an_element_that_it_cannot_hold_is_named(warp, monkeypatch):
    """By kind and name."""
    simulator, _ = ball(more='<geom name="egg" type="ellipsoid" size=".1 .1 .2" mass="1"/>')
    message = "['mjGEOM_ELLIPSOID'] not supported."

    def refuse(model, batch_sizes):
        raise NotImplementedError(message)

    monkeypatch.setattr(warp[1], "put_model", refuse)
    with pytest.raises(Incompatible, match="Warp cannot hold geom 'egg'"):
        WarpSimulator(simulator)


def test_a_missing_package_is_named(monkeypatch):
    """With how to install it."""
    monkeypatch.setattr(optional_dependencies, "find_spec", lambda name: None)
    with pytest.raises(MissingPackage, match=r"pip install 'dropo\[warp\]'"):
        WarpSimulator(ball(parameters=[MASS])[0])


@pytest.mark.parametrize(
    ("there", "named", "chosen", "says"),
    [
        (["cpu"], None, "cpu", True),
        (["cpu"], "cpu", "cpu", False),
        (["cpu", "cuda:0"], None, "cuda:0", False),
    ],
)
@pytest.mark.filterwarnings("error")
def test_the_cpu_is_taken_with_a_warning(there, named, chosen, says, monkeypatch):
    """Where nobody named it; Warp itself is not needed to say so."""
    config = SimpleNamespace(log_level=0)
    found = SimpleNamespace(config=config, LOG_ERROR=3, get_devices=lambda: there)
    monkeypatch.setitem(sys.modules, "warp", found)
    monkeypatch.setattr(warp_module, "need", lambda *packages, **more: None)
    if says:
        with pytest.warns(DropoWarning, match="no CUDA device .* about 30 times slower"):
            assert warp_module._device(named) == chosen
    else:
        assert warp_module._device(named) == chosen
