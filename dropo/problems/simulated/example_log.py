"""An example to begin with: the model of an arm with position servos, and logs of a machine.

`python -m dropo.problems.simulated.example_log DIR` writes `arm.xml`, which is what an engineer
believes, and CSV logs of a simulated machine that is another: it has rotors and dry friction. It is
simulated at a finer step, its encoders are read in ticks, and logged in degrees.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.files.atomic_write import write_text
from dropo.core.services.validation import Array
from dropo.simulators.mujoco.simulator import MujocoSimulator

MODEL = """\
<mujoco model="arm">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" range="-120 120" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8"/>
      <body name="lower" pos="0 0 -0.3">
        <joint name="elbow" axis="0 1 0" range="-140 140" damping="0.05"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.4"/>
      </body>
    </body>
  </worldbody>
  <contact><exclude body1="upper" body2="lower"/></contact>
  <actuator>
    <position name="shoulder_servo" joint="shoulder" kp="30" kv="1"/>
    <position name="elbow_servo" joint="elbow" kp="15" kv="0.5"/>
  </actuator>
</mujoco>
"""
HEADER = "ms,shoulder angle,elbow angle,shoulder target,elbow target"
JOINTS = ("shoulder", "elbow")


@dataclass(frozen=True)
class ExampleMachine:
    """The machine behind the logs, and how it is logged.

    Attributes
    ----------
    armature, friction : tuple of float
        Of shoulder and elbow: rotor inertia [kg m^2], dry friction [N m].
    finer : int
        Physics steps of the machine in one of the model.
    rate : float
        Rows of a log in a second.
    rows : int
        Rows of each log.
    ticks : int
        Of an encoder's turn.
    """

    armature: tuple[float, float] = (0.02, 0.008)
    friction: tuple[float, float] = (0.25, 0.1)
    finer: int = 4
    rate: float = 100.0
    rows: int = 1000
    ticks: int = 16384


MACHINE = ExampleMachine()


def write_example(
    folder: str | Path, runs: int = 3, seed: int = 0, machine: ExampleMachine = MACHINE
) -> list[Path]:
    """Write the model and logs of the example.

    Parameters
    ----------
    folder : str or Path
        Where.
    runs : int
        How many logs.
    seed : int
        Of the commands.
    machine : Machine, optional
        What is logged.

    Returns
    -------
    list of Path
        arm.xml, log1.csv, log2.csv, ...
    """
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    paths = [place / "arm.xml"]
    write_text(paths[0], MODEL)
    for number, rng in enumerate(np.random.default_rng(seed).spawn(runs), 1):
        paths.append(place / f"log{number}.csv")
        write_text(paths[-1], _format_log(_commands(rng, machine), machine))
    return paths


def _commands(rng: np.random.Generator, machine: ExampleMachine) -> Array:
    """Smooth targets (n, 2) [rad] that begin at 0: sums of sines, and steps."""
    time = np.arange(machine.rows) / machine.rate
    columns = []
    for reach in (0.8, 1.0):
        rates = rng.uniform(0.1, 1.2, 4)
        phases = rng.uniform(0, 2 * np.pi, 4)
        wave = np.sin(2 * np.pi * np.outer(time, rates) + phases).sum(axis=1)
        steps = np.repeat(rng.uniform(-0.6, 0.6, 1 + machine.rows // 80), 80)[: machine.rows]
        begins = 1 - np.exp(-time / 0.3)
        columns.append(reach * begins * (0.35 * wave + 0.5 * steps))
    return np.stack(columns, axis=1)


def _format_log(commands: Array, machine: ExampleMachine) -> str:
    """The log of a run as CSV."""
    step = 360 / machine.ticks
    angles = np.rint(np.degrees(_angles(commands, machine)) / step) * step
    table = np.column_stack(
        [1000 * np.arange(len(commands)) / machine.rate, angles, np.degrees(commands)]
    )
    lines = []
    for milliseconds, *numbers in table:
        lines.append(",".join([f"{milliseconds:.0f}", *(f"{x:.3f}" for x in numbers)]))
    return "\n".join([HEADER, *lines]) + "\n"


def _angles(commands: Array, machine: ExampleMachine) -> Array:
    """The joints' angles (n, 2) [rad] when each row was logged, from rest."""
    spec = mujoco.MjSpec.from_string(MODEL)
    skip = round(machine.finer / (machine.rate * spec.option.timestep))
    spec.option.timestep /= machine.finer
    for i, name in enumerate(JOINTS):
        joint = spec.joint(name)
        joint.armature = machine.armature[i]
        joint.frictionloss = machine.friction[i]
    simulator = MujocoSimulator(spec, [], frame_skip=skip, threads=1)
    n = len(commands)
    blank = Trajectories(np.zeros((n, 4)), commands, np.zeros((n, 4)), np.arange(n) == n - 1)
    after = simulator.predict(np.empty((1, 0)), blank.segments(reset="start"))[0]
    return np.vstack([np.zeros((1, 2)), after[:-1, :2]])


if __name__ == "__main__":
    for path in write_example(sys.argv[1] if len(sys.argv) > 1 else "."):
        print(path)
