"""Neural posterior estimation, as in BayesSim: a network that learned from simulations which
parameters go with which data.
"""

from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from typing import Any, Literal

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.prior import LogPrior
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit, Status
from dropo.core.records.search_records import NeuralPosterior
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.isolated_torch import isolated_torch
from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import Array, known, require
from dropo.estimators.support.distribution_fit import point_likelihood, posterior_fit
from dropo.estimators.support.posterior_targets import PointLikelihood

DENSITIES = ("mdn", "maf", "nsf")
SUMMARIES = ("slopes", "moments")
MARGIN = 0.25  # a box reaches so much of the draws' own range beyond them
STEP = 0.01  # half width of the differences behind the slopes, as a share of the box
SETTLED = (
    0.8  # a round whose draws leave more of every side of its box than this has nothing left to cut
)
EDGE = 0.01  # of a side of the box
RATE = 3e-3  # of learning: networks this small take six times what sbi gives large ones

Summarise = Callable[[Array], Array]  # predictions or measurements (K, R, p) -> (K, n)


@dataclass(frozen=True, kw_only=True)
class NPE(Estimator):
    """The posterior of parameters that are the same in all rows, learned from simulations without a
    likelihood (Ramos et al. 2019).

    Parameters are drawn from the box, the segments simulated with noise of variance epsilon, and
    `density` learns the law of the parameters given a summary of what came out: "mdn", the mixture
    of Gaussians of BayesSim (Ramos, Possas, Fox 2019, arXiv:1906.01728); "maf", a masked
    autoregressive flow; "nsf", a neural spline flow (package sbi; extra `sbi`). Asked at the
    measured data, it gives draws.
    One round from a wide box tells little: each of `rounds` takes the box around the draws of the
    one before, its prior cut to where the posterior is (Deistler et al. 2022, arXiv:2210.04815),
    until a round cuts nothing. simulations: in each round.
    summary: "slopes", the residuals projected on the simulator's slopes in the middle of the box, a
    number for each parameter, which loses nothing where the simulator is linear; "moments", as in
    BayesSim: each signal's mean and variance, and its products with the actions, of the residuals
    from the box's middle. draws: of the posterior, kept in `search_record.draws`; the problem's
    priors weigh them. epsilon: the noise variance, one or for each signal; None, the problem's own,
    else what least squares leaves.
    """

    density: str = "mdn"
    summary: Literal["slopes", "moments"] = "slopes"
    simulations: int = 500
    rounds: int = 8
    draws: int = 1000
    epsilon: float | tuple[float, ...] | None = None
    name = "npe"

    def __post_init__(self) -> None:
        need("torch", "sbi", extra="sbi", caller="Method 'npe'")
        known("density", self.density, DENSITIES)
        known("summary", self.summary, SUMMARIES)
        require(self.simulations >= 50, "simulations", "at least 50", self.simulations, "NPE")
        require(
            min(self.rounds, self.draws - 99) >= 1,
            "rounds, draws",
            "at least 1 and 100",
            (self.rounds, self.draws),
            "NPE",
        )

    def _fit(self, problem: Problem, run: Run) -> Fit:
        target = point_likelihood(problem, run, self.name, self.epsilon)
        boxes = [_whole(problem)]
        settled = False
        for done in range(self.rounds):
            low, high = boxes[-1]
            draws = _weighed(
                problem,
                low + (high - low) * self._round(problem, run, target, boxes[-1]),
                run.rng.spawn(1)[0],
            )
            run.progress(
                (done + 1) / self.rounds,
                f"round {done + 1}, box of {np.prod(high - low):.3g} of the first",
            )
            cut = _around(draws, boxes[-1])
            settled = bool(((cut[1] - cut[0]) / (high - low) > SETTLED).all())
            if settled:
                break
            boxes.append(cut)
        end = (
            "the last one cut nothing"
            if settled
            else "each cut the box: take more of them, or more simulations"
        )
        parameters = problem.space.from_unit(draws)
        bounds = problem.space.from_unit(np.array(boxes[: done + 1]))
        return posterior_fit(
            problem,
            run,
            self.name,
            parameters,
            target,
            status=Status.CONVERGED if settled else Status.OUT_OF_BUDGET,
            message=f"{done + 1} rounds of {self.simulations} simulations; {end}.",
            search_record=NeuralPosterior(parameters, bounds, self.density, self.summary),
        )

    def _round(self, problem: Problem, run: Run, target: PointLikelihood, box: Array) -> Array:
        """Draws (K, d) of the posterior, in coordinates of the box (2, d)."""
        low, high = box
        rng = run.rng.spawn(1)[0]
        seed = int(run.rng.integers(2**63))
        summarize = (
            _slopes(problem, run, target, box)
            if self.summary == "slopes"
            else _moments(problem, run, box)
        )
        noise = np.sqrt(target.epsilon(np.zeros(len(problem.space))))

        def simulate(points: Array) -> Array:
            out = []
            for part in np.array_split(
                points, -(-len(points) // 50)
            ):  # few at once: all rows of all signals are kept
                predictions = problem.simulator.predict(
                    problem.space.from_unit(part), problem.segments
                )
                out.append(summarize(predictions + noise * rng.standard_normal(predictions.shape)))
            return np.concatenate(out)

        points = rng.random((self.simulations, len(problem.space)))
        summaries = run.evaluate(low + (high - low) * points, simulate)
        good = np.isfinite(summaries).all(axis=1)
        if good.sum() < 50:
            raise SimulationFailed(
                f"Only {good.sum()} of {len(points)} simulations did not diverge: narrow "
                "the bounds."
            )
        return learn(
            points[good],
            summaries[good],
            summarize(target.targets[None])[0],
            self.density,
            self.draws,
            seed,
        )


def learn(
    points: Array, summaries: Array, observed: Array, density: str, draws: int, seed: int
) -> Array:
    """Draws of the points given the summary that was observed (n,), from points (K, d) of the unit
    box and their summaries (K, n).
    """
    import torch
    from sbi.inference import NPE as Trainer
    from sbi.utils import BoxUniform

    centre = summaries.mean(axis=0)
    size = summaries.std(axis=0) + 1e-300
    single: Callable[[Array], Any] = lambda array: torch.as_tensor(array, dtype=torch.float32)
    d = points.shape[1]
    with isolated_torch(seed):
        prior = BoxUniform(torch.zeros(d), torch.ones(d))
        trainer = Trainer(
            prior, density_estimator=density, show_progress_bars=False, tracker=_Silent()
        )
        with redirect_stdout(StringIO()):  # sbi prints when it is done
            network = trainer.append_simulations(
                single(points), single((summaries - centre) / size)
            ).train(learning_rate=RATE)
        found = trainer.build_posterior(network).sample(
            (draws,), x=single((observed - centre) / size), show_progress_bars=False
        )
    return np.asarray(found.numpy(), dtype=float)


class _Silent:
    """Keeps none of the training's figures; sbi else writes them into the present folder."""

    log_dir = None

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments, **more: None


def _weighed(problem: Problem, draws: Array, rng: np.random.Generator) -> Array:
    """The draws (K, d) of the unit box, drawn again by the problem's priors where it has some."""
    if not problem.priors:
        return draws
    logarithms = LogPrior(problem.priors, problem.space)(problem.space.from_unit(draws))
    weights = np.exp(logarithms - logarithms.max())
    return draws[rng.choice(len(draws), len(draws), p=weights / weights.sum())]


def _whole(problem: Problem) -> Array:
    return np.stack([np.zeros(len(problem.space)), np.ones(len(problem.space))])


def _around(draws: Array, box: Array) -> Array:
    """The box (2, d) around draws (K, d), inside the one before."""
    low = draws.min(axis=0)
    high = draws.max(axis=0)
    margin = MARGIN * (high - low) + EDGE * (box[1] - box[0])
    return np.stack([np.maximum(box[0], low - margin), np.minimum(box[1], high + margin)])


def _middle(problem: Problem, box: Array) -> Array:
    return problem.space.from_unit(box.mean(axis=0))


def _slopes(problem: Problem, run: Run, target: PointLikelihood, box: Array) -> Summarise:
    """(J' W J)^-1 J' W r of residuals r from the middle, W = diag(1 / epsilon): in linear models
    the estimate of least squares.
    """
    ends = problem.space.from_unit(box)
    with run.counting(evaluations=1):
        middle, jacobian = problem.simulator.linearize(
            _middle(problem, box), problem.segments, step=STEP * (ends[1] - ends[0])
        )
    variance = np.maximum(target.epsilon(np.zeros(len(problem.space))), 1e-300)
    white = (jacobian * (ends[1] - ends[0]) / np.sqrt(variance)[:, None]).reshape(
        -1, len(problem.space)
    )
    project = np.linalg.pinv(white, rcond=1e-12)
    return lambda rows: ((rows - middle) / np.sqrt(variance)).reshape(len(rows), -1) @ project.T


def _moments(problem: Problem, run: Run, box: Array) -> Summarise:
    """Of residuals from the middle: mean and variance of each signal, and its mean products with
    the actions of its rows.
    """
    with run.counting(evaluations=1):
        middle = problem.simulator.predict(_middle(problem, box)[None], problem.segments)[0]
    segment, step = problem.segments.rows
    actions = problem.trajectories.actions[problem.segments.steps[segment, step]]  # (R, q)

    def summarize(rows: Array) -> Array:
        residuals = rows - middle
        products = np.einsum("krp,rq->kpq", residuals, actions) / len(actions)
        return np.concatenate(
            [residuals.mean(axis=1), residuals.var(axis=1), products.reshape(len(rows), -1)], axis=1
        )

    return summarize
