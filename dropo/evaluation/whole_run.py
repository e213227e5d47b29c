"""A whole run beside what two models predict for it, in windows that follow each other."""

import copy
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.predictions import WholeRun
from dropo.core.services.validation import Array
from dropo.evaluation.held_out import DataPart


@dataclass(frozen=True)
class RunSettings:
    """How much of a run is kept.

    Attributes
    ----------
    steps : int
        So many control steps are kept at most, from the run's first one.
    numbers : int
        So many numbers, steps times signals, are kept at most, so that what is kept of a large
        robot stays small.
    """

    steps: int = 12_000
    numbers: int = 150_000


SETTINGS = RunSettings()


def whole_run(
    problem: Problem,
    simulator: Simulator,
    part: DataPart,
    sides: tuple[Array, Array],
    length: int,
    settings: RunSettings = SETTINGS,
) -> WholeRun:
    """Predict the longest run of some data, or of those with rows held out, before and after.

    Its steps are not counted with those of a search: the simulator is a copy.

    Parameters
    ----------
    problem : Problem
        Where its `reset` is "transition", predictions start again from a measurement every `length`
        steps; else once, at the run's start, since no other state is measured.
    simulator : Simulator
        Of the problem's model, which takes the parameters of both sides.
    part : DataPart
        The data, and which of them count as held out.
    sides : tuple of two (m,) arrays
        The parameters before and after.
    length : int
        Control steps in a window.
    settings : RunSettings
        How much is kept.

    Returns
    -------
    WholeRun
    """
    data = part.trajectories
    has_unseen = part.chosen.any()
    lengths = []
    for start, stop in data.spans:
        may_be_shown = part.chosen[start:stop].any() or not has_unseen
        lengths.append(stop - start if may_be_shown else 0)
    chosen = int(np.argmax(lengths))
    start, stop = data.spans[chosen]
    most = max(1, min(settings.steps, settings.numbers // len(simulator.signals)))
    count = min(stop - start, most)
    each = min(length, count) if problem.reset == "transition" else count
    end = start + count - count % each
    windows = [data.from_rows(np.arange(start, end, each), each, every_step=True)]
    if count % each:
        windows.append(data.from_rows(np.array([end]), count % each, every_step=True))
    own = copy.copy(simulator)
    values = np.stack(sides)
    before, after = np.concatenate([own.predict(values, one) for one in windows], axis=1)
    return WholeRun(
        trajectory=chosen,
        length=each,
        measured=np.concatenate([simulator.targets(one) for one in windows]),
        rows=data.next_observations[start : start + count],
        before=before,
        after=after,
        held_out=part.chosen[start : start + count],
    )
