"""How usual each effect is on machines: what decides between causes where the data do not."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

USUAL = MappingProxyType(
    {
        # What hardly any first model has right.
        "joint_friction": 0.0,
        "joint_damping": 0.0,
        "joint_armature": 0.0,
        "actuator_gain": 0.0,
        "tendon_friction": -0.5,  # of machines whose drives pull tendons
        "tendon_damping": -0.5,
        "tendon_armature": -0.5,
        "payload": -0.5,
        "body_mass": -0.5,
        "actuator_delay": -0.5,
        # What a model's drawing, mounting or first guess may get wrong.
        "body_com": -1.0,
        "contact_friction": -1.0,
        "sensor_bias": -1.0,
        "actuator_bias": -1.0,
        "actuator_lag": -1.0,
        "contact_stiffness": -1.0,
        "body_inertia": -1.5,
        "joint_stiffness": -1.5,
        "joint_load_friction": -1.5,
        "sensor_delay": -1.5,
        "gravity_tilt": -1.5,
        "joint_stribeck": -2.0,
        "joint_limit": -2.0,
        "gear_lash": -2.0,
        "actuator_torque_speed": -2.0,
        "external_force": -2.0,
    }
)
"""Log odds of effects against the most usual ones [nats], one of which every machine has."""


@dataclass(frozen=True)
class Plausibility:
    """Log odds of effects before any data are seen, against the most usual ones.

    They stand for what an engineer expects of a machine, not for what was counted anywhere, and are
    small: a hundred transitions that tell two effects apart outweigh them.

    Attributes
    ----------
    log_odds : mapping of str to float
        By an effect's name [nats].
    others : float
        Of every effect that is not in it [nats].
    """

    log_odds: Mapping[str, float] = field(default_factory=lambda: USUAL)
    others: float = -3.0

    def of(self, effect: str) -> float:
        """Return the log odds of an effect [nats].

        Parameters
        ----------
        effect : str
            Its name.

        Returns
        -------
        float
        """
        return self.log_odds.get(effect, self.others)
