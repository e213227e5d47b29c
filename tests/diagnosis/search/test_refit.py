"""Fits to windows where predictions bend."""

from functools import cache
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from dropo import Diagnose, load
from dropo.diagnosis.findings.causes import standard_errors
from dropo.diagnosis.search.linearization import Library, estimate_noise, linearize
from dropo.diagnosis.search.refit import (
    DEFAULTS,
    RefitSettings,
    other_noise,
    refit,
    with_noise,
)
from dropo.diagnosis.search.whitening import WhitenessSettings, white
from dropo.diagnosis.search.windows import split
from dropo.diagnosis.settings import DiagnosisSettings
from tests.models import hidden_in_arm as arms

TRUE = {"contact_stiffness.margin": -0.001, "body_mass:foot": -0.2, "body_inertia:foot": -0.1}


@cache
def fitted(off, settings=DEFAULTS):
    """The hopper's noise-free data fitted with three numbers, begun so far off: library, look, free
    numbers, and their errors (3,).
    """
    problem = arms.problem(
        [(label, [size]) for label, size in TRUE.items()], sigma=1e-9, name="hopper"
    )
    instances = [arms.instance(problem.simulator, label) for label in TRUE]
    library = Library(problem.simulator.with_effects(instances), instances, len(problem.space))
    declared = problem.simulator.nominal
    truth = np.array(list(TRUE.values()))
    free = len(declared) + np.arange(len(TRUE))
    train = split(problem, 5, 96)[0]
    floor = np.full(len(problem.simulator.signals), 1e-6)
    theta = np.concatenate([declared, (1 + off) * truth])
    begun = linearize(library, train, theta, white(1e3 * floor))
    begun = linearize(library, train, begun.theta, estimate_noise(begun, begun.whiten.noise, floor))
    found = refit(library, begun, free, floor, settings=settings)
    return library, found, free, found.theta[free] - truth


@pytest.mark.parametrize("off", [0.1, pytest.param(-0.02, marks=pytest.mark.study)])
def test_where_predictions_bend(off):
    """A contact's margin, to which windows answer that an impact has only just reached: found to
    1e-6 of the truth, whatever is near, and within four standard errors.
    """
    library, found, free, errors = fitted(off)
    assert np.all(np.abs(errors) < 1e-6 * np.abs(list(TRUE.values())))
    assert np.all(
        np.abs(errors) < 4 * standard_errors(library, SimpleNamespace(free=free, train=found))[0]
    )


@pytest.mark.study
def test_wide_differences_alone_stop_short():
    """The control: slopes over the usual widths take so small steps that the foot's mass stays 0.1
    % off and more; where the fit is right, as above, the margin's standard error by them is less
    than half of what it should be.
    """
    library, found, free, _ = fitted(0.1)
    state = SimpleNamespace(free=free, train=found)
    near = standard_errors(library, state)[0]
    wide = standard_errors(library, state, close=1e-9)[0]
    assert wide[0] < 0.5 * near[0]
    assert np.abs(fitted(-0.02, RefitSettings(close=1.0))[-1] / list(TRUE.values())).max() > 1e-3


ARM = """<mujoco><option timestep="0.002"/><worldbody><body>
<joint name="hinge" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="1"/></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""
SIZE = np.array([1e-3, 1e-2])
WHITE_ALONE = DiagnosisSettings(noise=WhitenessSettings(z=np.inf))


def swinging(folder, *, rho=0.0, uneven=0.0, damping=0.0, runs=20, steps=60):
    """A problem file of an arm in open loop: sensors' errors with that autoregression, the fraction
    of control steps that are a fifth too short or too long, and damping that the model lacks.
    """
    rng = np.random.default_rng(0)
    model = mujoco.MjModel.from_xml_string(ARM)
    model.dof_damping += damping
    rows = np.empty((runs, steps + 1, 2))
    torque = np.repeat(rng.normal(0, 2, (runs, steps // 5 + 1)), 5, axis=1)[:, : steps + 1]
    physics = 5 + rng.choice([-1, 0, 1], (runs, steps), p=[uneven / 2, 1 - uneven, uneven / 2])
    for run in range(runs):
        data = mujoco.MjData(model)
        data.qpos[0] = rng.uniform(-0.5, 0.5)
        for k in range(steps + 1):
            rows[run, k] = data.qpos[0], data.qvel[0]
            data.ctrl[0] = torque[run, k]
            if k < steps:
                mujoco.mj_step(model, data, physics[run, k])
    errors = rng.standard_normal((runs, steps + 1, 2))
    for k in range(steps):
        errors[:, k + 1] = rho * errors[:, k] + np.sqrt(1 - rho**2) * errors[:, k + 1]
    (folder / "arm.xml").write_text(ARM)
    np.savez(
        folder / "log.npz",
        observations=(rows + SIZE * errors).reshape(-1, 2),
        actions=torque.reshape(-1, 1),
        terminals=np.tile(np.arange(steps + 1) == steps, runs),
    )
    file = folder / "problem.yaml"
    file.write_text(
        "model: arm.xml\nframe_skip: 5\ndata: log.npz\nobservation: [qpos, qvel]\n"
        "start_noise: true\n"
    )
    return load(file, threads=1)


@pytest.mark.parametrize("noise", [{"rho": 0.9}, {"uneven": 0.2}])
def test_noise_that_is_not_white_is_no_error_of_the_model(tmp_path, noise):
    """Nothing is missing, and nothing is said to be; a warning says what the noise is. By white
    noise alone something is missing.
    """
    problem = swinging(tmp_path, **noise)
    found = Diagnose(["joint_damping"], windows=48).run(problem)
    blind = Diagnose(["joint_damping"], windows=48, settings=WHITE_ALONE).run(problem)
    assert found.verdict == "consistent"
    said = (
        "errors follow each other in qpos.hinge"
        if noise.get("rho")
        else "control steps seem to differ"
    )
    assert said in " ".join(found.warnings)
    assert said not in " ".join(blind.warnings)
    assert blind.verdict != "consistent"  # the control


def test_causes_are_found_beside_noise_that_is_not_white(tmp_path):
    """Damping within four standard errors, and nothing remains."""
    found = Diagnose(["joint_damping", "joint_friction"], windows=48).run(
        swinging(tmp_path, damping=0.05, rho=0.9)
    )
    assert [cause.effect for cause in found.causes] == ["joint_damping"]
    size = found.causes[0].estimate["damping"]
    assert abs(size.value - 0.05) < 4 * size.se
    assert found.verdict == "explained"


def test_white_noise_stays_white(tmp_path):
    """Answers are those of white noise alone, number by number."""
    problem = swinging(tmp_path)
    found, blind = (
        Diagnose(["joint_damping"], windows=48, settings=settings).run(problem)
        for settings in (DiagnosisSettings(), WHITE_ALONE)
    )
    assert found.verdict == "consistent"
    assert found.simulator_steps == blind.simulator_steps
    assert found.to_json()["noise"] == blind.to_json()["noise"]


def test_size_of_uneven_steps(tmp_path):
    """0.2 sqrt(0.2) of a step within a quarter (a t for three values), and no colour beside it."""
    problem = swinging(tmp_path, uneven=0.2)
    library = Library(problem.simulator, (), 0)
    windows = split(problem, 10, 60)[0]
    floor = 1e-6 * SIZE
    begun = linearize(library, windows, np.zeros(0), white(SIZE))
    found = other_noise(library, with_noise(library, begun, floor), floor)
    assert not found.coloured
    assert abs(found.timing / (0.2 * np.sqrt(0.2)) - 1) < 0.25
