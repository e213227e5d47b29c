"""What to type into an MJCF, on the page."""

import json

from dropo.report.folder import read_result
from dropo.report.model_changes import changes_part


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
