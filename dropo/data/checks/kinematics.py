"""Does the motion fit its own velocity, and does free fall fit gravity? Signs, units and axes that
are wrong show here.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.data.checks.findings import Finding, Level

SURE = 0.8
"""Correlation of displacement and integrated velocity from which their ratio means something."""
FOLLOWS = 0.3
"""Correlation below which a velocity is that of something else."""
WRONG = 2.0
ODD = 1.15
"""A velocity that is too large or too small by such a factor is an error, or odd."""
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
WINDOW = 0.1  # [s] over which displacements are summed
FALL = 0.03  # [s] over which an acceleration is taken
NEAR = 0.2
ENOUGH = 0.02
SOME = 0.1
MANY = 50  # windows, without which nothing is said of a correlation that is missing


@dataclass(frozen=True, eq=False)
class Motion:
    """Displacements (n,) from row to row, the integral (n,) of the measured velocity meanwhile, and
    how sure the first are.

    noise: of one displacement (sd); rows, time: of each displacement's beginning; pieces: (n,)
    which go on without a break where neighbours have the same number.
    """

    name: str
    velocity: str
    moved: Array
    integral: Array
    noise: float
    step: float
    rows: Ints
    time: Array
    pieces: Ints
    run: str | None = None


def check_motions(motions: Sequence[Motion]) -> list[Finding]:
    """A velocity of the wrong sign or unit, or of another joint: in some runs, else in all
    together.
    """
    single = [finding for motion in motions for finding in _judged([motion], alone=True)]
    return single if 0 < len(single) < len(motions) else _judged(motions, alone=False)


def _judged(motions: Sequence[Motion], *, alone: bool) -> list[Finding]:
    windows = [(motion, *_windows(motion)) for motion in motions]
    moving = [
        (m, y, x, first)
        for m, y, x, first in windows
        if len(y) >= 3 and float(np.sqrt(np.mean(y**2))) > 10 * m.noise
    ]
    y = np.concatenate([window[1] for window in moving] or [np.empty(0)])
    x = np.concatenate([window[2] for window in moving] or [np.empty(0)])
    if not (x**2).any():
        return []
    correlation = float(np.sum(x * y) / np.sqrt(np.sum(x**2) * np.sum(y**2)))
    factor = float(np.sqrt(np.sum(x**2) / np.sum(y**2)))
    # what noise in one or the other leaves open
    least = factor * abs(correlation)
    largest = factor / max(abs(correlation), 1e-9)
    most, moved, _, first = max(moving, key=lambda window: float(np.abs(window[1]).max()))
    i = int(first[np.argmax(np.abs(moved))])
    clearly = f"most clearly from row {most.rows[i]} at {most.time[i]:.6g} s"

    def finding(level: Level, text: str, advice: str) -> Finding:
        return Finding(
            level,
            most.velocity,
            f"{text}, {clearly}.",
            advice,
            most.run,
            int(most.rows[i]),
            float(most.time[i]),
        )

    found = []
    if correlation < -SURE:
        found.append(
            finding(
                "error",
                f"it has the opposite sign of the change of {most.name}",
                "Give one of the two the `sign` -1.",
            )
        )
    wrong, odd = (least > bound or largest < 1 / bound for bound in (WRONG, ODD))
    if abs(correlation) > SURE and (wrong or (odd and not alone)):
        level: Level = "error" if wrong else "warning"
        found.append(
            finding(
                level,
                f"it is {factor:.4g} times the change of {most.name} in time",
                _advice(factor),
            )
        )
    if abs(correlation) < FOLLOWS and not alone and len(y) >= MANY:
        text = f"it does not follow the change of {most.name} (correlation {correlation:.2f})"
        found.append(finding("warning", text, "Check that both columns are of the same joint."))
    return found


def _advice(factor: float) -> str:
    near = next(
        (words for words, known in FACTORS.items() if abs(np.log(factor / known)) < 0.1), None
    )
    return (
        f"It looks like {near}: check the units."
        if near
        else "Check the units of position, velocity and time, and gear ratios."
    )


def _windows(motion: Motion) -> tuple[Array, Array, Ints]:
    """Displacements and integrals summed over windows that no break cuts, and where each begins."""
    width = max(1, min(round(WINDOW / motion.step), len(motion.moved) // 20))
    edges = np.flatnonzero(np.diff(motion.pieces)) + 1
    begin = np.concatenate([[0], edges])
    lengths = np.diff([*begin, len(motion.moved)])
    first = np.concatenate(
        [
            b + np.arange(0, max(n - width, 0) + 1, width)
            for b, n in zip(begin, lengths, strict=True)
            if n >= width
        ]
        or [[]]
    )
    first = first.astype(np.int64)
    sums = [np.concatenate([[0.0], np.cumsum(a)]) for a in (motion.moved, motion.integral)]
    return sums[0][first + width] - sums[0][first], sums[1][first + width] - sums[1][first], first


def noise_of_steps(moved: Array) -> float:
    """The noise of displacements (sd) from how they zigzag: their second differences, by the
    median.
    """
    zigzag = np.diff(moved, n=2)
    return (
        float(np.median(np.abs(zigzag)) / 0.6745 / np.sqrt(20) * np.sqrt(2)) if len(zigzag) else 0.0
    )


def turned(quaternions: Array, following: Array) -> Array:
    """Rotation vectors (n, 3) in the body's frame from quaternions (n, 4), w x y z, to those that
    follow.
    """
    before, after = (Rotation.from_quat(q, scalar_first=True) for q in (quaternions, following))
    return np.asarray((before.inv() * after).as_rotvec())


def check_fall(
    name: str, accelerations: Array, gravity: Array, rows: Ints, time: Array, run: str | None = None
) -> Iterator[Finding]:
    """Accelerations (n, 3) [m/s^2] of a free body: spans of free fall must have the model's gravity
    (3,).
    """
    g = float(np.linalg.norm(gravity))
    if g == 0 or len(accelerations) < 10:
        return
    if _share(accelerations, gravity) >= ENOUGH:
        return
    along, across = _split(accelerations, gravity / g)
    steady = (np.abs(along) > 0.05 * g) & (across < NEAR * np.abs(along))
    if steady.mean() > SOME:
        factor = float(np.median(along[steady])) / g
        for _ in range(5):  # windows with an impact mislead
            like = steady & (np.abs(along / g / factor - 1) < NEAR)
            factor = float(np.median(along[like])) / g if like.any() else factor
        if like.mean() > SOME:
            i = int(np.argmax(steady))
            text = (
                f"it falls at {factor:.4g} times the model's gravity, first from row {rows[i]} "
                f"at {time[i]:.6g} s."
            )
            advice = (
                "Check the sign of the axis."
                if factor < 0
                else "Check the units of length and time."
            )
            yield Finding("error", name, text, advice, run, int(rows[i]), float(time[i]))
            return
    for axis in np.concatenate([np.eye(3), -np.eye(3)]):
        if _share(accelerations, g * axis) > SOME:
            near = np.linalg.norm(accelerations - g * axis, axis=1) < NEAR * g
            i = int(np.argmax(near))
            down = "xyz"[int(np.argmax(np.abs(axis)))]
            where = (
                f"{'+' if axis.sum() > 0 else '-'}{down}, first from row {rows[i]} at "
                f"{time[i]:.6g} s"
            )
            text = f"it falls along {where}; the model's gravity does not."
            yield Finding(
                "error",
                name,
                text,
                "Check the order and the signs of the columns.",
                run,
                int(rows[i]),
                float(time[i]),
            )
            return


def _share(accelerations: Array, expected: Array) -> float:
    return float(
        np.mean(np.linalg.norm(accelerations - expected, axis=1) < NEAR * np.linalg.norm(expected))
    )


def _split(accelerations: Array, down: Array) -> tuple[Array, Array]:
    along = accelerations @ down
    return along, np.linalg.norm(accelerations - along[:, None] * down, axis=1)


def falling(time: Array, positions: Array) -> tuple[Array, Ints]:
    """Accelerations (m, 3) from positions (n, 3) at increasing `time` (n,), over windows of FALL,
    and where each begins.

    A parabola through each window's rows, by least squares.
    """
    width = max(5, round(FALL / float(np.median(np.diff(time)))) + 1)
    first = np.arange(0, len(time) - width + 1, width)
    if not len(first):
        return np.empty((0, 3)), first
    index = first[:, None] + np.arange(width)
    t = time[index] - time[index].mean(axis=1, keepdims=True)
    design = np.stack([np.ones_like(t), t, t**2 / 2], axis=2)
    return (np.linalg.pinv(design) @ positions[index])[:, 2], first
