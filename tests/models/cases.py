"""Small models that each have one thing that a simulator can get wrong, and data in their
coordinates.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from dropo.core.records.trajectories import Trajectories
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator

PENDULUM = """<mujoco><option timestep="0.01"/><worldbody>
  <body name="rod" pos="0 0 1"><joint name="pivot" axis="0 1 0" damping="0.1"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.5" mass="0.4"/></body>
</worldbody><actuator><motor name="torque" joint="pivot"/></actuator></mujoco>"""

CART = """<mujoco><option timestep="0.01" integrator="RK4"/><worldbody>
  <body name="cart" pos="0 0 1">
    <joint name="rail" type="slide" axis="1 0 0" damping="0.5" ref="0.2" range="-0.5 0.5"
    limited="true"/>
    <geom type="box" size="0.1 0.05 0.05" mass="1"/>
    <body name="pole"><joint name="hinge" axis="0 1 0"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.6" mass="0.2"/></body></body>
</worldbody><actuator><motor joint="rail" gear="5"/><motor joint="hinge"/></actuator></mujoco>"""

BOX = """<mujoco><option timestep="0.005"/><worldbody><geom name="floor" type="plane" size="2 2 1"/>
  <body name="box" pos="0 0 0.11"><freejoint/>
    <geom name="shell" type="box" size="0.1 0.08 0.1" mass="1"/>
    <body name="flap" pos="0 0 0.1">
      <joint name="lid" axis="0 1 0" range="-30 30" limited="true" frictionloss="0.02"/>
      <geom type="capsule" size="0.03" fromto="0 0 0 0.2 0 0.1" mass="0.3"/></body></body>
</worldbody></mujoco>"""

BALL = """<mujoco><option timestep="0.01"/><worldbody>
  <body name="arm" pos="0 0 1"><joint name="shoulder" type="ball" damping="0.05"/>
    <geom type="capsule" size="0.03" fromto="0 0 0 0.4 0 -0.1" mass="0.5"/>
    <body name="forearm" pos="0.4 0 -0.1"><joint name="elbow" axis="0 1 0"/>
      <geom type="box" pos="0.1 0 0" size="0.1 0.02 0.03" mass="0.2"/></body></body>
</worldbody><actuator><motor joint="elbow"/></actuator></mujoco>"""

VALVE = """<mujoco><option timestep="0.01"/><worldbody>
  <body name="spool"><joint name="slide" type="slide" axis="1 0 0" stiffness="4"/>
    <geom type="sphere" size="0.1" mass="0.5"/></body>
</worldbody><actuator><general name="direct" joint="slide"/>
  <general name="lag" joint="slide" dyntype="filter" dynprm="0.1" gainprm="3"/></actuator>
    </mujoco>"""

SENSED = """<mujoco><option timestep="0.01"/><worldbody>
  <body name="rod" pos="0 0 1"><joint name="pivot" axis="0 1 0" damping="0.1"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.5" mass="0.4"/>
    <site name="tip" pos="0 0 -0.5"/></body>
</worldbody><actuator><motor name="torque" joint="pivot"/></actuator>
<sensor><accelerometer name="imu" site="tip"/><jointpos name="angle" joint="pivot"/>
  <actuatorfrc name="load" actuator="torque"/></sensor></mujoco>"""


@dataclass(frozen=True)
class Case:
    """A model, two of its numbers as parameters, its observed columns, and those that a `partial`
    reset sets.
    """

    xml: str
    parameters: tuple
    observation: tuple
    columns: tuple
    partly: tuple
    frame_skip: int = 2

    def simulator(self, threads=1):
        """The simulator under test."""
        spec = mujoco.MjSpec.from_string(self.xml)
        return MujocoSimulator(
            spec,
            self.parameters,
            observation=self.observation,
            frame_skip=self.frame_skip,
            threads=threads,
        )

    def data(self, lengths=(8, 6, 4), seed=0):
        """Trajectories whose rows are unrelated states: each transition is a test of its own."""
        rng = np.random.default_rng(seed)
        n = sum(lengths)
        model = mujoco.MjModel.from_xml_string(self.xml)
        ends = np.isin(np.arange(n), np.cumsum(lengths) - 1)
        observations, following = (
            np.array([self._row(model, rng) for _ in range(n)]) for _ in range(2)
        )
        return Trajectories(observations, rng.normal(size=(n, model.nu)), following, ends)

    def segments(self, cut):
        """The data, cut in one of the ways of CUTS."""
        options = CUTS[cut] | ({"set_columns": self.partly} if "partial" in cut else {})
        return self.data().segments(**options)

    def _row(self, model, rng):
        data = mujoco.MjData(model)
        mujoco.mj_integratePos(model, data.qpos, 0.2 * rng.normal(size=model.nv), 1.0)
        data.qvel[:], data.act[:] = 0.5 * rng.normal(size=model.nv), 0.5 * rng.normal(size=model.na)
        mujoco.mj_forward(model, data)
        return [getattr(data, field)[place] for field, place in self.columns]


CUTS = {
    "transitions": {},
    "lambda": {"horizon": 2},
    "every step": {"horizon": 3, "every_step": True},
    "start": {"reset": "start"},
    "partial": {"horizon": 2, "reset": "partial"},
    "partial, every step": {"horizon": 2, "reset": "partial", "every_step": True},
}


def mass(body, **more):
    """The mass of a body as a parameter."""
    return FieldParameter(f"{body}_mass", 0.1, 2.0, "kg", field="body_mass", element=body, **more)


def places(**fields):
    """(field, place) pairs: places(qpos=2) -> (("qpos", 0), ("qpos", 1))."""
    return tuple((field, i) for field, count in fields.items() for i in range(count))


CASES = {
    "pendulum": Case(
        PENDULUM,
        (mass("rod"), FieldParameter("damping", 0.01, 0.5, field="dof_damping", element="pivot")),
        ("qpos", "qvel"),
        places(qpos=1, qvel=1),
        (True, False),
    ),
    "cart": Case(
        CART,
        (mass("cart"), mass("pole", derived=False)),
        ("qpos", "qvel"),
        places(qpos=2, qvel=2),
        (True, False, False, True),
    ),
    "box": Case(
        BOX,
        (mass("box", derived=False), mass("flap")),
        ("qpos", "qvel"),
        places(qpos=8, qvel=7),
        (True,) * 8 + (False,) * 7,
        4,
    ),
    "ball": Case(
        BALL,
        (mass("arm"), mass("forearm", derived=False)),
        ("qpos", "qvel"),
        places(qpos=5, qvel=4),
        (True,) * 4 + (False,) * 5,
    ),
    "valve": Case(
        VALVE,
        (
            mass("spool"),
            FieldParameter("lag", 0.02, 0.4, "s", field="actuator_dynprm", element="lag", index=0),
        ),
        ("qpos", "qvel", "act"),
        places(qpos=1, qvel=1, act=1),
        (False, True, False),
    ),
    "sensed": Case(
        SENSED,
        (
            mass("rod"),
            FieldParameter("gear", 0.5, 2, field="actuator_gear", element="torque", index=0),
        ),
        ("qpos", "qvel", "sensordata"),
        places(qpos=1, qvel=1, sensordata=5),
        (False, True) + (False,) * 5,
    ),
}
