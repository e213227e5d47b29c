"""Pushes are listed and left out of a diagnosis, and runs that disagree are named; where there are
none, nothing is said.
"""

import json

import mujoco
import pytest

from dropo import Diagnose
from dropo.core.contracts.problem import Problem
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.models.pushed_arm import PUSHES, STEP, XML, recorded, with_payloads

EFFECTS = ("joint_friction", "joint_damping")
STRONG = {span: 2 * torque for span, torque in PUSHES.items()}


@pytest.fixture(scope="module")
def smooth():
    """The pendulum without its friction, and what recorded the data."""
    mass = FieldParameter("mass", 0.3, 1.2, "kg", field="body_mass", element="link")
    model = XML.replace('frictionloss="0.15" damping="0.02"', "")
    return tuple(
        MujocoSimulator(mujoco.MjSpec.from_string(xml), [mass], frame_skip=2, threads=1)
        for xml in (model, XML)
    )


def diagnosed(smooth, data, windows=20, **settings):
    return Diagnose(EFFECTS, length=10, windows=windows, **settings).run(
        Problem("pendulum", smooth[0], data)
    )


def test_pushes_are_listed_and_left_out(smooth, tmp_path):
    """Both pushes by run and time, in words, in the JSON and on the terminal; friction as without
    them; the errors with and without.
    """
    data = recorded(smooth[1], STRONG)
    found = diagnosed(smooth, data)
    spans = found.disturbances.spans
    assert [span.trajectory for span in spans] == [0, 2]
    for span, (_, first, last) in zip(spans, STRONG, strict=True):
        assert span.start - 0.3 < first * STEP < span.start + 0.2
        assert span.end - 0.2 < last * STEP < span.end + 0.3
    friction = (
        next(cause for cause in found.causes if cause.effect == "joint_friction")
        .estimate["frictionloss"]
        .value
    )
    assert abs(friction - 0.15) < 0.02
    assert len(found.problem.trajectories) == len(data) - sum(
        span.last - span.first for span in spans
    )
    assert "Left out: 2 spans of time" in found.headline()
    assert str(found).count("left out: trajectory") == 2
    found.save(tmp_path)
    told = json.loads((tmp_path / "diagnosis.json").read_text())["disturbances"]
    assert [(one["run"], one["held_out"]) for one in told["spans"]] == [(0, False), (2, False)]
    assert all(one["seconds"] == one["to"] - one["from"] for one in told["spans"])
    without = next(h.units["rad/s"][0] for h in found.extended.horizons if h.steps == 10)
    assert told["errors_with_them"]["extended"]["units"]["rad/s"]["rmse"] > without
    off = diagnosed(smooth, data, windows=12, disturbances=False)
    assert off.disturbances is None
    assert len(off.problem.trajectories) == len(data)


def test_without_pushes_nothing_is_left_out(smooth):
    """Missing friction alone is no disturbance, although the first model is far off."""
    found = diagnosed(smooth, recorded(smooth[1], {}))
    assert "joint_friction" in [cause.effect for cause in found.causes]
    assert found.disturbances is None
    assert found.outlier_runs == ()
    assert found.to_json()["disturbances"] is None


def test_a_run_with_another_payload_is_named(smooth):
    """Of six runs the one with a heavier link, by its mass."""
    found = diagnosed(smooth, with_payloads([0.6, 0.6, 0.6, 0.9, 0.6, 0.6]))
    assert {run.run for run in found.outlier_runs} == {3}
    assert "Run 3 disagrees with the others" in found.headline()
    assert found.to_json()["odd_runs"][0]["run"] == 3
