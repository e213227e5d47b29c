"""The targets `mjx` and `playground`: the function that wrappers of MuJoCo Playground call."""

import ast
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dropo.core.services.registry import find
from dropo.exports.export import export
from dropo.exports.mjx import mjx as target
from dropo.exports.support.subject import subject_of_fit
from tests.exports.conftest import (
    ERRORS,
    MASS,
    MEANS,
    PARAMETERS,
    SCALES,
    arm_problem,
    beyond,
    known_fit,
    run_file,
)

BATCH = 4000
BOUND = 4.5
"""Standard errors, of two dozen comparisons."""
SINGLE = 2e-6
"""Relative rounding of single precision."""
CUT_SD = 0.8796


def test_signature_and_fields(arm, tmp_path):
    """Without JAX: `domain_randomize(model, rng)`, and fields that an mjx.Model has, each element
    by its own name.
    """
    problem, fit = arm
    assert find("exports", "playground") is target
    export(fit, "playground", tmp_path, problem=problem)
    tree = ast.parse((tmp_path / "domain_randomize.py").read_text())
    functions = {one.name: one for one in tree.body if isinstance(one, ast.FunctionDef)}
    assert [one.arg for one in functions["domain_randomize"].args.args] == ["model", "rng"]
    imported = {one.module for one in ast.walk(tree) if isinstance(one, ast.ImportFrom)}
    assert imported == {"mujoco"}
    (table,) = [
        ast.literal_eval(one.value)
        for one in tree.body
        if isinstance(one, ast.Assign) and one.targets[0].id == "NUMBERS"
    ]
    named = {(field, *entry[:3]) for field, entries in table.items() for entry in entries}
    assert named == {
        ("body_mass", "body", "upper", (0,)),
        ("dof_damping", "joint", "shoulder", (0,)),
        ("dof_frictionloss", "joint", "shoulder", (0,)),
        ("dof_armature", "joint", "shoulder", (0,)),
        ("actuator_gainprm", "actuator", "servo", (0, 0)),
        ("actuator_biasprm", "actuator", "servo", (0, 1)),
        ("opt.gravity", None, None, (2,)),
    }


def test_what_does_not_change_in_proportion_keeps_its_mean():
    """A payload moves masses and centres together; a linear effect beside it is kept."""
    free = ("joint_friction:elbow", "payload:lower")
    problem = arm_problem((MASS,), free, [("actuator_delay:push", [0.006])])
    means = np.array([1.3, 0.05, 0.3, 0.05, 0.02, -0.1])
    subject = subject_of_fit(known_fit(problem, means, 0.1 * np.abs(means), 0 * means), problem)
    numbers, others = subject.probed
    assert {(one.field, one.owner, round(one.slope, 9)) for one in numbers} == {
        ("body_mass", ("body", "upper"), 1.0),
        ("dof_frictionloss", ("joint", "elbow"), 1.0),
    }
    assert others == [f"payload:lower/{name}" for name in ("mass", "x", "y", "z")]
    left_out = target(subject).left_out
    assert left_out[0] == (
        "actuator_delay:push (delay 0.006 s) is left out: the function sets numbers of a model "
        "alone."
    )
    assert left_out[1].startswith("The spread of payload:lower/mass is left out: it is no number")


@pytest.fixture(scope="module")
def batch(arm, tmp_path_factory):
    """A batch of models of the arm, their axes, and the model that they are made from."""
    jax = pytest.importorskip("jax")
    mjx = pytest.importorskip("mujoco.mjx")
    problem, fit = arm
    folder = tmp_path_factory.mktemp("mjx")
    export(fit, "mjx", folder, problem=problem)
    function = run_file(folder / "domain_randomize.py")["domain_randomize"]
    model = mjx.put_model(mujoco.MjModel.from_xml_path(str(folder / "model.xml")))
    keys = jax.random.split(jax.random.PRNGKey(0), BATCH)
    return function(model, keys), model, function


def test_the_batch_is_drawn_from_the_fit(batch):
    """Means and standard deviations; the control lacks what is not known of the means."""
    (models, _), _, _ = batch
    drawn = np.stack(
        [
            models.body_mass[:, 1],
            models.dof_damping[:, 0],
            models.dof_frictionloss[:, 0],
            models.dof_armature[:, 0] / 0.02,
            models.actuator_gainprm[:, 1, 0],
            models.opt.gravity[:, 2],
        ],
        axis=1,
    ).astype(float)
    sd = np.sqrt((CUT_SD * SCALES) ** 2 + ERRORS**2)
    assert beyond(drawn, MEANS, sd) < BOUND
    assert beyond(drawn, MEANS, CUT_SD * SCALES) > BOUND
    np.testing.assert_array_equal(
        models.actuator_biasprm[:, 1, 1], -models.actuator_gainprm[:, 1, 0]
    )


def test_the_batch_steps_as_each_model_alone(batch, arm):
    """vmap over the axes that are returned; each of three models moves as plain MuJoCo's does."""
    jax = pytest.importorskip("jax")
    mjx = pytest.importorskip("mujoco.mjx")
    (models, axes), model, _ = batch
    start = mjx.make_data(model).replace(ctrl=np.array([0.5, 0.1]))
    moved = jax.vmap(lambda one: mjx.step(one, start), in_axes=(axes,))(models)
    assert axes.body_mass == 0
    assert axes.body_inertia is None
    simulator = arm[0].simulator
    for i in range(3):
        values = np.array(
            [
                models.body_mass[i, 1],
                models.dof_damping[i, 0],
                models.dof_frictionloss[i, 0],
                models.dof_armature[i, 0] / 0.02,
                models.actuator_gainprm[i, 1, 0],
                models.opt.gravity[i, 2],
            ],
            dtype=float,
        )
        plain = simulator.model_of(values)
        data = mujoco.MjData(plain)
        data.ctrl[:] = [0.5, 0.1]
        mujoco.mj_step(plain, data)
        np.testing.assert_allclose(moved.qvel[i], data.qvel, rtol=5e-3, atol=1e-4)
        subtree = np.asarray(models.body_subtreemass[i])
        np.testing.assert_allclose(subtree, plain.body_subtreemass, rtol=SINGLE)
    assert np.ptp(np.asarray(moved.qvel[:, 0])) > 1e-3


def test_elements_are_found_by_name(batch):
    """In a model with another body in front; one without the element is refused."""
    jax = pytest.importorskip("jax")
    mjx = pytest.importorskip("mujoco.mjx")
    function = batch[2]
    text = """<mujoco><worldbody>
      <body name="stone" pos="5 0 0"><freejoint/><geom size="0.1"/></body>
      <body name="upper"><joint name="shoulder" axis="0 1 0"/><geom size="0.1"/>
      <body name="lower"><joint name="elbow" axis="0 1 0"/><geom size="0.1"/></body></body>
      </worldbody><actuator><position name="servo" joint="elbow" kp="1"/></actuator></mujoco>"""
    keys = jax.random.split(jax.random.PRNGKey(1), 2)
    model = mujoco.MjModel.from_xml_string(text)
    models, _ = function(mjx.put_model(model), keys)
    assert np.all(np.asarray(models.body_mass[:, 1]) == model.body_mass[1].astype(np.float32))
    assert np.all(np.abs(np.asarray(models.body_mass[:, 2]) - 1.3) < 0.5)
    assert np.all(np.asarray(models.dof_damping[:, 6]) > 0.1)
    assert np.all(np.asarray(models.dof_damping[:, 7]) == 0)
    other = mujoco.MjModel.from_xml_string(text.replace('"servo"', '"push"'))
    with pytest.raises(
        ValueError, match="The model has no actuator 'servo', whose actuator_gainprm"
    ):
        function(mjx.put_model(other), keys)


@pytest.mark.parametrize("family", ["full", "log_normal", "uniform"])
def test_every_family_is_drawn(family, tmp_path):
    """Correlations too: draws of the file and of NumPy have the same moments."""
    jax = pytest.importorskip("jax")
    pytest.importorskip("mujoco.mjx")
    problem = arm_problem((*PARAMETERS[:2], replace(PARAMETERS[2], low=0.01)))
    phi = None
    if family == "full":
        covariance = np.diag([0.04, 0.01, 0.0004])
        covariance[0, 1] = covariance[1, 0] = 0.015
        phi = find("families", family)(problem.space).phi_of(MEANS[:3], covariance)
    fit = known_fit(problem, MEANS[:3], SCALES[:3], ERRORS[:3], family, phi)
    subject = subject_of_fit(fit, problem)
    export(fit, "mjx", tmp_path, problem=problem)
    made = run_file(tmp_path / "domain_randomize.py")
    draws = jax.vmap(made["draw"])(jax.random.split(jax.random.PRNGKey(2), 20_000))
    draws = np.asarray(draws, dtype=float)
    mean, sd = (
        np.array([of(name) for name in fit.space.names]) for of in (subject.mean, subject.sd)
    )
    assert beyond(draws, mean, sd) < BOUND
    found = np.corrcoef(draws.T)[0, 1]
    expected = np.corrcoef(subject.distribution.sample(20_000, np.random.default_rng(5)).T)[0, 1]
    assert abs(found - expected) < BOUND * np.sqrt(2 / 20_000)
    assert (abs(expected) > 0.5) == (family == "full")
