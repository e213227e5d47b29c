"""What to type into an MJCF."""

from dropo.mjmodel.files.changes import changed_elements

OLD = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="arm">
      <inertial mass="1" pos="0 0 0"/><joint name="hinge" damping="0.1"/><geom/><geom size="1"/>
    </body>
  </worldbody>
</mujoco>"""


def test_only_what_changes_is_named():
    """New and changed attributes with what was there; of elements without a name their place."""
    new = (
        OLD.replace('damping="0.1"', 'damping="0.2" frictionloss="0.05"')
        .replace('size="1"', 'size="2"')
        .replace('mass="1"', 'mass="1.5"')
        .replace("</worldbody>", '</worldbody><actuator><motor joint="hinge"/></actuator>')
    )
    assert list(changed_elements(OLD, new)) == [
        '<!-- body arm > inertial: was mass="1" -->',
        '<inertial mass="1.5" pos="0 0 0"/>',
        '<!-- body arm > joint hinge: was damping="0.1"; new: frictionloss -->',
        '<joint name="hinge" damping="0.2" frictionloss="0.05"/>',
        '<!-- body arm > geom 2: was size="1" -->',
        '<geom size="2"/>',
        "<!-- actuator: new element -->",
        "<actuator />",
        "<!-- motor: new element -->",
        '<motor joint="hinge"/>',
    ]
    assert list(changed_elements(OLD, OLD)) == []


def test_elements_that_are_as_by_default_are_named():
    """MuJoCo writes no option that is its default: that it is gone is said."""
    new = OLD.replace('<option timestep="0.01"/>', "")
    assert list(changed_elements(OLD, new)) == [
        '<!-- option: was timestep="0.01", now without -->',
        "<option/>",
    ]
