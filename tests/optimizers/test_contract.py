"""All optimizers on textbook costs in the unit box, and what the search around them promises."""

import subprocess
import sys
import threading

import numpy as np
import pytest

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.optimizer import CallbackOptimizer, Optimizer
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.maximize import maximize
from dropo.core.records.fits.fit import Status
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.registry import find, names
from dropo.simulators.toy import LinearSimulator, simulate
from dropo.testing import check_optimizer
from dropo.testing.optimizers import drive

ALL = names("optimizers")
BUDGET_ENDS_IT = {"nlopt-crs2", "nlopt-direct-l"}


class Sphere:
    """|u - centre|^2 / width^2: its minimum is the centre."""

    def __init__(self, centre, width=1.0):
        self.centre = np.array(centre)
        self.width = width

    def __call__(self, u):
        return float(np.sum(((u - self.centre) / self.width) ** 2))

    def gradient(self, u):
        return 2 * (u - self.centre) / self.width**2


class Rosenbrock:
    """100 (y - x^2)^2 + (1 - x)^2 with x = -2 + 4 u_1, y = -2 + 4 u_2: the minimum (1, 1) is at u =
    (0.75, 0.75).
    """

    def __call__(self, u):
        x, y = -2 + 4 * u
        return 100 * (y - x**2) ** 2 + (1 - x) ** 2

    def gradient(self, u):
        x, y = -2 + 4 * u
        return 4 * np.array([-400 * x * (y - x**2) - 2 * (1 - x), 200 * (y - x**2)])


class Slope:
    """u_1 + (u_2 - 0.4)^2: falls to the bound u_1 = 0; its minimum is (0, 0.4)."""

    def __call__(self, u):
        return float(u[0] + (u[1] - 0.4) ** 2)

    def gradient(self, u):
        return np.array([1.0, 2 * (u[1] - 0.4)])


class Objective:
    """-cost over `SPACE`, counted; the failure rule makes some points NaN, others -inf."""

    has_gradients = True

    def __init__(self, cost, fails=lambda u: False, dies_after=None):
        self.cost = cost
        self.fails = fails
        self.dies_after = dies_after
        self.calls = 0

    def __call__(self, phi):
        if self.calls == self.dies_after:
            raise RuntimeError("killed")
        self.calls += 1
        u = SPACE.to_unit(phi)
        if self.fails(u):
            return np.nan if self.calls % 2 else -np.inf
        return -self.cost(u)

    def gradient(self, phi):
        u = SPACE.to_unit(phi)
        widths = np.array([4.0, np.log(100.0) * phi[1]])  # d phi / d u
        return np.full(2, np.nan) if self.fails(u) else -self.cost.gradient(u) / widths


SPACE = ParameterSpace((Parameter("a", -1.0, 3.0), Parameter("b", 0.1, 10.0, scale="log")))


def make(name, dimension=2, seed=1, budget=5000, **settings) -> Optimizer:
    return find("optimizers", name)(
        dimension, np.random.default_rng(seed), budget=budget, **settings
    )


def run(evaluation_log=None) -> Run:
    """A run around a problem that nothing simulates."""
    simulator = LinearSimulator(np.ones((1, 1, 1)))
    data = simulate(simulator, np.array([[1.0]]), np.ones((1, 3, 1)), np.zeros(1))
    return Run(
        Problem("none", simulator, data),
        np.random.default_rng(0),
        evaluation_log or EvaluationLog(),
    )


@pytest.mark.parametrize("name", ALL)
def test_keeps_the_contract(name):
    """Every built-in optimizer passes the checks that plug-in authors are given."""
    check_optimizer(find("optimizers", name))


COSTS = {
    "sphere": (Sphere([0.3, 0.6, 0.8]), [0.3, 0.6, 0.8]),
    "line": (Sphere([0.3]), [0.3]),
    "rosenbrock": (Rosenbrock(), [0.75, 0.75]),
    "bound": (Slope(), [0.0, 0.4]),
    "narrow": (Sphere([0.3, 0.6], width=1e-9), [0.3, 0.6]),
}


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("name", ALL)
def test_finds_the_minimum(name, cost):
    """Within 1e-6 of the box; SLSQP alone is not for gradients of 1e18."""
    if (name, cost) == ("nlopt-slsqp", "narrow"):
        pytest.skip("its first step is lost in rounding")
    function, minimum = COSTS[cost]
    optimizer = make(name, len(minimum), budget=3000)
    _, reason = drive(optimizer, function)
    assert np.abs(optimizer.best[0] - minimum).max() < 1e-6
    assert (reason is None) <= (name in BUDGET_ENDS_IT or name == "scipy-differential-evolution")


@pytest.mark.parametrize("name", ALL)
def test_start_and_step_are_used(name):
    """With a start beside the minimum and small steps a local method needs fewer evaluations, and a
    start is asked for.
    """
    optimizer = make(name, start=[0.75, 0.7], step=[0.01, 0.02])
    asked, _ = drive(optimizer, Rosenbrock(), batches=40)
    if name == "nlopt-direct-l":
        return  # begins in the middle always
    near = np.abs(asked - [0.75, 0.7]).max(axis=1)
    assert near.min() < 0.05


@pytest.mark.parametrize("name", ALL)
def test_search_survives_failed_points(name):
    """A corner whose simulations fail (NaN, -inf, gradients NaN) does not stop the search; the
    optimum lies beside it.
    """
    objective = Objective(Sphere([0.3, 0.25]), fails=lambda u: u.sum() < 0.5)
    found = maximize(objective, SPACE, make(name, budget=2000), run())
    assert np.abs(SPACE.to_unit(found.point) - [0.3, 0.25]).max() < 1e-3
    assert found.value == pytest.approx(objective(found.point), abs=1e-12)


@pytest.mark.parametrize("name", ALL)
def test_search_where_everything_fails(name):
    """Nothing is made up: the value is -inf."""
    found = maximize(Objective(Slope(), fails=lambda u: True), SPACE, make(name, budget=60), run())
    assert found.value == -np.inf


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("budget", [37, 100])
def test_budget_is_never_exceeded(name, budget):
    """Not even by a part of a batch; and a search that it cuts short says so."""
    objective = Objective(Rosenbrock())
    found = maximize(objective, SPACE, make(name, budget=budget), run())
    assert objective.calls == found.evaluations <= budget
    if found.status is Status.OUT_OF_BUDGET:
        assert f"budget of {budget} evaluations" in found.reason


def test_budget_smaller_than_a_batch_is_refused():
    with pytest.raises(
        BadArgument, match=r"'budget' of CMAES must be at least 6, the first batch\. Got 5"
    ):
        maximize(Objective(Slope()), SPACE, make("cma-es", budget=5), run())


@pytest.mark.parametrize("name", ALL)
def test_killed_search_resumes(name, tmp_path):
    """Killed in its 21st evaluation and taken up again: the same result as in one go, and nothing
    evaluated twice.
    """
    cost = Rosenbrock()
    path = tmp_path / "journal"
    whole = maximize(Objective(cost), SPACE, make(name, budget=200), run())
    with pytest.raises(RuntimeError, match="killed"):
        maximize(
            Objective(cost, dies_after=20), SPACE, make(name, budget=200), run(EvaluationLog(path))
        )
    recorded = sum(len(entry["points"]) for entry in EvaluationLog(path)._known)
    again = Objective(cost)
    resumed = maximize(again, SPACE, make(name, budget=200), run(EvaluationLog(path)))
    assert recorded >= 12
    assert again.calls == whole.evaluations - recorded
    assert np.array_equal(resumed.point, whole.point)
    assert (resumed.value, resumed.evaluations, resumed.reason) == (
        whole.value,
        whole.evaluations,
        whole.reason,
    )


@pytest.mark.parametrize("name", [n for n in ALL if find("optimizers", n).needs_gradients])
def test_gradients_are_asked_for_and_wrong_ones_harm(name):
    """An objective without gradients is refused with the way out; the control with its gradients
    reversed must fail.
    """
    with pytest.raises(
        Incompatible,
        match=r"needs gradients, and function gives none\. "
        r"Use likelihood 'emulated'.* such as 'cma-es'",
    ):
        maximize(lambda phi: 0.0, SPACE, make(name), run())

    class Reversed(Objective):
        def gradient(self, phi):
            return -super().gradient(phi)

    right = maximize(Objective(Rosenbrock()), SPACE, make(name), run())
    wrong = maximize(Reversed(Rosenbrock()), SPACE, make(name), run())
    assert np.abs(SPACE.to_unit(right.point) - 0.75).max() < 1e-5
    assert np.abs(SPACE.to_unit(wrong.point) - 0.75).max() > 0.1


@pytest.mark.parametrize("name", ALL)
def test_a_failing_objective_leaves_no_thread(name):
    before = threading.active_count()
    with pytest.raises(RuntimeError, match="killed"):
        maximize(Objective(Rosenbrock(), dies_after=11), SPACE, make(name, budget=300), run())
    assert threading.active_count() == before


@pytest.mark.parametrize("name", ALL)
def test_closed_optimizer_does_not_hang(name):
    optimizer = make(name)
    optimizer.stop()
    optimizer.ask()
    optimizer.close()
    if isinstance(optimizer, CallbackOptimizer):
        assert optimizer.stop() == "The optimizer was closed."


def test_an_error_in_a_minimiser_reaches_the_caller():
    class Broken(CallbackOptimizer):
        def _minimise(self, cost):
            cost(self.start)
            raise ZeroDivisionError("from the minimiser")

    optimizer = Broken(2, np.random.default_rng(0))
    optimizer.tell(optimizer.ask(), [1.0])
    with pytest.raises(ZeroDivisionError, match="from the minimiser"):
        optimizer.stop()


@pytest.mark.parametrize("reason", [None, "", 3, np.zeros(2)])
def test_a_minimiser_that_does_not_say_why_it_stopped_is_refused(reason):
    """Also where it gives what could be taken for a point; asked again, and after it was closed,
    it answers the same.
    """

    class Wordless(CallbackOptimizer):
        def _minimise(self, cost):
            cost(self.start)
            return reason

    optimizer = Wordless(2, np.random.default_rng(0))
    optimizer.tell(optimizer.ask(), [1.0])
    words = "Wordless._minimise must be a sentence that says why it stopped"
    for ending in (optimizer.stop, optimizer.ask, optimizer.close, optimizer.stop):
        if ending == optimizer.close:
            ending()
            continue
        with pytest.raises(BadArgument, match=words):
            ending()
    assert not optimizer._thread.is_alive()


def test_a_minimiser_that_swallows_exceptions_still_ends():
    class Stubborn(CallbackOptimizer):
        def _minimise(self, cost):
            for _ in range(5):
                try:
                    cost(self.start)
                except BaseException:  # what some libraries do
                    continue
            return "It went on to its end."

    optimizer = Stubborn(2, np.random.default_rng(0))
    optimizer.ask()
    optimizer.close()
    assert not optimizer._thread.is_alive()


@pytest.mark.parametrize("name", ["nlopt-crs2", "scipy-differential-evolution"])
def test_random_optimizers_use_their_rng(name):
    """Another seed asks for other points."""
    one = drive(make(name, seed=1), Rosenbrock(), batches=60)[0]
    other = drive(make(name, seed=2), Rosenbrock(), batches=60)[0]
    assert not np.array_equal(one, other)


def test_unusable_settings_are_refused():
    for settings, message in [
        ({"population": 2}, "'population' of CMAES must be at least 4"),
        ({"restarts": -1}, "'restarts' of CMAES"),
    ]:
        with pytest.raises(BadArgument, match=message):
            make("cma-es", **settings)
    with pytest.raises(
        BadArgument, match="'population' of DifferentialEvolution must be at least 5"
    ):
        make("scipy-differential-evolution", population=1)


def test_libraries_are_imported_late():
    """Importing the plug-ins imports neither pycma nor NLopt nor emcee."""
    modules = (
        "import dropo.optimizers.cma_es, dropo.optimizers.nlopt, dropo.optimizers.scipy, "
        "dropo.optimizers.samplers.emcee, sys"
    )
    heavy = "('cma', 'nlopt', 'emcee', 'matplotlib')"
    late = f"{modules}; print([m for m in {heavy} if m in sys.modules])"
    command = [sys.executable, "-c", late]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


class Outside(Optimizer):
    """Asks beyond the box, by as much as it is told."""

    beyond = 0.0

    def _ask(self):
        return np.full((1, self.dimension), 1.0 + self.beyond)

    def _tell(self, points, costs, gradients):
        pass

    def _stop(self):
        return None


def test_points_outside_the_box_are_refused():
    """Rounding is taken for the bound; more is the optimizer's mistake, as NaN is."""
    optimizer = Outside(2, np.random.default_rng(0))
    optimizer.beyond = 1e-12
    assert optimizer.ask().tolist() == [[1.0, 1.0]]
    for beyond, shown in ((0.3, r"\[1.3, 1.3\]"), (np.nan, "nan")):
        optimizer.beyond = beyond
        with pytest.raises(BadArgument, match=rf"inside the unit box \[0, 1\]. Got .*{shown}"):
            optimizer.ask()


class Wandering(CallbackOptimizer):
    """A minimiser that takes a step out of the box."""

    def _minimise(self, cost):
        cost(self.start)
        cost(self.start + 0.75)
        return "It went on to its end."


class AsksItself(Outside):
    """Its own `ask` comes past the check of the contract."""

    def ask(self):
        return np.full((1, self.dimension), 1.25)


@pytest.mark.parametrize("kind", [Wandering, AsksItself])
def test_no_way_of_asking_comes_past_the_box(kind):
    """A minimiser's point is not clipped in silence, whose cost it would take for its own; what a
    public `ask` gives is looked at too. Nothing is evaluated there, and no thread is left.
    """
    evaluated = []
    before = threading.active_count()

    def objective(phi):
        evaluated.append(SPACE.to_unit(phi).tolist())
        return 0.0

    optimizer = kind(2, np.random.default_rng(0), budget=9)
    words = rf"'points' of {kind.__name__}.ask must be .*\[0, 1\]. Got \[1.25, 1.25\]"
    with pytest.raises(BadArgument, match=words):
        maximize(objective, SPACE, optimizer, run())
    assert all(0 <= x <= 1 for point in evaluated for x in point)
    assert threading.active_count() == before
