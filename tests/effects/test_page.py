"""The page on effects names what there is, with the quantities' own names."""

import re
from pathlib import Path

from dropo.core.services.registry import find, names
from tests.models.robots import ROBOTS

PAGE = (Path(__file__).parents[2] / "docs" / "effects.md").read_text()


def rows():
    """The cells of the table, by effect."""
    table = PAGE.split("<!-- names: effects -->\n")[1].split("\n\n")[0]
    cells = [
        [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        for line in table.splitlines()[2:]
    ]
    return {row[0].strip("`"): row for row in cells}


def test_every_effect_has_a_row():
    """All names of the catalogue and no others, five cells each."""
    assert sorted(rows()) == names("effects")
    assert {len(row) for row in rows().values()} == {5}


def test_quantities_and_layers_are_named():
    """Every quantity and every hook of every instance on all robots stands in its effect's row."""
    hooks = (
        "start",
        "command",
        "actuation",
        "command_feedback",
        "force",
        "wrench",
        "model",
        "measurement",
        "sensor_delay",
    )
    for robot in (make().simulator.effect_context for make in ROBOTS.values()):
        for name in set(names("effects")) - {"parameter_drift"}:
            for instance in find("effects", name)(robot):
                for quantity in instance.quantities:
                    assert quantity.name in rows()[name][2], (instance.label, quantity.name)
                for hook in hooks:
                    assert getattr(instance, hook) is None or hook in rows()[name][4], (
                        instance.label,
                        hook,
                    )
