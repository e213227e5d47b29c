"""Does the motion fit its own velocity, and does free fall fit gravity?

Signs, units and axes that are wrong show here.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dropo.core.numerics.spans import spans_of
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.data.checks.findings import Finding, Level

FACTORS = {
    "deg/s in place of rad/s (or positions in rev/60)": 180 / np.pi,
    "rpm in place of rad/s": 30 / np.pi,
    "rev/s in place of rad/s": 1 / (2 * np.pi),
    "rad/s in place of deg/s, or a position in deg": np.pi / 180,
    "mm in place of m in the velocity, or ms in place of s": 1e3,
    "mm in place of m in the position, or s in place of ms": 1e-3,
    "cm in place of m in the velocity": 1e2,
    "cm in place of m in the position": 1e-2,
}
"""What a velocity that is too large by a factor is a sign of."""


@dataclass(frozen=True)
class KinematicsSettings:
    """What makes a motion look odd.

    Attributes
    ----------
    certain_correlation : float
        Correlation of displacement and integrated velocity from which their ratio means something.
    unrelated_correlation : float
        Correlation below which a velocity is that of something else.
    minimum_windows : int
        Windows without which nothing is said of a correlation that is missing.
    wrong_factor : float
        A velocity that is too large or too small by this factor is an error.
    odd_factor : float
        A velocity that is too large or too small by this factor is a warning.
    window : float
        Length of the windows over which displacements are summed [s].
    frozen : int
        Windows in a row in which a velocity that keeps its value has stopped to be written, where
        the position moves otherwise.
    frozen_share : float
        Share of such windows from which on that is an error.
    fall_window : float
        Length of the windows over which an acceleration is taken [s].
    fall_tolerance : float
        How far an acceleration may be from the expected one, as a fraction of it.
    fall_fraction : float
        Fraction of the windows that must fall as the model does for all to be well.
    wrong_fall_fraction : float
        Fraction of the windows that fall in another way for an error.
    """

    certain_correlation: float = 0.8
    unrelated_correlation: float = 0.3
    minimum_windows: int = 50
    wrong_factor: float = 2.0
    odd_factor: float = 1.15
    window: float = 0.1
    frozen: int = 5
    frozen_share: float = 0.05
    fall_window: float = 0.03
    fall_tolerance: float = 0.2
    fall_fraction: float = 0.02
    wrong_fall_fraction: float = 0.1


DEFAULTS = KinematicsSettings()


# Velocities


@dataclass(frozen=True, eq=False)
class Displacements:
    """Displacements of a position from row to row, beside its measured velocity.

    Attributes
    ----------
    name, velocity : str
        The signals of position and velocity.
    displacement : (n,) array
        Change of the position, in its unit.
    integral : (n,) array
        Integral of the measured velocity meanwhile.
    noise : float
        Standard deviation of one displacement.
    step : float
        Seconds from row to row.
    rows : (n,) int array
        Where each displacement begins, in the log or the data.
    time : (n,) array
        The same in seconds.
    pieces : (n,) int array
        The record goes on without a break where neighbours have the same number.
    run : str or None
        The run of a log, where there are several.
    """

    name: str
    velocity: str
    displacement: Array
    integral: Array
    noise: float
    step: float
    rows: Ints
    time: Array
    pieces: Ints
    run: str | None = None


@dataclass(frozen=True, eq=False)
class _Windows:
    """Displacements (m,) and integrals (m,) summed over windows, and where each begins.

    kept: whether the velocity keeps its value in the window, and since the one before.
    """

    source: Displacements
    displacement: Array
    integral: Array
    first: Ints
    kept: NDArray[np.bool_]


def check_motions(
    motions: Sequence[Displacements], settings: KinematicsSettings = DEFAULTS
) -> list[Finding]:
    """Find a velocity of the wrong sign or unit, or of another joint.

    Parameters
    ----------
    motions : sequence of Displacements
        Of one signal, one for each run.
    settings : KinematicsSettings, optional
        What counts as odd.

    Returns
    -------
    list of Finding
        In single runs where only some are odd, else in all together.
    """
    single = []
    for motion in motions:
        single += _compare([motion], settings, one_of_several=True)
    if 0 < len(single) < len(motions):
        return single
    return _compare(motions, settings, one_of_several=False)


def _compare(
    motions: Sequence[Displacements], settings: KinematicsSettings, *, one_of_several: bool
) -> list[Finding]:
    """Correlation and ratio of displacements and integrated velocities.

    In one of several runs only what is an error counts.
    """
    moving = []
    for motion in motions:
        windows = _sum_over_windows(motion, settings.window)
        if len(windows.first) >= 3 and _rms(windows.displacement) > 10 * motion.noise:
            moving.append(windows)
    if not moving:
        return []
    frozen = [_frozen(windows, settings) for windows in moving]
    share = float(np.mean(np.concatenate(frozen)))
    if share > settings.frozen_share:
        i = int(np.argmax([one.sum() for one in frozen]))
        first = int(moving[i].first[np.argmax(frozen[i])])
        source = moving[i].source
        row = int(source.rows[first])
        time = float(source.time[first])
        text = (
            f"it stands at {source.integral[first] / source.step:.4g} while {source.name} moves, "
            f"in {share:.0%} of the log, from row {row} at {time:.6g} s on."
        )
        advice = "Leave it out of the mapping: it is then smoothed from the positions."
        return [Finding("error", source.velocity, text, advice, source.run, row, time)]
    y = np.concatenate([windows.displacement for windows in moving])
    x = np.concatenate([windows.integral for windows in moving])
    if not (x**2).any():
        return []
    correlation = float(np.sum(x * y) / np.sqrt(np.sum(x**2) * np.sum(y**2)))
    factor = float(np.sqrt(np.sum(x**2) / np.sum(y**2)))
    largest = max(moving, key=lambda windows: float(np.abs(windows.displacement).max()))

    found = []
    if correlation < -settings.certain_correlation:
        text = f"it has the opposite sign of the change of {largest.source.name}"
        found.append(_finding(largest, "error", text, "Give one of the two the `sign` -1."))
    wrong = _differs_by(settings.wrong_factor, factor, correlation)
    odd = _differs_by(settings.odd_factor, factor, correlation) and not one_of_several
    if abs(correlation) > settings.certain_correlation and (wrong or odd):
        level: Level = "error" if wrong else "warning"
        text = f"it is {factor:.4g} times the change of {largest.source.name} in time"
        found.append(_finding(largest, level, text, _unit_advice(factor)))
    enough = not one_of_several and len(y) >= settings.minimum_windows
    if abs(correlation) < settings.unrelated_correlation and enough:
        text = (
            f"it does not follow the change of {largest.source.name} "
            f"(correlation {correlation:.2f})"
        )
        advice = "Check that both columns are of the same joint."
        found.append(_finding(largest, "warning", text, advice))
    return found


def _differs_by(bound: float, factor: float, correlation: float) -> bool:
    """Whether a ratio is beyond a bound, whichever of the two signals holds the noise."""
    smallest = factor * abs(correlation)
    largest = factor / max(abs(correlation), 1e-9)
    return smallest > bound or largest < 1 / bound


def _finding(windows: _Windows, level: Level, text: str, advice: str) -> Finding:
    """A finding whose place is where the position moves most."""
    motion = windows.source
    i = int(windows.first[np.argmax(np.abs(windows.displacement))])
    row = int(motion.rows[i])
    time = float(motion.time[i])
    sentence = f"{text}, most clearly from row {row} at {time:.6g} s."
    return Finding(level, motion.velocity, sentence, advice, motion.run, row, time)


def _unit_advice(factor: float) -> str:
    """What a velocity that is too large by a factor is a sign of."""
    for words, known in FACTORS.items():
        if abs(np.log(factor / known)) < 0.1:
            return f"It looks like {words}: check the units."
    return "Check the units of position, velocity and time, and gear ratios."


def _sum_over_windows(motion: Displacements, seconds: float) -> _Windows:
    """Sums over windows that no break cuts."""
    n = len(motion.displacement)
    width = max(1, min(round(seconds / motion.step), n // 20))
    breaks = np.flatnonzero(np.diff(motion.pieces)) + 1
    bounds = np.concatenate([[0], breaks, [n]])
    starts = [np.empty(0, dtype=np.int64)]
    for begin, end in pairwise(bounds.tolist()):
        starts.append(np.arange(begin, end - width + 1, width, dtype=np.int64))
    first = np.concatenate(starts)
    displacement = _window_sums(motion.displacement, first, width)
    integral = _window_sums(motion.integral, first, width)
    within = motion.integral[first[:, None] + np.arange(width)]
    kept = np.ptp(within, axis=1) <= 1e-3 * np.abs(within).max(axis=1) if width > 2 else first < 0
    again = np.abs(np.diff(integral)) <= 1e-3 * np.abs(integral[1:])
    kept[1:] &= again & (np.diff(first) == width)
    return _Windows(motion, displacement, integral, first, kept)


def _frozen(windows: _Windows, settings: KinematicsSettings) -> NDArray[np.bool_]:
    """(m,) in which windows the velocity stands still while the position moves otherwise."""
    long = np.zeros(len(windows.kept), dtype=bool)
    for start, stop in spans_of(windows.kept).tolist():
        long[start:stop] = stop - start >= settings.frozen
    apart = np.abs(windows.displacement - windows.integral)
    return np.asarray(long & (apart > 0.5 * _rms(windows.displacement)))


def _window_sums(values: Array, first: Ints, width: int) -> Array:
    """Sums of `width` values from each of the places on."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(total[first + width] - total[first])


def _rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def displacement_noise(displacements: Array) -> float:
    """Estimate the noise of displacements from how they zigzag.

    Parameters
    ----------
    displacements : (n,) array
        Changes of a position from row to row.

    Returns
    -------
    float
        Standard deviation of one displacement, in their unit; 0 for fewer than three.

    Notes
    -----
    The median of the size of their second differences, which holds for white noise of the position.
    """
    zigzag = np.diff(displacements, n=2)
    if not len(zigzag):
        return 0.0
    return float(np.median(np.abs(zigzag)) / 0.6745 / np.sqrt(20) * np.sqrt(2))


def rotation_vectors(quaternions: Array, following: Array) -> Array:
    """Compute by how much a body turns between orientations.

    Parameters
    ----------
    quaternions, following : (n, 4) array
        Orientations w, x, y, z, before and after.

    Returns
    -------
    (n, 3) array
        Rotation vectors in the body's frame [rad].
    """
    from scipy.spatial.transform import Rotation  # slow to import

    before = Rotation.from_quat(quaternions, scalar_first=True)
    after = Rotation.from_quat(following, scalar_first=True)
    return np.asarray((before.inv() * after).as_rotvec())


# Free fall


@dataclass(frozen=True, eq=False)
class _Accelerations:
    """Accelerations (n, 3) [m/s^2] of the free body `name`, with their places and its run."""

    name: str
    values: Array
    rows: Ints
    time: Array
    run: str | None

    def near(self, expected: Array, tolerance: float) -> Array:
        """(n,) whether each is the expected one (3,)."""
        distance = np.linalg.norm(self.values - expected, axis=1)
        return np.asarray(distance < tolerance * np.linalg.norm(expected))

    def place(self, i: int) -> str:
        """Where the i-th stands."""
        return f"first from row {self.rows[i]} at {self.time[i]:.6g} s"

    def error(self, i: int, sentence: str, advice: str) -> Finding:
        """An error at the i-th."""
        row = int(self.rows[i])
        return Finding("error", self.name, sentence, advice, self.run, row, float(self.time[i]))


def check_fall(
    name: str,
    accelerations: Array,
    gravity: Array,
    rows: Ints,
    time: Array,
    run: str | None = None,
    settings: KinematicsSettings = DEFAULTS,
) -> Iterator[Finding]:
    """Find a free body that falls in another way than under the model's gravity.

    Parameters
    ----------
    name : str
        The signal of its position.
    accelerations : (n, 3) array
        In m/s^2, see `fall_accelerations`.
    gravity : (3,) array
        Of the model, in m/s^2.
    rows : (n,) int array
        Where each acceleration is taken, in the log or the data.
    time : (n,) array
        The same in seconds.
    run : str, optional
        The run of a log, where there are several.
    settings : KinematicsSettings, optional
        What counts as odd.

    Yields
    ------
    Finding
        At most one.
    """
    g = float(np.linalg.norm(gravity))
    if g == 0 or len(accelerations) < 10:
        return
    body = _Accelerations(name, accelerations, rows, time, run)
    if np.mean(body.near(gravity, settings.fall_tolerance)) >= settings.fall_fraction:
        return
    found = _check_gravity_factor(body, gravity, settings)
    if found is None:
        found = _check_gravity_axis(body, g, settings)
    if found is not None:
        yield found


def _check_gravity_factor(
    body: _Accelerations, gravity: Array, settings: KinematicsSettings
) -> Finding | None:
    """An error where a body falls along gravity, too fast, too slowly or upward."""
    g = float(np.linalg.norm(gravity))
    down = gravity / g
    along = body.values @ down
    across = np.linalg.norm(body.values - along[:, None] * down, axis=1)
    tolerance = settings.fall_tolerance
    falls = (np.abs(along) > 0.05 * g) & (across < tolerance * np.abs(along))
    if falls.mean() <= settings.wrong_fall_fraction:
        return None
    factor = float(np.median(along[falls])) / g
    for _ in range(5):  # windows with an impact mislead: take the median again without them
        alike = falls & (np.abs(along / g / factor - 1) < tolerance)
        factor = float(np.median(along[alike])) / g if alike.any() else factor
    if alike.mean() <= settings.wrong_fall_fraction:
        return None
    i = int(np.argmax(falls))
    text = f"it falls at {factor:.4g} times the model's gravity, {body.place(i)}."
    sign = "Check the sign of the axis."
    units = "Check the units of length and time."
    return body.error(i, text, sign if factor < 0 else units)


def _check_gravity_axis(
    body: _Accelerations, g: float, settings: KinematicsSettings
) -> Finding | None:
    """An error where a body falls along another axis."""
    for axis in np.concatenate([np.eye(3), -np.eye(3)]):
        near = body.near(g * axis, settings.fall_tolerance)
        if np.mean(near) > settings.wrong_fall_fraction:
            i = int(np.argmax(near))
            sign = "+" if axis.sum() > 0 else "-"
            letter = "xyz"[int(np.argmax(np.abs(axis)))]
            text = f"it falls along {sign}{letter}, {body.place(i)}; the model's gravity does not."
            return body.error(i, text, "Check the order and the signs of the columns.")
    return None


def fall_accelerations(
    time: Array, positions: Array, settings: KinematicsSettings = DEFAULTS
) -> tuple[Array, Ints]:
    """Compute accelerations from positions, by a parabola through the rows of each window.

    Parameters
    ----------
    time : (n,) array
        Increasing stamps [s].
    positions : (n, 3) array
        In m.
    settings : KinematicsSettings, optional
        How long a window is.

    Returns
    -------
    accelerations : (m, 3) array
        By least squares, in m/s^2.
    first : (m,) int array
        Where each window begins.
    """
    width = max(5, round(settings.fall_window / float(np.median(np.diff(time)))) + 1)
    first = np.arange(0, len(time) - width + 1, width)
    if not len(first):
        return np.empty((0, 3)), first
    index = first[:, None] + np.arange(width)
    t = time[index] - time[index].mean(axis=1, keepdims=True)
    design = np.stack([np.ones_like(t), t, t**2 / 2], axis=2)
    return (np.linalg.pinv(design) @ positions[index])[:, 2], first
