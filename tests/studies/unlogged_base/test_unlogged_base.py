"""The study of machines on legs without a pose: its machines, and what its tables say."""

import mujoco
import pytest

from dropo.core.services.errors import BadArgument
from dropo.studies.engine.work import Work
from dropo.studies.unlogged_base.machines import FITTED, HIDDEN, TRUTH
from dropo.studies.unlogged_base.study import CASES, DEFAULT, FIT, replication, unlogged_base


def test_machines_differ_where_they_say() -> None:
    """Each text is in the model, and changes what the case is called by."""
    models = {name: mujoco.MjModel.from_xml_string(one.machine) for name, one in HIDDEN.items()}
    usual = models["nothing"]
    heavy = models["1 kg on the trunk"]
    assert heavy.body("trunk").mass[0] == pytest.approx(usual.body("trunk").mass[0] + 1)
    assert heavy.body("trunk").ipos[2] > usual.body("trunk").ipos[2]
    weak = models["70 % of a knee's servo"].actuator("FR_knee")
    assert weak.gainprm[0] == pytest.approx(0.7 * usual.actuator("FR_knee").gainprm[0])
    assert weak.biasprm[2] == pytest.approx(0.7 * usual.actuator("FR_knee").biasprm[2])
    dry = models["0.4 N m at a hip"].joint("RL_hip").dofadr[0]
    stiff = models["0.4 N m at a hip"].dof_frictionloss[dry]
    assert stiff == pytest.approx(usual.dof_frictionloss[dry] + 0.4)
    assert models["ground friction 0.4"].geom("floor").friction[0] == 0.4
    fitted = mujoco.MjModel.from_xml_string(FITTED.machine)
    assert fitted.body("trunk").mass[0] == TRUTH["trunk"]
    assert fitted.geom("floor").friction[0] == TRUTH["floor"]


def test_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors, intervals and names are counted in their own rows; seeds are the evaluation's."""
    asked = []

    def given(self: Work, task: object, items: list[list[object]]) -> list[dict[str, object]]:
        assert task is replication
        asked.extend(items)
        answers: list[dict[str, object]] = []
        for case, seed, _, _ in items:
            sign = 1 if int(str(seed)) % 2 else -1
            fit = {"error": [0.2, 0.1 * sign], "se": [0.1, 0.2], "inside": [False, True]}
            named = {"named": seed != DEFAULT.first_evaluation, "others": ["a:b"], "size": 0.9}
            answers.append({**fit, "steps": 1000} if case == FIT else named)
        return answers

    monkeypatch.setattr(Work, "map", given)
    study = unlogged_base(Work(threads=1), 4)
    assert {item[1] for item in asked} == {DEFAULT.first_evaluation + i for i in range(4)}
    assert len(asked) == 4 * len(CASES)
    fits, diagnoses = study.tables
    rows = [dict(zip(fits.header, row, strict=True)) for row in fits.rows]
    assert [row["inside"] for row in rows] == ["0", "4"]
    assert [row["mean error"] for row in rows] == ["+0.2000", "+0.0000"]
    assert [row["rms error"] for row in rows] == ["0.2000", "0.1000"]
    first = dict(zip(diagnoses.header, diagnoses.rows[0], strict=True))
    assert (first["named with its place"], first["other names"]) == ("3", "4")
    assert first["median error"] == "10%"
    last = dict(zip(diagnoses.header, diagnoses.rows[-1], strict=True))
    assert last["named with its place"] == "none to name"
    with pytest.raises(BadArgument, match="'seeds' of unlogged_base must be at least 1"):
        unlogged_base(Work(), 0)


@pytest.mark.study
def test_a_replication_of_each_kind() -> None:
    """One fit within five standard errors, and a machine's payload."""
    found = replication([FIT, 3, 4.0, 2])
    assert all(abs(e) < 5 * se for e, se in zip(found["error"], found["se"], strict=True))
    named = replication(["1 kg on the trunk", 3, 5.0, 2])
    assert named["named"]
    assert named["size"] == pytest.approx(1.0, abs=0.3)
