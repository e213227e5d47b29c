"""The published hopper transitions against a wrong model: Gymnasium's Hopper-v5 as it is."""

from dropo.core.contracts.problem import Problem
from dropo.mjmodel.bodies import body_masses, contact_margin, principal_inertia
from dropo.mjmodel.files.loading import gymnasium_spec
from dropo.mjmodel.names import element_id
from dropo.problems.hopper.model import BODIES, FRAME_SKIP, MARGIN, hopper_model
from dropo.problems.hopper.published import published
from dropo.problems.hopper.task import hopping
from dropo.simulators.mujoco.simulator import MujocoSimulator


def hopper_v5(threads: int = 0) -> Problem:
    """The authors' 10,000 transitions against Gymnasium's unchanged Hopper-v5.

    Nine numbers of the model are not those of the data; `differences` lists them.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem
        Without parameters, for a diagnosis.

    Raises
    ------
    BadFile
        If the published data are neither found nor fetched.
    """
    simulator = MujocoSimulator(
        gymnasium_spec("hopper.xml"),
        [],
        observation=["qpos[1:]", "qvel"],
        frame_skip=FRAME_SKIP,
        threads=threads,
    )
    return Problem("hopper-v5", simulator, published("clean"), task=hopping())


def differences() -> dict[tuple[str, str | None], float]:
    """What must be added to Gymnasium's model to obtain the one that made the data.

    Returns
    -------
    dict
        (effect, target) -> difference: masses [kg], inertias (as fractions of Gymnasium's), and
        the distance at which contacts begin [m], whose target is None.
    """
    stock = gymnasium_spec("hopper.xml").compile()
    true = hopper_model()
    out: dict[tuple[str, str | None], float] = {}
    for body in BODIES:
        i = element_id(stock, "body", body)
        j = element_id(true, "body", body)
        out["body_mass", body] = float(body_masses(true)[j] - body_masses(stock)[i])
        ratio = principal_inertia(true, j).max() / principal_inertia(stock, i).max()
        out["body_inertia", body] = float(ratio - 1)
    margin = contact_margin(stock, element_id(stock, "geom", "foot_geom"))
    out["contact_stiffness", None] = 2 * MARGIN - 2 * margin
    return out
