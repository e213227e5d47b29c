"""The linear likelihood: closed forms, many parameters, fits."""

import time

import numpy as np
import pytest
from scipy import stats
from threadpoolctl import threadpool_limits

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.services.registry import find
from dropo.estimators.dropo import DROPO
from dropo.families.full_gaussian import FullGaussian
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.linear import Linear
from dropo.likelihoods.support.member_moments import moments_of
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.hopper.data import simulate as hopper_transitions
from dropo.problems.hopper.model import BODIES, FRAME_SKIP, hopper_spec
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.simulators.toy import LinearSimulator, SlidingBlock, simulate
from dropo.testing import check_likelihood

NOISE = 1e-5


def test_keeps_to_the_contract():
    """The checks that plug-in authors call are silent."""
    check_likelihood(Linear())


@pytest.mark.parametrize("name", ["truncated_gaussian", "full", "uniform"])
def test_linear_simulator_has_the_closed_form(name):
    """o + M(a) xi with covariance M S M' + diag(epsilon), to 1e-9; sigma in place of the sd of a
    cut Gaussian is rejected.
    """
    rng = np.random.default_rng(5)
    simulator = LinearSimulator(rng.normal(size=(2, 3, 2)))
    values = np.array([1.0, -2.0]) + rng.normal(size=(25, 2))
    actions = rng.normal(size=(25, 1, 2))
    segments = simulate(
        simulator, values, actions, np.zeros(3), noise_variance=0.01, rng=rng
    ).segments()
    epsilon = np.array([0.01, 0.02, 0.05])
    family = find("families", name)(simulator.space)
    phi = family.phi([1.0, -2.0], [0.5, 0.9])
    if name == "full":
        phi[4] = 0.6
    local = Linear().linearize_at(
        simulator, segments, family, epsilon, np.array([1.1, -1.9]), np.array([0.4, 0.7]), rng
    )

    def closed_form(sd):
        covariance = family.correlation(phi) * np.outer(sd, sd)
        rows = []
        for start, action, target in zip(
            segments.starts, segments.actions[:, 0], segments.targets, strict=True
        ):
            m = np.einsum("q,qpd->pd", action, simulator.matrices)
            rows.append(
                stats.multivariate_normal(
                    start + m @ family.mean(phi), m @ covariance @ m.T + np.diag(epsilon)
                ).logpdf(target)
            )
        return np.array(rows)

    np.testing.assert_allclose(local.rows(phi), closed_form(family.sd(phi)), rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        local.predict(values[:4]), simulator.predict(values[:4], segments), atol=1e-9
    )
    assert local(phi) == pytest.approx(local.rows(phi).sum(), rel=1e-13)
    if name == "truncated_gaussian":
        assert abs(local(phi) - closed_form(family.scale(phi)).sum()) > 0.1


def test_moments_of_logarithms_are_exact():
    """Of a log-normal: mean log m - s^2 / 2 and variance s^2, to rounding also where s is tiny."""
    family = find("families", "log_normal")(SlidingBlock().space)
    for scale in ([0.2, 0.1], [1e-5, 0.3]):
        mean, covariance = moments_of(family, family.phi([1.5, 0.8], scale))
        np.testing.assert_allclose(np.diagonal(covariance), np.square(scale), rtol=1e-9)
        np.testing.assert_allclose(mean, np.log([1.5, 0.8]) - np.square(scale) / 2, rtol=1e-12)


def test_entries_that_do_not_move_cost_nothing():
    """Without correlations a family has d entries of its covariance, with them d (d + 1) / 2."""
    simulator = LinearSimulator(np.ones((1, 2, 5)))
    rng = np.random.default_rng(0)
    segments = simulate(simulator, np.zeros((3, 5)), np.ones((3, 1, 1)), np.zeros(2)).segments()
    for family, count in (
        (TruncatedGaussian(simulator.space), 5),
        (FullGaussian(simulator.space), 15),
    ):
        local = Linear().linearize_at(
            simulator, segments, family, 1.0, np.zeros(5), np.ones(5), rng
        )
        phi = family.phi(np.zeros(5), np.ones(5))
        assert len(local._member_slopes(phi)[1].first) == count


# --- fits


def test_fits_a_linear_simulator_like_the_emulated_one():
    """Through the iterations of DROPO: the same maximum, from 2 d + 1 simulations a segment."""
    rng = np.random.default_rng(3)
    simulator = LinearSimulator(rng.normal(size=(2, 3, 2)))
    values = np.array([1.0, -2.0]) + np.array([0.5, 0.2]) * rng.standard_normal((80, 2))
    data = simulate(
        simulator, values, rng.normal(size=(80, 1, 2)), np.zeros(3), noise_variance=0.01, rng=rng
    )
    problem = Problem("linear", simulator, data, epsilon=0.01)
    linear, emulated = (DROPO(likelihood=name).fit(problem) for name in ("linear", "emulated"))
    assert linear.status == "converged"
    np.testing.assert_allclose(linear.mean, emulated.mean, atol=1e-3)
    np.testing.assert_allclose(linear.scale, emulated.scale, atol=1e-3)
    assert linear.log_likelihood == pytest.approx(emulated.log_likelihood, abs=1e-3)
    assert linear.simulator_steps < emulated.simulator_steps


class Arms(Simulator):
    """100 parameters that act on 12 signals through smooth features of the action: o + W (tanh(V a)
    sin xi).
    """

    def __init__(self, d=100, p=12, q=6):
        rng = np.random.default_rng(0)
        toy = LinearSimulator(np.ones((q, p, d)), low=0.2, high=1.2)
        self.space = toy.space
        self.signals = toy.signals
        self.weights = rng.normal(size=(p, d))
        self.features = rng.normal(size=(q, d))

    def _predict(self, values, segments, offsets):
        load = np.tanh(segments.actions[:, 0] @ self.features)  # (N, d)
        return segments.starts + np.stack(
            [(load * np.sin(value)) @ self.weights.T for value in values]
        )


def arms_problem(rows, rng):
    """Transitions of `Arms` at one parameter vector, which is returned too."""
    simulator = Arms()
    truth = rng.uniform(0.5, 0.9, 100)
    actions = rng.normal(size=(rows, 1, 6))
    data = simulate(
        LinearSimulator(np.zeros((6, 12, 1))), np.zeros((rows, 1)), actions, np.zeros(12)
    )
    following = simulator.predict(truth[None], data.segments())[0] + np.sqrt(
        NOISE
    ) * rng.standard_normal((rows, 12))
    return Problem(
        "arms",
        simulator,
        type(data)(data.observations, data.actions, following, data.terminals),
        epsilon=NOISE,
    ), truth


def test_a_hundred_parameters_in_seconds():
    """1000 transitions: the design and three expansions take below 4 s of processor time, a quarter
    of a round; scores are the value's.
    """
    problem, truth = arms_problem(1000, np.random.default_rng(1))
    family = TruncatedGaussian(problem.space)
    phi = family.phi(truth, np.full(100, 0.01))
    with threadpool_limits(
        1, user_api="blas"
    ):  # as in a fit: waiting threads count as processor time
        begun = time.process_time()
        local = Linear().linearize_at(
            problem.simulator,
            problem.segments,
            family,
            NOISE,
            truth + 0.01,
            np.full(100, 0.02),
            np.random.default_rng(0),
        )
        for _ in range(3):
            score = local.value_score_information(phi)[1].sum(axis=0)
        assert time.process_time() - begun < 4
    for i in (0, 57, 130, 199):
        step = 1e-5 * phi[i] * np.eye(200)[i]
        assert score[i] == pytest.approx(
            (local(phi + step) - local(phi - step)) / (2 * step.sum()),
            rel=1e-5,
            abs=1e-5 * np.abs(score).max(),
        )


@pytest.mark.study
def test_a_hundred_parameters_are_found():
    """All means within 4.5 standard errors (the largest of 100 normals is below 4.5 with 99.9 %),
    all scales below 0.01.
    """
    problem, truth = arms_problem(1000, np.random.default_rng(1))
    fit = DROPO(likelihood="linear").fit(problem)
    assert fit.status == "converged"
    assert (np.abs(fit.mean - truth) / fit.mean_se).max() < 4.5
    assert fit.scale.max() < 0.01


def hopper_of_18(threads=0):
    """Masses, inertias, joint damping and armature, gears and the foot's friction, each a factor on
    the model's own number in [0.5, 2].
    """
    spec = hopper_spec()
    for i, actuator in enumerate(spec.actuators):
        actuator.name = f"motor{i}"
    fields = {
        "body_mass": BODIES,
        "body_inertia": BODIES,
        "geom_friction": ["foot_geom"],
        "actuator_gear": [f"motor{i}" for i in range(3)],
        **{
            field: [f"{body}_joint" for body in BODIES[1:]]
            for field in ("dof_damping", "dof_armature")
        },
    }
    parameters = [
        FieldParameter(
            f"{field}.{element}",
            0.5,
            2.0,
            field=field,
            element=element,
            relative=True,
            derived=False,
        )
        for field, elements in fields.items()
        for element in elements
    ]
    return MujocoSimulator(
        spec, parameters, observation=["qpos[1:]", "qvel"], frame_skip=FRAME_SKIP, threads=threads
    )


def fitted_hopper(transitions, seed, likelihood="linear"):
    """DROPO's fit of 18 parameters, all 1 in truth, to noisy transitions."""
    data, _ = hopper_transitions(
        transitions // 2, 2, rng=np.random.default_rng(seed), noise_variance=NOISE
    )
    problem = Problem("hopper-18", hopper_of_18(), data, epsilon=NOISE)
    return DROPO(likelihood=likelihood).fit(problem)


def test_eighteen_parameters_of_the_hopper_linearize():
    """The model at factors of 1 is the hopper's own; the likelihood's score there is within 4.5 of
    its standard errors, at 1.1 not.
    """
    data, _ = hopper_transitions(100, 1, rng=np.random.default_rng(0), noise_variance=NOISE)
    simulator = hopper_of_18()
    assert simulator.nominal.tolist() == [1.0] * 18
    family = find("families", "point")(simulator.space)

    def z(point):
        local = Linear().linearize_at(
            simulator,
            data.segments(),
            family,
            NOISE,
            point,
            np.full(18, 1e-3),
            np.random.default_rng(0),
        )
        _, scores, information = local.value_score_information(point)
        return np.abs(scores.sum(axis=0) / np.sqrt(np.diagonal(information))).max()

    assert z(np.ones(18)) < 4.5
    assert z(np.full(18, 1.1)) > 4.5


@pytest.mark.study
def test_eighteen_parameters_of_the_hopper_are_found():
    """1000 noisy transitions: every mean within 3.5 standard errors (of 18, 99 % are), in at most
    1.5e6 simulator steps.
    """
    fit = fitted_hopper(1000, seed=61)
    assert (np.abs(fit.mean - 1) / fit.mean_se).max() < 3.5
    assert fit.simulator_steps <= 1.5e6
