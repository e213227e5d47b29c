"""MuJoCo's warnings leave no file in the working directory."""

import logging
from pathlib import Path

import mujoco
import pytest

from dropo.mjmodel.warnings import LOGGER, leave_no_log_file

NOT_A_NUMBER = '<mujoco><option timestep="nan"/></mujoco>'


def test_warnings_go_to_logging(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Wherever MuJoCo is called; without anyone who listens, it writes its file."""
    monkeypatch.chdir(tmp_path)
    with caplog.at_level(logging.DEBUG, LOGGER.name):
        mujoco.MjSpec.from_string(NOT_A_NUMBER)
    assert "NaN" in caplog.text
    assert list(tmp_path.iterdir()) == []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(None)
    try:
        mujoco.MjSpec.from_string(NOT_A_NUMBER)
    finally:
        mujoco.set_mju_user_warning(before)
    assert [path.name for path in tmp_path.iterdir()] == ["MUJOCO_LOG.TXT"]


def test_the_users_own_handler_stays() -> None:
    """Importing dropo later does not take it away."""
    before = mujoco.get_mju_user_warning()
    said: list[str] = []
    mujoco.set_mju_user_warning(said.append)
    try:
        leave_no_log_file()
        mujoco.MjSpec.from_string(NOT_A_NUMBER)
    finally:
        mujoco.set_mju_user_warning(before)
    assert len(said) == 1
