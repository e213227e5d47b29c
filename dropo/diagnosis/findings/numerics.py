"""What of the differences is the simulation's own arithmetic: its step, and how friction holds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.diagnosis.parts import Cause
from dropo.diagnosis.search.library import robot_of
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.selection import State
from dropo.mjmodel.holding_friction import holds
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True)
class NumericsSettings:
    """When the arithmetic is spoken of.

    Attributes
    ----------
    share : float
        Change of the predictions under physics steps of half the length, as a fraction of what the
        causes change, from which it is said.
    windows : int
        Windows, spread over the data, that are simulated with half the step.
    """

    share: float = 0.5
    windows: int = 24


SETTINGS = NumericsSettings()


def numerics(
    given: Problem,
    found: Problem,
    library: Library,
    first: State,
    last: State,
    causes: Sequence[Cause],
    settings: NumericsSettings = SETTINGS,
) -> tuple[str, ...]:
    """Say where the model's arithmetic, not its physics, decides.

    Parameters
    ----------
    given : Problem
        With the model as it came.
    found : Problem
        With the model that was found.
    library : Library
        The simulator with every effect.
    first, last : State
        Where the search began, and where it ended.
    causes : sequence of Cause
        What was named.
    settings : NumericsSettings
        Numbers that decide.

    Returns
    -------
    tuple of str
        A sentence each.
    """
    sentences = []
    if holds(robot_of(found).model) and not holds(robot_of(given).model):
        sentences.append(
            "Dry friction holds what rests here, where MuJoCo's lets it creep: the extended model"
            f" has solimpfriction {robot_of(found).model.dof_solimp[0, 0]:.4f}, which predicts data"
            " held out better."
        )
    step = float(robot_of(found).model.opt.timestep)
    sentences += [_below_step(cause, step) for cause in causes if _is_below_step(cause, step)]
    moved = _moved_by_step(library, first, last, settings) if causes else 0.0
    if moved > settings.share:
        sentences.append(
            f"Physics steps of half the length ({500 * step:.3g} ms) change predictions by"
            f" {moved:.2g} of what the causes change: their sizes are those of this step."
        )
    return tuple(sentences)


def _is_below_step(cause: Cause, step: float) -> bool:
    """Whether a cause is a delay of less than a physics step."""
    if not cause.effect.endswith("_delay"):
        return False
    return any(one.unit == "s" and 0 < abs(one.value) < step for one in cause.estimate.values())


def _below_step(cause: Cause, step: float) -> str:
    """That a delay may be the step's."""
    return (
        f"The {cause.place} is less than a physics step of {1e3 * step:.3g} ms: a machine whose"
        " own loop is faster than the model's looks like that. Shorten the timestep first."
    )


def _moved_by_step(
    library: Library, first: State, last: State, settings: NumericsSettings
) -> float:
    """How far half the step moves predictions, as a fraction of what the causes move them."""
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        return 0.0
    windows = last.train.windows
    index = np.unique(np.linspace(0, len(windows) - 1, settings.windows).round().astype(np.int64))
    some = windows.take(index)
    usual = simulator.predict(np.stack([first.theta, last.theta]), some.segments)
    finer = simulator.with_finer_steps(2)
    half = finer.predict(last.theta[None], some.segments)
    simulator.steps += finer.steps
    p = len(simulator.signals)
    spread = some.measured.reshape(-1, p).std(axis=0)
    of_step = ((half[0] - usual[1]).reshape(-1, p) / spread) ** 2
    of_causes = ((usual[0] - usual[1]).reshape(-1, p) / spread) ** 2
    return float(np.sqrt(np.nansum(of_step) / np.nansum(of_causes)))
