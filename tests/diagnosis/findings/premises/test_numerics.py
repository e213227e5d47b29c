"""What the physics step does is said to be the step's, and no cause."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from dropo import Diagnose, Problem
from dropo.core.contracts.effect import instances_of
from dropo.core.records.trajectories import Trajectories
from dropo.diagnosis import solving
from dropo.diagnosis.findings.causes import standard_errors
from dropo.diagnosis.findings.premises.numerics import _share_of_step, numerics, short_delay
from dropo.diagnosis.search.arithmetic import Arithmetic, ArithmeticAlternatives, shift_in_time
from dropo.diagnosis.search.linearization import Library, linearize, shift_linearization
from dropo.diagnosis.search.refit import NO_INDICES, refit
from dropo.diagnosis.search.review import Review, reviews_so_far
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.trials import penalized_log_likelihood
from dropo.diagnosis.search.whitening import WhitenessSettings, white
from dropo.diagnosis.search.windows import split
from dropo.diagnosis.setup import SearchedEffects, SearchSetup
from dropo.mjmodel.options import integrator, physics_step
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.models.holding_servo import FRICTION, servo

XML = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body>
      <joint name="pivot" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="pivot"/></actuator>
</mujoco>
"""
DAMPING = 0.03  # [N m s/rad]
NOISE = np.array([2e-4, 2e-3])  # [rad, rad/s]
RUNS, STEPS = 12, 60
EFFECTS = ("joint_damping", "joint_armature", "sensor_delay", "actuator_delay")


def pendulum(damping=0.0, finer=1, integrator="mjINT_EULER"):
    """A pendulum on a motor, its physics steps so many times shorter."""
    spec = mujoco.MjSpec.from_string(XML)
    spec.option.integrator = getattr(mujoco.mjtIntegrator, integrator)
    spec.option.timestep /= finer
    spec.joints[0].damping[0] = damping
    return MujocoSimulator(spec, [], frame_skip=2 * finer, threads=1)


def chain(joints):
    """Hinges one behind another, each on a motor."""
    spec = mujoco.MjSpec()
    body = spec.worldbody
    for i in range(joints):
        body = body.add_body(pos=[0, 0, -0.3 * bool(i)])
        body.add_joint(name=f"joint{i}", axis=[0, 1, 0])
        body.add_geom(size=[0.05, 0.05, 0.05], mass=0.5)
        motor = spec.add_actuator(name=f"motor{i}", target=f"joint{i}")
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
    return MujocoSimulator(spec, [], frame_skip=2, threads=1)


def recorded(finer, integrator, late=0.0):
    """A log of a pendulum that has damping, beside the model that has none.

    late: of its positions [s].
    """
    rng = np.random.default_rng(3)
    phase = rng.uniform(0, 2 * np.pi, (RUNS, 1))
    torque = 0.5 * np.sin(0.15 * np.arange(STEPS) + phase).reshape(-1, 1)
    rest = np.zeros((len(torque), 2))
    ends = np.arange(len(torque)) % STEPS == STEPS - 1
    segments = Trajectories(rest, torque, rest, ends).segments(STEPS, every_step=True)
    machine = pendulum(DAMPING, finer, integrator)
    delay, _ = instances_of(machine.effect_context, "sensor_delay")
    machine = machine.with_effects((), [(delay, np.array([late]))])
    after = machine.predict(np.zeros((1, 0)), segments)[0]
    exact = np.concatenate([np.zeros((RUNS, 1, 2)), after.reshape(RUNS, STEPS, 2)], axis=1)
    measured = exact + NOISE * rng.normal(size=exact.shape)
    before = measured[:, :-1].reshape(-1, 2)
    return Problem(
        "pendulum", pendulum(), Trajectories(before, torque, measured[:, 1:].reshape(-1, 2), ends)
    )


SEARCH = Diagnose(EFFECTS, windows=20, disturbances=False)
STEPS_SAID = "act like delays, inertia and damping"


@pytest.mark.parametrize(
    ("finer", "integrator"), [(4, "mjINT_RK4"), (10, "mjINT_EULER"), (1, "mjINT_EULER")]
)
def test_exact_steps_stand_beside_the_cause(finer, integrator):
    """A machine in other, shorter steps: its damping is named, alone, with its size, and the steps
    are said to be the model's, whether it is exact or another simulation, which steps as the model
    does. Control: in the model's own steps, nothing is said of them.
    """
    found = SEARCH.run(recorded(finer, integrator), rng=0)
    (cause,) = found.causes
    assert cause.effect == "joint_damping"
    estimate = cause.estimate["damping"]
    assert abs(estimate.value - DAMPING) < 4 * estimate.se
    assert found.verdict == "explained"
    assert any(STEPS_SAID in text for text in found.numerics) == (finer > 1)


def test_a_delay_below_a_step_is_no_cause_where_something_remains(monkeypatch):
    """Where exact steps are not tried, half a step of delay is accepted, refused in the end, and
    said, beside what half the steps would explain. So this is the control of the test above, too.
    """
    for decision in ("is_preferred", "__call__"):
        monkeypatch.setattr(ArithmeticAlternatives, decision, lambda *given: False)
    found = SEARCH.run(recorded(4, "mjINT_RK4"), rng=0)
    assert [cause.effect for cause in found.causes] == ["joint_damping"]
    estimate = found.causes[0].estimate["damping"]
    # Off by what the steps do, which is part of its error.
    assert 0.03 * DAMPING < abs(estimate.value - DAMPING) < 3 * estimate.se
    assert found.verdict == "partly"
    better, refused = found.numerics
    assert "physics steps of half the length (5 ms)" in better
    assert refused.startswith("The sensor delay at qpos.pivot of 4.")
    assert "qpos.pivot" not in {leader.target for leader in found.leaders}


def test_a_delay_below_a_step_is_a_cause_where_all_is_explained():
    """In the model's own steps they are no rivals of positions that are 4 ms late."""
    found = SEARCH.run(recorded(1, "mjINT_EULER", late=0.004), rng=0)
    causes = {cause.effect: cause for cause in found.causes}
    assert set(causes) == {"joint_damping", "sensor_delay"}
    estimate = causes["sensor_delay"].estimate["delay"]
    assert abs(estimate.value - 0.004) < 4 * estimate.se
    assert not any(STEPS_SAID in text for text in found.numerics)


def test_coarse_steps_are_corrected_where_windows_are_linearized():
    """Windows in the model's own steps with their defect, and in exact steps alone: the same
    residuals, nearly so for twice the damping, and the same damping within its error once fitted.
    Controls: the model's own steps alone are off by many times the noise, and a library in exact
    steps alone takes the defect out again.
    """
    windows, _ = split(recorded(4, "mjINT_RK4"), 10, 20)
    libraries = stepped_in_three_ways()
    at, near = np.array([0.02]), np.array([0.04])
    begun = {name: linearize(one, windows, at, white(NOISE)) for name, one in libraries.items()}
    sigma = np.tile(NOISE, windows.length)
    off = {
        name: np.abs((side.residuals - begun["exact"].residuals) / sigma).max()
        for name, side in begun.items()
    }
    assert off["both"] < 0.01
    assert off["own"] > 10
    exact = shift_linearization(libraries["exact"], begun["exact"], near, white(NOISE))
    moved = shift_linearization(libraries["both"], begun["both"], near, white(NOISE))
    assert np.abs((moved.residuals - exact.residuals) / sigma).max() < 0.4 * off["own"]
    back = shift_linearization(libraries["exact"], begun["both"], near, white(NOISE))
    np.testing.assert_allclose(back.residuals, exact.residuals, atol=1e-3 * NOISE.min())
    assert back.defect is None
    found, errors = fitted_dampings(libraries, windows)
    assert abs(found["both"] - found["exact"]) < errors["exact"]
    assert abs(found["own"] - found["exact"]) > 4 * errors["exact"]


def stepped_in_three_ways():
    """Libraries of the pendulum with its damping, in exact steps, in its own, and in both."""
    (damping,) = instances_of(pendulum().effect_context, "joint_damping")
    own = pendulum().with_effects([damping])
    exact = own.with_integrator("RK4")
    libraries = {
        "both": Library(exact, [damping], 0, coarse=own),
        "exact": Library(exact, [damping], 0),
        "own": Library(own, [damping], 0),
    }
    return libraries


def fitted_dampings(libraries, windows):
    """The damping by each library, and its standard error."""
    found, errors = {}, {}
    for name, library in libraries.items():
        begun = linearize(library, windows, np.array([0.02]), white(NOISE))
        train = refit(library, begun, np.array([0]), 1e-3 * NOISE)
        state = SimpleNamespace(free=np.array([0]), train=train)
        found[name] = train.theta[0]
        errors[name] = standard_errors(library, state)[0][0]
    return found, errors


@pytest.mark.parametrize(
    ("finer", "integrator", "share"), [(4, "mjINT_EULER", 0.25), (4, "mjINT_RK4", 0.0)]
)
def test_errors_in_exact_steps_hold_what_data_say_of_the_machines(finer, integrator, share):
    """A simulation in four times finer steps of the model's kind is a quarter of the way from exact
    steps to the model's own: the error holds that. The control: one in exact steps, whose motions
    say so, adds nothing.
    """
    windows, _ = split(recorded(finer, integrator), 10, 20)
    libraries = stepped_in_three_ways()
    found, errors = fitted_dampings(libraries, windows)
    wrong = abs(found["own"] - found["exact"])
    assert errors["both"] == pytest.approx(np.hypot(errors["exact"], share * wrong), rel=0.3)


@pytest.mark.parametrize(("within", "won"), [(True, True), (False, False)])
def test_a_delay_below_a_step_must_be_confirmed_over_exact_steps(monkeypatch, within, won):
    """Steps that are nearly as likely win against such a delay, for they cost no assumption; the
    control: against one that is no shorter than a step they do not.
    """
    search, first, found = late_by(0.004)
    library = search.library
    nearly = moved(library, found, 0.998)
    loss = penalized_log_likelihood(found) - penalized_log_likelihood(nearly)
    assert 0 < loss < 3
    alternatives = ArithmeticAlternatives(
        library, search.floor, search.settings, search.log, first=first
    )
    exact = Arithmetic(8)
    monkeypatch.setattr(alternatives, "_most_promising", lambda *given: (exact, np.inf))
    monkeypatch.setattr(alternatives, "_tried", lambda *given: nearly)
    monkeypatch.setattr(alternatives, "_fitted", lambda *given: nearly)
    if not within:
        monkeypatch.setattr(
            "dropo.diagnosis.search.arithmetic.shift_in_time", lambda *given: 2 * 0.01
        )
    assert alternatives(first, found) is won
    assert alternatives.winner == (exact if won else None)


def late_by(seconds):
    """A search for a delay of a pendulum that is late, its beginning, and the model with it."""
    problem = recorded(1, "mjINT_EULER", late=seconds)
    delay, _ = instances_of(problem.simulator.effect_context, "sensor_delay")
    library = Library(pendulum(DAMPING).with_effects([delay]), [delay], 0)
    search = Selection(library, 1e-3 * NOISE)
    train, test = split(problem, 10, 20)
    first = search.begin(train, test, np.zeros(1), white(NOISE), NO_INDICES)
    return search, first, search.try_set(first, np.array([seconds]), (), (delay,), scanned=())


def moved(library, found, share):
    """A model with a part of its numbers."""
    noise = found.train.whiten.noise
    sides = (found.train, found.test)
    train, test = (shift_linearization(library, side, share * found.theta, noise) for side in sides)
    return replace(found, train=train, test=test)


@pytest.mark.parametrize(("share", "won"), [(0.998, True), (0.9, False)])
def test_exact_steps_need_not_be_confirmed_beside_what_a_delay_explained(monkeypatch, share, won):
    """Ends of two fits without either may be far apart, where numbers do nearly the same: steps
    that explain as much as the delay win though windows held out are not sure of their gain. The
    control: steps that explain less do not.
    """
    search, first, found = late_by(0.004)
    library = search.library
    alternatives = ArithmeticAlternatives(
        library, search.floor, search.settings, search.log, first=first
    )
    other = moved(library, found, share)
    monkeypatch.setattr(alternatives, "_most_promising", lambda *given: (Arithmetic(8), np.inf))
    monkeypatch.setattr(alternatives, "_tried", lambda *given: other)
    monkeypatch.setattr(alternatives, "_fitted", lambda *given: other)
    monkeypatch.setattr("dropo.diagnosis.search.arithmetic.is_confirmed", lambda *given: False)
    assert alternatives(first, found) is won


@pytest.mark.parametrize(("late", "refused"), [(0.004, True), (0.012, False)])
def test_few_degrees_of_freedom_do_not_excuse_a_delay_below_a_step(monkeypatch, late, refused):
    """One of two errors, which have one degree of freedom; the control: one above a step."""
    search, first, found = late_by(late)
    searched = SearchedEffects(first, found, reviews_so_far(search, found))
    monkeypatch.setattr(
        solving, "standard_errors", lambda *given: (np.abs(found.theta) / 2, np.ones(1))
    )
    unsure = solving.that_may_be_nothing(search.library, searched, 0.98)
    assert (unsure is not None) is refused


@pytest.mark.parametrize(
    ("finer", "integrator", "late", "again"),
    [(4, "mjINT_RK4", 0.0, True), (1, "mjINT_EULER", 0.004, False)],
)
def test_a_delay_below_a_step_meets_exact_steps_at_the_end(
    monkeypatch, finer, integrator, late, again
):
    """Of an exact machine the search goes on in them without it, whenever the delay was accepted;
    the control: positions that are 4 ms late are no matter of steps.
    """
    problem = recorded(finer, integrator, late)
    problem = replace(problem, simulator=pendulum(DAMPING))
    delay, _ = instances_of(problem.simulator.effect_context, "sensor_delay")
    library = Library(problem.simulator.with_effects([delay]), [delay], 0)
    search = Selection(library, 1e-3 * NOISE)
    train, test = split(problem, 10, 20)
    first = search.begin(train, test, np.zeros(1), white(NOISE), NO_INDICES)
    last = search.polish(search.try_set(first, np.array([0.004]), (), (delay,), scanned=()))
    found = SearchedEffects(first, last, {delay.label: Review(first, None, ())})
    setup = SearchSetup(problem, None, library, search, train, test, NO_INDICES, 1, ())
    monkeypatch.setattr(solving, "search_effects", lambda anew: (anew, found))
    further = solving.in_exact_steps(setup, found)
    assert (further is not None) is again
    if again:
        assert further[0].exact
        _, begun = further[0].begun
        assert not begun.accepted
        assert solving.in_exact_steps(*further) is None


@pytest.mark.parametrize(
    ("finer", "machine", "exact", "expected"),
    [
        (4, "mjINT_EULER", True, (4, "Euler")),
        (4, "mjINT_RK4", False, (1, "RK4")),
        (1, "mjINT_EULER", True, None),
        (1, "mjINT_EULER", False, None),
    ],
)
def test_steps_are_others_beside_all_that_was_found(monkeypatch, finer, machine, exact, expected):
    """Of a machine of shorter steps the search goes on in these where steps are chosen, else in
    those of Runge and Kutta, and that once; the controls: a machine of the model's own steps.
    """
    problem = recorded(finer, machine)
    problem = replace(problem, simulator=pendulum(DAMPING))
    library = Library(problem.simulator, [], 0)
    search = Selection(library, 1e-3 * NOISE)
    train, test = split(problem, 10, 20)
    first = search.begin(train, test, np.zeros(0), white(NOISE), NO_INDICES)
    found = SearchedEffects(first, first, {})
    setup = SearchSetup(problem, None, library, search, train, test, NO_INDICES, 1, (), exact=exact)
    monkeypatch.setattr(solving, "search_effects", lambda anew: (anew, found))
    further = solving.in_shorter_steps(setup, found, WhitenessSettings())
    if expected is None:
        assert further is None
        return
    setup, _ = further
    model = setup.problem.simulator.model
    assert (round(0.01 / physics_step(model)), integrator(model)) == expected
    assert solving.in_shorter_steps(setup, found, WhitenessSettings()) is None


def test_shifts_are_the_latest_signals():
    """Of three joints that are read one after another the first is read twice the interval early,
    or the last; a delay's and a lag's are their own.
    """
    context = chain(3).effect_context
    (polling,) = instances_of(context, "sensor_polling")
    for interval in (0.001, -0.001):
        assert shift_in_time(polling, np.array([interval])) == pytest.approx(0.002)
    for name in ("actuator_delay", "actuator_lag"):
        one = next(iter(instances_of(context, name)))
        assert shift_in_time(one, np.array([0.003])) == pytest.approx(0.003)
    damping = next(iter(instances_of(context, "joint_damping")))
    assert shift_in_time(damping, np.array([0.003])) is None


@pytest.mark.parametrize(("late", "told"), [(0.004, 0.004), (0.012, None)])
def test_short_delays_are_shorter_than_a_physics_step(late, told):
    """Of a step of 10 ms; other effects are none, whatever their size."""
    context = pendulum().effect_context
    (delay, _), (damping,) = (
        instances_of(context, name) for name in ("sensor_delay", "joint_damping")
    )
    assert short_delay(delay, np.array([late]), 0.01) == told
    assert short_delay(damping, np.array([late]), 0.01) is None


def test_where_the_model_that_came_diverges_steps_change_less_than_causes():
    """Without a warning; elsewhere the share is that of the rows that are known."""
    found = np.zeros((2, 6))
    came = np.full((2, 6), 4.0)
    finer = np.full((2, 6), 1.0)
    spread = np.array([1.0, 2.0])
    assert _share_of_step(finer, came, found, spread) == pytest.approx(0.25)
    came[0] = np.nan
    finer[0] = 9.0
    assert _share_of_step(finer, came, found, spread) == pytest.approx(0.25)
    came[1] = np.nan
    assert _share_of_step(finer, came, found, spread) == 0.0


@pytest.mark.parametrize(("came", "found", "said"), [(0, 1, 1), (1, 0, 0), (1, 1, 0)])
def test_dry_friction_is_spoken_of_where_it_is_no_longer_mujocos(came, found, said):
    """From creeping (0) to holding (1); nothing is said of the reverse, or of what is as it was."""
    simulators = (servo(FRICTION), servo(FRICTION, holding=True))
    given, after = (SimpleNamespace(simulator=simulators[i]) for i in (came, found))
    nothing = np.zeros(0)
    sentences = numerics(given, after, None, None, None, (), nothing, unexplained=False)
    assert sum("Dry friction holds what rests" in text for text in sentences) == said
