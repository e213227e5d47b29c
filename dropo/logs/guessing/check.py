"""The checks of raw logs, and of what stands in them beside the mapping."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from dropo.data.checks.findings import Finding, errors_first
from dropo.logs.guessing.base import moving_base
from dropo.logs.log_checks import DEFAULTS, LogCheckSettings, check_runs
from dropo.logs.mapping import Mapping
from dropo.logs.readers.reader import open_log
from dropo.logs.recordings import LogRun
from dropo.mjmodel.joints import ModelJoints


def check_logs(
    logs: Sequence[str | Path],
    runs: Sequence[LogRun],
    mapping: Mapping,
    robot: ModelJoints,
    settings: LogCheckSettings = DEFAULTS,
) -> list[Finding]:
    """Find what looks odd in raw logs, and where they and the model do not belong together.

    Parameters
    ----------
    logs : sequence of str or Path
        The logs.
    runs : sequence of LogRun
        Their runs as they were read.
    mapping : Mapping
        Which columns are what.
    robot : ModelJoints
        The robot.
    settings : LogCheckSettings, optional
        What counts as odd.

    Returns
    -------
    list of Finding
        Errors first.
    """
    found = check_runs(runs, robot, settings)
    found += _check_joints(mapping, robot)
    for path in logs:
        moves = moving_base(open_log(path), robot)
        if moves is not None:
            found.append(moves)
            break  # one line for all logs
    return errors_first(found)


def _check_joints(mapping: Mapping, robot: ModelJoints) -> Iterator[Finding]:
    """Joints that are commanded and whose position is not in the log."""
    measured = {channel.name for channel in mapping.of("qpos")}
    commanded = [channel.name for channel in mapping.channels if channel.field == "ctrl"]
    blind = []
    for name in dict.fromkeys(commanded):
        joint = robot.actuators[name].joint
        if joint is not None and joint.name not in measured:
            blind.append(joint.name)
    if blind:
        text = f"commanded, and without a position in the log: {', '.join(blind)}."
        advice = "Such joints start where the model has them, at rest."
        yield Finding("warning", "qpos", text, advice)
