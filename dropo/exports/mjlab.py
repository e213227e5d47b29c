"""The target `mjlab`: event terms with its functions for domain randomization."""

from dataclasses import dataclass

from dropo._version import __version__
from dropo.exports.support.distribution import REDRAWS, FittedDistribution
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
from dropo.mjmodel.dynamics.drives import Drive, Servo, drives_of, servo_of

CHECKED = "1.6.0"
"""The version of mjlab whose functions are named here."""
FUNCTIONS = {
    "body_mass": "body_mass",
    "body_ipos": "body_com_offset",
    "dof_damping": "joint_damping",
    "dof_armature": "joint_armature",
    "dof_frictionloss": "joint_friction",
    "jnt_stiffness": "joint_stiffness",
    "jnt_range": "joint_limits",
    "geom_friction": "geom_friction",
    "pair_friction": "pair_friction",
    "tendon_damping": "tendon_damping",
    "tendon_stiffness": "tendon_stiffness",
    "tendon_frictionloss": "tendon_friction",
    "tendon_armature": "tendon_armature",
}
"""The function of mjlab's `dr` that sets a field."""
GAINS = {"actuator_kp": ("kp_range", "kd_range"), "actuator_kv": ("kd_range", "kp_range")}
"""The gain that a parameter is in `dr.pd_gains`, and the other one."""
APART = "it is several numbers, which terms of mjlab would draw independently."
DISTINCT = 1e-9
"""Fraction of a slope by which the slopes of two numbers that are drawn together may differ."""

HEADER = '''"""Parameters drawn from what was fitted, as event terms of mjlab {checked}.

    from events import ACTUATORS, EVENTS          # this file
    EntityArticulationInfoCfg(actuators=ACTUATORS)         # of the robot, whose MJCF is model.xml
    cfg.events |= EVENTS                                   # of a ManagerBasedRlEnvCfg

The scene's entity is called "robot". Every term draws one
parameter at each reset, from its own distribution: ranges are (a, b) of a number a + b * parameter.
The spread holds what was fitted and what is not known of the means.
Written by dropo {version} from {name!r}.
{remarks}"""

'''
CODE = '''import torch
from mjlab.actuator.xml_actuator import XmlActuatorCfg
from mjlab.envs.mdp import dr
from mjlab.managers.event_manager import EventTermCfg
from mjlab.managers.scene_entity_config import SceneEntityCfg

KIND = {kind!r}
LOGARITHMIC = {logarithmic}
REDRAWS = {redraws}
INF = float("inf")


def fitted(centre, scale, error, lower, upper):
    """The distribution of a parameter, times the upper end of a range and added to the lower."""

    def attempt(shape, device):
        if KIND == "uniform":
            parts = 2 * torch.rand(shape, device=device) - 1
        else:
            parts = torch.randn(shape, device=device)
            if KIND == "truncated normal":
                torch.nn.init.trunc_normal_(parts, a=-2.0, b=2.0)
        values = centre + scale * parts
        return torch.exp(values) if LOGARITHMIC else values

    def sample(offset, slope, shape, device):
        values = attempt(shape, device)
        for _ in range(REDRAWS):
            bad = (values < lower) | (values > upper)
            values = torch.where(bad, attempt(shape, device), values)
        values = values.clamp(lower, upper) + error * torch.randn(shape, device=device)
        return offset + slope * values.clamp(lower, upper)

    return dr.Distribution("fitted", sample)


ACTUATORS = (
{actuators})
EVENTS = {{
{terms}}}
'''


@dataclass(frozen=True)
class EventTerm:
    """An event term.

    Attributes
    ----------
    function : str
        Of `dr`.
    elements : str
        The argument of SceneEntityCfg that names elements, such as "joint_names".
    names : tuple of str
        The elements.
    arguments : str
        The function's further arguments, as source text.
    """

    function: str
    elements: str
    names: tuple[str, ...]
    arguments: str


def mjlab(subject: Subject) -> Written:
    """Event terms of mjlab, one for each parameter, with its functions for domain randomization.

    Parameters
    ----------
    subject : Subject
        The robot at its means; event terms are written only where it has a distribution.

    Returns
    -------
    Written
        The file of events and actuators and the MJCF at the means, with what mjlab has no setting
        for among `left_out`.
    """
    drives = drives_of(subject.model)
    approximated = list(subject.approximated)
    delays, others = delays_of(subject, drives, approximated)
    left_out = effects_left_out(others, "mjlab has no setting for it")
    terms = ""
    if subject.distribution is None:
        left_out.append(NO_SPREAD)
    else:
        terms = _terms(subject, subject.distribution, left_out, approximated)
    distribution = subject.distribution
    code = CODE.format(
        kind=distribution.kind if distribution else "normal",
        logarithmic=bool(distribution and distribution.logarithmic),
        redraws=REDRAWS,
        actuators=_actuators(drives, delays),
        terms=terms,
    )
    remarks = remarks_of(left_out, approximated)
    header = HEADER.format(checked=CHECKED, version=__version__, name=subject.name, remarks=remarks)
    files: dict[str, str | bytes] = {"events.py": header + code}
    return Written(files, tuple(left_out), tuple(approximated), subject.older_xml)


def _actuators(drives: list[Drive], delays: dict[str, int]) -> str:
    """The entries of ACTUATORS."""
    text = ""
    for drive in drives:
        if drive.actuator is not None:
            steps = delays.get(drive.joint, 0)
            lag = f", delay_min_lag={steps}, delay_max_lag={steps}" if steps else ""
            text += f"    XmlActuatorCfg(target_names_expr=({drive.joint!r},){lag}),\n"
    return text


def _terms(
    subject: Subject, distribution: FittedDistribution, left_out: list[str], approximated: list[str]
) -> str:
    """The entries of EVENTS."""
    if distribution.together:
        approximated.append(
            "Parameters are drawn independently: terms of mjlab hold no correlations."
        )
    numbers, others = subject.probed
    left_out += others_left_out(subject, others)
    text = ""
    gains: list[str] = []
    for i, name in enumerate(distribution.names):
        own = [one for one in numbers if one.parameter == name]
        if not own:
            continue
        try:
            term = _term(subject, own, gains)
        except CannotHold as error:
            left_out.append(f"The spread of {name} is left out: {error}")
            continue
        text += _event(distribution, i, term)
    return text


def _event(distribution: FittedDistribution, i: int, term: EventTerm) -> str:
    """An entry of EVENTS."""
    scale = float((distribution.factor[i] ** 2).sum() ** 0.5)
    bounds = [
        repr(float(x)).replace("inf", "INF") for x in (distribution.lower[i], distribution.upper[i])
    ]
    given = [repr(float(x)) for x in (distribution.centre[i], scale, distribution.error[i])]
    return (
        f"    {distribution.names[i]!r}: EventTermCfg(\n"
        f"        func=dr.{term.function},\n"
        '        mode="reset",\n'
        "        params={\n"
        f'            "asset_cfg": SceneEntityCfg("robot", {term.elements}={term.names!r}),\n'
        f'            "distribution": fitted({", ".join([*given, *bounds])}),\n'
        f"{term.arguments}"
        "        },\n"
        "    ),\n"
    )


def _term(subject: Subject, numbers: list[DrawnNumber], gains: list[str]) -> EventTerm:
    """The term of a parameter; refused with a reason where there is none."""
    name = numbers[0].parameter
    binding = subject.binding(name)
    names = tuple(one.owner[1] for one in numbers if one.owner is not None)
    if names and binding is not None and binding.parameter.field in GAINS:
        if names[0] in gains:
            raise CannotHold("dr.pd_gains sets both gains of a servo, and draws the other one.")
        servo = servo_of(subject.model, numbers[0].place[0])
        if servo is None:
            raise CannotHold("dr.pd_gains is for position servos.")
        gains.append(names[0])
        return _gains_term(servo, numbers[0], binding.parameter.field, names[0])
    fields = {one.field for one in numbers}
    axes = {one.row[1:] for one in numbers}
    one = numbers[0]
    if len(fields) > 1 or len(axes) > 1:
        raise CannotHold(APART)
    if one.field not in FUNCTIONS:
        raise CannotHold(f"no function of mjlab's dr sets {one.field}.")
    if len(names) < len(numbers):
        raise CannotHold(f"{one.field} is of what has no name.")
    if any(x.row[0] for x in numbers):
        raise CannotHold(APART)
    arguments = _ranges(subject, numbers)
    if one.row[1:]:
        arguments += f'            "axes": [{one.row[1]}],\n'
    assert one.owner is not None
    return EventTerm(FUNCTIONS[one.field], f"{one.owner[0]}_names", names, arguments)


def _ranges(subject: Subject, numbers: list[DrawnNumber]) -> str:
    """The arguments by which one draw gives all numbers."""
    one = numbers[0]
    mean = subject.mean(one.parameter)
    if len(numbers) == 1:
        offset = one.mean - one.slope * mean
        if abs(offset) <= DISTINCT * abs(one.mean):
            offset = 0.0
        ranges = (offset, one.slope)
        return f'            "ranges": {ranges!r},\n            "operation": "abs",\n'
    if all(abs(x.slope - one.slope) <= DISTINCT * abs(one.slope) for x in numbers):
        operation = "add"
        ranges = (-one.slope * mean, one.slope)
    elif all(abs(x.mean - x.slope * mean) <= DISTINCT * abs(x.mean) for x in numbers):
        operation = "scale"
        ranges = (0.0, 1 / mean)
    else:
        raise CannotHold(APART)
    return (
        f'            "ranges": {ranges!r},\n            "operation": "{operation}",\n'
        '            "shared_random": True,\n'
    )


def _gains_term(servo: Servo, one: DrawnNumber, field: str, actuator: str) -> EventTerm:
    """The term of a servo's gain, which leaves the other gain as it is."""
    own, other = GAINS[field]
    kept = servo.kv if own == "kp_range" else servo.kp
    arguments = (
        f'            "{own}": (0.0, {abs(one.slope)!r}),\n'
        f'            "{other}": ({kept!r}, 0.0),\n            "operation": "abs",\n'
    )
    return EventTerm("pd_gains", "actuator_names", (actuator,), arguments)
