"""Lambda chosen on data held out: the table, the rule, what it gains, and refusals."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dropo.core.records.fits.fit import Status
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.estimators.dropo import DROPO
from dropo.estimators.support.segment_length import ChooseHorizon, choose, split
from dropo.problems.simulated.slide import MEAN, slide
from tests.reference.pushes import pushes, z_of_mean

NOISY = 4e-4  # variance on every measurement


def measured_pushes(seed=0, noise=NOISY):
    """12 pushes of one block, where the same noisy measurement ends a transition and starts the
    next, as in any log.
    """
    clean = pushes(seed, sd=0.0, noise=0.0, count=12)
    data = clean.trajectories
    rng = np.random.default_rng(seed + 100)
    after = data.next_observations + np.sqrt(noise) * rng.standard_normal(
        data.next_observations.shape
    )
    before = np.vstack([data.observations[:1], after[:-1]])
    before[::20] = np.sqrt(noise) * rng.standard_normal((12, 2))
    return replace(clean, trajectories=replace(data, observations=before, next_observations=after))


@cache
def chosen():
    return ChooseHorizon(DROPO()).fit(measured_pushes())


def test_longer_segments_win_where_starts_are_noisy():
    """With noise on every measurement it takes more than one step, and then means are right that
    one step gets wrong by 5 errors.
    """
    fit = chosen()
    one = DROPO(likelihood="emulated").fit(measured_pushes())
    table = fit.horizon_choice.trials
    assert [row.horizon for row in table] == [1, 2, 5, 10, 20][: len(table)]
    taken = next(row for row in table if row.chosen)
    assert taken.horizon > 1
    assert (fit.mean_se < 0.7 * one.mean_se).all()
    assert (np.abs(z_of_mean(fit, MEAN)) < 4.5).all(), str(fit)
    assert f"lambda = {taken.horizon} predicts held-out data best" in fit.message


def test_the_fit_is_that_of_the_lambda_on_all_data():
    """Found by the same method on everything; the log-likelihood within 0.01 nat."""
    table = chosen().horizon_choice.trials
    length = next(row.horizon for row in table if row.chosen)
    again = DROPO().fit(measured_pushes().using(horizon=length))
    assert chosen().log_likelihood == pytest.approx(again.log_likelihood, abs=0.01)
    assert chosen().transitions == again.transitions


def test_clean_data_lose_nothing():
    """Without noise the means are still right to a millionth."""
    fit = ChooseHorizon(DROPO(family="point")).fit(
        pushes(1, sd=0.0, noise=0.0, count=9, epsilon=1e-8)
    )
    np.testing.assert_allclose(fit.mean, MEAN, rtol=1e-6)


def test_close_scores_are_settled_by_standard_errors():
    """Within one paired standard error the smaller errors are taken; beyond it the better score."""
    base = DROPO().fit(slide())
    scores = np.random.default_rng(0).normal(0, 10, 8)
    made = lambda n, gain, se: type(
        "C",
        (),
        {"horizon": n, "scores": scores + gain, "fit": replace(base, mean_se=np.full(2, se))},
    )()
    wobble = np.array([1.0, -1.0] * 4)
    sure = made(1, 0.0, 0.02)
    near = made(2, -0.1 + wobble, 0.01)
    far = made(5, -2.0 + 0.1 * wobble, 0.001)
    assert choose([sure, near, far])[0] is near
    assert choose([sure, far])[0] is sure
    rows = choose([sure, near, far])[1].trials
    assert [row.chosen for row in rows] == [False, True, False]
    assert rows[2].below_best == pytest.approx(16.0, abs=1e-9)


def test_what_is_held_out():
    """The problem's own data; every third trajectory; the last third of one or two."""
    problem = slide()
    own = replace(problem, held_out=problem.trajectories.select([0]))
    assert split(own) == (own, own.held_out)
    training, unseen = split(problem)
    assert (len(training.trajectories.spans), len(unseen.spans)) == (34, 16)
    single = replace(problem, trajectories=problem.trajectories.select([3, 4]))
    training, unseen = split(single)
    assert (len(training.trajectories), len(unseen)) == (26, 14)
    np.testing.assert_array_equal(unseen.observations[0], single.trajectories.observations[13])


def test_an_interrupted_choice_goes_on_from_its_evaluation_log(tmp_path):
    """Its best so far says what it is; taken up again it ends as one that was left alone."""

    def interrupt(share, text):
        if text.startswith("lambda 2: round 2"):
            raise KeyboardInterrupt

    stopped = ChooseHorizon(DROPO()).fit(
        measured_pushes(), evaluation_log=EvaluationLog(tmp_path / "j", {}), progress=interrupt
    )
    assert stopped.status is Status.INTERRUPTED
    assert (
        stopped.warnings[-1]
        == "interrupted while lambda was chosen: this is lambda = 2 on a part of the data"
    )
    again = ChooseHorizon(DROPO()).fit(
        measured_pushes(), evaluation_log=EvaluationLog(tmp_path / "j", {})
    )
    assert {**again.to_json(), "wall_time_s": 0} == {**chosen().to_json(), "wall_time_s": 0}


def test_refusals():
    with pytest.raises(
        BadArgument,
        match=r"No lambda of \(1, 2\) leaves 10 segments to fit and 10 to hold out\. Give lambda\.",
    ):
        ChooseHorizon(DROPO(), (1, 2)).fit(pushes(0, count=1, epsilon=1e-6).using(transitions=12))
    with pytest.raises(Incompatible, match="There is no lambda to choose with `reset: start`"):
        ChooseHorizon(DROPO()).fit(replace(slide(), reset="start"))
    with pytest.raises(
        BadArgument, match="The 'lengths' of ChooseHorizon must be whole numbers of at least 1"
    ):
        ChooseHorizon(DROPO(), (0, 1))
