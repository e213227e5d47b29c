"""A problem: simulator, measured trajectories, how they are cut into segments, and what is known
beforehand.
"""

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.parallel_simulator import ParallelSimulator
from dropo.core.contracts.prior import Prior, read_prior
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.task import Task
from dropo.core.records.trajectories import Reset, Segments, Trajectories
from dropo.core.services.validation import Array, check_shape, known, require


@dataclass(frozen=True, eq=False)
class Problem:
    """A simulator, and what was measured: all that a method needs. Checked once, when it is made.

    It may have no parameters; an estimator needs at least one. name: for tables and files;
    simulator: its parameters are those of the problem; trajectories: what is fitted. length: the
    thesis' lambda, in control steps; reset, set_columns,
    every_step: as in `Trajectories.segments`; epsilon: the noise variance, one or (p,), where it is
    known; start_noise: whether the measured start states carry it too; noise_degrees: of freedom of
    a Student t in the Gaussian noise's place;
    truth: the parameters' true values, where the data are simulated; held_out: trajectories that no
    fit sees; everything: the whole data, where `trajectories` are only their first ones; priors: of
    single parameters, for a posterior, by name;
    task: what a policy is to do on the simulator, for training;
    warnings: what looked odd in the data; settings: what a fit of this problem takes where its
    caller says nothing (for example {"draws": 20}).
    """

    name: str
    simulator: Simulator
    trajectories: Trajectories
    _: KW_ONLY
    length: int = 1
    reset: Reset = "transition"
    set_columns: NDArray[np.bool_] | None = None
    every_step: bool = False
    epsilon: float | Array | None = None
    start_noise: bool = False
    noise_degrees: float | None = None
    truth: Mapping[str, float] | None = None
    held_out: Trajectories | None = None
    everything: Trajectories | None = None
    priors: Mapping[str, Prior] = field(default_factory=dict)
    task: Task | None = None
    warnings: tuple[str, ...] = ()
    settings: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.truth or ():
            known("parameter", name, self.space.names)
        for name, prior in self.priors.items():
            read_prior(prior, self.space[name])
        degrees = self.noise_degrees
        require(
            degrees is None or degrees > 2,
            "noise_degrees",
            "above 2, to have a variance",
            degrees,
            f"Problem {self.name!r}",
        )
        _ = self.segments  # refuses a lambda that does not fit the trajectories
        check_shape(
            "targets",
            self.simulator.targets(self.segments),
            (len(self.segments.rows[0]), len(self.simulator.signals)),
            self.name,
        )

    @property
    def space(self) -> ParameterSpace:
        """The d parameters."""
        return self.simulator.space

    @cached_property
    def segments(self) -> Segments:
        """The segments that a fit sees."""
        return self.cut(self.trajectories)

    def cut(self, trajectories: Trajectories, *, every_step: bool | None = None) -> Segments:
        """Other trajectories (held-out ones, say) as segments of the same kind; every_step: compare
        all steps; None: as here.
        """
        every = self.every_step if every_step is None else every_step
        return trajectories.segments(
            self.length, reset=self.reset, set_columns=self.set_columns, every_step=every
        )

    def using(
        self,
        *,
        transitions: int | None = None,
        length: int | None = None,
        executor: Executor | None = None,
    ) -> "Problem":
        """The same problem with the first so many transitions, another lambda (`length`), or its
        simulations on an executor's workers.

        executor: any concurrent.futures.Executor; the results stay the same, bit for bit.
        """
        whole = self.trajectories if self.everything is None else self.everything
        data = self.trajectories if transitions is None else whole.head(transitions)
        simulator = (
            self.simulator if executor is None else ParallelSimulator(self.simulator, executor)
        )
        return replace(
            self,
            simulator=simulator,
            trajectories=data,
            length=self.length if length is None else length,
        )
