"""The study of machines on servos: what it makes of replayed motions."""

import pytest

from dropo.core.services.errors import UnknownName
from dropo.studies.measured.servos import MACHINES, servos

ARM = MACHINES["so101"]


class Diagnosed:
    """Work that is done already: three motions of an arm, in the last of which the roll stuck."""

    def map(self, function, items):
        before = dict.fromkeys((*ARM, "qpos.gripper"), 0.04)
        after = {**dict.fromkeys(ARM, 0.006), "qpos.gripper": 0.5}
        stuck = {**after, "qpos.wrist_roll": 0.1}
        motions = [
            {"seconds": 60.0, "nominal": before, "extended": one} for one in (after, after, stuck)
        ]
        return [
            {
                "problem": name,
                "seed": seed,
                "verdict": "partly",
                "steps": 1000,
                "seconds": 2.0,
                "sentences": ["actuator gain at a drive, gain -0.9 +- 0.01"],
                "motions": motions,
                "odd": [2],
            }
            for name, seed in items
        ]


def test_motions_with_and_without_the_odd_one():
    """Root mean squares over the five joints of the arm, not its jaw: 26.5 mrad, 6 without."""
    overall, by_motion, causes, cost = servos(Diagnosed(), problems=["so101"]).tables
    assert overall.rows == (("so101", "3", "40", "26.5", "3", "40", "6"),)
    assert [row[2:] for row in by_motion.rows] == [
        ("40", "6", ARM[0], "6"),
        ("40", "6", ARM[0], "6"),
        ("40", "45", "qpos.wrist_roll", "100"),
    ]
    assert causes.rows[0][1].startswith("actuator gain")
    assert cost.rows == (("so101", "partly", "1,000", "2"),)


def test_an_unknown_machine():
    with pytest.raises(UnknownName, match="Did you mean 'go2'"):
        servos(Diagnosed(), problems=["go"])
