"""Fitting with a local likelihood: build it, maximise it, move it to where its maximum was, until nothing moves."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.checks import Array
from dropo.core.errors import SimulationFailed
from dropo.core.estimator import Run
from dropo.core.family import Family
from dropo.core.fisher_scoring import maximise_locally
from dropo.core.fit import Status
from dropo.core.journal import Journal
from dropo.core.likelihood import Epsilon, LocalLikelihood, LocalLogLikelihood
from dropo.core.optimizer import Optimizer
from dropo.core.problem import Problem
from dropo.core.search import SearchResult, maximise

FIRST, COARSE, LEAST = 1 / 6, 5, 200  # first width as a share of the box; every 5th segment at first, where 200 remain
MOVED, SETTLED = 0.7, 0.15  # a width follows 0.7 of the last move; rounds end when widths change by less than 15 %
NARROW = 2e-4  # the least width, as a share of the box


@dataclass
class _Region:
    """Where the local model is built: centre and width (d,)."""

    centre: Array
    width: Array


def fit_in_rounds(
    problem: Problem, run: Run, family: Family, likelihood: LocalLikelihood, epsilon: Epsilon, rng: np.random.Generator,
    make_optimizer: Callable[[int, Array], Optimizer] | None, start: Array, rounds: int = 25,
) -> tuple[LocalLogLikelihood, SearchResult]:  # fmt: skip
    """The likelihood built around its own maximum, and that maximum. make_optimizer: None for Fisher scoring, else
    a function of (dimension, start) to an Optimizer."""
    space = problem.space
    box = space.high - space.low
    region = _Region(start.copy(), FIRST * box)
    coarse = np.arange(len(problem.segments)) % COARSE == 0
    thin = coarse.sum() >= LEAST and len(problem.segments.levels) == 1
    design = rng.spawn(1)[0].bit_generator.seed_seq  # type: ignore[attr-defined]  # one scramble for all rounds, so that they can settle
    phi, local, value = None, None, -np.inf
    try:
        for count in range(1, rounds + 1):
            segments = problem.segments.take(coarse) if thin else problem.segments
            local, region = _build(problem, run, family, likelihood, epsilon, region, segments, design)
            phi = _maximise(local, _first(family, local, region, phi), make_optimizer, run)
            value = local(phi)
            run.progress(min(0.95, count / 8), f"round {count}, log-likelihood {value:.6g}")
            move, settled = _move(family, region, phi, box)
            small = np.all(np.abs(move) < np.maximum.reduce([0.02 * family.sd(phi[: len(family.unknowns)]), 0.1 * _errors(family, local, phi), 1e-2 * NARROW * box]))
            if not thin and settled and small:
                return local, SearchResult(phi, value, run.evaluations, f"The estimate stopped moving after {count} rounds.", Status.CONVERGED)
            if thin and (settled or count >= 3):
                thin = False
        reason = f"The estimate still moved after {rounds} rounds: raise the budget, or look at parameters that the data cannot tell."
        status = Status.OUT_OF_BUDGET
    except KeyboardInterrupt:
        if phi is None or local is None:
            raise
        reason, status = "Interrupted: this is the best so far.", Status.INTERRUPTED
    assert local is not None and phi is not None
    return local, SearchResult(phi, value, run.evaluations, reason, status)


def _build(problem, run, family, likelihood, epsilon, region, segments, design):  # type: ignore[no-untyped-def]
    """The local likelihood; where a design's simulations diverge, on half the width, up to five times."""
    for attempt in range(6):
        try:
            with run.counting(evaluations=1):
                return likelihood.around(problem.simulator, segments, family, epsilon, region.centre, region.width, np.random.default_rng(design)), region
        except SimulationFailed:
            if attempt == 5:
                raise
            region = _Region(region.centre, region.width / 2)
    raise AssertionError


def _first(family: Family, local: LocalLogLikelihood, region: _Region, phi: Array | None) -> Array:
    """Where the inner search begins: the last maximum, its scales not below a twentieth of the width."""
    unknowns = local.unknowns
    start = np.array(unknowns.from_unit(np.full(len(unknowns), 0.5)) if phi is None else phi)
    for name, c, h in zip(family.space.names, region.centre, region.width, strict=True):
        start[unknowns.names.index(f"mean.{name}")] = c
        if f"scale.{name}" in unknowns.names:
            relative = h / c if family.logarithmic else h
            i = unknowns.names.index(f"scale.{name}")
            start[i] = relative / 2 if phi is None else max(start[i], 0.05 * relative)
    if phi is None:  # the noise is below the misfit at the middle of the box
        start[len(family.unknowns) :] = 0.1
    return np.clip(start, unknowns.low, unknowns.high)


def _maximise(local: LocalLogLikelihood, start: Array, make_optimizer, run: Run) -> Array:  # type: ignore[no-untyped-def]
    if make_optimizer is None:
        return maximise_locally(local, start).phi
    optimizer: Optimizer = make_optimizer(len(start), np.clip(local.unknowns.to_unit(start), 0.0, 1.0))
    inside = replace(run, journal=Journal(), progress=lambda share, text: None)
    return maximise(local, local.unknowns, optimizer, inside).point


def _errors(family: Family, local: LocalLogLikelihood, phi: Array) -> Array:
    """(d,) the means' standard errors by the Fisher information, as far as the data tell them."""
    d = len(family.space)
    information = local.expand(phi)[2][:d, :d]
    return np.sqrt(np.abs(np.diagonal(np.linalg.pinv(information, hermitian=True))))


def _move(family: Family, region: _Region, phi: Array, box: Array) -> tuple[Array, bool]:
    """Moves the region to the maximum; the move (d,), and whether its widths have settled."""
    n = len(family.unknowns)
    mean, sd = family.mean(phi[:n]), family.sd(phi[:n])
    spread = np.maximum(family.scale(phi[:n]) * (mean if family.logarithmic else 1.0), sd)
    move = mean - region.centre
    want = np.maximum.reduce([spread, MOVED * np.abs(move), NARROW * box])
    width = np.clip(want, np.maximum(region.width / 20, NARROW * box), 2 * region.width)
    settled = bool(np.all(np.abs(width / region.width - 1) < SETTLED))
    region.centre, region.width = mean.copy(), width
    return move, settled
