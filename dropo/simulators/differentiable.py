"""Robots of few equations, differentiable: pendulum, cart-pole, sliding puck."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dropo.core.records.parameters import Parameter
from dropo.core.records.trajectories import Signal
from dropo.core.services.validation import require
from dropo.simulators.torch import TorchSimulator

if TYPE_CHECKING:
    from torch import Tensor

GRAVITY = 9.81  # [m/s^2]


class Robot(TorchSimulator):
    """x = (q, v), dq/dt = v: a plug-in writes `_acceleration`.

    The action is held over a control step of dt [s].

    Integrated by the classical Runge-Kutta method of fourth order in `substeps` equal steps
    (Hairer, Norsett, Wanner 1993, Solving Ordinary Differential Equations I, section II.1).
    """

    def __init__(
        self, parameters: Sequence[Parameter], signals: Sequence[Signal], dt: float, substeps: int
    ):
        super().__init__(parameters, signals)
        require(dt > 0, "dt", "positive [s]", dt, type(self).__name__)
        require(substeps >= 1, "substeps", "at least 1", substeps, type(self).__name__)
        self.dt = dt
        self.substeps = substeps

    @abstractmethod
    def _acceleration(
        self, values: "Tensor", q: "Tensor", v: "Tensor", actions: "Tensor"
    ) -> "Tensor":
        """dv/dt (K, N, n) from values (K, 1, d), positions and velocities (K, N, n) each, and
        actions (N, q).
        """

    def _advance(self, values: "Tensor", states: "Tensor", actions: "Tensor") -> "Tensor":
        h = self.dt / self.substeps
        for _ in range(self.substeps):
            one = self._slope(values, states, actions)
            two = self._slope(values, states + h / 2 * one, actions)
            three = self._slope(values, states + h / 2 * two, actions)
            four = self._slope(values, states + h * three, actions)
            states = states + h / 6 * (one + 2 * two + 2 * three + four)
        return states

    def _slope(self, values: "Tensor", states: "Tensor", actions: "Tensor") -> "Tensor":
        import torch

        q, v = states.chunk(2, dim=-1)
        return torch.cat([v, self._acceleration(values, q, v, actions)], dim=-1)


class Pendulum(Robot):
    """A point mass m on a massless rod of length l, driven at its pivot: m l^2 q'' = u - c q' - m g
    l sin q.

    Observation (angle q [rad], 0 where it hangs, not wrapped; angular velocity [rad/s]), action
    (torque u [N m]), parameters length [m], mass [kg], damping c [N m s/rad]. Source: Strogatz
    2015, Nonlinear Dynamics and Chaos, section 4.4.
    """

    def __init__(self, *, dt: float = 0.05, substeps: int = 5):
        parameters = [
            Parameter("length", 0.2, 2.0, "m"),
            Parameter("mass", 0.1, 3.0, "kg"),
            Parameter("damping", 0.0, 1.0, "N m s/rad"),
        ]
        super().__init__(
            parameters, [Signal("angle", "rad"), Signal("angular_velocity", "rad/s")], dt, substeps
        )

    def _acceleration(
        self, values: "Tensor", q: "Tensor", v: "Tensor", actions: "Tensor"
    ) -> "Tensor":
        length, mass, damping = values[..., None].unbind(-2)
        return (actions - damping * v) / (mass * length**2) - GRAVITY / length * q.sin()


class CartPole(Robot):
    """A cart on a rail, pushed by u, that carries a uniform pole of mass m and half length l on a
    hinge without friction.

        (M + m) x'' + m l cos(q) q'' - m l sin(q) q'^2 = u - c x'
        cos(q) x'' + 4/3 l q'' = g sin(q)

    Observation (position x [m], angle q [rad], 0 upright and positive towards +x, not wrapped;
    their velocities), action (force u [N]), parameters cart_mass M, pole_mass m [kg], half_length l
    [m], friction c [N s/m] of the rail.
    Source: Barto, Sutton, Anderson 1983, IEEE Trans. Systems, Man, Cybernetics 13; here friction is
    viscous.
    """

    def __init__(self, *, dt: float = 0.02, substeps: int = 4):
        parameters = [
            Parameter("cart_mass", 0.3, 3.0, "kg"),
            Parameter("pole_mass", 0.05, 1.0, "kg"),
            Parameter("half_length", 0.2, 1.5, "m"),
            Parameter("friction", 0.0, 2.0, "N s/m"),
        ]
        signals = [
            Signal("position", "m"),
            Signal("angle", "rad"),
            Signal("velocity", "m/s"),
            Signal("angular_velocity", "rad/s"),
        ]
        super().__init__(parameters, signals, dt, substeps)

    def _acceleration(
        self, values: "Tensor", q: "Tensor", v: "Tensor", actions: "Tensor"
    ) -> "Tensor":
        import torch

        cart, pole, half, friction = values[..., None].unbind(-2)
        angle = q[..., 1:]
        speed = v[..., :1]
        turning = v[..., 1:]
        sin = angle.sin()
        cos = angle.cos()
        force = actions - friction * speed + pole * half * sin * turning**2
        turn = (GRAVITY * sin - cos * force / (cart + pole)) / (
            half * (4 / 3 - pole * cos**2 / (cart + pole))
        )
        return torch.cat([(force - pole * half * cos * turn) / (cart + pole), turn], dim=-1)


class SlidingPuck(Robot):
    """A puck pushed over a level table, with viscous and dry friction: m v' = u - c v - mu m g v /
    sqrt(|v|^2 + s^2).

    Coulomb's friction is made smooth below about s = 1 cm/s, so that a puck at rest creeps under a
    small push instead of sticking. Observation (x, y [m], their velocities [m/s]), action (force in
    x and y [N]), parameters mass m [kg], damping c [N s/m], friction coefficient mu. Source:
    Armstrong-Helouvry, Dupont, Canudas de Wit 1994, Automatica 30.
    """

    creep = 0.01  # s [m/s]

    def __init__(self, *, dt: float = 0.05, substeps: int = 20):
        parameters = [
            Parameter("mass", 0.1, 2.0, "kg"),
            Parameter("damping", 0.0, 2.0, "N s/m"),
            Parameter("friction", 0.02, 0.5),
        ]
        super().__init__(
            parameters,
            [Signal("x", "m"), Signal("y", "m"), Signal("vx", "m/s"), Signal("vy", "m/s")],
            dt,
            substeps,
        )

    def _acceleration(
        self, values: "Tensor", q: "Tensor", v: "Tensor", actions: "Tensor"
    ) -> "Tensor":
        mass, damping, friction = values[..., None].unbind(-2)
        speed = ((v**2).sum(dim=-1, keepdim=True) + self.creep**2).sqrt()
        return (actions - damping * v) / mass - friction * GRAVITY * v / speed
