"""What is hidden in the machine on legs whose logs are fitted and diagnosed."""

from dataclasses import dataclass, replace

from dropo.problems.simulated.example_quadruped import MODEL, Walk

MOTOR = '<position name="FR_knee" joint="FR_knee"/>'
JOINT = '<joint name="RL_hip" axis="0 1 0" range="-40 170"/>'


@dataclass(frozen=True)
class Hidden:
    """A machine that differs from its model, and what a diagnosis is to say of it.

    Attributes
    ----------
    texts : tuple of (str, str)
        What stands in the model, and in the machine instead.
    late : float
        By how much commands act late [s].
    tilt : float
        By how much the IMU is mounted askew [rad].
    cause : (str, str) or None
        Effect and target that are to be named; "imu" where the import is to say it; None where
        nothing may be named.
    size : float
        Of the effect's first number.
    """

    texts: tuple[tuple[str, str], ...] = ()
    late: float = 0.0
    tilt: float = 0.0
    cause: tuple[str, str] | None = None
    size: float = 0.0

    @property
    def machine(self) -> str:
        """The machine as MJCF."""
        text = MODEL
        for old, new in self.texts:
            assert old in text
            text = text.replace(old, new)
        return text

    def walk(self, walk: Walk) -> Walk:
        """Make how it walks and is logged, with an IMU.

        Parameters
        ----------
        walk : Walk
            That of the model.

        Returns
        -------
        Walk
        """
        return replace(walk, imu=True, late=self.late, tilt=self.tilt)


TRUNK = '<site name="imu" pos="0.02 0 0.01"/>'
LOAD = (
    '<geom type="box" size="0.06 0.04 0.03" pos="0.05 0 0.08" mass="1" contype="0"'
    ' conaffinity="0"/>'
)
FITTED = Hidden((('mass="5.2"', 'mass="6.5"'), ('friction="0.7 ', 'friction="0.5 ')))
"""The machine whose trunk mass and ground friction are fitted."""
TRUTH = {"trunk": 6.5, "floor": 0.5}
"""These numbers [kg, 1]."""
HIDDEN = {
    "1 kg on the trunk": Hidden(((TRUNK, f"{TRUNK}{LOAD}"),), cause=("payload", "trunk"), size=1.0),
    "70 % of a knee's servo": Hidden(
        ((MOTOR, MOTOR.replace("/>", ' kp="42" kv="0.7"/>')),),
        cause=("actuator_gain", "FR_knee"),
        size=-0.3,
    ),
    "0.4 N m at a hip": Hidden(
        ((JOINT, JOINT.replace("/>", ' frictionloss="0.6"/>')),),
        cause=("joint_friction", "RL_hip"),
        size=0.4,
    ),
    "commands 4 ms late": Hidden(late=0.004, cause=("actuator_delay", ""), size=0.004),
    "IMU askew by 0.1 rad": Hidden(tilt=0.1, cause=("imu", "acc"), size=0.1),
    "ground friction 0.4": Hidden(
        (('friction="0.7 ', 'friction="0.4 '),), cause=("contact_friction", ""), size=0.4 / 0.7 - 1
    ),
    "nothing": Hidden(),
}
"""By name what is hidden, one at a time."""
