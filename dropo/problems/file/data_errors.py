"""Why a fit of measured data cannot work."""

from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Trajectories
from dropo.data.checks.check import find_error

WAY_OUT = "If they are right all the same: --unchecked, or load(..., checked=False)."


def find_data_error(trajectories: Trajectories | None, simulator: Simulator) -> str | None:
    """Find what makes a fit of data impossible.

    Parameters
    ----------
    trajectories : Trajectories or None
        The data; None where there are none.
    simulator : Simulator
        The simulator that they are compared with.

    Returns
    -------
    str or None
        The error, what to do, and how to go on all the same; None where there is no error.
    """
    finding = None if trajectories is None else find_error(trajectories, simulator)
    if finding is None:
        return None
    text = f"{finding.signal}: {finding.sentence} {finding.advice}".strip()
    return f"{text} {WAY_OUT}"
