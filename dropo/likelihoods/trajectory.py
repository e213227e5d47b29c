"""The likelihood of whole runs, with the states in which they start as unknowns.

What is measured is no start: noise on it, or a velocity that no sensor gives, would be taken for
motion. Every measurement is used once, for what the model predicts at that instant.
"""

import copy
import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LogLikelihood, RunLikelihood, WholeRunsFit
from dropo.core.contracts.noise import Epsilon, NoiseModel
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.contracts.support.fisher_scoring import maximize_locally
from dropo.core.contracts.support.maximize import SearchResult
from dropo.core.contracts.support.mean_prior import MeanPrior, local_with_prior
from dropo.core.numerics.tails import chi2_tail, normal_of_tail, student_below
from dropo.core.records.fits.fit import Status, interrupted
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Ints, Segments, Trajectories
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.tables import duration_text
from dropo.core.services.validation import Array, known, require
from dropo.likelihoods.support.runs.condensed import Condensed, condense, log_densities
from dropo.likelihoods.support.runs.found_starts import FoundStarts
from dropo.likelihoods.support.runs.linearization import (
    LinearizedInstants,
    Observed,
    Steps,
    linearize_windows,
)
from dropo.likelihoods.support.runs.noise_levels import (
    NoiseDistribution,
    NoiseLevelSettings,
    RestrictedEstimates,
    white,
    whiten,
)
from dropo.likelihoods.support.runs.rows import RunRows, profiled
from dropo.likelihoods.support.runs.windows import RunWindows, following_rows, windows_of

SETTLED = "Parameters and start states stopped moving after {} rounds."
SETTLED_APART = "Parameters that differ from group to group stopped moving after {} rounds."
UNSETTLED = "Parameters or start states still moved after {} rounds."
STALLED = "No shorter step came closer to the measurements after {} rounds."
NOT_REACHED = (
    "the search did not reach the measurements: {:.0%} of the windows of single runs are far from"
    " them. There are no intervals"
)
SLOW = "an iteration takes {}"


@dataclass(frozen=True)
class TrajectorySettings:
    """What decides how runs are cut and searched.

    Attributes
    ----------
    window : int
        Control steps in a window where the problem compares single steps.
    growth : float
        A run is cut where an error of the start has grown by this factor: behind it the start is
        known so well that a link adds little, and the linearization no longer holds.
    start_step : float
        Half width of the differences in starts, as a fraction of each coordinate's spread.
    value_step : float
        Half width of the first differences in the parameters, as a fraction of their intervals, and
        the largest one later: then it is a standard error.
    minimum_value_step : float
        Smallest half width of the later ones, as a fraction of the intervals.
    prior_spread : float
        A start is within this many spreads of its coordinate from its first guess.
    longest : float
        Longest step of a parameter, as a fraction of its interval.
    outer_iterations : int
        So many linearizations are made at most.
    halvings : int
        How often a step is halved that leads away from the measurements.
    close : float
        Noise is looked into from where no parameter moves by more standard errors than this.
    settled : float
        The search ends where no parameter moves by more standard errors than this.
    worse : float
        A step is halved that costs more than this [nats].
    spread_iterations : int
        So many iterations are made at most in which every group is linearized at its own
        parameters.
    settled_mode : float
        These iterations end where no group's parameter moves by more of its standard errors.
    spread_gain : float
        A spread between groups is kept where it raises the log-likelihood by more than this [nats].
    stuck : float
        A window may be stuck where its mean squared residual is this many times the noise's.
    stuck_level : float
        It is stuck where noise makes it so large with this probability only.
    largest_stuck : float
        The search did not reach the measurements where more than this fraction of the windows is
        stuck.
    excess : float
        The model may be wrong where what is new at an instant is this many times as large along
        whole runs as within windows of their own.
    excess_z : float
        The model is wrong where it is larger by so many standard errors, too.
    slow_iteration : float
        The first outer iteration that takes longer is shown [s].
    """

    window: int = 20
    growth: float = 1e3
    start_step: float = 1e-4
    value_step: float = 1e-3
    minimum_value_step: float = 1e-5
    prior_spread: float = 10.0
    longest: float = 0.25
    outer_iterations: int = 30
    halvings: int = 5
    close: float = 1.0
    settled: float = 0.02
    worse: float = 1.0
    spread_iterations: int = 6
    settled_mode: float = 0.1
    spread_gain: float = 2.0
    stuck: float = 2.0
    stuck_level: float = 1e-3
    largest_stuck: float = 0.05
    excess: float = 1.15
    excess_z: float = 5.0
    slow_iteration: float = 30.0


@dataclass(frozen=True)
class Trajectory(RunLikelihood):
    """The likelihood of whole runs, their start states integrated out.

    Attributes
    ----------
    unmeasured : tuple of str
        Signals of which the data hold a guess, beside those that the problem calls estimated.
    settings : TrajectorySettings
    noise : NoiseLevelSettings

    Notes
    -----
    y_k = h(F^k(x, u; theta)) + n, with one start x a run, wide prior. Runs are simulated in windows
    with starts of their own, linked as in multiple shooting [1]_: each ends where the next begins.
    Linearized, the links eliminate all starts but the first, and a Schur complement this one. n is
    white, or of first order (memory), or a Student t, as the restricted likelihood says [2]_.

    References
    ----------
    .. [1] Bock, "Numerical treatment of inverse problems in chemical reaction kinetics", Springer
       Series in Chemical Physics 18 (1981), 102.
    .. [2] Patterson, Thompson, "Recovery of inter-block information when block sizes are unequal",
       Biometrika 58 (1971), 545.
    """

    unmeasured: tuple[str, ...] = ()
    settings: TrajectorySettings = field(default_factory=TrajectorySettings)
    noise: NoiseLevelSettings = field(default_factory=NoiseLevelSettings)

    def fit_runs(
        self, problem: Problem, run: Run, family: Family, noise: Epsilon, mean: Array
    ) -> WholeRunsFit:
        """Find parameters, starts and noise levels together.

        Raises
        ------
        Incompatible
            If the data hold no runs, or rows have a covariance of their own.
        SimulationFailed
            If simulations diverge at the first parameters.
        """
        _require_runs(problem)
        length = problem.horizon if problem.horizon > 1 else self.settings.window
        unmeasured = (*problem.estimated, *self.unmeasured)
        search = _JointSearch(self, problem.simulator, problem.trajectories, length, unmeasured)
        search.take_noise(noise)
        search.prior = MeanPrior(problem.priors, problem.space)
        place, found = search.run(run, mean)
        if found.status is not Status.INTERRUPTED:
            place, found = search.with_spread(run, place, found, family)
        return search.fit(problem, family, search.linearized_at(place), found)

    def bind(
        self,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        rng: np.random.Generator,
    ) -> LogLikelihood:
        """Make the log-likelihood around the middle of the search box, for known noise.

        Raises
        ------
        Incompatible
            If the noise is to be learned, or segments are no whole transitions in their order.
        """
        rows = segments.steps[segments.steps >= 0]
        whole = np.array_equal(rows, np.arange(len(segments.trajectories)))
        if not whole or len(segments.rows[0]) != len(rows):
            raise Incompatible(
                "The likelihood 'trajectory' compares every row of whole runs: give segments of one"
                " step, or with every step compared."
            )
        if NoiseModel(epsilon, len(simulator.signals)).unknowns:
            raise Incompatible(
                "The likelihood 'trajectory' learns noise with the start states, in a search of its"
                " own (method 'dropo'). Give epsilon."
            )
        search = _JointSearch(self, simulator, segments.trajectories, self.settings.window, ())
        search.take_noise(epsilon)
        space = simulator.space
        state = search.first((space.low + space.high) / 2)
        for _ in range(self.settings.halvings):
            state = search.advanced(state, np.zeros(len(space)))
        return search.objective(state, family)


@dataclass(frozen=True, eq=False)
class _State:
    """Where the search is: parameters (d,), window starts (N, s), windows, their noise.

    Where groups differ, own are the parameters of each (G, d).
    """

    value: Array
    starts: Array
    windows: RunWindows
    noise: NoiseDistribution
    own: Array | None = None


@dataclass(frozen=True, eq=False)
class _Linearized:
    """A state linearized: its columns, and its pieces without their starts."""

    state: _State
    columns: LinearizedInstants
    condensed: Condensed

    @property
    def information(self) -> Array:
        """(d, d) of all pieces."""
        return np.asarray(self.condensed.information.sum(axis=0))


@dataclass(frozen=True, eq=False)
class _LinearizedState:
    """How a state was linearized, so that it can be done again: the state before, the half
    widths of the differences in parameters (d,), and the noise that was found there.
    """

    state: _State
    value_step: Array
    noise: NoiseDistribution


@dataclass(frozen=True, eq=False)
class _Position:
    """What the next outer iteration needs: its state, the step (d,) from the best one that led
    there and which fraction of it, how often noise was looked into, the half widths (d,) of the
    next differences, the best state so far, and the sentence in which the search ended, if it has.
    """

    state: _State
    step: Array
    fraction: float
    chosen: int
    value_step: Array
    best: _LinearizedState | None
    ended: str = ""


ENDS = ("", SETTLED, STALLED)
"""How an outer iteration may leave the search, by the number in its record."""
GOES_ON, IS_SETTLED, IS_DONE = range(3)
"""The numbers of a turn's record: groups move still, they do not, or their simulations diverge."""


class _JointSearch:
    """The joint search of one problem's parameters, starts and noise."""

    def __init__(
        self,
        likelihood: Trajectory,
        simulator: Simulator,
        data: Trajectories,
        length: int,
        unmeasured: tuple[str, ...],
    ):
        self.settings = likelihood.settings
        self.noise_settings = likelihood.noise
        self.simulator = simulator
        whole, columns = simulator.observing_state()
        names = [signal.name for signal in simulator.signals]
        guessed = {known("signal", name, names) for name in unmeasured}
        measured = np.zeros(len(whole.signals), dtype=bool)
        measured[: len(names)] = [name not in guessed for name in names]
        require(bool(measured.any()), "unmeasured", "not all signals", unmeasured, "Trajectory")
        self.observed = Observed(whole, measured, whole.state_coordinates)
        data = _with_columns(data, columns)
        self.first_windows = windows_of(following_rows(data), length)

        spread = whole._start_spread(self.first_windows.segments)[whole.state_coordinates]
        self.start_step = self.settings.start_step * spread
        self.start_prior = (self.settings.prior_spread * spread) ** -2.0
        self.width = simulator.space.high - simulator.space.low
        self.value_step = self.settings.value_step * self.width
        self.prior = MeanPrior({}, simulator.space)
        self.noise: NoiseDistribution | None = None
        self.given = False
        self.degrees: float | None = None
        self._last: tuple[_LinearizedState, _Linearized] | None = None
        self._cost_is_shown = False

    # --- what is given

    def take_noise(self, noise: Epsilon) -> None:
        """Takes variances that are known, and the tails that are asked for."""
        model = NoiseModel(noise, len(self.simulator.signals))
        if model.noise.rows is not None:
            raise Incompatible(
                "The likelihood 'trajectory' takes no filtered starts: it estimates its own. Use"
                " starts='measured'."
            )
        own = self.observed.measured[: len(self.simulator.signals)]
        self.given = model.noise.learned is None
        if self.given:
            model = model.positive("Trajectory")
        self.degrees = model.noise.degrees
        self.noise = white(np.sqrt(np.maximum(model.shape[own], 1e-300)), self.degrees)

    def first(self, value: Array) -> _State:
        """The state in which the search begins: measured starts."""
        assert self.noise is not None
        count = len(self.first_windows.segments)
        starts = np.zeros((count, int(self.observed.state.sum())))
        return _State(value, starts, self.first_windows, self.noise)

    # --- one outer iteration

    def linearize(self, state: _State, value_step: Array | None = None) -> _Linearized:
        """Linearize a state, by differences in parameters of the first half widths or of others
        (d,); count its simulations with those of the problem's simulator.
        """
        widths = self.value_step if value_step is None else value_step
        whole = self.observed.simulator
        before = whole.steps, whole.failures
        unit = 1 / np.sqrt(self.start_prior)
        steps = Steps(self.start_step, widths, unit, self.settings.growth)
        try:
            columns, windows = linearize_windows(
                self.observed,
                state.windows,
                state.value if state.own is None else state.own,
                state.starts,
                steps,
            )
        finally:
            if whole is not self.simulator:
                self.simulator.steps += whole.steps - before[0]
                self.simulator.failures += whole.failures - before[1]
        state = replace(state, windows=windows)
        return _Linearized(state, columns, self._condense(columns, state))

    def _condense(self, columns: LinearizedInstants, state: _State) -> Condensed:
        """The pieces without their starts."""
        opening = np.flatnonzero(state.windows.depth == 0)
        return condense(columns, state.noise, self.start_prior, state.starts[opening])

    def with_noise(self, linearized: _Linearized, *, choose: bool) -> _Linearized:
        """The same with noise levels as the residuals have them."""
        if self.given:
            return linearized
        prior = np.concatenate([self.start_prior, self.width**-2.0])
        estimates = RestrictedEstimates(linearized.columns, prior, self.noise_settings)
        noise = linearized.state.noise
        if choose:
            noise = estimates.choose(white(noise.sd)) if self.degrees is None else noise
        noise = estimates.levels(noise)
        state = replace(linearized.state, noise=noise)
        return replace(linearized, state=state, condensed=self._condense(linearized.columns, state))

    def step_of(self, linearized: _Linearized) -> Array:
        """(d,) the Gauss-Newton step of the parameters, within their box."""
        value = linearized.state.value
        information = linearized.information + np.diag(self.prior.information(value))
        score = linearized.condensed.scores.sum(axis=0) + self.prior.score(value)
        size = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
        scaled = information / np.outer(size, size) + 1e-12 * np.eye(len(size))
        root = np.linalg.cholesky(scaled).T
        right = np.linalg.solve(root.T, score / size)
        space = self.prior.within
        longest = self.settings.longest * self.width
        low = np.maximum(space.low - value, -longest) * size
        high = np.minimum(space.high - value, longest) * size
        high = np.maximum(high, low + 1e-12 * np.maximum(np.abs(low), 1e-30))
        return np.asarray(lsq_linear(root, right, (low, high)).x / size)

    def shifted(self, linearized: _Linearized, step: Array, fraction: float = 1.0) -> _State:
        """The state behind a fraction of a step (d,), with the starts that go with it."""
        windows = linearized.state.windows
        starts = self._start_steps(
            linearized, np.broadcast_to(step, (len(windows.pieces.spans), len(step)))
        )
        value = np.clip(
            linearized.state.value + fraction * step, self.prior.within.low, self.prior.within.high
        )
        return replace(
            linearized.state, value=value, starts=linearized.state.starts + fraction * starts
        )

    def _start_steps(self, linearized: _Linearized, steps: Array) -> Array:
        """(N, s) steps of all window starts that go with the pieces' parameters' (P, d)."""
        condensed = linearized.condensed
        columns = linearized.columns
        follow = (condensed.start_by_value @ steps[:, :, None])[:, :, 0]
        piece = linearized.state.windows.piece
        own = (condensed.start_step + follow)[piece][:, :, None]
        moved = columns.of_start @ own + columns.of_value @ steps[piece][:, :, None]
        return np.asarray(moved[:, :, 0] + columns.gap)

    def advanced(self, state: _State, step: Array) -> _State:
        """The state behind one outer iteration in which the parameters make a given step."""
        return self.shifted(self.linearize(state), step)

    def errors(self, linearized: _Linearized) -> Array:
        """(d,) standard errors by the information, at most the width of the box."""
        known = self.width**-2.0 + self.prior.information(linearized.state.value)
        information = linearized.information + np.diag(known)
        return np.sqrt(np.diagonal(np.linalg.inv(information)))

    # --- the search

    def run(self, run: Run, mean: Array) -> tuple[_LinearizedState, SearchResult]:
        """Outer iterations until nothing moves, each of them recorded."""
        self._position = _Position(
            self.first(mean), np.zeros(len(mean)), 1.0, 0, self.value_step, None
        )
        self._count = 0
        try:
            status, reason = self._iterations(run)
        except KeyboardInterrupt:
            if self._position.best is None:
                raise
            status, reason = Status.INTERRUPTED, interrupted()
        best = self._position.best
        assert best is not None
        count = 0 if status is Status.INTERRUPTED else self._count
        return best, self._result(self.linearized_at(best), status, reason, count)

    def linearized_at(self, place: _LinearizedState) -> _Linearized:
        """The linearized state of a place, made again, not counted, where it was recorded."""
        if self._last is None or self._last[0] is not place:
            simulator = self.simulator
            counted = simulator.steps, simulator.failures
            linearized = self.linearize(place.state, place.value_step)
            simulator.steps, simulator.failures = counted
            state = replace(linearized.state, noise=place.noise)
            linearized = replace(
                linearized, state=state, condensed=self._condense(linearized.columns, state)
            )
            self._last = (place, linearized)
        return self._last[1]

    def _placed(
        self, state: _State, value_step: Array, linearized: _Linearized
    ) -> _LinearizedState:
        """The place of a linearized state, which is remembered."""
        place = _LinearizedState(state, value_step, linearized.state.noise)
        self._last = (place, linearized)
        return place

    def _iterations(self, run: Run) -> tuple[Status, str]:
        """The search; how it ended."""
        while self._count < self.settings.outer_iterations:
            self._position = self._recorded_iteration(run, self._position)
            self._count += 1
            if self._position.ended:
                return Status.CONVERGED, self._position.ended
            run.progress(min(0.95, self._count / 8), f"round {self._count}, whole runs")
        return Status.OUT_OF_BUDGET, UNSETTLED

    def _recorded_iteration(self, run: Run, position: _Position) -> _Position:
        """An outer iteration, or its record in the evaluation log.

        A record holds the log-likelihood of the best state, whether it is that of this iteration,
        the number of the end, fraction, chosen, step (d,), half widths (d,), the noise of the best
        state (3 m,), and, where the search goes on, the next state. A first state that diverges is
        one NaN.
        """
        reached: _Position | None = None

        def evaluate(_: Array) -> Array:
            nonlocal reached
            begun = time.perf_counter()
            try:
                reached = self._iteration(position)
            except SimulationFailed:
                return np.full((1, 1), np.nan)
            assert reached.best is not None
            value = float(self.linearized_at(reached.best).condensed.values.sum())
            is_best = position.best is None or reached.best.state is not position.best.state
            noise = reached.best.noise
            numbers = [value, is_best, ENDS.index(reached.ended), reached.fraction, reached.chosen]
            parts: list[Any] = [
                numbers,
                reached.step,
                reached.value_step,
                noise.sd,
                noise.memory,
                noise.degrees,
            ]
            if not reached.ended:
                parts.append(self._packed(reached.state))
            self._tell_cost(run, time.perf_counter() - begun)
            return np.concatenate(parts)[None]

        record = run.evaluate(position.state.value[None], evaluate)[0]
        if reached is not None:
            return reached
        if len(record) == 1:
            self.linearize(position.state, position.value_step)  # diverges again, and says where
            raise SimulationFailed("Simulations of a recorded iteration diverged.")
        (_, is_best, end, fraction, chosen), rest = np.split(record, [5])
        d = len(self.width)
        m = int(self.observed.measured.sum())
        places = np.cumsum([d, d, m, m, m])
        step, value_step, sd, memory, degrees, state = np.split(rest, places)
        noise = NoiseDistribution(sd, memory, degrees)
        if is_best:
            best = _LinearizedState(position.state, position.value_step, noise)
        else:
            assert position.best is not None
            best = replace(position.best, noise=noise)
        following = self._unpacked(state, noise) if len(state) else position.state
        return _Position(following, step, fraction, int(chosen), value_step, best, ENDS[int(end)])

    def _tell_cost(self, run: Run, seconds: float) -> None:
        """Tell once that outer iterations are slow."""
        if not self._cost_is_shown and seconds > self.settings.slow_iteration:
            self._cost_is_shown = True
            run.progress(0.0, SLOW.format(duration_text(seconds)))

    def _iteration(self, position: _Position) -> _Position:
        """Linearize the state, and step from there, or half as far from the best one."""
        settings = self.settings
        best = None if position.best is None else self.linearized_at(position.best)
        linearized: _Linearized | None = None
        try:
            linearized = self.linearize(position.state, position.value_step)
        except SimulationFailed:
            if best is None:
                raise
        if best is not None and (
            linearized is None or self._is_worse(linearized, best, position.chosen > 0)
        ):
            # Further from the measurements than before: half of the step.
            assert position.best is not None
            fraction = position.fraction / 2
            if fraction < 0.5**settings.halvings:
                best = self.with_noise(best, choose=position.chosen < 2)
                place = self._placed(position.best.state, position.best.value_step, best)
                return replace(position, best=place, ended=STALLED)
            state = self.shifted(best, position.step, fraction)
            return replace(
                position, state=replace(state, noise=best.state.noise), fraction=fraction
            )
        assert linearized is not None
        near = best is not None and bool(
            np.all(np.abs(position.step) < settings.close * self.errors(best))
        )
        linearized = self.with_noise(linearized, choose=near and position.chosen < 2)
        place = self._placed(position.state, position.value_step, linearized)
        chosen = position.chosen + near
        step = self.step_of(linearized)
        errors = self.errors(linearized)
        done = bool(np.all(np.abs(step) < settings.settled * errors))
        if done and (chosen >= 2 or (self.given and self._count > 1)):
            return replace(position, best=place, chosen=chosen, ended=SETTLED)
        least = settings.minimum_value_step * self.width
        value_step = np.clip(errors, least, settings.value_step * self.width)
        state = self.shifted(linearized, step)
        if not near:  # far off, motion may have looked more unstable than it is
            state = replace(state, windows=self.first_windows)
        return _Position(state, step, 1.0, chosen, value_step, place)

    def _packed(self, state: _State) -> Array:
        """A state but for its noise in a row of numbers."""
        own = np.zeros(0) if state.own is None else state.own.ravel()
        cuts = np.flatnonzero(state.windows.cut & ~state.windows.runs.terminals)
        sizes = [len(own), len(cuts)]
        return np.concatenate([sizes, state.value, own, cuts, state.starts.ravel()])

    def _unpacked(self, row: Array, noise: NoiseDistribution) -> _State:
        """The state of such a row."""
        d = len(self.width)
        groups, count = (int(size) for size in row[:2])
        value, own, cuts, starts = np.split(row[2:], np.cumsum([d, groups, count]))
        windows = self.first_windows
        if count:
            cut = windows.cut.copy()
            cut[cuts.astype(np.int64)] = True
            windows = replace(windows, cut=cut)
        return _State(
            value,
            starts.reshape(len(self.first_windows.segments), -1),
            windows,
            noise,
            own.reshape(-1, d) if groups else None,
        )

    def _is_worse(self, linearized: _Linearized, best: _Linearized, noise_is_known: bool) -> bool:
        """Whether a state is further from the measurements than the best, under the same noise."""
        if self.given or noise_is_known:
            noise = best.state.noise
            lost = (
                log_densities(best.columns, noise).sum()
                - log_densities(linearized.columns, noise).sum()
            )
        else:
            counts = best.columns.valid.sum(axis=0)
            ratio = _mean_squares(linearized.columns) / _mean_squares(best.columns)
            lost = 0.5 * np.sum(counts * np.log(ratio))
        lost += self.prior.value(best.state.value) - self.prior.value(linearized.state.value)
        return bool(lost > self.settings.worse)

    def _result(
        self, linearized: _Linearized, status: Status, reason: str, count: int
    ) -> SearchResult:
        """How the search ended; the point is filled in with the family."""
        value = float(linearized.condensed.values.sum())
        return SearchResult(linearized.state.value, value, count, reason.format(count), status)

    # --- the fit

    def objective(
        self, state: _State, family: Family, linearized: _Linearized | None = None
    ) -> RunRows:
        """The log-likelihood around a state."""
        linearized = linearized or self.linearize(state)
        noise = linearized.state.noise
        whitened = None
        if self.given:
            whitened = whiten(linearized.columns, noise)[~linearized.columns.first, :, -1]
        group = _groups(state.windows)
        centre = state.value if state.own is None else state.own
        own = RunRows(
            family,
            linearized.condensed,
            linearized.columns,
            group,
            centre,
            noise,
            whitened,
        )
        if noise.memory.any():
            slopes, less = profiled(
                linearized.columns, whiten(linearized.columns, noise), linearized.condensed
            )
            own.unexplained = (-less * noise.sd, slopes * noise.sd[:, None])
        targets = self.observed.simulator.targets(state.windows.segments)
        own.predicted = own.predicted + targets[:, self.observed.measured]
        return own

    def with_spread(
        self, run: Run, place: _LinearizedState, found: SearchResult, family: Family
    ) -> tuple[_LinearizedState, SearchResult]:
        """The same, with every group linearized at its own parameters, where groups differ."""
        for turn in range(self.settings.spread_iterations):
            if turn == 0 and not self._varies(self.linearized_at(place), family):
                break
            place, outcome = self._recorded_turn(run, place, family, is_first=turn == 0)
            if outcome == IS_SETTLED:
                count = found.evaluations + turn + 1
                linearized = self.linearized_at(place)
                return place, self._result(linearized, Status.CONVERGED, SETTLED_APART, count)
            if outcome == IS_DONE:
                break
        return place, found

    def _varies(self, linearized: _Linearized, family: Family) -> bool:
        """Whether some parameter differs from group to group by more than its error."""
        phi = self._member(self.objective(linearized.state, family, linearized), family, linearized)
        return bool((family.sd(phi[: len(family.unknowns)]) > self.errors(linearized)).any())

    def _recorded_turn(
        self, run: Run, place: _LinearizedState, family: Family, *, is_first: bool
    ) -> tuple[_LinearizedState, int]:
        """A turn of the groups, or its record in the evaluation log.

        A record holds the log-likelihood, the outcome, the noise (3 m,), and the state before it
        was linearized; where simulations diverge, the first two alone.
        """
        reached: tuple[_LinearizedState, int] | None = None

        def evaluate(_: Array) -> Array:
            nonlocal reached
            reached = self._turn(place, family, is_first=is_first)
            value = float(self.linearized_at(reached[0]).condensed.values.sum())
            noise = reached[0].noise
            parts: list[Any] = [[value, reached[1]]]
            if reached[1] != IS_DONE:
                parts += [noise.sd, noise.memory, noise.degrees, self._packed(reached[0].state)]
            return np.concatenate(parts)[None]

        record = run.evaluate(place.state.value[None], evaluate)[0]
        if reached is not None:
            return reached
        outcome = int(record[1])
        if outcome == IS_DONE:
            return place, outcome
        m = int(self.observed.measured.sum())
        sd, memory, degrees, state = np.split(record[2:], np.cumsum([m, m, m]))
        noise = NoiseDistribution(sd, memory, degrees)
        # What was linearized still had the noise before, which decides nothing of it.
        return _LinearizedState(
            self._unpacked(state, noise), self._position.value_step, noise
        ), outcome

    def _turn(
        self, place: _LinearizedState, family: Family, *, is_first: bool
    ) -> tuple[_LinearizedState, int]:
        """Every group linearized at its own parameters, and whether they have settled."""
        linearized = self.linearized_at(place)
        objective = self.objective(linearized.state, family, linearized)
        phi = self._member(objective, family, linearized)
        group = _groups(linearized.state.windows)
        modes = objective.modes(phi)
        step = modes - objective.centre
        own = np.exp(modes) if family.logarithmic else modes
        space = self.simulator.space
        own = space.clip(own)
        before = linearized.state.value if linearized.state.own is None else linearized.state.own
        starts = linearized.state.starts + self._start_steps(linearized, (own - before)[group])
        within = self.prior.within
        mean = within.clip(family.mean(phi[: len(family.unknowns)]))
        state = replace(linearized.state, value=mean, own=own, starts=starts)
        value_step = self._position.value_step
        try:
            linearized = self.with_noise(self.linearize(state, value_step), choose=is_first)
        except SimulationFailed:
            return place, IS_DONE
        known = np.linalg.inv(objective.information + np.diag(self.width**-2.0))
        error = np.sqrt(np.diagonal(known, axis1=1, axis2=2))
        settled = bool((np.abs(step) < self.settings.settled_mode * error).all())
        return self._placed(state, value_step, linearized), IS_SETTLED if settled else GOES_ON

    def fit(
        self, problem: Problem, family: Family, linearized: _Linearized, found: SearchResult
    ) -> WholeRunsFit:
        """The maximum in the family, and the problem as it was compared."""
        objective = self.objective(linearized.state, family, linearized)
        phi = self._member(objective, family, linearized)
        value = objective(phi)
        found = replace(found, point=phi, value=value)
        windows = linearized.state.windows
        opening = np.flatnonzero(windows.depth == 0)
        rows = windows.segments.steps[opening, 0]
        simulator = FoundStarts(
            self.observed,
            rows,
            linearized.state.starts[opening],
            linearized.condensed.start_by_value,
            linearized.state.value
            if linearized.state.own is None
            else linearized.state.own[_groups(windows)],
        )
        compared = replace(
            problem,
            simulator=simulator,
            trajectories=windows.pieces,
            everything=None,
            horizon=1,
            reset="start",
            set_columns=None,
            every_step=False,
            whole_runs=False,
            epsilon=None,
            start_noise=False,
            held_out=None,
            estimated={},
            settings={},
        )
        variance = np.zeros(len(self.observed.measured))
        variance[self.observed.measured] = linearized.state.noise.variance
        names = [signal.name for signal in problem.simulator.signals]
        for name, sd in problem.estimated.items():
            variance[names.index(name)] = sd**2
        epsilon = variance[: len(names)]
        stuck = self._stuck(linearized)
        warnings = self._warnings(linearized)
        details = self._details(linearized)
        details["trajectory"]["stuck_windows"] = stuck
        reached = stuck <= self.settings.largest_stuck
        if not reached:
            warnings = (*warnings, NOT_REACHED.format(stuck))
        return WholeRunsFit(compared, objective, found, epsilon, details, warnings, reached)

    def _member(self, objective: RunRows, family: Family, linearized: _Linearized) -> Array:
        """Phi of the maximum: without spreads, but for those that gain enough."""
        unknowns = objective.unknowns
        scales = [i for i, name in enumerate(unknowns.names) if name.startswith("scale.")]
        low = family.phi(linearized.state.value, np.zeros(len(linearized.state.value)))
        low = unknowns.clip(low)
        plain = low
        if linearized.state.own is not None:
            plain = self._maximum(objective, scales, low)
        if not scales or len(objective.scores) < 2:
            return plain
        start = plain.copy()
        relative = (
            linearized.state.value if family.logarithmic else np.ones(len(linearized.state.value))
        )
        first = np.maximum(3 * self.errors(linearized), self._scatter(objective)) / relative
        start[scales] = np.clip(first, unknowns.low[scales], unknowns.high[scales])
        found = self._maximum(objective, [], start)
        value = local_with_prior(objective, self.prior)
        best = value(found)
        if best - value(plain) <= self.settings.spread_gain * len(scales):
            return plain
        # Without those whose absence costs little.
        empty = []
        for i in scales:
            if best - value(self._maximum(objective, [i], found)) <= self.settings.spread_gain:
                empty.append(i)
        return self._maximum(objective, empty, found) if empty else found

    def _maximum(self, objective: RunRows, held: list[int], start: Array) -> Array:
        """Phi of the maximum from a start, with the scales at some places held at their least."""
        searched = _held(objective, held) if held else objective
        return maximize_locally(local_with_prior(searched, self.prior), start).phi

    def _scatter(self, objective: RunRows) -> Array:
        """(d,) standard deviations of the groups' own parameters."""
        if objective.centre.shape[0] < 2:
            return np.zeros(objective.centre.shape[1])
        return np.asarray(objective.centre.std(axis=0))

    def _stuck(self, linearized: _Linearized) -> float:
        """The fraction of windows whose residuals are larger than the noise explains."""
        noise = linearized.state.noise
        columns = linearized.columns
        residual = whiten(columns, noise)[:, :, -1]
        finite = np.isfinite(noise.degrees)
        tails = np.clip(
            student_below(residual, np.where(finite, noise.degrees, 5.0)), 1e-15, 1 - 1e-15
        )
        scores = np.where(finite, -normal_of_tail(tails), residual)
        squares = np.where(columns.valid, scores**2, 0.0).sum(axis=1)
        total = np.bincount(columns.window, squares)
        count = np.bincount(columns.window, columns.valid.sum(axis=1))
        far = total > self.settings.stuck * count
        unlikely = chi2_tail(total, np.maximum(count, 1)) < self.settings.stuck_level
        return float(np.mean(far & unlikely))

    def _warnings(self, linearized: _Linearized) -> tuple[str, ...]:
        """A sentence where runs stray from the measurements further than noise explains.

        Noise is what windows with a start of their own leave, which hardly see a wrong model.
        """
        windows = linearized.state.windows
        if self.given or len(windows.segments) < 2 * len(windows.pieces.spans):
            return ()
        columns = linearized.columns.unlinked()
        estimates = RestrictedEstimates(columns, self.start_prior, self.noise_settings)
        noise = linearized.state.noise
        if self.degrees is None:
            within = estimates.choose(white(noise.news))
        else:
            within = estimates.levels(white(noise.news, self.degrees))
        ratio = noise.news / within.news
        z = np.log(ratio) * np.sqrt(2 * columns.valid.sum(axis=0))
        worst = int(np.argmax(ratio))
        if ratio[worst] <= self.settings.excess or z[worst] <= self.settings.excess_z:
            return ()
        name = self.observed.simulator.signals[np.flatnonzero(self.observed.measured)[worst]].name
        return (
            f"the model is wrong: along whole runs, {name} strays {ratio[worst]:.3g} times as far"
            f" as the noise that it has within {windows.length} steps",
        )

    def _details(self, linearized: _Linearized) -> dict[str, Any]:
        """What fit.json says of runs, starts and noise."""
        noise = linearized.state.noise
        windows = linearized.state.windows
        signals = np.array(self.observed.simulator.signals, dtype=object)[self.observed.measured]
        by_signal = {}
        for j, signal in enumerate(signals):
            degrees = float(noise.degrees[j])
            by_signal[signal.name] = {
                "sd": float(noise.sd[j]),
                "correlation": float(noise.memory[j]),
                "degrees": degrees if np.isfinite(degrees) else None,
                "unit": signal.unit,
            }
        return {
            "trajectory": {
                "runs": len(windows.runs.spans),
                "pieces": len(windows.pieces.spans),
                "window": windows.length,
                "noise": by_signal,
            }
        }


def _require_runs(problem: Problem) -> None:
    """Raise Incompatible where rows do not follow each other, or segments start otherwise."""
    if problem.reset == "partial":
        raise Incompatible(
            "The likelihood 'trajectory' finds the start states of whole runs, and the problem's"
            " resets are partial. Use 'emulated', or leave `reset` out."
        )
    runs = following_rows(problem.trajectories)
    if len(runs.spans) == len(runs):
        raise Incompatible(
            "The likelihood 'trajectory' needs rows that follow each other: each must begin with"
            " what the one before it ended with. Use 'emulated'."
        )


def _with_columns(data: Trajectories, columns: Array) -> Trajectories:
    """The data with further constant columns (c,)."""
    if not len(columns):
        return data
    further = np.broadcast_to(columns, (len(data), len(columns)))
    return replace(
        data,
        observations=np.concatenate([data.observations, further], axis=1),
        next_observations=np.concatenate([data.next_observations, further], axis=1),
    )


def _held(objective: RunRows, places: list[int]) -> RunRows:
    """The same log-likelihood with some of its scales held at their least values."""
    held = copy.copy(objective)
    unknowns = list(objective.unknowns)
    for i in places:
        own = unknowns[i]
        unknowns[i] = replace(own, high=own.low + 1e-9 * max(abs(own.low), 1e-12))
    held.unknowns = ParameterSpace(tuple(unknowns))
    return held


def _groups(windows: RunWindows) -> Ints:
    """(P,) the group of each piece, numbered as they come."""
    first = np.array([start for start, _ in windows.pieces.spans])
    assert windows.pieces.group is not None
    return np.unique(windows.pieces.group[first], return_inverse=True)[1]


def _mean_squares(columns: LinearizedInstants) -> Array:
    """(m,) mean squared residuals."""
    found = np.sum(columns.residuals**2, axis=0) / np.maximum(columns.valid.sum(axis=0), 1)
    return np.maximum(found, 1e-300)
