"""Fitting with a local likelihood: build it in a trust region, maximise it, move the region there.

A local likelihood is sound only near the point where it was built. Each outer iteration builds one
in the trust region, searches it for its maximum, and centres the next region there, as wide as the
estimate is uncertain. The iterations end where the region stays as it is. In three stages they see
a few of the segments, then, where there are very many, a sample of them, and at last all. Messages
call an iteration a round.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from dropo.core.contracts.estimator import Run, silent
from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.optimizer import Optimizer
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.fisher_scoring import maximize_locally
from dropo.core.contracts.support.maximize import SearchResult, maximize
from dropo.core.contracts.support.mean_prior import MeanPrior, local_with_prior, mean_places
from dropo.core.records.fits.fit import Status, interrupted
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.registry import find
from dropo.core.services.tables import duration_text
from dropo.core.services.validation import Array

UNSETTLED = (
    "The estimate still moved after {} rounds: look at parameters that the data cannot tell."
)
SETTLED = "The estimate stopped moving after {} rounds."
SPENT = "The budget of {} evaluations ran out in round {}: raise it."
CUT_SHORT = (
    "The estimate stopped moving, but the search within the last round did not come to its end."
)
RAISE = " Raise its budget."
STALLED = "The likelihood stopped rising after {} rounds; designs differ by more than the steps."
DIVERGED = "Simulations of a design diverged."
SLOW = "an iteration takes {}"
LINEAR = "--likelihood linear would take about {}"

MakeOptimizer = Callable[[int, Array], Optimizer]
"""From the number of unknowns and a start (m,) in the unit box to the inner optimizer."""


@dataclass(frozen=True)
class TrustRegionSettings:
    """What decides how trust regions move and when the outer iterations end.

    Attributes
    ----------
    max_iterations : int
        There are so many outer iterations at most.
    budget : int or None
        None begins after so many evaluations of the whole run.
    first_width : float
        Width of the first region, and the largest of any, as a fraction of the search interval.
    minimum_width : float
        Smallest width of a region, as a fraction of the search interval; larger where a simulator
        of single precision asks for it (`Simulator.minimum_step`).
    coarse_segments : int
        The first iterations see so many segments at least.
    coarse_segments_per_parameter : int
        The first iterations see so many segments for each parameter, if that is more.
    coarse_iterations : int
        The first iterations end after so many, or once the estimate is settled.
    sample_segments : int
        The next iterations see so many segments, as fine as all of them, until the estimate is
        settled there; then all are seen.
    sample_factor : float
        There is such a sample where the data have at least this many times as many segments as it.
    sample_iterations : int
        The iterations on the sample end after so many.
    sample_margin : float
        The first region of all segments is so many times as wide as the sample asks for, since its
        estimate is off by what rows differ.
    sample_reach : float
        The first maximum on all segments is taken if it is within so many widths of the centre.
    errors_wide : float
        A region is at least so many standard errors of the mean wide.
    followed_move : float
        A region is at least as wide as this fraction of the last move of the mean.
    maximum_shrink : float
        A width becomes smaller by at most this factor from one iteration to the next.
    maximum_growth : float
        A width becomes larger by at most this factor from one iteration to the next.
    settled_width : float
        The estimate is settled only where widths change by less than this fraction.
    settled_sd : float
        The estimate is settled only where the mean moves by less than this fraction of the
        distribution's standard deviation, or as little as the next two fields say.
    settled_error : float
        A move below this fraction of the mean's own standard error is as good.
    settled_minimum : float
        A move below this fraction of the smallest width is as good.
    patience : int
        Iterations on all segments without a better likelihood, after which the best is taken.
    retries : int
        How often a width is halved where the simulations of a design diverge.
    first_noise : float
        The first search begins with learned noise multiplied by this factor.
    first_scale : float
        The first search begins with scales of this fraction of the width.
    minimum_start_scale : float
        Later searches begin with scales of at least this fraction of the width.
    slow_iteration : float
        The first iteration that takes longer is shown, with what another likelihood would take [s].
    """

    max_iterations: int = 25
    budget: int | None = None
    first_width: float = 1 / 6
    minimum_width: float = 5e-5
    coarse_segments: int = 60
    coarse_segments_per_parameter: int = 5
    coarse_iterations: int = 6
    sample_segments: int = 10_000
    sample_factor: float = 4.0
    sample_iterations: int = 6
    sample_margin: float = 1.5
    sample_reach: float = 1.8
    errors_wide: float = 1.0
    followed_move: float = 0.7
    maximum_shrink: float = 20.0
    maximum_growth: float = 4.0
    settled_width: float = 0.15
    settled_sd: float = 0.02
    settled_error: float = 0.1
    settled_minimum: float = 0.05
    patience: int = 5
    retries: int = 5
    first_noise: float = 0.1
    first_scale: float = 0.5
    minimum_start_scale: float = 0.05
    slow_iteration: float = 30.0


class Stage(Enum):
    """How many of the segments an iteration sees.

    Attributes
    ----------
    FEW
        Some from all over the data, coarsely modelled.
    SAMPLE
        A sample of them, as finely modelled as all.
    ALL
        All segments.
    """

    FEW = "few"
    SAMPLE = "sample"
    ALL = "all"


@dataclass(frozen=True)
class TrustRegion:
    """Where a local likelihood is built.

    Attributes
    ----------
    centre, width : (d,) array
        Means are near the centre and scales at most about the width, in the parameters' units.
    stage : Stage
        How many of the segments are seen.
    """

    centre: Array
    width: Array
    stage: Stage


@dataclass(frozen=True)
class IterationResult:
    """What an outer iteration found.

    Attributes
    ----------
    region : TrustRegion
        Where the likelihood was built.
    phi : (m,) array
        The maximum: the family's unknowns, then the likelihood's own.
    value : float
        The log-likelihood there, with the log prior where there is one [nats].
    errors : (d,) array
        The standard errors of the means, in the parameters' units.
    converged : bool
        Whether the search within the iteration came to its own end.
    """

    region: TrustRegion
    phi: Array
    value: float
    errors: Array
    converged: bool

    def to_record(self) -> Array:
        """Return what is kept in the evaluation log.

        Returns
        -------
        (2 d + 2 + m,) array
            The region's width (d,), the errors (d,), the value, whether the search converged (0 or
            1), and phi (m,).
        """
        return np.concatenate(
            [self.region.width, self.errors, [self.value, self.converged], self.phi]
        )

    @classmethod
    def from_record(cls, record: Array, region: TrustRegion) -> "IterationResult":
        """Make a result again from its record.

        Parameters
        ----------
        record : (2 d + 2 + m,) array
            As of `to_record`.
        region : TrustRegion
            The region that was asked for: that of the result may be narrower.

        Returns
        -------
        IterationResult
        """
        d = len(region.width)
        width, errors, (value, converged), phi = np.split(record, [d, 2 * d, 2 * d + 2])
        return cls(replace(region, width=width), phi, float(value), errors, bool(converged))


@dataclass
class OuterIterations:
    """One fit by a local likelihood in trust regions.

    Attributes
    ----------
    problem : Problem
    run : Run
    family : Family
        The distributions to choose from.
    likelihood : LocalLikelihood
        What builds the local likelihoods.
    epsilon : Epsilon
        The noise.
    rng : numpy.random.Generator
    make_optimizer : function, optional
        Makes the optimizer of each iteration; without it, Fisher scoring.
    settings : TrustRegionSettings
    prior : MeanPrior
        What is known of the means before.
    box : (d,) array
        Widths of the search intervals, in the parameters' units.
    smallest_width : (d,) array
        Lower bound of a region's widths, in the parameters' units.
    design_seed : int
        Seed of the points that every local likelihood is built from.
    """

    problem: Problem
    run: Run
    family: Family
    likelihood: LocalLikelihood
    epsilon: Epsilon
    rng: np.random.Generator
    make_optimizer: MakeOptimizer | None = None
    settings: TrustRegionSettings = field(default_factory=TrustRegionSettings)
    prior: MeanPrior = field(init=False)
    box: Array = field(init=False)
    smallest_width: Array = field(init=False)
    design_seed: int = field(init=False)

    def __post_init__(self) -> None:
        self.prior = MeanPrior(self.problem.priors, self.problem.space)
        self.box = self.problem.space.high - self.problem.space.low
        fraction = max(self.settings.minimum_width, self.problem.simulator.minimum_step)
        self.smallest_width = fraction * self.box
        # One seed for all designs: with a new one each time, iterations would never settle.
        self.design_seed = int(self.rng.spawn(1)[0].integers(2**63))
        self._last_built: tuple[TrustRegion, LocalLogLikelihood] | None = None
        self._cost_is_shown = False

    def fit(
        self, start: Array, width: Array | None = None
    ) -> tuple[LocalLogLikelihood, SearchResult]:
        """Find the likelihood that is built around its own maximum.

        Parameters
        ----------
        start : (d,) array
            The first means.
        width : (d,) array, optional
            The first region's, where the start is nearly right; all segments are seen at once.

        Returns
        -------
        LocalLogLikelihood
            The likelihood.
        SearchResult
            Its maximum, and how the iterations ended.

        Raises
        ------
        SimulationFailed
            Where even narrow regions hold simulations that diverge.
        """
        results: list[IterationResult] = []
        try:
            status, reason = self._iterate(self._first_region(start, width), results)
        except KeyboardInterrupt:
            if not results:
                raise
            status = Status.INTERRUPTED
            reason = interrupted()

        best = self._best(results)
        if status is Status.CONVERGED and not best.converged:
            status = Status.OUT_OF_BUDGET
            reason = CUT_SHORT + (RAISE if self.make_optimizer else "")
        if best.region.stage is not Stage.ALL:
            best = self._on_all_segments(best)
        objective = self._likelihood_of(best)
        value = best.value
        if self.prior:
            value -= self.prior.value(best.phi[mean_places(objective, self.problem.space)])
        return objective, SearchResult(best.phi, value, len(results), reason, status)

    def _iterate(self, region: TrustRegion, results: list[IterationResult]) -> tuple[Status, str]:
        """Iterate until an end; append a result for each iteration, and return how they ended."""
        while len(results) < self.settings.max_iterations:
            # Build the likelihood in the region, and find its maximum from the last one on.
            last_maximum = results[-1].phi if results else None
            result = self._iteration(region, last_maximum)
            results.append(result)
            count = len(results)
            text = f"round {count}, log-likelihood {result.value:.6g}"
            # How many iterations there will be is not known: progress is shown as if it were eight.
            self.run.progress(min(0.95, count / 8), text)

            # End where nothing moves, or where the likelihood no longer rises.
            following = self._next_region(result)
            settled = self._is_settled(result, following)
            sees_all = result.region.stage is Stage.ALL
            if sees_all and len(results) > 1 and results[-2].region.stage is Stage.SAMPLE:
                settled = settled or self._stays_inside(result)
            if settled and sees_all:
                return Status.CONVERGED, SETTLED.format(count)
            stalled = self._is_stalled(results)
            if stalled and sees_all:
                return Status.CONVERGED, STALLED.format(count)

            if self.settings.budget is not None and self.run.evaluations >= self.settings.budget:
                return Status.OUT_OF_BUDGET, SPENT.format(self.settings.budget, count)

            # Move there; once the estimate is settled on some segments, see more of them.
            region = self._with_more(following, results, settled or stalled)
        return Status.OUT_OF_BUDGET, UNSETTLED.format(self.settings.max_iterations)

    def _with_more(
        self, region: TrustRegion, results: list[IterationResult], settled: bool
    ) -> TrustRegion:
        """The region with as many segments as the estimate needs: some, a sample, or all."""
        settings = self.settings
        if region.stage is Stage.ALL:
            return region
        if region.stage is Stage.FEW:
            if not settled and len(results) < settings.coarse_iterations:
                return region
            every = self.problem.segments
            sample = len(every.thin(settings.sample_segments))  # all where they form chains
            many = len(every) >= settings.sample_factor * sample
            return replace(region, stage=Stage.SAMPLE if many else Stage.ALL)
        sampled = sum(result.region.stage is Stage.SAMPLE for result in results)
        if not settled and sampled < settings.sample_iterations:
            return region
        width = np.minimum(settings.sample_margin * region.width, settings.first_width * self.box)
        return replace(region, width=width, stage=Stage.ALL)

    def _stays_inside(self, result: IterationResult) -> bool:
        """Whether a first maximum on all segments is where the model of a settled sample holds."""
        width = result.region.width
        phi = self._of_family(result.phi)
        move = np.abs(self.family.mean(phi) - result.region.centre)
        needed = np.maximum(self.family.sd(phi), result.errors)
        inside = move < self.settings.sample_reach * width
        return bool(np.all(inside & (needed < (1 + self.settings.settled_width) * width)))

    def _iteration(self, region: TrustRegion, last_maximum: Array | None) -> IterationResult:
        """One iteration, or its record in the evaluation log, from the last maximum (m,).

        A design that diverges is recorded as one NaN, so that a resumed run goes the same way.
        """
        failures: list[SimulationFailed] = []

        def evaluate(_: Array) -> Array:
            begun = time.perf_counter()
            steps_before = self.problem.simulator.steps
            try:
                used_region, local = self._build(region)
            except SimulationFailed as error:
                failures.append(error)
                return np.full((1, 1), np.nan)
            result = self._search_in(used_region, local, last_maximum)
            steps = self.problem.simulator.steps - steps_before
            self._show_cost(region, time.perf_counter() - begun, steps)
            return result.to_record()[None]

        # The evaluation log knows an iteration by its region.
        point = np.concatenate([region.centre, region.width])[None]
        record = self.run.evaluate(point, evaluate)[0]
        if len(record) == 1:
            raise failures[0] if failures else SimulationFailed(DIVERGED)
        return IterationResult.from_record(record, region)

    def _show_cost(self, region: TrustRegion, seconds: float, steps: int) -> None:
        """Show once that iterations are slow, and what linear ones would take: 2 d + 1 simulations
        of the same segments.
        """
        if self._cost_is_shown or seconds <= self.settings.slow_iteration:
            return
        self._cost_is_shown = True
        text = SLOW.format(duration_text(seconds))
        segments = self._segments(region)
        each = int(segments.lengths.sum()) * self.problem.simulator.steps_per_action
        fraction = (2 * len(self.box) + 1) * each / max(steps, 1)
        if fraction < 1 and not isinstance(self.likelihood, find("likelihoods", "linear")):
            text = f"{text}; {LINEAR.format(duration_text(seconds * fraction))}"
        self.run.progress(0.0, text)

    # --- regions

    def _first_region(self, start: Array, width: Array | None) -> TrustRegion:
        """A wide one that sees a few segments, unless the start is nearly right."""
        if width is None:
            return TrustRegion(start, self.settings.first_width * self.box, Stage.FEW)
        return TrustRegion(start, width, Stage.ALL)

    def _next_region(self, result: IterationResult) -> TrustRegion:
        """The region around the found mean, as wide as spread, last move and error ask for."""
        settings = self.settings
        phi = self._of_family(result.phi)
        mean = self.family.mean(phi)
        scale = self.family.scale(phi)
        if self.family.logarithmic:
            # A scale of the logarithms is relative to the mean.
            scale = scale * mean
        # The largest of all that asks for width ...
        spread = np.maximum(scale, self.family.sd(phi))
        followed = settings.followed_move * np.abs(mean - result.region.centre)
        errors = settings.errors_wide * result.errors
        wanted = np.maximum.reduce([spread, followed, errors, self.smallest_width])
        # ... as far as a width may change in one iteration.
        before = result.region.width
        smallest = before / settings.maximum_shrink
        largest = np.minimum(settings.maximum_growth * before, settings.first_width * self.box)
        width = np.maximum(np.clip(wanted, smallest, largest), self.smallest_width)
        return replace(result.region, centre=mean, width=width)

    def _is_settled(self, result: IterationResult, following: TrustRegion) -> bool:
        """Whether neither the mean nor the widths moved."""
        settings = self.settings
        # The mean moves by less than the largest of three lengths ...
        sd = self.family.sd(self._of_family(result.phi))
        small_move = np.maximum.reduce(
            [
                settings.settled_sd * sd,
                settings.settled_error * result.errors,
                settings.settled_minimum * self.smallest_width,
            ]
        )
        move = np.abs(following.centre - result.region.centre)
        # ... and no width changes by a larger fraction than the settings say.
        width_change = np.abs(following.width / result.region.width - 1)
        return bool(np.all(move < small_move) and np.all(width_change < settings.settled_width))

    def _of_family(self, phi: Array) -> Array:
        """The family's part of phi (m,), without the likelihood's own unknowns behind it."""
        return phi[: len(self.family.unknowns)]

    def _is_stalled(self, results: list[IterationResult]) -> bool:
        """Whether the last iterations on these segments brought no better likelihood."""
        stage = results[-1].region.stage
        if stage is Stage.FEW:
            return False
        values = [result.value for result in results if result.region.stage is stage]
        patience = self.settings.patience
        if len(values) <= patience:
            return False
        return max(values[-patience:]) <= max(values[:-patience])

    def _best(self, results: list[IterationResult]) -> IterationResult:
        """The last result; of a search that stalled, that of the highest likelihood."""
        last = results[-1]
        if last.region.stage is not Stage.ALL or not self._is_stalled(results):
            return last
        # Log-likelihoods of some segments do not compare with those of all.
        on_all_segments = [result for result in results if result.region.stage is Stage.ALL]
        return max(on_all_segments, key=lambda result: result.value)

    # --- the likelihood in a region

    def _build(self, region: TrustRegion) -> tuple[TrustRegion, LocalLogLikelihood]:
        """The local likelihood, in a narrower region where simulations of its design diverge."""
        self._last_built = None  # its memory is free for the next one
        for attempt in range(self.settings.retries + 1):
            try:
                local = self.likelihood.linearize_at(
                    self.problem.simulator,
                    self._segments(region),
                    self.family,
                    self.epsilon,
                    region.centre,
                    region.width,
                    np.random.default_rng(self.design_seed),
                    rough=region.stage is Stage.FEW,
                )
            except SimulationFailed:
                if attempt == self.settings.retries:
                    raise
                region = replace(region, width=region.width / 2)
            else:
                self._last_built = (region, local)
                return self._last_built
        raise AssertionError("the last attempt returns or raises")

    def _segments(self, region: TrustRegion) -> Segments:
        """All segments, or some from all over the data."""
        every = self.problem.segments
        if region.stage is Stage.ALL:
            return every
        settings = self.settings
        count = settings.sample_segments
        if region.stage is Stage.FEW:
            per_parameter = settings.coarse_segments_per_parameter * len(self.box)
            count = max(settings.coarse_segments, per_parameter)
        chosen = every.thin(count)
        return every.take(chosen) if len(chosen) < len(every) else every

    def _likelihood_of(self, result: IterationResult) -> LocalLogLikelihood:
        """The likelihood that a result came from.

        It is built again, not counted, where it was read from the log or left behind.
        """
        if self._last_built is not None:
            region, local = self._last_built
            if np.array_equal(region.centre, result.region.centre):
                return local
        return self._build(result.region)[1]

    def _on_all_segments(self, result: IterationResult) -> IterationResult:
        """The same maximum in a likelihood of all segments, after an early interruption."""
        with self.run.counting():
            region, local = self._build(replace(result.region, stage=Stage.ALL))
        return replace(result, region=region, value=local(result.phi))

    # --- the search in a region

    def _search_in(
        self, region: TrustRegion, local: LocalLogLikelihood, last_maximum: Array | None
    ) -> IterationResult:
        """The maximum of the likelihood that was built in a region."""
        start = self._search_start(local, region, last_maximum)
        phi, converged = self._maximize(local, start)
        errors = self._standard_errors(local, phi)
        value = local_with_prior(local, self.prior)(phi)
        return IterationResult(region, phi, value, errors, converged)

    def _search_start(
        self, local: LocalLogLikelihood, region: TrustRegion, last_maximum: Array | None
    ) -> Array:
        """Where the search begins: the last maximum (m,) with the region's mean, and no scale 0."""
        unknowns = local.unknowns
        if last_maximum is None:
            start = unknowns.from_unit(np.full(len(unknowns), 0.5))
            # Learned noise begins below the misfit at the middle of the box.
            start[len(self.family.unknowns) :] = self.settings.first_noise
        else:
            start = last_maximum.copy()

        for i, name in enumerate(self.family.space.names):
            mean_index = unknowns.names.index(f"mean.{name}")
            start[mean_index] = region.centre[i]
            if f"scale.{name}" not in unknowns.names:
                continue
            scale_index = unknowns.names.index(f"scale.{name}")
            width = region.width[i]
            if self.family.logarithmic:
                # A scale of the logarithms is relative to the mean.
                width = width / region.centre[i]
            if last_maximum is None:
                start[scale_index] = self.settings.first_scale * width
            else:
                minimum = self.settings.minimum_start_scale * width
                start[scale_index] = max(start[scale_index], minimum)
        return unknowns.clip(start)

    def _maximize(self, local: LocalLogLikelihood, start: Array) -> tuple[Array, bool]:
        """The local maximum (m,), and whether the search came to its own end."""
        local = local_with_prior(local, self.prior)
        if self.make_optimizer is None:
            maximum = maximize_locally(local, start)
            self.run.inner_evaluations += maximum.evaluations
            return maximum.phi, maximum.converged
        # Rounding may carry a start on a bound out of the unit box.
        unit_start = np.clip(local.unknowns.to_unit(start), 0.0, 1.0)
        optimizer = self.make_optimizer(len(start), unit_start)
        # The evaluations of a local model are cheap: counted apart, neither logged nor shown.
        inner_run = replace(self.run, evaluation_log=EvaluationLog(), progress=silent)
        found = maximize(local, local.unknowns, optimizer, inner_run)
        self.run.inner_evaluations += found.evaluations
        if found.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        return found.point, found.status is Status.CONVERGED

    def _standard_errors(self, local: LocalLogLikelihood, phi: Array) -> Array:
        """(d,) of the means, by the sandwich of scores and information.

        On data without noise they are far below those of the information alone, so that the
        iterations end in narrow regions.
        """
        d = len(self.box)
        # The first d unknowns are the means; scores have a row for each row or group of data.
        _, scores, information = local.value_score_information(phi)
        known = self.prior.information(phi[:d])
        inverse = np.linalg.pinv(information[:d, :d] + np.diag(known), hermitian=True)
        # With I^-1 the inverse and S the scores: the roots of the diagonal of I^-1 S' S I^-1.
        of_data = np.sum((scores[:, :d] @ inverse) ** 2, axis=0)
        return np.sqrt(of_data + np.sum(known[:, None] * inverse**2, axis=0))
