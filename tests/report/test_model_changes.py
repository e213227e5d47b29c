"""What to type into an MJCF."""

import json

from dropo.report.folder import read_result
from dropo.report.model_changes import changed_elements, changes_part

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
        '<inertial mass="1.5"/>',
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


def test_a_diagnosis_says_what_to_type(diagnosis_folder, copy_of):
    """The joint with its new damping, the declared parameters, and what MJCF cannot hold; without
    the files nothing.
    """
    folder = copy_of(diagnosis_folder)
    content = json.loads((folder / "diagnosis.json").read_text())
    part = changes_part(read_result(folder))
    assert "&lt;joint name=&quot;elbow&quot; damping=&quot;" in part
    assert "joint elbow" in part
    assert 'class="copy"' in part
    assert "--- before.xml" in part
    assert str(folder) not in part
    problem = folder / "extended" / "problem.yaml"
    problem.write_text(problem.read_text() + "effects:\n- effect: actuator_delay\n  target: push\n")
    assert "MJCF has no element for actuator delay at push" in changes_part(read_result(folder))
    (folder / "extended" / "before.xml").unlink()
    assert changes_part(read_result(folder)) == ""
    assert content["causes"]
