"""The target `isaac-lab` against the functions and settings of Isaac Lab, by name and type."""

import numpy as np
import pytest
from ruamel.yaml import YAML

from dropo.exports.export import export
from dropo.exports.isaac_lab import CHECKED
from dropo.mjmodel.fields import FieldParameter
from tests.exports.conftest import ERRORS, MEANS, PARAMETERS, SCALES, arm_problem, known_fit

CUT_SD = 0.8796
PAIR = "pair"
"""Two numbers: the ends of a uniform distribution, or mean and standard deviation."""
DRAWN = {
    "operation": ("add", "scale", "abs"),
    "distribution": ("uniform", "log_uniform", "gaussian"),
}
FUNCTIONS = {
    "randomize_rigid_body_mass": {
        "mass_distribution_params": PAIR,
        "recompute_inertia": bool,
        "min_mass": float,
        **DRAWN,
    },
    "randomize_rigid_body_com": {"com_range": dict},
    "randomize_actuator_gains": {
        "stiffness_distribution_params": PAIR,
        "damping_distribution_params": PAIR,
        **DRAWN,
    },
    "randomize_joint_parameters": {
        "friction_distribution_params": PAIR,
        "armature_distribution_params": PAIR,
        "lower_limit_distribution_params": PAIR,
        "upper_limit_distribution_params": PAIR,
        **DRAWN,
    },
}
"""Parameters of functions of isaaclab.envs.mdp.events behind env, env_ids and asset_cfg, from the
source of isaaclab 2.3.2.post1. A factor's range is refused there unless its ends ascend from 0.
"""
SETTINGS = {
    "joint_names_expr": list,
    "stiffness": float,
    "damping": float,
    "armature": float,
    "friction": float,
    "dynamic_friction": float,
    "viscous_friction": float,
    "effort_limit": float,
    "effort_limit_sim": float,
}
CLASSES = {
    "ImplicitActuatorCfg": SETTINGS,
    "DelayedPDActuatorCfg": SETTINGS | {"min_delay": int, "max_delay": int},
}
"""Fields of isaaclab.actuators.actuator_pd_cfg, in the same version."""


def errors_of(content):
    """What in events and actuators Isaac Lab would refuse."""
    found = []
    for name, term in content["events"].items():
        module, function = term["func"].split(":")
        known = FUNCTIONS.get(function, {})
        params = dict(term["params"])
        asset = params.pop("asset_cfg")
        fine = module == "isaaclab.envs.mdp.events" and term["mode"] in ("startup", "reset")
        fine = fine and set(term) == {"func", "mode", "params"} and asset["name"] == "robot"
        fine = fine and set(asset) <= {"name", "body_names", "joint_names"}
        if not fine or function not in FUNCTIONS:
            found.append(name)
        for key, value in params.items():
            if key not in known or not fits(value, known[key]):
                found.append(f"{name}.{key}")
        pairs = [value for key, value in params.items() if known.get(key) == PAIR]
        if params.get("operation") == "scale":
            found += [f"{name}: range" for low, high in pairs if not 0 <= low <= high]
    for name, kept in content["actuators"].items():
        module, kind = kept["class"].split(":")
        known = CLASSES.get(kind, {})
        if module != "isaaclab.actuators.actuator_pd_cfg":
            found.append(name)
        given = {key: value for key, value in kept.items() if key != "class"}
        found += [
            f"{name}.{key}"
            for key, value in given.items()
            if key not in known or not isinstance(value, known[key])
        ]
    return found


def fits(value, kind):
    """Whether a value is of a kind: a pair of numbers, one of several words, or a type."""
    if kind == PAIR:
        return len(value) == 2 and all(isinstance(one, float) for one in value)
    return value in kind if isinstance(kind, tuple) else isinstance(value, kind)


def content_of(problem, fit, folder):
    """What is in the YAML file, and the report."""
    found = export(fit, "isaac-lab", folder, problem=problem)
    return YAML(typ="safe").load((folder / "isaac_lab.yaml").read_text()), found


def test_events_and_actuators_are_those_of_isaac_lab(tmp_path):
    """A fit of the arm with a delay; wrong keys, words and ranges are found."""
    problem = arm_problem(fixed=[("actuator_delay:servo", [0.009])])
    content, found = content_of(problem, known_fit(problem), tmp_path)
    assert errors_of(content) == []
    assert list(content["events"]) == ["mass", "damping", "dry", "armature", "kp"]
    assert found.left_out == (
        "The spread of gravity is left out: no event term of Isaac Lab sets opt.gravity.",
    )
    assert [sentence.split(":")[0] for sentence in found.approximated] == [
        "actuator_delay",
        "Isaac Lab knows normal and uniform distributions, and the fit is truncated normal",
        "Uniform, with their standard deviations",
    ]
    text = (tmp_path / "isaac_lab.yaml").read_text()
    assert CHECKED in text
    assert "# The spread of gravity is left out" in text
    content["events"]["mass"]["params"]["mass_params"] = [1.0, 0.1]
    content["events"]["kp"]["params"]["operation"] = "set"
    content["events"]["dry"]["params"]["friction_distribution_params"] = [1.0, 0.2]
    content["events"]["armature"]["func"] = "isaaclab.envs.mdp.events:randomize_armature"
    content["actuators"]["elbow"]["lag"] = 2
    assert errors_of(content) == [
        "mass.mass_params",
        "dry: range",
        "armature",
        "armature.armature_distribution_params",
        "armature.operation",
        "armature.distribution",
        "kp.operation",
        "elbow.lag",
    ]


def test_numbers_are_those_fitted(arm, tmp_path):
    """Means and standard deviations, and a servo behind its gear of 1.5."""
    content, _ = content_of(*arm, tmp_path)
    sd = np.sqrt((CUT_SD * SCALES) ** 2 + ERRORS**2)
    params = {name: term["params"] for name, term in content["events"].items()}
    pairs = {
        "mass": ("mass_distribution_params", 1.0),
        "damping": ("damping_distribution_params", 1.0),
        "armature": ("armature_distribution_params", 0.02),
        "kp": ("stiffness_distribution_params", 1.5**2),
    }
    for i, parameter in enumerate(PARAMETERS):
        if parameter.name in pairs:
            key, factor = pairs[parameter.name]
            expected = [factor * MEANS[i], factor * sd[i]]
            assert params[parameter.name][key] == pytest.approx(expected, rel=1e-4)
    low, high = params["dry"]["friction_distribution_params"]
    assert (low + high) / 2 == pytest.approx(1.0)
    assert (high - low) / np.sqrt(12) == pytest.approx(sd[2] / MEANS[2], rel=1e-4)
    shoulder, elbow = content["actuators"]["shoulder"], content["actuators"]["elbow"]
    assert (shoulder["stiffness"], shoulder["damping"]) == (0.0, 0.4)
    assert (shoulder["friction"], shoulder["effort_limit_sim"]) == (0.15, 20.0)
    assert (elbow["stiffness"], elbow["damping"]) == pytest.approx((33.75, 0.9))


def test_what_isaac_lab_cannot_hold(tmp_path):
    """Effects, contacts and springs are named one by one, and the rest is kept."""
    spring = FieldParameter("spring", 0.5, 5.0, field="jnt_stiffness", element="elbow")
    whole = FieldParameter("centre", 0.5, 1.5, field="body_ipos", element="upper", relative=True)
    x = FieldParameter("x", 0.0, 0.3, field="body_ipos", element="lower", index=0)
    fixed = [("actuator_lag:push", [0.01]), ("gravity_tilt.x", [0.05])]
    problem = arm_problem((PARAMETERS[0], spring, whole, x), fixed=fixed)
    means = np.array([1.3, 2.0, 1.0, 0.1])
    content, found = content_of(
        problem, known_fit(problem, means, 0.1 * means, 0 * means), tmp_path
    )
    assert errors_of(content) == []
    assert list(content["events"]) == ["mass", "x"]
    half = content["events"]["x"]["params"]["com_range"]["x"]
    assert half == pytest.approx(
        [-np.sqrt(3) * CUT_SD * 0.01, np.sqrt(3) * CUT_SD * 0.01], rel=1e-4
    )
    assert found.left_out == (
        "actuator_lag:push (time constant 0.01 s) is left out: Isaac Lab has no setting for it.",
        "The spread of spring is left out: no event term of Isaac Lab sets jnt_stiffness.",
        "The spread of centre is left out: it is several numbers, which Isaac Lab would draw "
        "independently.",
    )
