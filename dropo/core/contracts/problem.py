"""A problem: a simulator, measured trajectories, and what is known before the fit."""

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.prior import Prior, read_prior
from dropo.core.contracts.simulator import Simulator
from dropo.core.contracts.support.parallel_simulator import ParallelSimulator
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.task import Task
from dropo.core.records.trajectories import Reset, Segments, Trajectories
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, check_shape, known, require


@dataclass(frozen=True, eq=False)
class Problem:
    """A simulator and what was measured: all that a method needs, checked once when it is made.

    It may have no parameters; an estimator needs at least one.

    Attributes
    ----------
    name : str
        For tables and files.
    simulator : Simulator
        Its d parameters are those of the problem.
    trajectories : Trajectories
        The data that are fitted.
    horizon : int
        The horizon of a segment in control steps, the thesis' lambda.
    reset : {"transition", "start", "partial"}
        Where segments start, as in `Trajectories.segments`.
    set_columns : (p,) array of bool, or None
        The columns that a partial reset sets, as in `Trajectories.segments`.
    every_step : bool
        Whether every step of a segment is compared, and not the last alone.
    whole_runs : bool
        Whether rows that follow each other are fitted as whole runs, whose start states are found,
        where a method can: the horizon is then that of their windows. Segments where it cannot.
    epsilon : float, (p,) array or None
        Noise variance, one or each signal's [signal unit^2], where it is known.
    start_noise : bool
        Whether the measured start states carry this noise too.
    noise_degrees : float or None
        Degrees of freedom (above 2) of a Student t in place of the Gaussian noise.
    truth : mapping of str to float, or None
        The true values of parameters by name, where the data are simulated.
    held_out : Trajectories or None
        Data that no fit sees.
    everything : Trajectories or None
        All data, where `trajectories` are the first of them.
    priors : mapping of str to Prior
        Priors of parameters by name, of the parameter itself or of its mean.
    task : Task or None
        What a policy is to do on the simulator, for training.
    warnings : tuple of str
        What is suspicious in the data, a sentence each.
    estimated : mapping of str to float
        The signals that were not measured, but estimated from measurements before and after, with
        the standard deviation of their errors.
    settings : mapping of str to object
        Settings of a fit where its caller gives none, for example {"draws": 20}.
    plugins : tuple of str
        Paths of the Python files that its problem file names, with parts that it may need.
    source : str
        What `dropo.load` took: a built-in name or the path of a file; empty where it took none.
    run_names : tuple of str
        The run of every trajectory of `trajectories`, then of `held_out`; empty where runs have no
        names.
    reference : tuple of str
        Names or patterns of the runs that all others are compared with.

    Raises
    ------
    UnknownName
        If `truth` or `priors` names a parameter that does not exist.
    BadArgument
        If a prior, `noise_degrees` or the shape of the data is not valid, or if `horizon` exceeds
        the trajectories.
    """

    name: str
    simulator: Simulator
    trajectories: Trajectories
    _: KW_ONLY
    horizon: int = 1
    reset: Reset = "transition"
    set_columns: NDArray[np.bool_] | None = None
    every_step: bool = False
    whole_runs: bool = False
    epsilon: float | Array | None = None
    start_noise: bool = False
    noise_degrees: float | None = None
    truth: Mapping[str, float] | None = None
    held_out: Trajectories | None = None
    everything: Trajectories | None = None
    priors: Mapping[str, Prior] = field(default_factory=dict)
    task: Task | None = None
    warnings: tuple[str, ...] = ()
    estimated: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, object] = field(default_factory=dict)
    plugins: tuple[str, ...] = ()
    source: str = ""
    run_names: tuple[str, ...] = ()
    reference: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in self.truth or ():
            known("parameter", name, self.space.names)
        for name, prior in self.priors.items():
            read_prior(prior, self.space[name])
        degrees = self.noise_degrees
        enough = degrees is None or degrees > 2
        owner = f"Problem {self.name!r}"
        require(enough, "noise_degrees", "above 2, to have a variance", degrees, owner)
        segments = self.segments  # refuses a horizon that is longer than the trajectories
        expected = (len(segments.rows[0]), len(self.simulator.signals))
        check_shape("targets", self.simulator.targets(segments), expected, self.name)

    def __repr__(self) -> str:
        """Its name, parameters and the size of its data, in a line."""
        signals = len(self.simulator.signals)
        data = f"{len(self.trajectories):,} transitions of {len(self.trajectories.spans)} runs"
        if self.held_out is not None:
            data += f", {len(self.held_out):,} held out"
        return f"Problem({self.name!r}, {self.space!r}, {signals} signals, {data})"

    @property
    def space(self) -> ParameterSpace:
        """The d parameters."""
        return self.simulator.space

    @cached_property
    def segments(self) -> Segments:
        """The segments that a fit sees."""
        return self.cut(self.trajectories)

    def cut(self, trajectories: Trajectories, *, every_step: bool | None = None) -> Segments:
        """Cut other trajectories, such as held-out ones, into segments of the same kind.

        Parameters
        ----------
        trajectories : Trajectories
            In the columns of the problem's own data.
        every_step : bool, optional
            Whether to compare every step; by default as the problem does.

        Returns
        -------
        Segments

        Raises
        ------
        BadArgument
            If the problem's horizon is longer than the trajectories.
        """
        every = self.every_step if every_step is None else every_step
        return trajectories.segments(
            self.horizon, reset=self.reset, set_columns=self.set_columns, every_step=every
        )

    def using(
        self,
        *,
        transitions: int | None = None,
        horizon: int | None = None,
        executor: Executor | None = None,
        simulator: str | None = None,
    ) -> "Problem":
        """Make the same problem with fewer data, another horizon, or other simulations.

        Parameters
        ----------
        transitions : int, optional
            Fit the first so many transitions.
        horizon : int, optional
            The horizon of a segment [control steps]: segments are then asked for, not whole runs.
        executor : concurrent.futures.Executor, optional
            Any executor, on whose workers simulations run; the results are the same, bit for bit.
        simulator : str, optional
            The name of a simulator that takes over the problem's own model: "warp".

        Returns
        -------
        Problem

        Raises
        ------
        BadArgument
            If there are no transitions, or the horizon is longer than the trajectories.
        UnknownName
            If there is no such simulator.
        Incompatible
            If there is an executor and the simulator gives gradients, or the simulator that is
            named takes over no other's model, or cannot hold this one.
        """
        trajectories = self.trajectories
        if transitions is not None:
            everything = self.trajectories if self.everything is None else self.everything
            trajectories = everything.head(transitions)
        simulating = self.simulator
        if simulator is not None:
            kind = find("simulators", simulator)
            if not getattr(kind, "takes_over", False):
                raise Incompatible(
                    f"The simulator {simulator!r} takes over no other's model. 'warp' does."
                )
            simulating = kind(simulating)
        if executor is not None:
            simulating = ParallelSimulator(simulating, executor)
        chosen = self.horizon if horizon is None else horizon
        # Those of the runs that are left, then those held out.
        names = self.run_names[: len(trajectories.spans)]
        names += self.run_names[len(self.trajectories.spans) :]
        return replace(
            self,
            simulator=simulating,
            trajectories=trajectories,
            horizon=chosen,
            whole_runs=self.whole_runs and horizon is None,
            run_names=names,
        )
