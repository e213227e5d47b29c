"""Units are found by names, ranges, encoders and what follows what; else they are left open."""

import mujoco
import numpy as np
import pytest

from dropo.logs.guessing.scales import Choice, Scale, angle_unit, command_unit, time_unit
from dropo.mjmodel.joints import Joint, model_joints

TIME = np.linspace(0, 4, 400)


def joint(limits: str = "") -> Joint:
    """A hinge, with a range in degrees or without."""
    limited = f'range="{limits}"' if limits else ""
    xml = (
        f'<mujoco><worldbody><body><joint name="j" {limited}/><geom size="0.1"/></body>'
        "</worldbody></mujoco>"
    )
    return model_joints(mujoco.MjModel.from_xml_string(xml)).joints["j"]


@pytest.mark.parametrize(
    ("step", "unit"), [(0.01, "s"), (5.0, "ms"), (2000.0, "us"), (5e6, "ns"), (1e-5, "s")]
)
def test_stamps_are_of_the_unit_in_which_logs_are_written(step: float, unit: str) -> None:
    """Rows from 0.25 ms to 0.25 s apart; where no unit makes them such, they are seconds."""
    stamps = 7.0 + step * np.arange(50)
    assert time_unit(stamps, None).unit == unit
    assert time_unit(stamps, "us") == Scale("us", "its name says so")


def test_degrees_of_an_encoder() -> None:
    """Numbers on a lattice of 360/4096 are degrees, whatever their size; control: of 0.1 not."""
    small = 8.0 * np.sin(2 * TIME)
    found = angle_unit([np.rint(small / (360 / 4096)) * 360 / 4096], [joint()], [None])
    assert found == Scale("deg", "they move in steps of 360/4096")
    found = angle_unit([np.rint(small / 0.1) * 0.1], [joint()], [None])
    assert found is not None
    assert found.unit == "rad"


def test_large_numbers() -> None:
    """Degrees on a joint without limits, rad where wide ranges hold them, else not decided."""
    wave = np.sin(2 * TIME)
    assert angle_unit([75 * wave], [joint()], [None]) == Scale("deg", "the largest is 75")
    wide = joint("-1200 1200")
    found = angle_unit([15 * wave], [wide], [None])
    assert found == Scale("rad", "they are within the joints' ranges")
    asked = angle_unit([15 * wave], [joint()], [None])
    assert asked == Choice(("rad", "deg"), "Angles reach 15")


@pytest.mark.parametrize(
    ("turn", "found"),
    [(4096, 4096), (4095, 4096), (8192, 8192), (10000, 10000), (65536, 65536), (1228.8, 1228.8)],
)
def test_counts_of_any_turn_by_the_commands(turn: float, found: float) -> None:
    """Joints that follow commands in rad tell the counts of a turn, usual ones exactly."""
    wave = 0.8 * np.sin(2 * TIME)
    counts = np.rint(0.98 * wave * turn / (2 * np.pi) + turn / 2)
    scale = angle_unit([counts], [joint()], [None], [(wave, counts)])
    assert isinstance(scale, Scale)
    assert (scale.unit, scale.offset) == (f"tick/{found:g}", -found / 2)


def test_counts_that_nothing_tells_are_asked() -> None:
    """8192 and 10000 look alike without commands; an odd size is asked with its neighbours."""
    wave = 0.8 * np.sin(2 * TIME)
    counts = np.rint(wave * 10000 / (2 * np.pi) + 5000)
    asked = angle_unit([counts], [joint("-90 90")], [None])
    assert isinstance(asked, Choice)
    assert {"tick/8192", "tick/10000"} <= set(asked.units)
    assert "counts reach 6273" in asked.what
    odd = np.rint(wave * 6300 / (2 * np.pi))
    asked = angle_unit([odd], [joint()], ["tick"], [(wave, odd)])
    assert isinstance(asked, Choice)
    assert "about 6300 a turn" in asked.what
    scale = angle_unit([odd], [joint()], ["tick/6300"], [(wave, odd)])
    assert scale == Scale("tick/6300", "it was given")
    small = np.rint(wave * 1024 / (2 * np.pi) + 512)
    asked = angle_unit([small], [joint("-90 90")], [None])
    assert isinstance(asked, Choice)
    assert asked.units[:2] == ("tick/1000", "tick/1024")


def test_a_name_of_ticks_counts_for_whole_numbers_alone() -> None:
    """Numbers with a fraction are none of an encoder, whatever the column is called."""
    found = angle_unit([0.8 * np.sin(2 * TIME)], [joint("-90 90")], ["tick"])
    assert found == Scale("rad", "the largest is 0.8")


def test_commands_are_in_the_unit_that_the_joint_follows() -> None:
    """Degrees beside positions in rad; the positions' own where nothing is nearer."""
    wanted = 0.7 * np.sin(2 * TIME)
    logged = 0.7 * np.sin(2 * TIME - 0.1)
    position = Scale("rad", "its name says so")
    assert command_unit(np.degrees(wanted), logged, None, position).unit == "deg"
    assert command_unit(wanted, logged, None, position).unit == "rad"
    assert command_unit(wanted, logged, "deg", position).why == "its name says so"


@pytest.mark.parametrize("unit", ["m", "cm", "mm"])
def test_commands_of_a_slide_have_a_unit_of_their_own(unit: str) -> None:
    """Metres beside positions in millimetres, say."""
    wanted = 0.04 * np.sin(2 * TIME) - 0.05
    logged = 1e3 * (0.04 * np.sin(2 * TIME - 0.1) - 0.05)
    commands = wanted / {"m": 1.0, "cm": 1e-2, "mm": 1e-3}[unit]
    position = Scale("mm", "its name says so")
    assert command_unit(commands, logged, None, position).unit == unit


def test_a_joint_that_moves_the_other_way_has_the_same_unit() -> None:
    """A wrong sign is not taken for commands that are next to nothing, in degrees."""
    wanted = 0.7 * np.sin(2 * TIME)
    logged = -0.7 * np.sin(2 * TIME - 0.1)
    position = Scale("rad", "its name says so")
    assert command_unit(wanted, logged, None, position).unit == "rad"
    assert command_unit(np.degrees(wanted), logged, None, position).unit == "deg"
