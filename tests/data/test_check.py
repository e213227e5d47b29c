"""The check is silent on data that the model itself made, and names the signal that was spoilt."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Signal, Trajectories
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array
from dropo.data.checks.check import check
from dropo.data.describe import columns, controls, describe
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """
<mujoco>
  <worldbody>
    <body name="ball"><freejoint name="free"/><geom name="shell" size="0.1" mass="1"/></body>
    <body name="cart"><joint name="slide" type="slide" axis="1 0 0"/>
    <geom name="box" size="0.1" mass="1" pos="0 3 0"/></body>
  </worldbody>
  <actuator>
    <motor name="push" joint="slide" ctrllimited="true" ctrlrange="-1 1"/>
    <motor joint="slide"/>
  </actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def simulator() -> MujocoSimulator:
    mass = FieldParameter("mass", 0.5, 2, "kg", field="body_mass", element="cart")
    return MujocoSimulator(mujoco.MjSpec.from_string(XML), [mass], threads=1)


@pytest.fixture(scope="module")
def clean(simulator: MujocoSimulator) -> Trajectories:
    """Two trajectories of 10 transitions that the simulator made."""
    rng = np.random.default_rng(0)
    n = 20
    start = rng.normal(size=(n, len(simulator.layout)))
    start[:, 3:7] = [0.5, 0.5, 0.5, 0.5]
    terminals = np.arange(n) % 10 == 9
    blank = Trajectories(start, rng.uniform(-1, 1, (n, 2)), start, terminals)
    states = start.copy()
    for t in range(
        n
    ):  # the simulator answers in the chart at the target; here the full rows are wanted
        one = Trajectories(states[[t]], blank.actions[[t]], states[[t]], np.array([True]))
        moved = simulator.layout.move(
            states[[t]],
            simulator.predict([[1.0]], one.segments())[0] - simulator.targets(one.segments()),
        )
        following = moved[0]
        if not terminals[t]:
            states[t + 1] = following
        start[t] = following
    return Trajectories(states, blank.actions, start, terminals)


def spoilt(data: Trajectories, **changes: Callable[[Array], None]) -> Trajectories:
    """A copy of the data with arrays changed in place."""
    arrays = {
        key: np.array(getattr(data, key))
        for key in ("observations", "actions", "next_observations", "terminals")
    }
    for key, change in changes.items():
        change(arrays[key])
    return Trajectories(**arrays)


def said(data: Trajectories, source: Any = None) -> list[tuple[str, str, str]]:
    """Level, signal and sentence of every finding."""
    return [(finding.level, finding.signal, finding.sentence) for finding in check(data, source)]


def put(index: Any, value: Any) -> Callable[[Array], None]:
    return lambda array: array.__setitem__(index, value)


def test_silent_on_clean_data(simulator: MujocoSimulator, clean: Trajectories) -> None:
    assert check(clean, simulator) == []
    assert check(clean) == []
    assert check(clean, Problem("clean", simulator, clean)) == []


def test_actions_outside_the_control_range(simulator: MujocoSimulator, clean: Trajectories) -> None:
    """Of the limited actuator alone; without a simulator nothing is known of ranges."""
    data = spoilt(clean, actions=put(([3, 4], 0), [-1.5, 1.25]))
    sentence = (
        "2 of 20 actions are outside the control range [-1, 1] and are clipped; the farthest "
        "is -1.5, row 3 at 0.006 s."
    )
    assert said(data, simulator) == [("warning", "ctrl.push", sentence)]
    assert (check(data, simulator)[0].row, check(data, simulator)[0].time) == (3, 0.006)
    assert check(data) == []
    assert check(spoilt(clean, actions=put((3, 1), 9.0)), simulator) == []


def test_quaternions(simulator: MujocoSimulator, clean: Trajectories) -> None:
    """Far from length 1 is an error, near is a warning, rounding is nothing."""
    length = lambda factor: spoilt(
        clean, observations=lambda a: put((0, slice(3, 7)), a[0, 3:7] * factor)(a)
    )
    assert said(length(2.0), simulator) == [
        ("error", "qpos.free", "a quaternion must have length 1, and one has 2, row 0.")
    ]
    assert said(length(1.01), simulator) == [
        ("warning", "qpos.free", "a quaternion must have length 1, and one has 1.01, row 0.")
    ]
    assert check(length(1 + 1e-6), simulator) == []


def test_a_channel_that_does_not_move(simulator: MujocoSimulator, clean: Trajectories) -> None:
    dead = put((slice(None), 7), 0.25)
    data = spoilt(
        clean, observations=dead, next_observations=dead, actions=put((slice(None), 1), 0.0)
    )
    assert said(data, simulator) == [
        ("warning", "qpos.slide", "it does not move: all 20 rows are 0.25."),
        ("warning", "ctrl.actuator1", "it does not move: all 20 rows are 0."),
    ]


def test_copies(clean: Trajectories) -> None:
    keys = ("observations", "actions", "next_observations")
    data = spoilt(
        clean, **{key: lambda array: put(9, array[19])(array) for key in keys}
    )  # ends of trajectories: no gap
    assert (
        "warning",
        "",
        "1 of 20 transitions are exact copies of others, the first is row 19.",
    ) in said(data)


def test_gaps_are_information(simulator: MujocoSimulator, clean: Trajectories) -> None:
    """The rms of 18 pairs, one of them off by 3 m."""
    data = spoilt(clean, next_observations=lambda array: put((2, 7), array[2, 7] + 3.0)(array))
    text = (
        "next_observations differ from the following observations by 0.7071 m (rms), most at "
        "row 2: noise, or a gap."
    )
    assert said(data, simulator) == [("information", "qpos.slide", text)]


def test_short_trajectories(simulator: MujocoSimulator, clean: Trajectories) -> None:
    data = spoilt(clean, terminals=put(2, True))
    assert said(data) == [("warning", "", "1 of 3 trajectories have fewer than 5 transitions: 0.")]
    sentence = "1 of 3 trajectories are shorter than lambda = 6 and are left out."
    assert ("warning", "", sentence) in said(data, Problem("short", simulator, data, horizon=6))


def test_time_must_go_on(clean: Trajectories) -> None:
    """Within a trajectory; the next one may begin at 0 again."""
    timed = lambda time: Trajectories(
        clean.observations, clean.actions, clean.next_observations, clean.terminals, time=time
    )
    time = np.tile(np.arange(10.0), 2)
    assert check(timed(time)) == []
    time[[4, 13]] = time[[3, 12]]
    assert said(timed(time))[0] == (
        "error",
        "time",
        "2 rows are not later than the row before them, the first is row 4.",
    )


def test_errors_come_first(simulator: MujocoSimulator, clean: Trajectories) -> None:
    data = spoilt(clean, actions=put((3, 0), 2.0), observations=put((5, slice(3, 7)), 9.0))
    assert [finding.level for finding in check(data, simulator)] == [
        "error",
        "warning",
        *["information"] * 4,
    ]
    assert str(check(data, simulator)[0]) == (
        "error: qpos.free: a quaternion must have length 1, and one has 18, row 5. The "
        "order is w, x, y, z."
    )


def test_names(simulator: MujocoSimulator) -> None:
    """Columns are the data's, with four numbers a quaternion; other counts are numbered."""
    assert [s.name for s in columns(simulator, 15)][3:8] == [
        *(f"qpos.free[{i}]" for i in range(3, 7)),
        "qpos.slide",
    ]
    assert [s.unit for s in columns(simulator, 15)] == ["m"] * 3 + [""] * 4 + ["m"] + [
        "m/s"
    ] * 3 + ["rad/s"] * 3 + ["m/s"]
    assert [s.name for s in controls(simulator, 2)] == ["ctrl.push", "ctrl.actuator1"]
    assert columns(None, 2) == [Signal("observation[0]"), Signal("observation[1]")]
    assert controls(simulator, 1) == [Signal("action[0]")]


def test_describe() -> None:
    data = Trajectories(
        [[0.0], [2.0], [4.0]],
        [[1.0], [1.0], [4.0]],
        [[2.0], [4.0], [6.0]],
        [False, True, True],
        group=[0, 0, 1],
        time=[0.0, 0.5, 0.0],
    )
    found = describe(data, [Signal("angle", "rad")])
    assert found.to_json() == {
        "transitions": 3,
        "trajectories": 2,
        "lengths": [2, 1],
        "groups": 2,
        "duration_s": 0.5,
        "signals": {
            "angle": {"min": 0.0, "mean": 2.0, "max": 4.0, "sd": np.sqrt(8 / 3), "unit": "rad"},
            "action[0]": {"min": 1.0, "mean": 2.0, "max": 4.0, "sd": np.sqrt(2), "unit": ""},
        },
    }
    assert str(found) == (
        "3 transitions in 2 trajectories of 1 to 2, 2 groups, 0.5 s\n"
        "signal     unit  min  mean  max      sd\n"
        "---------  ----  ---  ----  ---  ------\n"
        "angle       rad    0     2    4   1.633\n"
        "action[0]          1     2    4  1.4142"
    )
    assert str(describe(data.select(0))).startswith(
        "2 transitions in 1 trajectory of 2, 1 group, 0.5 s\n"
    )
    with pytest.raises(BadArgument, match="must be 1 and 1 columns"):
        describe(data, [Signal("angle"), Signal("speed")])


def test_rows_that_are_no_control_step_apart(
    simulator: MujocoSimulator, clean: Trajectories
) -> None:
    """Rows of another rate name the frame_skip that fits; uneven ones are noticed; control: even
    rows a control step apart are silent.
    """
    count = np.arange(20)
    even = simulator.control_step * count
    assert said(replace(clean, time=even), simulator) == []
    every = check(replace(clean, time=3 * even), simulator)
    (found,) = [finding for finding in every if finding.signal == "time"]
    assert found.level == "error"
    assert "rows are 6 ms apart, and one control step of the model takes 2 ms" in found.sentence
    assert found.advice.startswith("Set frame_skip to 3, or resample the data")
    uneven = even + 0.3 * simulator.control_step * (count % 4 == 2)
    every = check(replace(clean, time=uneven), simulator)
    (found,) = [finding for finding in every if finding.signal == "time"]
    assert found.level == "warning"
    assert found.sentence.startswith("steps vary by ")
