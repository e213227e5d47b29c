"""Differentiable simulators of a few equations: pendulum, cart-pole, sliding puck."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dropo.core.records.parameters import Parameter
from dropo.core.records.trajectories import Signal
from dropo.core.services.validation import require
from dropo.simulators.torch import TorchSimulator

if TYPE_CHECKING:
    from torch import Tensor

GRAVITY = 9.81
"""The acceleration of gravity [m/s^2]."""


class SecondOrderSimulator(TorchSimulator):
    """A simulator with the state (q, v), dq/dt = v; a plug-in writes `_acceleration`.

    The action is held over a control step, which the classical Runge-Kutta method of fourth order
    integrates in equal steps.

    Parameters
    ----------
    parameters : sequence of Parameter
        The d parameters.
    signals : sequence of Signal
        The positions q, then the velocities v.
    dt : float
        The control step [s].
    substeps : int
        Integration steps in a control step.

    Raises
    ------
    BadArgument
        If `dt` is not positive, or `substeps` is below 1.

    References
    ----------
    Hairer, Norsett, Wanner 1993, Solving Ordinary Differential Equations I, section II.1.
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
        """dv/dt (K, N, n) from values (K, 1, d), q and v (K, N, n) each, and actions (N, q)."""

    def _advance(self, values: "Tensor", states: "Tensor", actions: "Tensor") -> "Tensor":
        """The states after a control step."""
        h = self.dt / self.substeps
        for _ in range(self.substeps):
            k1 = self._derivative(values, states, actions)
            k2 = self._derivative(values, states + h / 2 * k1, actions)
            k3 = self._derivative(values, states + h / 2 * k2, actions)
            k4 = self._derivative(values, states + h * k3, actions)
            states = states + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return states

    def _derivative(self, values: "Tensor", states: "Tensor", actions: "Tensor") -> "Tensor":
        """(K, N, 2 n) the derivative of the states by time."""
        import torch

        q, v = states.chunk(2, dim=-1)
        return torch.cat([v, self._acceleration(values, q, v, actions)], dim=-1)


class Pendulum(SecondOrderSimulator):
    """A point mass on a massless rod, driven at its pivot.

    Observation (angle q [rad], 0 where it hangs, not wrapped; angular velocity [rad/s]), action
    (torque u [N m]), parameters length l [m], mass m [kg], damping c [N m s/rad].

    Parameters
    ----------
    dt : float
        The control step [s].
    substeps : int
        Integration steps in a control step.

    Notes
    -----
    m l^2 q'' = u - c q' - m g l sin(q)

    References
    ----------
    Strogatz 2015, Nonlinear Dynamics and Chaos, section 4.4.
    """

    def __init__(self, *, dt: float = 0.05, substeps: int = 5):
        parameters = [
            Parameter("length", 0.2, 2.0, "m"),
            Parameter("mass", 0.1, 3.0, "kg"),
            Parameter("damping", 0.0, 1.0, "N m s/rad"),
        ]
        signals = [Signal("angle", "rad"), Signal("angular_velocity", "rad/s")]
        super().__init__(parameters, signals, dt, substeps)

    def _acceleration(
        self, values: "Tensor", q: "Tensor", v: "Tensor", actions: "Tensor"
    ) -> "Tensor":
        length, mass, damping = values[..., None].unbind(-2)
        return (actions - damping * v) / (mass * length**2) - GRAVITY / length * q.sin()


class CartPole(SecondOrderSimulator):
    """A cart that is pushed on a rail and carries a uniform pole on a hinge without friction.

    Observation (position x [m], angle q [rad], 0 upright and positive towards +x, not wrapped;
    their velocities), action (force u [N]), parameters cart_mass M, pole_mass m [kg], half_length l
    of the pole [m], friction c of the rail [N s/m].

    Parameters
    ----------
    dt : float
        The control step [s].
    substeps : int
        Integration steps in a control step.

    Notes
    -----
    (M + m) x'' + m l cos(q) q'' - m l sin(q) q'^2 = u - c x'

    cos(q) x'' + 4/3 l q'' = g sin(q)

    References
    ----------
    Barto, Sutton, Anderson 1983, IEEE Trans. Systems, Man, Cybernetics 13; here friction is
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
        total = cart + pole
        turn = (GRAVITY * sin - cos * force / total) / (half * (4 / 3 - pole * cos**2 / total))
        return torch.cat([(force - pole * half * cos * turn) / total, turn], dim=-1)


class SlidingPuck(SecondOrderSimulator):
    """A puck pushed over a level table, with viscous and dry friction.

    Observation (x, y [m], their velocities [m/s]), action (force u in x and y [N]), parameters mass
    m [kg], damping c [N s/m], friction coefficient mu.

    Parameters
    ----------
    dt : float
        The control step [s].
    substeps : int
        Integration steps in a control step.

    Attributes
    ----------
    creep : float
        The speed s below which dry friction fades out [m/s].

    Notes
    -----
    m v' = u - c v - mu m g v / sqrt(|v|^2 + s^2): Coulomb's friction is made smooth below about
    s = 1 cm/s, so that a puck at rest creeps under a small force instead of sticking.

    References
    ----------
    Armstrong-Helouvry, Dupont, Canudas de Wit 1994, Automatica 30.
    """

    creep = 0.01

    def __init__(self, *, dt: float = 0.05, substeps: int = 20):
        parameters = [
            Parameter("mass", 0.1, 2.0, "kg"),
            Parameter("damping", 0.0, 2.0, "N s/m"),
            Parameter("friction", 0.02, 0.5),
        ]
        signals = [Signal("x", "m"), Signal("y", "m"), Signal("vx", "m/s"), Signal("vy", "m/s")]
        super().__init__(parameters, signals, dt, substeps)

    def _acceleration(
        self, values: "Tensor", q: "Tensor", v: "Tensor", actions: "Tensor"
    ) -> "Tensor":
        mass, damping, friction = values[..., None].unbind(-2)
        speed = ((v**2).sum(dim=-1, keepdim=True) + self.creep**2).sqrt()
        return (actions - damping * v) / mass - friction * GRAVITY * v / speed
