"""The published hopper transitions against a model that is wrong: Gymnasium's Hopper-v5 as it is."""

from importlib.resources import as_file, files

import mujoco

from dropo.core.contracts.problem import Problem
from dropo.problems.hopper.model import BODIES, FRAME_SKIP, MARGIN, hopper_model
from dropo.problems.hopper.published import published
from dropo.problems.hopper.task import hopping
from dropo.simulators.mujoco.simulator import MujocoSimulator


def hopper_v5(threads: int = 0) -> Problem:
    """The authors' 10,000 transitions against Gymnasium's Hopper-v5, unchanged: nine of its numbers
    are not those of the data.
    """
    simulator = MujocoSimulator(
        gymnasium_spec(),
        [],
        observation=["qpos[1:]", "qvel"],
        frame_skip=FRAME_SKIP,
        threads=threads,
    )
    return Problem("hopper-v5", simulator, published("clean"), task=hopping())


def gymnasium_spec() -> mujoco.MjSpec:
    """Gymnasium's `hopper.xml`."""
    with as_file(files("gymnasium") / "envs" / "mujoco" / "assets" / "hopper.xml") as path:
        return mujoco.MjSpec.from_file(str(path))


def differences() -> dict[tuple[str, str | None], float]:
    """(effect, place) -> what the model that made the data has beside Gymnasium's: masses [kg],
    inertias (as shares), and the distance at which contacts begin [m].
    """
    own = gymnasium_spec().compile()
    made = hopper_model()
    out: dict[tuple[str, str | None], float] = {}
    for body in BODIES:
        out["body_mass", body] = float(made.body(body).mass[0] - own.body(body).mass[0])
        out["body_inertia", body] = float(
            made.body(body).inertia.max() / own.body(body).inertia.max() - 1
        )
    out["contact_stiffness", None] = 2 * MARGIN - 2 * float(own.geom("foot_geom").margin[0])
    return out
