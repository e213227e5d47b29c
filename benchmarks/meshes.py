"""What meshes cost: first and later predictions of a six-joint arm with and without them.

`python benchmarks/meshes.py [FACES]` prints a row for the arm without meshes, with ones that are
only seen, and with ones that collide as well, each link with so many triangles (150,000).
"""

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dropo.core.records.trajectories import Segments, Trajectories
from dropo.core.services.registry import find
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator

JOINTS = 6
FRAME_SKIP = 5
SEGMENTS = 20
STEPS = 10  # control steps of a segment
LOOKS = ("none", "seen", "colliding")
LENGTH = 0.25  # m, of a link
EFFECTS = ("body_mass", "body_com", "contact_friction", "joint_load_friction")


def write_link(path: Path, faces: int) -> None:
    """Write a binary STL of a bumpy link along z, of about so many triangles."""
    around = max(8, round(np.sqrt(faces / 2)))
    along = max(4, faces // (2 * around))
    turn, height = np.meshgrid(
        np.linspace(0, 2 * np.pi, around, endpoint=False), np.linspace(0, np.pi, along + 1)
    )
    radius = 0.05 * np.sin(height) * (1 + 0.03 * np.sin(9 * turn) * np.sin(7 * height))
    z = LENGTH / 2 * (1 - np.cos(height))
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=2)
    ahead = np.roll(points, -1, axis=1)
    first = np.stack([points[:-1], ahead[:-1], ahead[1:]], axis=2).reshape(-1, 3, 3)
    second = np.stack([points[:-1], ahead[1:], points[1:]], axis=2).reshape(-1, 3, 3)
    # the triangles at both ends that have no area are left out
    whole = np.concatenate([first[:-around], second[around:]])
    rows = np.zeros(len(whole), dtype=[("normal", "<f4", 3), ("at", "<f4", (3, 3)), ("", "<u2")])
    rows["at"] = whole
    with path.open("wb") as file:
        file.write(bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())


def write_arm(folder: Path, faces: int, looks: str) -> Path:
    """Write an arm above a floor, whose meshes are "none", "seen" or "colliding"."""
    assets = ""
    if looks != "none":
        write_link(folder / "link.stl", faces)
        # an own asset for each link, as in the model of a real robot
        files = [f'<mesh name="mesh{i}" file="link.stl"/>' for i in range(JOINTS)]
        assets = "".join(files) + (
            '<texture name="grain" type="2d" builtin="checker" width="256" height="256"/>'
            '<material name="paint" texture="grain"/>'
        )
    bodies = ""
    for i in range(JOINTS):
        axis = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")[i]
        unseen = "" if looks == "colliding" else 'contype="0" conaffinity="0"'
        look = f'<geom name="look{i}" type="mesh" mesh="mesh{i}" material="paint" {unseen}/>'
        mass = "0.9" if looks == "none" else "0"
        bodies += f"""<body name="link{i}" pos="0 0 {LENGTH if i else 0.1}">
            <joint name="joint{i}" axis="{axis}" damping="0.2" frictionloss="0.05" armature="0.01"/>
            {look if looks != "none" else ""}
            <geom name="core{i}" type="capsule" size="0.03" fromto="0 0 0.04 0 0 0.2"
                mass="{mass}"/>"""
    motors = "".join(f'<motor name="motor{i}" joint="joint{i}"/>' for i in range(JOINTS))
    path = folder / f"{looks}.xml"
    path.write_text(
        f"""<mujoco model="arm"><option timestep="0.002" integrator="implicitfast"/>
        <asset>{assets}</asset>
        <worldbody><geom name="floor" type="plane" size="3 3 1" friction="0.3"/>
        {bodies}{"</body>" * JOINTS}</worldbody>
        <actuator>{motors}</actuator></mujoco>"""
    )
    return path


def arm_simulator(path: Path, threads: int = 1) -> MujocoSimulator:
    """The arm with a mass, a damping and the friction of a geom as parameters."""
    parameters = [
        FieldParameter("mass", 0.1, 5.0, "kg", field="body_mass", element="link3"),
        FieldParameter("damping", 0.0, 2.0, "N m s/rad", field="dof_damping", element="joint2"),
        FieldParameter("grip", 0.1, 2.0, field="geom_friction", element="core5", index=0),
    ]
    return MujocoSimulator(str(path), parameters, frame_skip=FRAME_SKIP, threads=threads)


def arm_segments(count: int = SEGMENTS, steps: int = STEPS) -> Segments:
    """Segments from poses all over, in some of which the arm touches the floor, under torques."""
    rng = np.random.default_rng(0)
    states = rng.normal(0, [1.0] * JOINTS + [0.5] * JOINTS, (count * steps, 2 * JOINTS))
    actions = rng.normal(0, 2.0, (count * steps, JOINTS))
    ends = np.arange(count * steps) % steps == steps - 1
    data = Trajectories(states, actions, states, ends)
    return data.segments(steps)


def effect_of(simulator: MujocoSimulator, name: str) -> tuple[MujocoSimulator, Array]:
    """The simulator with the effect at its last place, and parameters with its last trial."""
    instance = list(find("effects", name)(simulator.effect_context))[-1]
    sizes = [quantity.probes[-1] for quantity in instance.quantities]
    extended = simulator.with_effects([instance])
    return extended, np.concatenate([simulator.nominal, sizes])[None]


def seconds(simulator: MujocoSimulator, values: Array, segments: Segments) -> float:
    """The time that a prediction takes."""
    start = time.perf_counter()
    simulator.predict(values, segments)
    return time.perf_counter() - start


def measure(path: Path) -> list[str]:
    """The cells of a row: load, first prediction, later one, with each effect, memory."""
    segments = arm_segments()
    start = time.perf_counter()
    simulator = arm_simulator(path)
    cells = [time.perf_counter() - start]
    values = simulator.nominal[None]
    cells.append(seconds(simulator, values, segments))
    cells.append(min(seconds(simulator, values, segments) for _ in range(3)))
    for name in EFFECTS:
        start = time.perf_counter()
        extended, own = effect_of(simulator, name)
        extended.predict(own, segments)
        cells.append(time.perf_counter() - start)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    steps = SEGMENTS * STEPS * FRAME_SKIP
    row = [f"{cell:.2f}" for cell in cells]
    row.insert(3, f"{1e6 * cells[2] / steps:.0f}")
    return [*row, f"{most:.0f}"]


def main(arguments: Sequence[str]) -> None:
    """Print the table; each row in a process of its own."""
    if len(arguments) == 2 and arguments[0] == "row":
        print(" | ".join(measure(Path(arguments[1]))))
        return
    faces = int(arguments[0]) if arguments else 150_000
    named = " | ".join(f"{name}, s" for name in EFFECTS)
    print(f"| meshes | load, s | first, s | later, s | a step, us | {named} | memory, MB |")
    print("|---|" + "---|" * (5 + len(EFFECTS)))
    with tempfile.TemporaryDirectory() as folder:
        for looks in LOOKS:
            path = write_arm(Path(folder), faces, looks)
            command = [sys.executable, __file__, "row", str(path)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            print(f"| {looks} | {done.stdout.strip()} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
