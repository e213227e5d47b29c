"""What is hidden in the study of laws: formulas, effects that are then not looked for, noise."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from dropo.core.contracts.effect import EffectInstance, instances_of
from dropo.core.services.validation import Array
from dropo.effects.law import law_instance
from dropo.simulators.mujoco.simulator import MujocoSimulator


@dataclass(frozen=True)
class HiddenLaw:
    """A law that a machine follows and its model does not.

    Attributes
    ----------
    machine : str
        One of `MACHINES`.
    place : str
        The joint.
    formula : str
        The force [N, N m].
    sizes : mapping of str to float
        Its constants, or the magnitudes of the effect that has this formula.
    effect : str
        The effect of the registry that has this formula, which is not looked for then; "" where
        none has it.
    target, variant : str
        Which instance of the effect.
    """

    machine: str
    place: str
    formula: str
    sizes: Mapping[str, float] = field(default_factory=dict)
    effect: str = ""
    target: str | None = None
    variant: str = ""

    def instance(self, simulator: MujocoSimulator) -> tuple[EffectInstance, Array]:
        """Make what acts on the machine.

        Parameters
        ----------
        simulator : MujocoSimulator
            The machine's.

        Returns
        -------
        effect : EffectInstance
        magnitudes : (q,) array
        """
        context = simulator.effect_context
        if not self.effect:
            made = law_instance(context, self.place, self.formula, typical=self.sizes)
        else:
            offered = instances_of(context, self.effect)
            wanted = (self.target, self.variant)
            made = next(one for one in offered if (one.target, one.variant) == wanted)
        return made, np.array([self.sizes.get(one.name, 0.0) for one in made.quantities])


DEVELOPMENT = {
    "quadratic drag": HiddenLaw("torque-arm", "elbow", "-c * abs(v) * v", {"c": 0.1}),
    "cubic drag": HiddenLaw("torque-arm", "shoulder", "-c * v**3", {"c": 0.02}),
    "friction away from the middle": HiddenLaw("torque-arm", "elbow", "-c * q**2 * v", {"c": 0.2}),
}
"""The laws on which the search was first worked out."""
EVALUATION = {
    "cubic spring": HiddenLaw("torque-arm", "shoulder", "-c * q**3", {"c": 1.0}),
    "tether": HiddenLaw("torque-arm", "elbow", "-c * max(q - a, 0)", {"c": 3.0, "a": 0.4}),
    "asymmetric viscous friction": HiddenLaw("torque-arm", "elbow", "-c * abs(v)", {"c": 0.1}),
    "square-root friction": HiddenLaw(
        "torque-arm", "shoulder", "-c * sign(v) * sqrt(abs(v))", {"c": 0.2}
    ),
    "coupling of speeds": HiddenLaw("torque-arm", "elbow", "-c * v.shoulder * v", {"c": 0.05}),
    "torque ripple": HiddenLaw("torque-arm", "shoulder", "c * sin(5 * q)", {"c": 0.3}),
    "thermal derating": HiddenLaw("torque-arm", "elbow", "-c * motor * t", {"c": 0.5}),
    "load friction with presliding": HiddenLaw(
        "torque-arm", "elbow", "-c * abs(motor) * dahl(x)", {"c": 0.3, "x": 0.05}
    ),
    "spring with play": HiddenLaw("torque-arm", "elbow", "-c * dead(q, w)", {"c": 3.0, "w": 0.3}),
    "detent": HiddenLaw(
        "torque-arm",
        "shoulder",
        "-c * (q - a) * exp(-((q - a) / w)**2)",
        {"c": 5.0, "a": 0.3, "w": 0.2},
    ),
    "drag of another axis": HiddenLaw(
        "position-arm", "yaw", "-c * abs(v.lift) * v.lift", {"c": 0.02}
    ),
    "friction that grows with the distance": HiddenLaw(
        "position-arm", "lift", "-c * abs(q) * sign(v)", {"c": 3.0}
    ),
    "drag with the power 1.5": HiddenLaw(
        "position-arm", "bend", "-c * sign(v) * abs(v)**1.5", {"c": 0.05}
    ),
    "presliding friction": HiddenLaw("position-arm", "yaw", "-c * dahl(x)", {"c": 1.5, "x": 0.05}),
    "drag along a rail": HiddenLaw("trolley", "rail", "-c * abs(v) * v", {"c": 2.0}),
    "play of a cable": HiddenLaw("trolley", "rail", "-c * dead(q, w)", {"c": 12.0, "w": 0.4}),
    "force ripple": HiddenLaw("trolley", "rail", "c * sin(k * q)", {"c": 1.0, "k": 25.0}),
    "joint that stiffens": HiddenLaw("trolley", "hook", "-c * q**3", {"c": 1.0}),
    "ripple of an odd order": HiddenLaw("pendulum", "pivot", "c * sin(13 * q)", {"c": 0.08}),
    "derating by past force": HiddenLaw(
        "pendulum", "pivot", "-c * motor * lag(motor**2, T)", {"c": 0.25, "T": 0.5}
    ),
    "friction that saturates": HiddenLaw(
        "pendulum", "pivot", "-c * tanh(v / w)", {"c": 0.1, "w": 4.0}
    ),
    "gain that falls": HiddenLaw("pendulum", "pivot", "-c * motor**3", {"c": 0.06}),
    "stop that gives": HiddenLaw("gantry", "across", "-c * max(q - a, 0)", {"c": 300.0, "a": 0.12}),
    "rail that tightens": HiddenLaw("gantry", "along", "-c * abs(q) * v", {"c": 60.0}),
}
"""The laws that are reported, on seeds of their own."""
REMOVED = {
    "Stribeck friction": HiddenLaw(
        "gantry",
        "along",
        "-c * exp(-(v / w)**2) * sign(v)",
        {"friction": 15.0, "log(speed / 0.5)": 0.0},
        "joint_stribeck",
        "along",
    ),
    "load friction": HiddenLaw(
        "pendulum",
        "pivot",
        "-c * abs(motor) * sign(v)",
        {"share": 0.15},
        "joint_load_friction",
        "pivot",
    ),
    "cogging": HiddenLaw(
        "pendulum",
        "pivot",
        "c * sin(12 * q) + a * cos(12 * q)",
        {"sine": 0.06, "cosine": 0.06},
        "joint_cogging",
        "pivot",
        "12-a-turn",
    ),
    "force that falls with speed": HiddenLaw(
        "trolley",
        "rail",
        "-c * max(motor * v, 0) * sign(v)",
        {"slope": 0.2},
        "actuator_torque_speed",
        "winch",
    ),
    "air drag": HiddenLaw(
        "trolley",
        "rail",
        "-c * abs(v) * v",
        {"density": 150.0},
        "air_drag",
        variant="density",
    ),
}
"""Effects of the registry, each with the formula that stands for it where it is not looked for."""
NULLS = ("gaussian", "t3", "ar1", "quantised")
"""Noise of machines with nothing hidden."""
