"""What a search does not simulate twice, and that it comes to the same."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dropo import Diagnose
from dropo.core.contracts.support.time_profile import growing, setting_in
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.diagnosis.far_off.search import FarOffSearch
from dropo.diagnosis.search import single_steps
from dropo.diagnosis.search.linearization import (
    Library,
    linearize,
    shift_linearization,
    with_other_noise,
)
from dropo.diagnosis.search.refit import NO_INDICES, RefitSettings, _scan, refit
from dropo.diagnosis.search.screening import Screening, all_probes
from dropo.diagnosis.search.whitening import white
from dropo.diagnosis.search.windows import split
from tests.models.hidden_in_arm import UPPER, instance, problem

LENGTH = 5
SIGMA = 1e-3


@pytest.fixture(scope="module")
def arm():
    """A library with a damping, the same from a moment on and as a ramp, and windows of an arm."""
    found = problem([], parameters=(UPPER,), episodes=14, steps=48)
    damping = instance(found.simulator, "joint_damping:elbow")
    every = [damping, setting_in(damping), growing(damping)]
    library = Library(found.simulator.with_effects(every), every, len(found.space))
    windows = split(found, LENGTH, 64)[0]
    theta = np.concatenate([found.simulator.nominal, np.zeros(len(library.simulator.space) - 1)])
    noise = white(np.full(len(found.simulator.signals), SIGMA))
    return library, windows, theta, noise


def spent(library, run):
    """What a function gives, and the simulator steps of it."""
    before = library.simulator.steps
    return run(), library.simulator.steps - before


def test_another_noise_takes_no_simulation(arm):
    """The same windows as those simulated again, to the last bit. Control: windows as they were
    linearized are simulated once.
    """
    library, windows, theta, noise = arm
    first = linearize(library, windows, theta, noise)
    other = white(1.2 * noise.sigma)
    moved = theta + np.eye(len(theta))[0] * 0.01
    shifted = shift_linearization(library, first, moved, noise)
    again = shift_linearization(library, shifted, moved, other)
    kept, steps = spent(library, lambda: with_other_noise(library, shifted, other))
    assert steps == 0
    assert np.array_equal(kept.residuals, again.residuals)
    assert np.array_equal(kept.log_likelihood, again.log_likelihood)
    _, steps = spent(library, lambda: with_other_noise(library, first, other))
    assert steps == windows.steps * library.simulator.steps_per_action


def test_jacobians_are_asked_for_once(arm):
    """The same, without a step; at other numbers another."""
    library, windows, theta, _ = arm
    free = np.arange(2)
    first = library.kept_jacobian(theta, free, windows)
    again, steps = spent(library, lambda: library.kept_jacobian(theta, free, windows))
    assert steps == 0
    assert again is first
    other, steps = spent(library, lambda: library.kept_jacobian(theta + 0.01, free, windows))
    assert steps > 0
    assert not np.array_equal(other, first)
    assert np.array_equal(other, library.jacobian(theta + 0.01, free, windows))


def test_what_sets_in_responds_as_what_always_holds(arm):
    """The responses are those of the simulation, in every window, though one simulation serves all
    moments. Control: what grows is simulated itself.
    """
    library, windows, theta, noise = arm
    screening = Screening(library, 1e-6 * noise.sigma)
    linearized = linearize(library, windows, theta, noise)
    _, from_a_moment, ramp = library.instances
    for one, moments in ((from_a_moment, 3), (ramp, 1)):
        probed = [(one, probe) for probe in all_probes(one)]
        responses = {}
        _, steps = spent(library, lambda p=probed, r=responses: _add(screening, linearized, p, r))
        once = windows.steps * library.simulator.steps_per_action
        assert steps == len(probed) // moments * once
        for _, probe in probed:
            there = theta.copy()
            there[library.indices_of[one.label]] = probe[0]
            simulated = library.predict(there[None], windows)[0] - linearized.predicted
            error = np.abs(responses[one.label, probe][0] - simulated).max()
            assert error <= 1e-12 * np.abs(simulated).max()


def _add(screening, linearized, probed, responses):
    """Responses to some probes."""
    screening._add_responses(linearized, probed, responses)


def test_all_windows_are_screened_along_one_probe_and_once(arm):
    """Screened again, also by part, nothing is simulated; the order by part is that of all."""
    library, windows, theta, noise = arm
    screening = Screening(library, 1e-6 * noise.sigma)
    linearized = linearize(library, windows, theta, noise)
    instances = library.instances
    found = screening(linearized, np.arange(1), instances)
    again, steps = spent(library, lambda: screening(linearized, np.arange(1), instances))
    assert steps == 0
    assert [one.gain for one in again] == [one.gain for one in found]
    everything = np.arange(len(windows))
    (part,), steps = spent(
        library, lambda: screening.by_part(linearized, np.arange(1), instances, [everything])
    )
    assert steps == 0
    assert [one.instance.label for one in part] == [one.instance.label for one in found]


def test_a_fit_that_changed_nothing_is_not_linearized_anew(arm):
    """Some windows say so, for a fraction of the cost; a control far from there is linearized."""
    library, windows, theta, noise = arm
    floor = 1e-6 * noise.sigma
    linearized = linearize(library, windows, theta, noise)
    _, whole = spent(library, lambda: linearize(library, windows, theta, noise))
    fitted = refit(library, linearized, NO_INDICES, floor)
    assert fitted.linearized_at[1] is linearized.linearized_at[1]
    _, steps = spent(library, lambda: refit(library, linearized, NO_INDICES, floor))
    assert steps < 0.5 * whole
    _, steps = spent(library, lambda: refit(library, fitted, NO_INDICES, floor))
    assert steps == 0
    far = theta + np.eye(len(theta))[0] * 0.5
    off = shift_linearization(library, linearized, far, noise)
    renewed = refit(library, off, NO_INDICES, floor)
    assert renewed.linearized_at[0] is far


def test_first_steps_of_windows_tell_that_an_effect_is_there(monkeypatch):
    """Nothing is linearized anew then. Control: of an effect that they do not show, single steps
    all over the windows are asked.
    """
    asked = []
    monkeypatch.setattr(
        single_steps, "magnitude_in_single_steps", lambda *_: asked.append(True) or (1.0, 0.1)
    )
    for hidden, times in (([("joint_damping:elbow", [0.1])], 0), ([], 1)):
        found = problem(hidden)
        damping = instance(found.simulator, "joint_damping:elbow")
        library = Library(found.simulator.with_effects([damping]), [damping], 0)
        noise = white(np.full(len(found.simulator.signals), SIGMA))
        theta = np.array([0.1])
        sides = [linearize(library, side, theta, noise) for side in split(found, LENGTH, 64)]
        assert not single_steps.absent_in_single_steps(library, sides, damping, 1e-6 * noise.sigma)
        assert len(asked) == times


def test_slopes_of_the_screening_begin_a_trial(arm):
    """Those that predictions have, within a hundredth; none of what is not smooth."""
    library, windows, theta, noise = arm
    screening = Screening(library, 1e-6 * noise.sigma)
    linearized = linearize(library, windows, theta, noise)
    damping, from_a_moment, _ = library.instances
    assert screening.slopes(windows, damping) is None
    screening(linearized, np.arange(1), library.instances)
    (slopes,), steps = spent(library, lambda: screening.slopes(windows, damping))
    assert steps == 0
    (exact,) = library.jacobian(theta, library.indices_of[damping.label], windows)
    assert np.abs(slopes - exact).max() < 0.05 * np.abs(exact).max()
    assert screening.slopes(windows, from_a_moment) is None


def test_a_scan_is_made_on_some_windows(arm):
    """Its best number is simulated on all: a third of the steps, and the same number."""
    library, windows, theta, noise = arm
    there = theta.copy()
    there[library.indices_of["joint_damping:elbow"]] = 0.05
    linearized = linearize(library, windows, there, noise)
    number = int(library.indices_of["joint_damping:elbow"][0])
    settings = RefitSettings()
    quick, steps = spent(library, lambda: _scan(library, linearized, number, settings))
    every = replace(settings, fewest=1000)
    whole, more = spent(library, lambda: _scan(library, linearized, number, every))
    assert steps < 0.4 * more
    assert quick.theta[number] == whole.theta[number] < 0.05


def test_motions_without_a_certain_effect_are_counted(monkeypatch):
    """Whole motions without a certain effect are no answer, and their steps are part of the cost.
    Control: with one they are.
    """
    found = problem([], episodes=4, steps=20)
    effect = instance(found.simulator, "joint_damping:elbow")

    def explained(certain):
        model = SimpleNamespace(numbers=[(effect, np.zeros(1))])
        return SimpleNamespace(
            model=model, certain=certain, fits=True, interrupted=False, simulator_steps=123
        )

    start = SimpleNamespace(model=None, whole=None, sure=True)
    for certain, expected in ((frozenset(), 123), (frozenset({effect.label}), 0)):
        monkeypatch.setattr(FarOffSearch, "run", lambda *_, c=certain: explained(c))
        answer, in_vain = Diagnose()._explained(start, lambda *_: None, EvaluationLog())
        assert (answer is None) == (not certain)
        assert in_vain == expected
