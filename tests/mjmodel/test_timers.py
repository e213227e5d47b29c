"""Simulations are not timed, and MuJoCo's timers are as before afterwards."""

import mujoco

from dropo.mjmodel.timers import without_timers

PENDULUM = """
<mujoco>
  <worldbody>
    <body>
      <joint axis="0 1 0"/>
      <geom size="0.1" pos="0 0 -0.3"/>
    </body>
  </worldbody>
</mujoco>
"""


def test_timers_stand_still_inside_alone() -> None:
    """Of contexts in each other too; the states are the same."""
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    timed = mujoco.MjData(model)
    plain = mujoco.MjData(model)
    for data in (timed, plain):
        data.qpos[:] = 0.3
    timer = plain.timer[mujoco.mjtTimer.mjTIMER_STEP]
    with without_timers():
        with without_timers():
            mujoco.mj_step(model, plain)
        mujoco.mj_step(model, plain)
        assert timer.duration == 0.0
    mujoco.mj_step(model, timed, 3)
    mujoco.mj_step(model, plain)
    assert timer.duration > 0.0
    assert (plain.qpos == timed.qpos).all()
