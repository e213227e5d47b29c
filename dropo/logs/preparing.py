"""Series of a raw log made fit for a simulator: cleaned, unwrapped, and with velocities where none
were logged.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.data.checks.columns import Column, hangs, unwrapped
from dropo.logs.mapping import Channel
from dropo.logs.recordings import Run, Series
from dropo.logs.signals.stamps import gaps, going_on
from dropo.logs.signals.velocities import Velocities, estimate_velocities
from dropo.mjmodel.joints import Joint, ModelJoints

ROWS = 4000
RUNS = 20
"""Rows of a run, and runs, that a noise level is estimated from at most."""
LEAST = 20
"""Rows that a velocity is estimated from at least."""


@dataclass(frozen=True)
class Noise:
    """The noise level of a signal, a standard deviation in its unit: of the measurement, or of the
    estimate where it has none.

    sd is None for commands, which are taken as they are, and where there are too few rows.
    """

    sd: float | None
    unit: str
    estimated: bool = False


def cleaned(run: Run, machine: ModelJoints) -> Run:
    """The run without rows whose stamps do not go on or in which a sensor hangs; hinge angles go on
    beyond a turn.
    """
    return replace(run, series=tuple(_cleaned(series, machine) for series in run.series))


def _cleaned(series: Series, machine: ModelJoints) -> Series:
    series = series.take(going_on(series.time))
    if series.channel.field == "ctrl":
        return series
    keep = np.ones(len(series.time), dtype=bool)
    cut = gaps(series.time)
    for values in series.values.T:
        for start, stop in hangs(
            Column(series.label, "", series.time, values, series.rows, breaks=cut)
        ):
            keep[start + 1 : stop] = False
    series = series.take(keep)
    hinge = series.channel.field == "qpos" and machine.joints[series.channel.name].kind == "hinge"
    return replace(series, values=unwrapped(series.values[:, 0])[:, None]) if hinge else series


def with_velocities(
    runs: Sequence[Run], machine: ModelJoints
) -> tuple[list[Run], dict[str, Noise]]:
    """The runs with a velocity for every position, and the noise level of every column of both.

    Velocities that were not logged come from a smoother (not causal) of each stretch between gaps,
    as late behind the positions as the model's own are.
    """
    levels: dict[str, list[tuple[float, int]]] = {}
    units: dict[str, tuple[str, bool]] = {}
    some = {int(i) for i in np.linspace(0, len(runs) - 1, min(RUNS, len(runs)))}
    out = []
    for number, run in enumerate(runs):
        more = []
        for series in run.series:
            if series.channel.field == "qpos" and run.of("qvel", series.channel.name) is None:
                velocity, noise = _estimated(series, machine.joints[series.channel.name])
                velocity = velocity.later(machine.velocity_lag)
                more.append(velocity)
                _note(levels, units, velocity.channel, noise, len(velocity.time), True)
            if number in some:
                noise = (
                    _noise(series)
                    if series.channel.field != "ctrl"
                    else np.full(len(series.channel.columns), np.nan)
                )
                _note(levels, units, series.channel, noise, len(series.time), False)
        out.append(replace(run, series=(*run.series, *more)))
    return out, {name: Noise(_pooled(pairs), *units[name]) for name, pairs in levels.items()}


def _note(
    levels: dict[str, list[tuple[float, int]]],
    units: dict[str, tuple[str, bool]],
    channel: Channel,
    noise: Array,
    rows: int,
    estimated: bool,
) -> None:
    for i, (unit, sd) in enumerate(zip(channel.units, noise, strict=True)):
        name = channel.label if len(channel.units) == 1 else f"{channel.label}[{i}]"
        levels.setdefault(name, []).append((float(sd), rows))
        units[name] = (unit, estimated)


def _pooled(pairs: list[tuple[float, int]]) -> float | None:
    """The root of the mean variance of the rows of several runs."""
    sd, rows = np.array([pair for pair in pairs if np.isfinite(pair[0])]).reshape(-1, 2).T
    return float(np.sqrt(np.sum(rows * sd**2) / np.sum(rows))) if len(sd) else None


def _pieces(series: Series) -> list[Ints]:
    return [
        piece
        for piece in np.split(np.arange(len(series.time)), gaps(series.time))
        if len(piece) >= LEAST
    ]


def _noise(series: Series) -> Array:
    """(k,) of the measured numbers, from the longest stretch; NaN where it is short."""
    pieces = _pieces(series)
    if not pieces:
        return np.full(series.values.shape[1], np.nan)
    rows = max(pieces, key=len)[:ROWS]
    return estimate_velocities(series.time[rows], series.values[rows]).position_noise


def _estimated(position: Series, joint: Joint) -> tuple[Series, Array]:
    """The velocity of a position, of its stretches that are long enough, and its noise level (k,)."""
    units = joint.units("qvel")
    channel = replace(position.channel, field="qvel", units=units, columns=units)
    stretches = [
        (
            rows,
            *_velocity(
                estimate_velocities(position.time[rows], _even(position.values[rows], joint)), joint
            ),
        )
        for rows in _pieces(position)
    ]
    if not stretches:
        return Series(
            channel, position.time, np.zeros((len(position.time), len(units))), position.rows
        ), np.full(len(units), np.nan)
    rows = np.concatenate([stretch[0] for stretch in stretches])
    variance = sum(len(stretch[0]) * stretch[2] ** 2 for stretch in stretches) / len(rows)
    values = np.concatenate([stretch[1] for stretch in stretches])
    return Series(channel, position.time[rows], values, position.rows[rows]), np.sqrt(variance)


def _even(values: Array, joint: Joint) -> Array:
    """Positions whose quaternion, q or -q, goes on without jumps."""
    quaternion = joint.quaternion()
    if quaternion is None:
        return values
    out = values.copy()
    turned = np.sum(out[1:, quaternion] * out[:-1, quaternion], axis=1) < 0
    out[1:, quaternion] *= np.where(np.cumsum(turned) % 2, -1.0, 1.0)[:, None]
    return out


def _velocity(smooth: Velocities, joint: Joint) -> tuple[Array, Array]:
    """Velocities (n, k) and their noise (k,): a quaternion's are turned into the body's angular
    velocity, 2 Im(conj(q) dq/dt).
    """
    quaternion = joint.quaternion()
    if quaternion is None:
        return smooth.velocities, smooth.velocity_noise
    q = smooth.positions[:, quaternion]
    dq = smooth.velocities[:, quaternion]
    w = q[:, :1]
    v = q[:, 1:]
    dw = dq[:, :1]
    dv = dq[:, 1:]
    turning = 2 * (w * dv - dw * v - np.cross(v, dv)) / np.sum(q**2, axis=1, keepdims=True)
    level = 2 * np.sqrt(np.mean(smooth.velocity_noise[quaternion] ** 2))
    linear = slice(0, quaternion.start)
    return np.hstack([smooth.velocities[:, linear], turning]), np.concatenate(
        [smooth.velocity_noise[linear], np.full(3, level)]
    )
