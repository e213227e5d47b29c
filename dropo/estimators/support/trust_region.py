"""Fitting with a local likelihood: build it, maximise it, move it to where its maximum was, until
nothing moves.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.fisher_scoring import maximize_locally
from dropo.core.contracts.local_likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.maximize import SearchResult, maximize
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.optimizer import Optimizer
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Status
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.evaluation_log import EvaluationLog
from dropo.core.services.validation import Array

FIRST = 1 / 6  # first width as a share of the box
# a first, rough look: 60 segments, or 5 for each parameter, in up to 6 rounds
COARSE = 60
EACH = 5
EARLY = 6
# a width follows 0.7 of the last move; rounds end when widths change by less than 15 %
MOVED = 0.7
SETTLED = 0.15
NARROW = 5e-5  # the least width, as a share of the box
# a width changes by at most these factors in a round, and stays within the first one
SHRINK = 20.0
GROW = 4.0
STALLED = 5  # full rounds without a better likelihood, after which the best one is taken

UNSETTLED = (
    "The estimate still moved after {} rounds: look at parameters that the data cannot tell."
)
SETTLED_IN = "The estimate stopped moving after {} rounds."
CUT_SHORT = (
    "The estimate stopped moving, but the search within the last round did not come to its "
    "end: raise its budget."
)
STOPPED = "The likelihood stopped rising after {} rounds; designs differ by more than the steps."

MakeOptimizer = Callable[[int, Array], Optimizer]


@dataclass(frozen=True)
class _Region:
    """Where a local likelihood is built: centre and width (d,), and whether it is a rough one from
    some of the segments.
    """

    centre: Array
    width: Array
    coarse: bool


@dataclass(frozen=True)
class _Outcome:
    """A round's maximum phi (m,) with its value, the standard errors (d,) of its means, and whether
    the search for it came to its own end.
    """

    region: _Region
    phi: Array
    value: float
    errors: Array
    finished: bool


@dataclass
class Rounds:
    """One fit. make_optimizer: a function of (dimension, start) to the inner optimizer, or None for
    Fisher scoring.
    """

    problem: Problem
    run: Run
    family: Family
    likelihood: LocalLikelihood
    epsilon: Epsilon
    rng: np.random.Generator
    make_optimizer: MakeOptimizer | None = None
    most: int = 25

    def __post_init__(self) -> None:
        self.box = self.problem.space.high - self.problem.space.low
        self.design = int(
            self.rng.spawn(1)[0].integers(2**63)
        )  # one scramble, so that rounds can settle
        self._built: tuple[_Region, LocalLogLikelihood] | None = None

    def fit(
        self, start: Array, width: Array | None = None
    ) -> tuple[LocalLogLikelihood, SearchResult]:
        """The likelihood built around its own maximum, and that maximum, from means (d,); width:
        (d,), where they are nearly right.
        """
        region = (
            _Region(start, FIRST * self.box, True)
            if width is None
            else _Region(start, width, False)
        )
        done: list[_Outcome] = []
        status = Status.OUT_OF_BUDGET
        reason = UNSETTLED.format(self.most)
        try:
            while len(done) < self.most:
                outcome = self._round(region, done[-1].phi if done else None)
                done.append(outcome)
                self.run.progress(
                    min(0.95, len(done) / 8),
                    f"round {len(done)}, log-likelihood {outcome.value:.6g}",
                )
                following = self._following(outcome)
                settled = self._still(outcome) and bool(
                    np.all(np.abs(following.width / outcome.region.width - 1) < SETTLED)
                )
                if not outcome.region.coarse and settled:
                    status = Status.CONVERGED
                    reason = SETTLED_IN.format(len(done))
                    break
                if self._stalled(done):
                    status = Status.CONVERGED
                    reason = STOPPED.format(len(done))
                    break
                region = replace(
                    following, coarse=outcome.region.coarse and not settled and len(done) < EARLY
                )
        except KeyboardInterrupt:
            if not done:
                raise
            status = Status.INTERRUPTED
            reason = "Interrupted: this is the best so far."
        full = [outcome for outcome in done if not outcome.region.coarse]
        best = max(full, key=lambda outcome: outcome.value) if self._stalled(done) else done[-1]
        if status is Status.CONVERGED and not best.finished:
            status = Status.OUT_OF_BUDGET
            reason = CUT_SHORT
        if best.region.coarse:
            best = self._on_all_segments(best)
        return self._likelihood_of(best), SearchResult(
            best.phi, best.value, len(done), reason, status
        )

    def _on_all_segments(self, outcome: _Outcome) -> _Outcome:
        """The same maximum in a likelihood of all segments: for a fit that was interrupted before
        its first full round.
        """
        with self.run.counting():
            region, local = self._build(replace(outcome.region, coarse=False))
        return replace(outcome, region=region, value=local(outcome.phi))

    def _round(self, region: _Region, last: Array | None) -> _Outcome:
        """One round, or its record: what is kept is the width used, the errors, the value, whether
        it finished, and phi.
        """
        d = len(self.box)
        point = np.concatenate([region.centre, region.width])[None]

        def rollout(point: Array) -> Array:
            used, local = self._build(region)
            phi, finished = self._maximise(local, self._first(local, used, last))
            return np.concatenate(
                [used.width, self._errors(local, phi), [local(phi), finished], phi]
            )[None]

        width, errors, (value, finished), phi = np.split(
            self.run.evaluate(point, rollout)[0], [d, 2 * d, 2 * d + 2]
        )
        return _Outcome(replace(region, width=width), phi, float(value), errors, bool(finished))

    def _build(self, region: _Region) -> tuple[_Region, LocalLogLikelihood]:
        """The local likelihood; where a design's simulations diverge, on half the width, up to five
        times.
        """
        for attempt in range(6):
            try:
                rng = np.random.default_rng(self.design)
                local = self.likelihood.linearize_at(
                    self.problem.simulator,
                    self._segments(region.coarse),
                    self.family,
                    self.epsilon,
                    region.centre,
                    region.width,
                    rng,
                    rough=region.coarse,
                )
                self._built = (region, local)
                return self._built
            except SimulationFailed:
                if attempt == 5:
                    raise
                region = replace(region, width=region.width / 2)
        raise AssertionError

    def _likelihood_of(self, outcome: _Outcome) -> LocalLogLikelihood:
        """The one that the outcome came from; built again, not counted, where it was read from the
        record or left behind.
        """
        if self._built is None or not np.array_equal(self._built[0].centre, outcome.region.centre):
            self._build(outcome.region)
        assert self._built is not None
        return self._built[1]

    def _segments(self, coarse: bool) -> Segments:
        every = self.problem.segments
        chosen = every.thin(max(COARSE, EACH * len(self.box)))
        return every.take(chosen) if coarse and len(chosen) < len(every) else every

    def _first(self, local: LocalLogLikelihood, region: _Region, last: Array | None) -> Array:
        """Where the inner search begins: the last maximum, its scales not below a twentieth of the
        width.
        """
        unknowns = local.unknowns
        start = unknowns.from_unit(np.full(len(unknowns), 0.5)) if last is None else last.copy()
        if last is None:  # learned noise begins below the misfit at the middle of the box
            start[len(self.family.unknowns) :] = 0.1
        for name, c, h in zip(self.family.space.names, region.centre, region.width, strict=True):
            start[unknowns.names.index(f"mean.{name}")] = c
            if f"scale.{name}" in unknowns.names:
                i = unknowns.names.index(f"scale.{name}")
                relative = h / c if self.family.logarithmic else h
                start[i] = relative / 2 if last is None else max(start[i], 0.05 * relative)
        return np.clip(start, unknowns.low, unknowns.high)

    def _maximise(self, local: LocalLogLikelihood, start: Array) -> tuple[Array, bool]:
        """The local maximum (m,), and whether the search came to its own end."""
        if self.make_optimizer is None:
            found = maximize_locally(local, start)
            return found.phi, found.converged
        optimizer = self.make_optimizer(
            len(start), np.clip(local.unknowns.to_unit(start), 0.0, 1.0)
        )
        inside = replace(
            self.run, evaluation_log=EvaluationLog(), progress=lambda share, text: None
        )
        result = maximize(local, local.unknowns, optimizer, inside)
        if result.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        return result.point, result.status is Status.CONVERGED

    def _errors(self, local: LocalLogLikelihood, phi: Array) -> Array:
        """Of the sandwich: on data without noise far below those of the information, so that rounds
        end on narrow designs.
        """
        d = len(self.box)
        _, scores, information = local.value_score_information(phi)
        inverse = np.linalg.pinv(information[:d, :d], hermitian=True)
        return np.sqrt(np.sum((scores[:, :d] @ inverse) ** 2, axis=0))

    def _following(self, outcome: _Outcome) -> _Region:
        """The region around the outcome's mean; wide enough for its spread, its last move and its
        standard error.
        """
        phi = outcome.phi[: len(self.family.unknowns)]
        width = outcome.region.width
        mean = self.family.mean(phi)
        spread = np.maximum(
            self.family.scale(phi) * (mean if self.family.logarithmic else 1.0), self.family.sd(phi)
        )
        want = np.maximum.reduce(
            [
                spread,
                MOVED * np.abs(mean - outcome.region.centre),
                outcome.errors,
                NARROW * self.box,
            ]
        )
        limited = np.clip(want, width / SHRINK, np.minimum(GROW * width, FIRST * self.box))
        return _Region(mean, np.maximum(limited, NARROW * self.box), outcome.region.coarse)

    def _still(self, outcome: _Outcome) -> bool:
        """Whether the mean moved by less than a fiftieth of its spread or a tenth of its standard
        error.
        """
        phi = outcome.phi[: len(self.family.unknowns)]
        move = np.abs(self.family.mean(phi) - outcome.region.centre)
        return bool(
            np.all(
                move
                < np.maximum.reduce(
                    [0.02 * self.family.sd(phi), 0.1 * outcome.errors, 0.05 * NARROW * self.box]
                )
            )
        )

    def _stalled(self, done: list[_Outcome]) -> bool:
        values = [outcome.value for outcome in done if not outcome.region.coarse]
        return len(values) > STALLED and max(values[-STALLED:]) <= max(values[:-STALLED])
