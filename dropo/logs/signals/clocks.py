"""Which stamps of a recording are late, by how much, and taken off: sensors beside each other, and
clocks beside the log's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array
from dropo.logs.mapping import Source
from dropo.logs.recordings import Run, Series
from dropo.logs.signals.delays import estimate_clock, estimate_delay
from dropo.logs.signals.resampling import resample
from dropo.logs.signals.velocities import estimate_velocities
from dropo.mjmodel.forces import inverse_forces
from dropo.mjmodel.joints import Joint, ModelJoints

INSTANTS = 20000  # rows that a delay is estimated from at most
LEAST = 50  # rows that it needs
APART = 0.5  # [s] to which two clocks, or their first rows, are together
# standard errors, and seconds, from which a delay is taken off
SURE = 3.0
WORTH = 5e-5
RUNS = 12  # that a constant delay is estimated from at most
# mean square of their deviations, in standard errors, from which runs have delays of their own
DISAGREE = 9.0
LEAST_ERROR = 1e-6  # [s]
WINDOW = 0.05  # [s] over which displacements are compared
EXPLAINED = 0.25  # of a signal's variance, without which a delay means nothing


@dataclass(frozen=True)
class Lateness:
    """Stamps of `signal` are too late by seconds + skew (t - origin), against those of `reference`,
    t on the latter's clock.

    se, skew_se: standard errors; run: None where one delay was found for all. Only what stands out
    of its error is taken off.
    """

    signal: str
    reference: str
    seconds: float
    se: float
    skew: float = 0.0
    skew_se: float = 0.0
    origin: float = 0.0
    run: str | None = None

    @property
    def removed(self) -> bool:
        """Whether an import takes it off."""
        return (
            abs(self.seconds) > max(SURE * self.se, WORTH)
            or abs(self.skew) > SURE * self.skew_se > 0
        )

    def __str__(self) -> str:
        where = f"{self.run}: " if self.run else ""
        skew = f", and its clock runs {1e6 * self.skew:+.4g} ppm fast" if self.skew else ""
        done = "taken off" if self.removed else "too little to tell, left"
        return (
            f"{where}{self.signal} is {1e3 * self.seconds:.4g} +- {1e3 * self.se:.2g} ms "
            f"behind {self.reference}{skew}: {done}."
        )

    def off(self, series: Series) -> Series:
        """The series with stamps of the reference's clock."""
        if not self.removed:
            return series
        return replace(
            series, time=self.origin + (series.time - self.origin - self.seconds) / (1 + self.skew)
        )


def aligned(runs: Sequence[Run], machine: ModelJoints) -> tuple[list[Run], list[Lateness]]:
    """The runs with the delays taken off, and all that were found.

    A source with a clock of its own is brought to the log's by its velocities or positions, beside
    the same joint's on the log's clock, or by its commands, beside the forces that the motion
    needs. A velocity on the log's clock is brought to its position, as late behind it as the
    model's own velocities are (`ModelJoints.velocity_lag`), which is not counted as a delay.
    """
    found: list[Lateness] = []
    runs = list(runs)
    for i, run in enumerate(runs):
        for source in dict.fromkeys(
            series.channel.source for series in run.series if series.channel.source.own_clock
        ):
            late = _clock(run, source, machine)
            if late is not None:
                found.append(late)
                run = _taken_off(
                    run,
                    late,
                    [series.label for series in run.series if series.channel.source == source],
                )
        runs[i] = run
    for name in machine.joints:
        delays = _velocity_delays(runs, name, machine)
        found += delays
        by_run = {one.run: one for one in delays}
        taken = [(run, by_run.get(run.name, by_run.get(None))) for run in runs]
        runs = [run if one is None else _taken_off(run, one, [one.signal]) for run, one in taken]
    return runs, found


def _taken_off(run: Run, late: Lateness, labels: list[str]) -> Run:
    return replace(
        run,
        series=tuple(
            late.off(series) if series.label in labels else series for series in run.series
        ),
    )


def _velocity_delays(runs: list[Run], name: str, machine: ModelJoints) -> list[Lateness]:
    """How much later a measured velocity is than the position: one delay for all runs, or each its
    own where they disagree.
    """
    some = [runs[int(i)] for i in np.linspace(0, len(runs) - 1, min(RUNS, len(runs)))]
    each = [late for run in some if (late := _velocity_delay(run, name, machine)) is not None]
    if not each:
        return []
    delays = np.array([one.seconds for one in each])
    weights = np.array([max(one.se, LEAST_ERROR) ** -2 for one in each])
    mean = float(np.sum(weights * delays) / np.sum(weights))
    spread = float(np.sum(weights * (delays - mean) ** 2)) / max(1, len(each) - 1)
    if spread > DISAGREE:
        return [late for run in runs if (late := _velocity_delay(run, name, machine)) is not None]
    return [
        replace(
            each[0], seconds=mean, se=float(np.sqrt(max(1.0, spread) / np.sum(weights))), run=None
        )
    ]


def _linear(series: Series, joint: Joint) -> Array:
    """The numbers (n, k) of a position or velocity that are no rotations."""
    return (
        series.values[:, :3]
        if joint.kind == "free"
        else series.values[:, :0]
        if joint.kind == "ball"
        else series.values
    )


def _moved(series: Series, machine: ModelJoints) -> tuple[Array, Array]:
    """Displacements (n, k) of a joint in the WINDOW around each stamp (n,), from its position or
    velocity, of a part of a long log.

    A velocity is integrated rather than a position differentiated: impacts leave no trace in it.
    """
    time = series.time[:INSTANTS]
    values = _linear(series, machine.joints[series.channel.name])[:INSTANTS]
    half = max(WINDOW, 5 * float(np.median(np.diff(time)))) / 2
    inside = time[(time >= time[0] + half) & (time <= time[-1] - half)]
    if series.channel.field == "qpos":
        ends = (np.clip(inside + side, time[0], time[-1]) for side in (half, -half))
        later, earlier = (resample(time, values, at) for at in ends)
        return inside, later - earlier
    time = time - machine.velocity_lag
    inside = inside - machine.velocity_lag
    steps = np.diff(time)[:, None] * (values[1:] + values[:-1]) / 2
    integral = CubicHermiteSpline(
        time, np.concatenate([np.zeros_like(values[:1]), np.cumsum(steps, axis=0)]), values
    )
    return inside, integral(inside + half) - integral(inside - half)


def _velocity_delay(run: Run, name: str, machine: ModelJoints) -> Lateness | None:
    """How much later a measured velocity is than the position of the same joint, on one clock."""
    position = run.of("qpos", name)
    velocity = run.of("qvel", name)
    if position is None or velocity is None or machine.joints[name].kind == "ball":
        return None
    (time, reference), (stamps, signal) = _moved(position, machine), _moved(velocity, machine)
    both = (time >= stamps[:1].sum()) & (time <= stamps[-1:].sum())
    if both.sum() < LEAST:
        return None
    time = time[both]
    reference = reference[both]
    signal = resample(stamps, signal, time)
    moving = (np.ptp(reference, axis=0) > 0) & (np.ptp(signal, axis=0) > 0)
    if not moving.any():
        return None
    late = estimate_delay(time, reference[:, moving], signal[:, moving])
    if not (np.isfinite(late.se) and late.se > 0 and late.explained > EXPLAINED):
        return None
    return Lateness(velocity.label, position.label, late.seconds, late.se, run=run.name)


def _clock(run: Run, source: Source, machine: ModelJoints) -> Lateness | None:
    """How late and how fast a source's clock is."""
    for reference, signal in _pairs(run, source, machine):
        (time, one), (stamps, other) = reference[1:], signal[1:]
        start = 0.0 if abs(stamps[0] - time[0]) < APART else float(stamps[0] - time[0])
        moving = (np.ptp(one, axis=0) > 0) & (np.ptp(other, axis=0) > 0)
        if not moving.any() or len(stamps) < LEAST:
            continue
        try:
            found = estimate_clock(
                time, one[:, moving], stamps - start, other[:, moving], most=APART
            )
        except BadArgument:
            continue
        if found.explained > EXPLAINED:
            return Lateness(
                signal[0],
                reference[0],
                found.seconds + start,
                found.se,
                found.skew,
                found.skew_se,
                found.origin,
                run.name,
            )
    return None


Curve = tuple[str, Array, Array]
"""Name, stamps (n,) and numbers (n, k)."""


def _pairs(run: Run, source: Source, machine: ModelJoints) -> list[tuple[Curve, Curve]]:
    """What the log's clock and the source's both saw: displacements of joints, else forces and
    commands.
    """
    out = []
    for name, joint in machine.joints.items():
        own = [
            s
            for field in ("qvel", "qpos")
            if (s := run.of(field, name)) is not None and s.channel.source == source
        ]
        main = [
            s
            for field in ("qpos", "qvel")
            if (s := run.of(field, name)) is not None and not s.channel.source.own_clock
        ]
        if own and main and joint.kind != "ball":
            out.append(
                (
                    (main[0].label, *_moved(main[0], machine)),
                    (own[0].label, *_moved(own[0], machine)),
                )
            )
    for series in run.series:
        if series.channel.source == source and series.channel.field == "ctrl":
            driven = machine.actuators[series.channel.name].joint
            forces = None if driven is None else _forces(run, machine, driven.qvel)
            if forces is not None:
                held = (
                    float(np.median(np.diff(series.time))) / 2 - machine.velocity_lag
                )  # from a row to the middle of its effect
                out.append(
                    (
                        ("the forces that the motion needs", *forces),
                        (series.label, series.time + held, series.values),
                    )
                )
    return out


def _forces(run: Run, machine: ModelJoints, dof: int) -> tuple[Array, Array] | None:
    """The generalised force (n, 1) at a dof that the motion needs (mj_inverse), at stamps (n,);
    None where a position is missing.
    """
    positions = [run.of("qpos", name) for name in machine.joints]
    if any(s is None or s.channel.source.own_clock for s in positions) or any(
        joint.quaternion() for joint in machine.joints.values()
    ):
        return None
    known = [s for s in positions if s is not None]
    time = known[0].time[:INSTANTS]
    time = time[(time >= max(s.time[0] for s in known)) & (time <= min(s.time[-1] for s in known))]
    if len(time) < LEAST:
        return None
    qpos = np.hstack([resample(s.time, s.values, time) for s in known])
    moved = estimate_velocities(time, qpos)
    accelerations = np.gradient(moved.velocities, time, axis=0)
    forces = inverse_forces(machine.model, moved.positions, moved.velocities, accelerations)
    return time, forces[:, [dof]]
