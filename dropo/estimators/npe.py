"""Neural posterior estimation, as in BayesSim: a network learns parameters from simulations."""

from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from typing import Any, Literal

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.prior import LogPrior
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.fits.search_records import NeuralPosterior
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.isolated_torch import isolated_torch
from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import Array, known, require
from dropo.estimators.support.distribution_fit import point_likelihood, posterior_fit
from dropo.estimators.support.posterior_targets import PointLikelihood

DENSITIES = ("mdn", "maf", "nsf")
SUMMARIES = ("slopes", "moments")

Summarize = Callable[[Array], Array]
"""From predictions or measurements (K, R, p) to summaries (K, n)."""


@dataclass(frozen=True)
class RoundSettings:
    """What decides how each round learns, and how the box of the next one is cut.

    Attributes
    ----------
    margin : float
        The next box extends beyond the draws by this fraction of their own range, and by `edge`.
    edge : float
        The next box extends further by this fraction of the box before.
    settled : float
        A round whose draws leave more than this fraction of every side of its box ends the search.
    step : float
        Half width of the differences behind the slopes, as a fraction of the box.
    minimum_simulations : int
        So many simulations of a round must not diverge.
    batch : int
        Parameter vectors that are simulated at once: all rows of all signals are kept.
    learning_rate : float
        Step of the optimizer that trains the network: small networks take six times what sbi gives
        large ones.
    proposals : int
        So many times as many draws as are wanted are taken of a network at most, to find as many
        inside the box.
    """

    margin: float = 0.25
    edge: float = 0.01
    settled: float = 0.8
    step: float = 0.01
    minimum_simulations: int = 50
    batch: int = 50
    learning_rate: float = 3e-3
    proposals: int = 100


DEFAULTS = RoundSettings()


@dataclass(frozen=True, kw_only=True)
class NPE(Estimator):
    """Learn the posterior of parameters that are the same in all rows, without a likelihood.

    Parameters are drawn from the box, the segments simulated with noise of variance epsilon, and a
    network learns the distribution of the parameters given a summary of the simulations. Asked at
    the measured data, it gives draws. One round from a wide box says little: each takes the box
    around the draws of the one before, its prior cut to where the posterior is [2]_, until a round
    cuts nothing. The problem's priors weight the draws.

    Attributes
    ----------
    density : {"mdn", "maf", "nsf"}
        "mdn": the mixture of Gaussians of BayesSim [1]_; "maf": a masked autoregressive flow;
        "nsf": a neural spline flow (package sbi; extra `sbi`).
    summary : {"slopes", "moments"}
        "slopes": the residuals projected on the simulator's slopes in the middle of the box, a
        number for each parameter, which loses nothing if the simulator is linear. "moments": as in
        BayesSim, each signal's mean and variance, and its products with the actions, of the
        residuals from the box's middle.
    simulations : int
        In each round; at least 50.
    rounds : int
        At most.
    draws : int
        Of the posterior, at least 100, kept in `search_record.draws`.
    epsilon : float or tuple of float, optional
        The noise variance, one or for each signal [signal unit^2]. None: the problem's own, else
        what least squares leaves.
    settings : RoundSettings

    Raises
    ------
    MissingPackage
        If torch or sbi is missing.
    UnknownName
        If there is no such `density` or `summary`.
    BadArgument
        If `simulations` is below 50, `rounds` below 1, or `draws` below 100.

    References
    ----------
    .. [1] Ramos, Possas, Fox, "BayesSim: adaptive domain randomization via probabilistic inference
       for robotics simulators", 2019, arXiv:1906.01728.
    .. [2] Deistler et al., "Truncated proposals for scalable and hassle-free simulation-based
       inference", 2022, arXiv:2210.04815.
    """

    density: str = "mdn"
    summary: Literal["slopes", "moments"] = "slopes"
    simulations: int = 500
    rounds: int = 8
    draws: int = 1000
    epsilon: float | tuple[float, ...] | None = None
    settings: RoundSettings = field(default_factory=RoundSettings)
    name = "npe"
    uses_priors = True

    def __post_init__(self) -> None:
        need("torch", "sbi", extra="sbi", caller="Method 'npe'")
        known("density", self.density, DENSITIES)
        known("summary", self.summary, SUMMARIES)
        require(self.simulations >= 50, "simulations", "at least 50", self.simulations, "NPE")
        counts = (self.rounds, self.draws)
        enough = self.rounds >= 1 and self.draws >= 100
        require(enough, "rounds, draws", "at least 1 and 100", counts, "NPE")

    def _fit(self, problem: Problem, run: Run) -> Fit:
        """Cut the box round by round to where the posterior is."""
        d = len(problem.space)
        target = point_likelihood(problem, run, self.name, self.epsilon)
        boxes = [np.stack([np.zeros(d), np.ones(d)])]
        settled = False
        for done in range(1, self.rounds + 1):
            box = boxes[-1]
            low, high = box
            draws = low + (high - low) * self._round(problem, run, target, box)
            draws = _resample(problem, draws, run.rng.spawn(1)[0])
            text = f"round {done}, box of {np.prod(high - low):.3g} of the first"
            run.progress(done / self.rounds, text)

            cut = _box_around(draws, box, self.settings)
            settled = bool(((cut[1] - cut[0]) / (high - low) > self.settings.settled).all())
            if settled:
                break
            boxes.append(cut)

        end = "each cut the box: take more of them, or more simulations"
        if settled:
            end = "the last one cut nothing"
        parameters = problem.space.from_unit(draws)
        bounds = problem.space.from_unit(np.array(boxes[:done]))
        return posterior_fit(
            problem,
            run,
            self.name,
            parameters,
            target,
            status=Status.CONVERGED if settled else Status.OUT_OF_BUDGET,
            message=f"{done} rounds of {self.simulations} simulations; {end}.",
            search_record=NeuralPosterior(parameters, bounds, self.density, self.summary),
        )

    def _round(self, problem: Problem, run: Run, target: PointLikelihood, box: Array) -> Array:
        """Draws (K, d) of the posterior, in coordinates of the box (2, d)."""
        low, high = box
        rng = run.rng.spawn(1)[0]
        seed = int(run.rng.integers(2**63))
        if self.summary == "slopes":
            summarize = _summarize_by_slopes(problem, run, target, box, self.settings.step)
        else:
            summarize = _summarize_by_moments(problem, run, box)
        noise = np.sqrt(target.epsilon(np.zeros(len(problem.space))))

        def simulate(points: Array) -> Array:
            summaries = []
            for part in np.array_split(points, -(-len(points) // self.settings.batch)):
                values = problem.space.from_unit(part)
                predictions = problem.simulator.predict(values, problem.segments)
                errors = noise * rng.standard_normal(predictions.shape)
                summaries.append(summarize(predictions + errors))
            return np.concatenate(summaries)

        points = rng.random((self.simulations, len(problem.space)))
        summaries = run.evaluate(low + (high - low) * points, simulate)
        finite = np.isfinite(summaries).all(axis=1)
        if finite.sum() < self.settings.minimum_simulations:
            raise SimulationFailed(
                f"Only {finite.sum()} of {len(points)} simulations did not diverge: narrow the"
                " bounds."
            )
        observed = summarize(target.targets[None])[0]
        return learn(
            points[finite],
            summaries[finite],
            observed,
            self.density,
            self.draws,
            seed,
            self.settings,
        )


def learn(
    points: Array,
    summaries: Array,
    observed: Array,
    density: str,
    draws: int,
    seed: int,
    settings: RoundSettings = DEFAULTS,
) -> Array:
    """Learn the distribution of points given a summary, and draw from it.

    Parameters
    ----------
    points : (K, d) array
        Of the unit box, drawn uniformly.
    summaries : (K, n) array
        Of the simulations at these points.
    observed : (n,) array
        Summary of the measurements.
    density : str
        The name of the network.
    draws : int
        How many.
    seed : int
        Of torch.
    settings : RoundSettings

    Returns
    -------
    (draws, d) array
        Points given the observed summary.
    """
    import torch
    from sbi.inference import NPE as Trainer
    from sbi.utils import BoxUniform

    centre = summaries.mean(axis=0)
    size = summaries.std(axis=0) + 1e-300
    d = points.shape[1]

    def single(array: Array) -> Any:
        return torch.as_tensor(array, dtype=torch.float32)

    with isolated_torch(seed):
        prior = BoxUniform(torch.zeros(d), torch.ones(d))
        trainer = Trainer(
            prior, density_estimator=density, show_progress_bars=False, tracker=_Silent()
        )
        with redirect_stdout(StringIO()):  # sbi prints when it is done
            trainer.append_simulations(single(points), single((summaries - centre) / size))
            network = trainer.train(learning_rate=settings.learning_rate)
        condition = single((observed - centre) / size)[None]

        def propose() -> Array:
            with torch.no_grad():
                found = network.sample((draws,), condition=condition)[:, 0]
            return np.asarray(found.numpy(), dtype=float)

        return _in_box(propose, settings)


def _in_box(propose: Callable[[], Array], settings: RoundSettings) -> Array:
    """As many draws inside the unit box as are proposed (K, d) at a time.

    Where hardly any are inside, as the data ask for parameters outside of the box, the rest are
    brought to its edge: waiting for them would have no end.
    """
    inside: list[Array] = []
    for _ in range(settings.proposals):
        proposed = propose()
        inside.append(proposed[((proposed >= 0) & (proposed <= 1)).all(axis=1)])
        if sum(map(len, inside)) >= len(proposed):
            break
    kept = np.concatenate([*inside, np.clip(proposed, 0.0, 1.0)])
    return kept[: len(proposed)]


class _Silent:
    """Keeps none of the training's figures; otherwise sbi writes them into the present folder."""

    log_dir = None

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments, **more: None


def _resample(problem: Problem, draws: Array, rng: np.random.Generator) -> Array:
    """The draws (K, d) of the unit box, drawn again by the problem's priors if it has some."""
    if not problem.priors:
        return draws
    logarithms = LogPrior(problem.priors, problem.space)(problem.space.from_unit(draws))
    weights = np.exp(logarithms - logarithms.max())
    return draws[rng.choice(len(draws), len(draws), p=weights / weights.sum())]


def _box_around(draws: Array, box: Array, settings: RoundSettings) -> Array:
    """The box (2, d) around draws (K, d), inside the one before."""
    low = draws.min(axis=0)
    high = draws.max(axis=0)
    margin = settings.margin * (high - low) + settings.edge * (box[1] - box[0])
    return np.stack([np.maximum(box[0], low - margin), np.minimum(box[1], high + margin)])


def _middle(problem: Problem, box: Array) -> Array:
    """(d,) parameters in the middle of a box of the unit box."""
    return problem.space.from_unit(box.mean(axis=0))


def _summarize_by_slopes(
    problem: Problem, run: Run, target: PointLikelihood, box: Array, step: float
) -> Summarize:
    """(J' W J)^-1 J' W r of residuals r from the middle, W = diag(1 / epsilon).

    In linear models this is the estimate of least squares.
    """
    low, high = problem.space.from_unit(box)
    width = high - low
    d = len(problem.space)
    with run.counting(evaluations=1):
        middle, jacobian = problem.simulator.linearize(
            _middle(problem, box), problem.segments, step=step * width
        )
    sd = np.sqrt(np.maximum(target.epsilon(np.zeros(d)), 1e-300))
    whitened = (jacobian * width / sd[:, None]).reshape(-1, d)
    project = np.linalg.pinv(whitened, rcond=1e-12)
    return lambda rows: ((rows - middle) / sd).reshape(len(rows), -1) @ project.T


def _summarize_by_moments(problem: Problem, run: Run, box: Array) -> Summarize:
    """Mean and variance of each signal's residuals, and their mean products with the actions."""
    with run.counting(evaluations=1):
        middle = problem.simulator.predict(_middle(problem, box)[None], problem.segments)[0]
    segment, step = problem.segments.rows
    actions = problem.trajectories.actions[problem.segments.steps[segment, step]]  # (R, q)

    def summarize(rows: Array) -> Array:
        residuals = rows - middle
        products = np.einsum("krp,rq->kpq", residuals, actions) / len(actions)
        parts = [residuals.mean(axis=1), residuals.var(axis=1), products.reshape(len(rows), -1)]
        return np.concatenate(parts, axis=1)

    return summarize
