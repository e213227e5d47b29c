"""Figures of docs/legged.md: fits and quick diagnoses of the example on legs.

`python benchmarks/legged.py fits SEED...` fits trunk mass, ground friction, and damping and dry
friction of all joints to simulated logs, and prints each estimate with its distance from the truth.
`python benchmarks/legged.py quick EFFECT SEED...` hides one effect and prints what a diagnosis by
regression names.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco

from dropo import fit, init, load
from dropo.diagnosis.regression.quick import QuickDiagnose
from dropo.problems.simulated.example_quadruped import WALK, Change, Walk, write_quadruped

SHORT = replace(WALK, seconds=10.0)
TRUTH = {"trunk": 6.5, "floor": 0.5, "damping": 0.5, "loss": 0.35}
PARAMETERS = """
parameters:
  trunk: {field: body_mass, name: trunk, low: 2.5, high: 12, unit: kg}
  floor: {field: geom_friction, name: floor, index: 0, low: 0.2, high: 1.5}
  damping: {field: dof_damping, name: "*_*", shared: true, low: 0, high: 3, unit: N m s/rad}
  loss: {field: dof_frictionloss, name: "*_*", shared: true, low: 0, high: 2, unit: N m}
"""


def as_fitted(model: mujoco.MjModel) -> None:
    """The machine whose numbers a fit is to find."""
    model.body_mass[model.body("trunk").id] = TRUTH["trunk"]
    model.geom_friction[model.geom("floor").id, 0] = TRUTH["floor"]
    model.dof_damping[6:] = TRUTH["damping"]
    model.dof_frictionloss[6:] = TRUTH["loss"]


def payload(model: mujoco.MjModel) -> None:
    """1 kg more at the trunk."""
    model.body_mass[model.body("trunk").id] += 1.0


def weak_motor(model: mujoco.MjModel) -> None:
    """The front right knee's servo has 70 % of its gains."""
    motor = model.actuator("FR_knee").id
    model.actuator_gainprm[motor, 0] *= 0.7
    model.actuator_biasprm[motor, 1:3] *= 0.7


def stiff_joint(model: mujoco.MjModel) -> None:
    """The rear left hip has 0.4 N m more dry friction."""
    model.dof_frictionloss[model.joint("RL_hip").dofadr[0]] += 0.4


def slippery(model: mujoco.MjModel) -> None:
    """The ground's friction is 0.4."""
    model.geom_friction[model.geom("floor").id, 0] = 0.4


def nothing(model: mujoco.MjModel) -> None:
    """The model is right."""


HIDDEN: dict[str, tuple[Change, Walk]] = {
    "nothing": (nothing, SHORT),
    "payload": (payload, SHORT),
    "motor": (weak_motor, SHORT),
    "friction": (stiff_joint, SHORT),
    "ground": (slippery, SHORT),
    "delay": (nothing, replace(SHORT, late=0.004)),
}


def written(folder: Path, seed: int, change: Change, walk: Walk) -> Path:
    """The problem file that `dropo init` makes of three logs, the last of which is held out."""
    paths = write_quadruped(folder, 3, seed, walk, change)
    init(paths[0], paths[1:], folder / "out")
    return folder / "out" / "problem.yaml"


def fits(seeds: list[int]) -> None:
    """One line for each seed: estimates, errors in standard errors, intervals, CPU time."""

    def one(folder: Path, seed: int) -> str:
        path = written(folder, seed, as_fitted, SHORT)
        path.write_text(path.read_text() + PARAMETERS)
        began = time.process_time()
        found = fit(load(path, threads=1))
        seconds = time.process_time() - began
        parts = []
        for i, name in enumerate(found.space.names):
            z = (found.mean[i] - TRUTH[name]) / found.mean_se[i]
            parts.append(f"{name} {found.mean[i]:.4f} +- {found.mean_se[i]:.4f} (z {z:+.1f})")
        said = [text for text in found.warnings if text.startswith("physics steps")]
        parts += [f"trusted {found.trusted}", *said, f"{seconds:.0f} CPU s"]
        return "; ".join(parts)

    _each(seeds, one)


def quick(effect: str, seeds: list[int]) -> None:
    """What is named for each seed, and the CPU time."""
    change, walk = HIDDEN[effect]

    def one(folder: Path, seed: int) -> str:
        problem = load(written(folder, seed, change, walk), threads=1)
        began = time.process_time()
        found = QuickDiagnose().run(problem)
        seconds = time.process_time() - began
        causes = []
        for cause in found.causes:
            name, size = next(iter(cause.estimate.items()))
            causes.append(
                f"{cause.effect}:{cause.target} {name} {size.value:+.3g} +- {size.se:.2g}"
            )
        return f"{found.verdict}: {'; '.join(causes) or 'nothing'}; {seconds:.0f} CPU s"

    _each(seeds, one, effect)


def _each(seeds: list[int], one: Callable[[Path, int], str], label: str = "") -> None:
    """Prints a line for every seed."""
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            print(f"{label} {seed}: {one(Path(folder), seed)}".strip(), flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "fits":
        fits([int(seed) for seed in sys.argv[2:]])
    else:
        quick(sys.argv[2], [int(seed) for seed in sys.argv[3:]])
