"""The motion of a free base that nobody logged, from an IMU on it and the feet that carry it.

The accelerometer and the gyro say how the base moves on from instant to instant; feet that stand do
not move, which the joints' angles turn into the base's velocity and height [1]_. All instants are
solved together (a smoother). Neither masses nor friction of the model count in it: what is fitted
later is not in the states already. Where on the ground the base is and which way it faces shows in
none of these measurements; both begin at zero.

References
----------
.. [1] Bloesch et al., "State estimation for legged robots: consistent fusion of leg kinematics and
   IMU", Robotics: Science and Systems 8, 2012.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.numerics.block_chain import BlockChain
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import ModelJoints
from dropo.mjmodel.sensors import Sensor
from dropo.mjmodel.standing import (
    Footing,
    footing,
    ground_height,
    level_ground,
    site_in_body,
    site_of,
)

STATES = 9
"""Numbers of the step of an instant: rotation [rad], velocity [m/s], position [m]; world's axes."""
BIASES = 6
"""Of the gyro [rad/s] and of the accelerometer [m/s^2], the same in a run; base's axes."""
HELD = 1e9
"""Information on what no measurement shows, at a run's first instant."""


@dataclass(frozen=True)
class BaseMotionSettings:
    """How well feet stand, how the IMU errs, and when neither agrees with the other.

    Attributes
    ----------
    slip : float
        Scale of the speed of a foot that stands, without the noise of the joints' speeds [m/s].
    sinking : float
        Standard deviation of the height of a foot that stands [m].
    degrees : float
        Degrees of freedom of the Student t of both: feet slide, and leave the ground.
    rough : float
        The same in the first rounds, while the inclination may be off.
    rough_rounds : int
        So many; behind them the feet are found anew.
    low : float
        A foot may stand where it is at most so high above the lowest one [m].
    lowest : float
        The same in the first round, in which feet that move do not show yet [m].
    acceleration, turning : float
        Least standard deviations of the IMU between two instants [m/s^2, rad/s]: it shows an impact
        at one of them, or at none.
    path : float
        Standard deviation of the velocity by which the position goes on [m/s].
    turning_bias, acceleration_bias : float
        Standard deviations of the IMU's biases [rad/s, m/s^2].
    rounds : int
        Of linearization, at most.
    settled : float
        They end where no velocity moves by more than this [m/s].
    standing : float
        A foot stands at an instant where its speed is below this many standard deviations.
    least_standing : float
        At this fraction of the instants at least one foot must stand.
    largest_bias : float
        A bias of so many standard deviations says that the IMU is turned in its mount.
    sampled : int
        Instants whose errors are computed.
    more : float
        Another solution is better if so many more feet stand at an instant, on average.
    shared : float
        Errors of neighbouring instants are alike; those of the smoother, which takes them for
        independent, are so many times as large.
    common : float
        The velocity is as uncertain as this fraction of the speed that the steadiest foot has in
        the middle: feet that slide together show in no measurement.
    """

    slip: float = 0.03
    sinking: float = 0.004
    degrees: float = 1.0
    rough: float = 0.03
    rough_rounds: int = 4
    low: float = 0.05
    lowest: float = 1e-3
    acceleration: float = 0.25
    turning: float = 0.01
    path: float = 0.002
    turning_bias: float = 0.02
    acceleration_bias: float = 0.2
    rounds: int = 12
    settled: float = 1e-3
    standing: float = 3.0
    least_standing: float = 0.5
    largest_bias: float = 3.0
    sampled: int = 20
    more: float = 0.1
    shared: float = 3.0
    common: float = 0.5


DEFAULTS = BaseMotionSettings()


@dataclass(frozen=True, eq=False)
class Imu:
    """What an IMU showed at n instants, and where it is on the base.

    Attributes
    ----------
    turning, acceleration : (n, 3) array
        Of the gyro [rad/s] and the accelerometer [m/s^2], both in the base's axes.
    noise : (float, float)
        Standard deviations of both.
    site : int
        Of the accelerometer.
    place : (3,) array
        Of the accelerometer, in the base's axes [m].
    """

    turning: Array
    acceleration: Array
    noise: tuple[float, float]
    site: int
    place: Array


@dataclass(frozen=True, eq=False)
class BaseMotion:
    """The estimated motion of a base.

    Attributes
    ----------
    positions : (n, 7) array
        Place [m] and quaternion, the real part first.
    velocities : (n, 6) array
        As qvel has them: of the place in the world's axes [m/s], of the rotation in the base's
        [rad/s].
    position_sd : (6,) array
        Typical errors of place and rotation [m, rad]; of what is not observable, where on the
        ground and which way, those of height and inclination.
    velocity_sd : (6,) array
        The same of the velocities [m/s, rad/s].
    standing : float
        The fraction of the instants at which a foot stands.
    bias : (6,) array
        Of the gyro [rad/s] and the accelerometer [m/s^2], in the base's axes.
    footholds : float
        How many feet stand, the mean over the instants: at rest, and at the height of the ground.
    """

    positions: Array
    velocities: Array
    position_sd: Array
    velocity_sd: Array
    standing: float
    bias: Array
    footholds: float


def imu_of(
    robot: ModelJoints, gyro: Sensor, accelerometer: Sensor, turning: Array, acceleration: Array
) -> Imu | None:
    """Bring what a gyro and an accelerometer on the base show into its axes.

    Parameters
    ----------
    robot : ModelJoints
        The robot.
    gyro, accelerometer : Sensor
        Both on sites.
    turning, acceleration : (n, 3) array
        What they show [rad/s, m/s^2].

    Returns
    -------
    Imu or None
        None where one of them is not on a site of the floating base.
    """
    first = site_of(robot.model, gyro.id)
    second = site_of(robot.model, accelerometer.id)
    if first is None or second is None:
        return None
    _, of_gyro = site_in_body(robot.model, first)
    place, of_accelerometer = site_in_body(robot.model, second)
    noise = (_zigzag(turning), _zigzag(acceleration))
    return Imu(turning @ of_gyro.T, acceleration @ of_accelerometer.T, noise, second, place)


def _zigzag(values: Array) -> float:
    """The standard deviation of white noise with such second differences, a median."""
    return float(np.median(np.abs(np.diff(values, n=2, axis=0))) / (0.6745 * np.sqrt(6)))


def estimate_base(
    robot: ModelJoints,
    time: Array,
    positions: Array,
    velocities: Array,
    joint_noise: float,
    imu: Imu,
    settings: BaseMotionSettings = DEFAULTS,
    bias: Array | None = None,
) -> BaseMotion:
    """Estimate the motion of a free base whose machine stands and walks on a level ground.

    Parameters
    ----------
    robot : ModelJoints
        With one free joint, and a level plane.
    time : (n,) array
        Increasing instants [s].
    positions, velocities : (n, nq), (n, nv) array
        Of the joints; those of the base do not count [rad, m].
    joint_noise : float
        Standard deviation of the joints' velocities [rad/s].
    imu : Imu
        What was measured then.
    settings : BaseMotionSettings, optional
        How.
    bias : (6,) array, optional
        Of the IMU, where the rounds begin; by default 0, and beyond what is found where that is
        more than usual.

    Returns
    -------
    BaseMotion
    """
    given = (robot, time, positions, velocities, joint_noise, imu, settings)
    found = _solved(_Smoother(*given, np.zeros(BIASES) if bias is None else bias))
    while bias is None and np.any(np.abs(found.bias[3:]) > settings.acceleration_bias):
        # An IMU that is askew puts feet so high that they count as flying: some are found again
        # from a bias that is larger than the one at which the others stop.
        beyond = _solved(_Smoother(*given, 2 * found.bias))
        if beyond.footholds <= found.footholds + settings.more:
            break
        found = beyond
    return found


def _solved(search: "_Smoother") -> BaseMotion:
    """The motion after all rounds."""
    settings = search.settings
    for turn in range(settings.rounds):
        moved = search.improve(turn)
        if turn > settings.rough_rounds and moved < settings.settled:
            break
    return search.motion()


class _Smoother:
    """Rounds of least squares, each linearized at the motion of the one before."""

    def __init__(
        self,
        robot: ModelJoints,
        time: Array,
        positions: Array,
        velocities: Array,
        joint_noise: float,
        imu: Imu,
        settings: BaseMotionSettings,
        bias: Array,
    ):
        from scipy.spatial.transform import Rotation  # slow to import

        self.rotation = Rotation
        self.robot = robot
        self.steps = np.diff(time)[:, None]
        self.joints = (positions, velocities)
        self.imu = imu
        self.settings = settings
        self.ground = level_ground(robot.model)
        assert self.ground is not None
        self.sd = np.concatenate(
            [
                np.full(3, np.hypot(settings.turning, imu.noise[0] / np.sqrt(2))),
                np.full(3, np.hypot(settings.acceleration, imu.noise[1] / np.sqrt(2))),
                np.full(3, settings.path),
            ]
        )
        self.bias = bias
        self.sinking = settings.rough
        self.turns = self._first_turns()
        self.velocity = np.zeros((len(time), 3))
        self.place = np.zeros((len(time), 3))
        self.footing = self._feet()
        arm = float(np.sqrt(np.mean(np.sum(self.footing.places**2, axis=2))))
        self.slip = float(np.hypot(settings.slip, arm * joint_noise))
        self.chain = BlockChain.zeros(len(time), STATES, BIASES)

    def _first_turns(self) -> Any:
        """The gyro added up, from where the accelerometer points up on average."""
        middle = 0.5 * (self.imu.turning[1:] + self.imu.turning[:-1]) - self.bias[:3]
        middle = middle * self.steps
        steps = self.rotation.from_rotvec(middle)
        turns = [self.rotation.identity()]
        for step in steps:
            turns.append(turns[-1] * step)
        added = self.rotation.concatenate(turns)
        up = added.apply(self.imu.acceleration - self.bias[3:]).mean(axis=0)
        upright, _ = self.rotation.align_vectors([[0, 0, 1.0]], [up / np.linalg.norm(up)])
        return upright * added

    def _feet(self) -> Footing:
        """The points that may stand, the base turned as it is thought to be."""
        assert self.ground is not None
        quaternions = self.turns.as_quat(scalar_first=True)
        return footing(self.robot.model, self.ground, self.imu.site, quaternions, *self.joints)

    def improve(self, turn: int) -> float:
        """One round; how far the velocities moved at most [m/s]."""
        if turn in (2, self.settings.rough_rounds):
            self.footing = self._feet()
        self.sinking = self.settings.rough
        if turn >= self.settings.rough_rounds:
            self.sinking = self.settings.sinking
        self.chain = BlockChain.zeros(len(self.place), STATES, BIASES)
        self._add_imu()
        self._add_feet(first=turn == 0)
        self._add_priors()
        step, of_bias = self.chain.solve()
        self.bias = self.bias + of_bias
        self.turns = self.rotation.from_rotvec(step[:, :3]) * self.turns
        self.velocity = self.velocity + step[:, 3:6]
        self.place = self.place + step[:, 6:]
        return float(np.abs(step[:, 3:6]).max())

    def _add_imu(self) -> None:
        """How the base moves on from each instant."""
        matrix = self.turns.as_matrix()
        h = self.steps
        acceleration, ahead = self._ahead(matrix)
        by_state = np.tile(np.eye(STATES), (len(h), 1, 1))
        by_state[:, 3:6, :3] = -_cross(acceleration - self.robot.gravity) * h[:, :, None]
        by_state[:, 6:, 3:6] = np.eye(3) * h[:, :, None]
        by_bias = np.zeros((len(h), STATES, BIASES))
        by_bias[:, :3, :3] = -matrix[:-1] * h[:, :, None]
        by_bias[:, 3:6, 3:] = -0.5 * (matrix[1:] + matrix[:-1]) * h[:, :, None]
        self.chain.add_links(by_state, by_bias, ahead, (self.sd * h) ** -2.0)

    def _ahead(self, matrix: Array) -> tuple[Array, Array]:
        """(n - 1, 3) accelerations between instants, and (n - 1, 9) how far each is ahead."""
        h = self.steps
        turning = 0.5 * (self.imu.turning[1:] + self.imu.turning[:-1]) - self.bias[:3]
        reached = self.turns[:-1] * self.rotation.from_rotvec(turning * h)
        turned = (reached * self.turns[1:].inv()).as_rotvec()
        own = np.einsum("nij,nj->ni", matrix, self.imu.acceleration - self.bias[3:])
        own = own + self.robot.gravity
        between = 0.5 * (own[1:] + own[:-1])
        faster = self.velocity[:-1] + between * h - self.velocity[1:]
        middle = 0.5 * (self.velocity[1:] + self.velocity[:-1])
        farther = self.place[:-1] + middle * h - self.place[1:]
        return between, np.concatenate([turned, faster, farther], axis=1)

    def _foot_speeds(self, matrix: Array) -> tuple[Array, Array, Array]:
        """(n, k, 3) speeds of the feet, their part that turns with the base, and their places from
        the site, all in the world's axes.
        """
        feet = self.footing
        turning = self.imu.turning - self.bias[:3]
        own = feet.speeds + np.cross(turning[:, None], feet.places)
        turned = np.einsum("nij,nkj->nki", matrix, own)
        places = np.einsum("nij,nkj->nki", matrix, feet.places)
        return self.velocity[:, None] + turned, turned, places

    def _add_feet(self, *, first: bool) -> None:
        """Feet that stand have no speed, and are on the ground."""
        matrix = self.turns.as_matrix()
        speeds, turned, places = self._foot_speeds(matrix)
        heights = self.place[:, None, 2] + places[:, :, 2]
        weight, weight_of_height = self._foot_weights(speeds, heights, first)
        for k in range(weight.shape[1]):
            by_state = np.zeros((len(matrix), 4, STATES))
            by_state[:, :3, :3] = -_cross(turned[:, k])
            by_state[:, :3, 3:6] = np.eye(3)
            by_state[:, 3, :3] = -_cross(places[:, k])[:, 2]
            by_state[:, 3, 8] = 1.0
            by_bias = np.zeros((len(matrix), 4, BIASES))
            by_bias[:, :3, :3] = matrix @ _cross(self.footing.places[:, k])
            residual = -np.concatenate([speeds[:, k], heights[:, k, None]], axis=1)
            weights = np.repeat(weight[:, k, None] / self.slip**2, 4, axis=1)
            weights[:, 3] = weight_of_height[:, k] / self.sinking**2
            self.chain.add_rows(by_state, by_bias, residual, weights)

    def _foot_weights(self, speeds: Array, heights: Array, first: bool) -> tuple[Array, Array]:
        """(n, k) how much each foot's speed and its height count."""
        settings = self.settings
        if first:
            lowest = np.where(self.footing.heights <= settings.lowest, 1.0, 0.0)
            return lowest, lowest
        near = self.footing.heights < settings.low
        nu = settings.degrees
        square = np.sum(speeds**2, axis=2) / self.slip**2
        weight = np.where(near, (nu + 3) / (nu + square), 0.0)
        of_height = np.where(near, (nu + 1) / (nu + (heights / self.sinking) ** 2), 0.0)
        return weight, of_height

    def _add_priors(self) -> None:
        """Biases are small; place on the ground and direction begin where they are."""
        settings = self.settings
        sizes = np.repeat([settings.turning_bias, settings.acceleration_bias], 3)
        self.chain.corner[:] += np.diag(sizes**-2.0)
        self.chain.right_corner[:] -= self.bias * sizes**-2.0
        held = [2, 6, 7]
        self.chain.diagonal[0, held, held] += HELD
        everywhere = np.arange(STATES)
        self.chain.diagonal[:, everywhere, everywhere] += 1 / HELD

    def motion(self) -> BaseMotion:
        """The motion of the base's own place."""
        matrix = self.turns.as_matrix()
        turning = self.imu.turning - self.bias[:3]
        arm = self.imu.place
        place = self.place - np.einsum("nij,j->ni", matrix, arm)
        assert self.ground is not None
        place[:, 2] += ground_height(self.robot.model, self.ground)
        velocity = self.velocity - np.einsum("nij,nj->ni", matrix, np.cross(turning, arm))
        quaternions = self.turns.as_quat(scalar_first=True)
        flips = np.cumsum(np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0) % 2
        quaternions[1:] *= np.where(flips, -1.0, 1.0)[:, None]
        speeds, _, _ = self._foot_speeds(matrix)
        near = self.footing.heights < self.settings.low
        steadiest = np.sqrt(np.where(near, np.sum(speeds**2, axis=2), np.inf).min(axis=1))
        standing = float(np.mean(steadiest < self.settings.standing * self.slip))
        position_sd, velocity_sd = self._errors(float(np.median(steadiest)))
        return BaseMotion(
            np.concatenate([place, quaternions], axis=1),
            np.concatenate([velocity, turning], axis=1),
            position_sd,
            velocity_sd,
            standing,
            self.bias,
            self._footholds(matrix, speeds),
        )

    def _footholds(self, matrix: Array, speeds: Array) -> float:
        """How many feet stand still and on the ground at an instant, on average."""
        settings = self.settings
        _, _, places = self._foot_speeds(matrix)
        heights = self.place[:, None, 2] + places[:, :, 2]
        slips = np.sum(speeds**2, axis=2) / self.slip**2
        sinks = (heights / settings.sinking) ** 2
        return float(np.mean(np.sum(slips + sinks < settings.standing**2, axis=1)))

    def _errors(self, unsteady: float) -> tuple[Array, Array]:
        """(6,) of place and rotation and (6,) of velocities, the steadiest feet being so fast."""
        settings = self.settings
        count = len(self.place)
        sampled = np.linspace(0, count - 1, min(settings.sampled, count)).astype(int)
        sd = settings.shared * np.median(self.chain.deviations(sampled), axis=0)
        inclination = float(max(sd[:2]))
        position_sd = np.concatenate([np.full(3, sd[8]), np.full(3, inclination)])
        velocity = np.maximum(sd[3:6], settings.common * unsteady)
        return position_sd, np.concatenate([velocity, np.full(3, self.imu.noise[0])])


def _cross(vectors: Array) -> Array:
    """(n, 3, 3) matrices C with C v = vector x v."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.moveaxis(np.array(rows), 2, 0)
