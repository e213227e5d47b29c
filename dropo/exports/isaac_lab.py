"""The target `isaac-lab`: event terms and actuator settings as YAML."""

import math
from collections.abc import Callable
from typing import Any

from dropo._version import __version__
from dropo.core.services.files.strict_yaml import format_yaml
from dropo.exports.support.subject import (
    NO_SPREAD,
    CannotHold,
    DrawnNumber,
    Subject,
    Written,
    delays_of,
    effects_left_out,
    others_left_out,
    remarks_of,
)
from dropo.mjmodel.dynamics.drives import Drive, drives_of

CHECKED = "2.3.2"
"""The version of Isaac Lab whose functions and settings are named here."""
EVENTS = "isaaclab.envs.mdp.events"
ACTUATORS = "isaaclab.actuators.actuator_pd_cfg"
MODE = "startup"
"""When terms draw: Isaac Lab advises it for all that goes through the CPU."""
AXES = "xyz"
HEADER = """Event terms and actuator settings for Isaac Lab {checked}, from what was fitted.

    content = yaml.safe_load(open("isaac_lab.yaml"))
    call = isaaclab.utils.string.string_to_callable
    for name, term in content["events"].items():
        params = dict(term["params"])
        params["asset_cfg"] = SceneEntityCfg(**params["asset_cfg"])
        made = EventTermCfg(func=call(term["func"]), mode=term["mode"], params=params)
        setattr(cfg.events, name, made)
    for name, kept in content["actuators"].items():
        cfg.scene.robot.actuators[name] = call(kept.pop("class"))(**kept)

The articulation is called "robot"; model.xml is the model at the means, for the importer of MJCF.
Terms draw once for each environment. Written by dropo {version} from {name!r}.
{remarks}"""


def isaac_lab(subject: Subject) -> Written:
    """Event terms and actuator settings of Isaac Lab as YAML.

    Parameters
    ----------
    subject : Subject
        The robot at its means; event terms are written only where it has a distribution.

    Returns
    -------
    Written
        The file isaac_lab.yaml and the MJCF at the means, with what Isaac Lab has no setting for.
    """
    drives = drives_of(subject.model)
    approximated = list(subject.approximated)
    delays, others = delays_of(subject, drives, approximated)
    left_out = effects_left_out(others, "Isaac Lab has no setting for it")
    events: dict[str, Any] = {}
    if subject.distribution is None:
        left_out.append(NO_SPREAD)
    else:
        events = _events(subject, drives, left_out, approximated)
    content = {"events": events, "actuators": _actuators(drives, delays)}
    remarks = remarks_of(left_out, approximated)
    header = HEADER.format(checked=CHECKED, version=__version__, name=subject.name, remarks=remarks)
    commented = "".join(f"# {line}".rstrip() + "\n" for line in header.splitlines())
    text = commented + format_yaml(content)
    files: dict[str, str | bytes] = {"isaac_lab.yaml": text}
    return Written(files, tuple(left_out), tuple(approximated), subject.older_xml)


def _events(
    subject: Subject, drives: list[Drive], left_out: list[str], approximated: list[str]
) -> dict[str, Any]:
    """The event terms by parameter."""
    distribution = subject.distribution
    assert distribution is not None
    numbers, others = subject.probed
    left_out += others_left_out(subject, others)
    exact = distribution.kind == "normal" and not distribution.logarithmic
    if not exact:
        kind = "log-normal" if distribution.logarithmic else distribution.kind
        approximated.append(
            f"Isaac Lab knows normal and uniform distributions, and the fit is {kind}: terms have "
            "its means and standard deviations."
        )
    if distribution.together:
        approximated.append(
            "Parameters are drawn independently: terms of Isaac Lab hold no correlations."
        )
    events: dict[str, Any] = {}
    for name in distribution.names:
        own = [one for one in numbers if one.parameter == name]
        if own:
            try:
                events[_identifier(name)] = _event(subject, drives, own)
            except CannotHold as error:
                left_out.append(f"The spread of {name} is left out: {error}")
    uniform = [name for name in distribution.names if _is_uniform(events.get(_identifier(name)))]
    if uniform and distribution.kind != "uniform":
        approximated.append(
            f"Uniform, with their standard deviations: {', '.join(uniform)}. Isaac Lab scales "
            "static, dynamic and viscous friction by draws of one range, and moves centres of mass "
            "by uniform ones."
        )
    return events


def _is_uniform(term: dict[str, Any] | None) -> bool:
    """Whether a term draws from a uniform distribution."""
    if term is None:
        return False
    return "com_range" in term["params"] or term["params"]["distribution"] == "uniform"


def _identifier(name: str) -> str:
    """A parameter's name as an attribute."""
    return "".join(letter if letter.isalnum() else "_" for letter in name)


def _event(subject: Subject, drives: list[Drive], numbers: list[DrawnNumber]) -> dict[str, Any]:
    """The term of a parameter; refused with a reason where there is none."""
    one = numbers[0]
    name = one.parameter
    binding = subject.binding(name)
    field = one.field
    if binding is not None and binding.parameter.field in ("actuator_kp", "actuator_kv"):
        field = binding.parameter.field
    elif len(numbers) > 1:
        raise CannotHold("it is several numbers, which Isaac Lab would draw independently.")
    if field not in TERMS:
        raise CannotHold(f"no event term of Isaac Lab sets {field}.")
    if one.owner is None:
        raise CannotHold(f"{field} is of what has no name.")
    function, selected, params = TERMS[field](subject, drives, one)
    asset = {"name": "robot", **selected}
    return {
        "func": f"{EVENTS}:{function}",
        "mode": MODE,
        "params": {"asset_cfg": asset, **params},
    }


Term = tuple[str, dict[str, list[str]], dict[str, Any]]


def _normal(subject: Subject, one: DrawnNumber, key: str) -> dict[str, Any]:
    """A number drawn from a normal distribution."""
    return {
        key: [one.mean, abs(one.slope) * subject.sd(one.parameter)],
        "operation": "abs",
        "distribution": "gaussian",
    }


def _half_width(subject: Subject, one: DrawnNumber) -> float:
    """Half of the width of the uniform distribution with the number's standard deviation."""
    return math.sqrt(3) * abs(one.slope) * subject.sd(one.parameter)


def _mass(subject: Subject, drives: list[Drive], one: DrawnNumber) -> Term:
    """A mass, of which the rotational inertia stays as it is."""
    params = _normal(subject, one, "mass_distribution_params") | {"recompute_inertia": False}
    return "randomize_rigid_body_mass", {"body_names": [_name(one)]}, params


def _centre(subject: Subject, drives: list[Drive], one: DrawnNumber) -> Term:
    """A centre of mass along one axis, about that of the model."""
    half = _half_width(subject, one)
    ranges = {"com_range": {AXES[one.row[1]]: [-half, half]}}
    return "randomize_rigid_body_com", {"body_names": [_name(one)]}, ranges


def _armature(subject: Subject, drives: list[Drive], one: DrawnNumber) -> Term:
    """A joint's armature."""
    params = _normal(subject, one, "armature_distribution_params")
    return "randomize_joint_parameters", {"joint_names": [_name(one)]}, params


def _friction(subject: Subject, drives: list[Drive], one: DrawnNumber) -> Term:
    """A joint's dry friction, as a factor on that of its actuator settings."""
    if one.mean <= 0:
        raise CannotHold("its mean is 0, and terms of Isaac Lab scale the friction of a joint.")
    half = min(_half_width(subject, one) / one.mean, 1.0)
    params = {
        "friction_distribution_params": [1 - half, 1 + half],
        "operation": "scale",
        "distribution": "uniform",
    }
    return "randomize_joint_parameters", {"joint_names": [_name(one)]}, params


def _limit(subject: Subject, drives: list[Drive], one: DrawnNumber) -> Term:
    """An end of a joint's range."""
    end = ("lower", "upper")[one.row[1]]
    params = _normal(subject, one, f"{end}_limit_distribution_params")
    return "randomize_joint_parameters", {"joint_names": [_name(one)]}, params


def _damping(subject: Subject, drives: list[Drive], one: DrawnNumber) -> Term:
    """A joint's viscous friction, which is in the damping of its drive."""
    drive = next(drive for drive in drives if drive.joint == _name(one))
    sd = abs(one.slope) * subject.sd(one.parameter)
    return _gain_term("damping", drive, drive.damping, sd)


def _servo(subject: Subject, drives: list[Drive], one: DrawnNumber) -> Term:
    """A gain of a position servo."""
    drive = next((drive for drive in drives if drive.actuator == one.place[0]), None)
    if drive is None or drive.stiffness == 0:
        raise CannotHold("its actuator is no position servo of one joint alone.")
    binding = subject.binding(one.parameter)
    assert binding is not None
    sd = abs(one.slope) * subject.sd(one.parameter) * drive.gear**2
    if binding.parameter.field == "actuator_kp":
        return _gain_term("stiffness", drive, drive.stiffness, sd)
    return _gain_term("damping", drive, drive.damping, sd)


def _gain_term(kind: str, drive: Drive, mean: float, sd: float) -> Term:
    """A gain of a drive, drawn from a normal distribution."""
    params = {
        f"{kind}_distribution_params": [mean, sd],
        "operation": "abs",
        "distribution": "gaussian",
    }
    return "randomize_actuator_gains", {"joint_names": [drive.joint]}, params


TERMS: dict[str, Callable[[Subject, list[Drive], DrawnNumber], Term]] = {
    "body_mass": _mass,
    "body_ipos": _centre,
    "dof_armature": _armature,
    "dof_frictionloss": _friction,
    "dof_damping": _damping,
    "jnt_range": _limit,
    "actuator_kp": _servo,
    "actuator_kv": _servo,
}
"""What makes the term of a field, or of a servo's gain."""


def _name(one: DrawnNumber) -> str:
    """The name of a number's element."""
    assert one.owner is not None
    return one.owner[1]


def _actuators(drives: list[Drive], delays: dict[str, int]) -> dict[str, Any]:
    """The settings of each driven or passive joint's actuator."""
    found: dict[str, Any] = {}
    for drive in drives:
        steps = delays.get(drive.joint, 0)
        kind = "DelayedPDActuatorCfg" if steps else "ImplicitActuatorCfg"
        settings: dict[str, Any] = {
            "class": f"{ACTUATORS}:{kind}",
            "joint_names_expr": [drive.joint],
            "stiffness": drive.stiffness,
            "damping": drive.damping,
            "armature": drive.armature,
            "friction": drive.friction,
            "dynamic_friction": drive.friction,
            "viscous_friction": 0.0,
        }
        if drive.limit is not None:
            settings["effort_limit" if steps else "effort_limit_sim"] = drive.limit
        if steps:
            settings |= {"min_delay": steps, "max_delay": steps}
        found[_identifier(drive.joint)] = settings
    return found
