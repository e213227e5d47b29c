"""Next data: what ranks first really shrinks the standard error most."""

import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, UnknownName
from dropo.estimators.least_squares import LeastSquares
from dropo.evaluation.next_data import rank_next
from dropo.simulators.toy import SlidingBlock, simulate

TRUTH = np.array([1.5, 0.8])
NOISE = 1e-4


def pushed(forces, seed=0):
    """One trajectory for each row of forces (E, T)."""
    rng = np.random.default_rng(seed)
    values = np.tile(TRUTH, (len(forces), 1))
    return simulate(
        SlidingBlock(),
        values,
        np.asarray(forces)[:, :, None],
        np.zeros(2),
        noise_variance=NOISE,
        rng=rng,
    )


def together(one, other):
    """Both data sets as one."""
    join = lambda name: np.concatenate([getattr(one, name), getattr(other, name)])
    return Trajectories(
        join("observations"), join("actions"), join("next_observations"), join("terminals")
    )


@pytest.fixture(scope="module")
def known():
    problem = Problem(
        "block", SlidingBlock(), pushed(np.random.default_rng(1).normal(0, 4, (25, 20)))
    )
    return problem, LeastSquares().fit(problem)


CANDIDATES = np.stack(
    [np.full(200, 0.2), np.full(200, 2.0), 2.0 * np.sign(np.sin(np.arange(200))), np.zeros(200)]
)


@pytest.mark.parametrize("about", [["mass"], ["damping"], None])
def test_the_first_one_shrinks_the_error_most(known, about):
    """Data are simulated for each candidate and fitted with what was known: the first and the last
    in the ranking are those with the least and the largest plain errors.
    """
    problem, fit = known
    ranked = rank_next(
        problem, fit, [(np.zeros(2), forces[:, None]) for forces in CANDIDATES], about
    )
    assert sorted(r.index for r in ranked) == [0, 1, 2, 3]
    entropies = []
    for forces in CANDIDATES:
        more = Problem(
            "more", problem.simulator, together(problem.trajectories, pushed(forces[None], 3))
        )
        _, jacobian = problem.simulator.linearize(LeastSquares().fit(more).mean, more.segments)
        covariance = NOISE * np.linalg.inv(np.einsum("rpd,rpe->de", jacobian, jacobian))
        chosen = [problem.space.names.index(name) for name in about or problem.space.names]
        entropies.append(np.linalg.slogdet(covariance[np.ix_(chosen, chosen)])[1])
    assert ranked[0].index == int(np.argmin(entropies))
    assert ranked[-1].index == int(np.argmax(entropies))
    assert ranked[-1].gain < ranked[0].gain / 2


def test_mass_and_damping_want_other_pushes(known):
    """Fast changes tell the mass, a long push the damping: a ranking that ignores `about` cannot
    give both.
    """
    problem, fit = known
    candidates = [(np.zeros(2), forces[:, None]) for forces in CANDIDATES]
    first = {
        name: rank_next(problem, fit, candidates, [name])[0].index for name in ("mass", "damping")
    }
    assert first["mass"] != first["damping"]


def test_given_trajectories_are_ranked_as_commands_are(known):
    """The measured trajectories of the same pushes: the same first one."""
    problem, fit = known
    ranked = rank_next(problem, fit, [pushed(forces[None], 4) for forces in CANDIDATES])
    commands = rank_next(problem, fit, [(np.zeros(2), forces[:, None]) for forces in CANDIDATES])
    assert ranked[0].index == commands[0].index
    assert ranked[0].standard_errors == pytest.approx(commands[0].standard_errors, rel=0.1)


def test_refusals(known):
    with pytest.raises(BadArgument, match="'candidates' of rank_next must be at least one"):
        rank_next(*known, [])
    with pytest.raises(UnknownName, match="No parameter called 'weight'"):
        rank_next(*known, [known[0].trajectories], ["weight"])
    with pytest.raises(BadArgument, match="'start' of rank_next must be of shape"):
        rank_next(*known, [(np.zeros(3), np.zeros((5, 1)))])
