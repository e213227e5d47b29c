"""The target `mjlab`: terms that its event manager runs; without mjlab, against its signatures."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from dropo.core.services.registry import find
from dropo.exports.export import export
from dropo.exports.mjlab import CHECKED
from dropo.mjmodel.fields import FieldParameter
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

DRAWS = 20_000
ENVIRONMENTS = 1000
BOUND = 4.5
"""Standard errors, of some ten comparisons each."""
CUT_SD = 0.8796
COMMON = {"asset_cfg", "ranges", "distribution", "operation", "axes", "shared_random"}
GAINS = {"asset_cfg", "kp_range", "kd_range", "distribution", "operation"}
SIGNATURES = {
    **dict.fromkeys(
        (
            "body_mass",
            "body_com_offset",
            "joint_damping",
            "joint_armature",
            "joint_friction",
            "joint_stiffness",
            "joint_limits",
            "geom_friction",
            "tendon_damping",
            "tendon_stiffness",
            "tendon_friction",
            "tendon_armature",
        ),
        COMMON,
    ),
    "pair_friction": COMMON | {"isotropic"},
    "pd_gains": GAINS,
}
"""The parameters of functions of `mjlab.envs.mdp.dr` in mjlab 1.6.0, behind env and env_ids."""
ELEMENTS = {"joint_names", "body_names", "geom_names", "actuator_names", "tendon_names"}
"""Those of `SceneEntityCfg` that name elements."""


class Entity:
    """What stands for SceneEntityCfg: a name and names of elements."""

    def __init__(self, name, **elements):
        assert set(elements) <= ELEMENTS | {"pair_names"}
        self.name = name
        self.elements = elements


def stand_in(monkeypatch):
    """Modules of mjlab with the classes and functions that a file imports, and no more."""
    functions = {name: name for name in SIGNATURES}
    dr = SimpleNamespace(**functions, Distribution=lambda name, sample: sample)
    parts = {
        "mjlab.envs.mdp": {"dr": dr},
        "mjlab.managers.event_manager": {"EventTermCfg": lambda **kept: SimpleNamespace(**kept)},
        "mjlab.managers.scene_entity_config": {"SceneEntityCfg": Entity},
        "mjlab.actuator.xml_actuator": {
            "XmlActuatorCfg": lambda **kept: SimpleNamespace(
                **{"delay_min_lag": 0, "delay_max_lag": 0, **kept}
            )
        },
    }
    for name, content in parts.items():
        for parent in ("mjlab", name.rpartition(".")[0], name):
            module = sys.modules.get(parent) or ModuleType(parent)
            monkeypatch.setitem(sys.modules, parent, module)
        vars(sys.modules[name]).update(content)


def errors_of(events):
    """What a term has that its function or its manager does not know."""
    found = []
    for name, term in events.items():
        unknown = set(term.params) - SIGNATURES.get(term.func, set())
        found += [f"{name}: {key}" for key in sorted(unknown)]
        if term.mode not in ("startup", "reset", "interval", "step"):
            found.append(f"{name}: {term.mode}")
        if term.params.get("operation") not in ("abs", "scale", "add"):
            found.append(f"{name}: operation")
    return found


def events_of(problem, fit, folder, monkeypatch):
    """The terms of an export beside stand-ins for mjlab, its report, and all that it defines."""
    stand_in(monkeypatch)
    found = export(fit, "mjlab", folder, problem=problem)
    made = run_file(folder / "events.py")
    return made["EVENTS"], found, made


def draws_of(term, key):
    """Draws of a term's number, by a range of it."""
    import torch

    torch.manual_seed(0)
    low, high = (torch.tensor([end]) for end in term.params[key])
    return term.params["distribution"](low, high, (DRAWS, 1), "cpu").double().numpy()


def test_terms_are_those_that_mjlab_knows(tmp_path, monkeypatch):
    """Functions, their parameters, elements and delays; a wrong parameter is found."""
    pytest.importorskip("torch")
    problem = arm_problem(fixed=[("actuator_delay:servo", [0.009])])
    events, found, made = events_of(problem, known_fit(problem), tmp_path, monkeypatch)
    assert errors_of(events) == []
    assert {name: term.func for name, term in events.items()} == {
        "mass": "body_mass",
        "damping": "joint_damping",
        "dry": "joint_friction",
        "armature": "joint_armature",
        "kp": "pd_gains",
    }
    assert events["mass"].params["asset_cfg"].elements == {"body_names": ("upper",)}
    lags = [(one.delay_min_lag, one.delay_max_lag) for one in made["ACTUATORS"]]
    assert lags == [(0, 0), (2, 2)]
    assert found.left_out == (
        "The spread of gravity is left out: no function of mjlab's dr sets opt.gravity.",
    )
    assert found.approximated == (
        "actuator_delay:servo is 2 physics steps of 0.004 s, for 0.009 s.",
    )
    assert CHECKED in (tmp_path / "events.py").read_text()
    events["mass"].params["mass_range"] = (0, 1)
    assert errors_of(events) == ["mass: mass_range"]


def test_terms_draw_from_the_fit(arm, tmp_path, monkeypatch):
    """Each number's mean and standard deviation; the control is another standard deviation."""
    pytest.importorskip("torch")
    events, _, _ = events_of(*arm, tmp_path, monkeypatch)
    sd = np.sqrt((CUT_SD * SCALES) ** 2 + ERRORS**2)
    scale = [1, 1, 1, 0.02, 1]
    for i, (name, term) in enumerate(events.items()):
        draws = draws_of(term, "kp_range" if name == "kp" else "ranges")
        assert beyond(draws, scale[i] * MEANS[i], scale[i] * sd[i]) < BOUND
        assert beyond(draws, scale[i] * MEANS[i], scale[i] * SCALES[i]) > BOUND
    np.testing.assert_array_equal(draws_of(events["kp"], "kd_range"), np.float32(0.4))


@pytest.mark.parametrize("family", ["full", "log_normal", "uniform"])
def test_every_family_is_drawn(family, tmp_path, monkeypatch):
    """By each parameter's own distribution; that correlations are lost is said."""
    pytest.importorskip("torch")
    problem = arm_problem((*PARAMETERS[:2], replace(PARAMETERS[2], low=0.01)))
    phi = None
    if family == "full":
        covariance = np.diag([0.04, 0.01, 0.0004])
        covariance[0, 1] = covariance[1, 0] = 0.015
        phi = find("families", family)(problem.space).phi_of(MEANS[:3], covariance)
    fit = known_fit(problem, MEANS[:3], SCALES[:3], ERRORS[:3], family, phi)
    events, found, _ = events_of(problem, fit, tmp_path, monkeypatch)
    said = "Parameters are drawn independently: terms of mjlab hold no correlations."
    assert (found.approximated == (said,)) == (family == "full")
    for i, term in enumerate(events.values()):
        sd = np.sqrt(fit.sd[i] ** 2 + ERRORS[i] ** 2)
        assert beyond(draws_of(term, "ranges"), fit.mean[i], sd) < BOUND


def test_several_numbers_by_one_draw(tmp_path, monkeypatch):
    """All hinges' friction by one draw that is added; what terms would draw apart is left out."""
    pytest.importorskip("torch")
    whole = FieldParameter("centre", 0.5, 1.5, field="body_ipos", element="upper", relative=True)
    kv = FieldParameter("kv", 0.1, 1.0, field="actuator_kv", element="servo")
    gain = FieldParameter("gain", 0.5, 2.0, field="actuator_gainprm", element="push", index=0)
    free = ("joint_friction.hinges",)
    problem = arm_problem((MASS, whole, PARAMETERS[4], kv, gain), free)
    means = np.array([1.3, 1.0, 15.0, 0.4, 1.0, 0.05])
    fit = known_fit(problem, means, 0.1 * means, 0.02 * means)
    events, found, _ = events_of(problem, fit, tmp_path, monkeypatch)
    friction = events["joint_friction.hinges/frictionloss"].params
    assert friction["asset_cfg"].elements == {"joint_names": ("shoulder", "elbow")}
    assert friction["shared_random"] is True
    assert friction["operation"] == "add"
    assert friction["ranges"] == pytest.approx((-0.05, 1.0))
    assert found.left_out == (
        "The spread of centre is left out: it is several numbers, which terms of mjlab would draw "
        "independently.",
        "The spread of kv is left out: dr.pd_gains sets both gains of a servo, and draws the other "
        "one.",
        "The spread of gain is left out: no function of mjlab's dr sets actuator_gainprm.",
    )


RUN = """
import json, sys, mujoco
sys.path.insert(0, sys.argv[1])
from events import ACTUATORS, EVENTS
from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab.envs.mdp import joint_pos_rel
from mjlab.managers.observation_manager import ObservationGroupCfg, ObservationTermCfg
from mjlab.scene import SceneCfg

robot = EntityCfg(
    spec_fn=lambda: mujoco.MjSpec.from_file(sys.argv[1] + "/model.xml"),
    articulation=EntityArticulationInfoCfg(actuators=ACTUATORS),
)
seen = ObservationGroupCfg(terms={"qpos": ObservationTermCfg(func=joint_pos_rel)})
scene = SceneCfg(num_envs=int(sys.argv[2]), entities={"robot": robot})
config = ManagerBasedRlEnvCfg(decimation=4, scene=scene, observations={"actor": seen}, seed=1)
config.events |= EVENTS
environment = ManagerBasedRlEnv(config, device="cpu")
environment.reset()
model = environment.sim.model
body = mujoco.mj_name2id(environment.sim.mj_model, mujoco.mjtObj.mjOBJ_BODY, "robot/upper")
found = {
    "mass": model.body_mass[:, body],
    "damping": model.dof_damping[:, 0],
    "dry": model.dof_frictionloss[:, 0],
    "armature": model.dof_armature[:, 0] / 0.02,
    "kp": model.actuator_gainprm[:, 1, 0],
    "minus kp": model.actuator_biasprm[:, 1, 1],
    "minus kv": model.actuator_biasprm[:, 1, 2],
    "subtree": model.body_subtreemass[:, body],
}
print("FOUND" + json.dumps({name: values.tolist() for name, values in found.items()}))
"""
"""An environment of mjlab with the exported robot, actuators and events, reset once."""


def test_an_environment_of_mjlab_runs_them(tmp_path):
    """In mjlab itself, by the Python that DROPO_MJLAB names, since mjlab needs an older MuJoCo: a
    reset sets the drawn numbers in every environment, and the masses of subtrees follow.
    """
    python = os.environ.get("DROPO_MJLAB")
    if python is None:
        pytest.skip("DROPO_MJLAB names no Python with mjlab")
    problem = arm_problem(fixed=[("actuator_delay:servo", [0.009])])
    export(known_fit(problem), "mjlab", tmp_path, problem=problem)
    command = [python, "-c", RUN, str(tmp_path), str(ENVIRONMENTS)]
    plain = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=plain)
    found = json.loads(done.stdout.partition("FOUND")[2])
    drawn = np.array([found[name] for name in ("mass", "damping", "dry", "armature", "kp")]).T
    sd = np.sqrt((CUT_SD * SCALES) ** 2 + ERRORS**2)[:5]
    assert beyond(drawn, MEANS[:5], sd) < BOUND
    assert beyond(drawn, MEANS[:5], 1.3 * sd) > BOUND
    np.testing.assert_allclose(found["minus kp"], -drawn[:, 4])
    np.testing.assert_allclose(found["minus kv"], -0.4, rtol=1e-6)
    np.testing.assert_allclose(found["subtree"], drawn[:, 0] + 0.5, rtol=1e-6)
