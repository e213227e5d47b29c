"""Do sensors show what the model's own show along the measured motion?

Units, quaternions in another order, signs, and sensors that are mounted turned show here.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from dropo.core.services.validation import Array
from dropo.data.checks.findings import Finding
from dropo.mjmodel.sensors import G

FACTORS = {
    "rad/s": {"deg/s": 180 / np.pi, "rpm": 30 / np.pi, "rev/s": 1 / (2 * np.pi), "rad/s": 1.0},
    "m/s^2": {"g": 1 / G, "mg": 1e3 / G, "m/s^2": 1.0},
    "m/s": {"mm/s": 1e3, "cm/s": 1e2, "m/s": 1.0},
}
"""By SI unit the units that sensors count in, with their numbers for one of it."""


@dataclass(frozen=True)
class SensorSettings:
    """When a sensor does not show what the model's own shows.

    Attributes
    ----------
    least : dict
        Sizes (rms, in SI units; turns in rad) below which nothing is said, by unit.
    unit_tolerance : float
        How far a ratio of sizes may be from a unit's, as a fraction of it.
    wrong : float
        Fraction of the model's mean square that is left over, from which a sensor shows something
        else.
    right : float
        Fraction left over below which a sensor that is turned shows what the model's does.
    tie : float
        Turns are as good as the best where they leave over this much more of the mean square.
    tilt : float
        A mount that is turned by less [rad] is not spoken of.
    world : float
        The world that orientations are measured from is not spoken of where it is turned by less
        [rad].
    determined : float
        Fraction of the mean square that must stand across the main direction, so that a turn about
        it is known.
    rows : int
        Number of rows that are needed.
    """

    least: tuple[tuple[str, float], ...] = (
        ("rad/s", 0.1),
        ("m/s^2", 1.0),
        ("m/s", 0.02),
        ("", 0.05),
    )
    unit_tolerance: float = 0.25
    wrong: float = 0.5
    right: float = 0.25
    tie: float = 0.03
    tilt: float = 0.1
    world: float = 0.2
    determined: float = 0.05
    rows: int = 50


DEFAULTS = SensorSettings()


@dataclass(frozen=True, eq=False)
class SensorPair:
    """What a sensor and the model's own showed at the same instants.

    Attributes
    ----------
    name : str
        The sensor, as in "sensordata.gyro".
    mount : str
        What it stands on.
    unit : str
        SI unit of its numbers; "" for orientations.
    measured, modelled : (n, 3) arrays
        In this unit. Orientations are given by how they turned meanwhile, in their own axes [rad].
    factor : float
        What one of the log's unit was taken for, in SI units.
    rotation : tuple of float or None
        How the mapping turns it already.
    negative : bool
        Whether the mapping turns its sign around already.
    reordered : (n, 3) array or None
        Of an orientation how it turned if its order is x, y, z, w.
    away : (m, 3) array or None
        Of an orientation the turn from the model's to the measured one, in the world's axes [rad].
    reordered_away : (m, 3) array or None
        The same if its order is x, y, z, w.
    """

    name: str
    mount: str
    unit: str
    measured: Array
    modelled: Array
    factor: float = 1.0
    rotation: tuple[float, ...] | None = None
    negative: bool = False
    reordered: Array | None = None
    away: Array | None = None
    reordered_away: Array | None = None

    @property
    def is_orientation(self) -> bool:
        """Whether it shows how it stands."""
        return self.unit == ""


def check_sensors(
    pairs: Sequence[SensorPair], settings: SensorSettings = DEFAULTS
) -> Iterator[Finding]:
    """Find sensors that do not show what the model's own show.

    Parameters
    ----------
    pairs : sequence of SensorPair
        One of each sensor, of all runs together.
    settings : SensorSettings, optional
        When they do not.

    Yields
    ------
    Finding
        Errors, and a warning of what no unit, sign or turn explains.
    """
    by_mount: dict[str, list[SensorPair]] = {}
    for pair in pairs:
        if len(pair.measured) < settings.rows or not _says_something(pair, settings):
            continue
        wrong = _check_order(pair, settings) or _check_unit(pair, settings)
        if wrong is not None:
            yield wrong
        else:
            by_mount.setdefault(pair.mount, []).append(pair)
    for together in by_mount.values():
        yield from _check_mount(together, settings)


def unit_of(pair: SensorPair, settings: SensorSettings = DEFAULTS) -> str | None:
    """Find the unit in which a sensor counts, by its size beside that of the model's own.

    Parameters
    ----------
    pair : SensorPair
        The sensor.
    settings : SensorSettings, optional
        How near the sizes must be.

    Returns
    -------
    str or None
        None where it fits no unit, or hardly moves.
    """
    if len(pair.measured) < settings.rows or not _says_something(pair, settings):
        return None
    ratio = _size(pair.measured) / pair.factor / _size(pair.modelled)
    for unit, factor in FACTORS.get(pair.unit, {}).items():
        if abs(np.log(ratio / factor)) < settings.unit_tolerance:
            return unit
    return None


def _size(values: Array) -> float:
    """The mean length (rms) of rows, which no turn changes."""
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))


def _says_something(pair: SensorPair, settings: SensorSettings) -> bool:
    """Whether the model's sensor shows enough, and the other one anything."""
    least = dict(settings.least).get(pair.unit, np.inf)
    return _size(pair.modelled) > least and _size(pair.measured) > 0


def left_over(measured: Array, modelled: Array) -> float:
    """Compute the share of the model's mean square by which measurements are off.

    Parameters
    ----------
    measured, modelled : (n, k) arrays
        In the same unit.

    Returns
    -------
    float
    """
    return float(np.sum((measured - modelled) ** 2) / max(np.sum(modelled**2), 1e-300))


def _check_order(pair: SensorPair, settings: SensorSettings) -> Finding | None:
    """A quaternion in the order x, y, z, w."""
    if pair.reordered is None:
        return None
    if not _is_reordered_in_place(pair, settings):
        _, as_it_is = _best_turn([pair], settings)
        _, reordered = _best_turn([_with(pair, pair.reordered)], settings)
        if as_it_is < settings.right or reordered > settings.right:
            return None
    text = "its quaternion is in the order x, y, z, w, by how the model turns along the motion."
    return Finding("error", pair.name, text, "Map the four columns in the order w, x, y, z.")


def _is_reordered_in_place(pair: SensorPair, settings: SensorSettings) -> bool:
    """Whether an orientation is the model's in another order, and another one as it is."""
    if pair.away is None or pair.reordered_away is None:
        return False
    as_it_is, reordered = (
        float(np.median(np.linalg.norm(away, axis=1))) for away in (pair.away, pair.reordered_away)
    )
    return reordered < settings.world < 2 * settings.world < as_it_is


def _check_unit(pair: SensorPair, settings: SensorSettings) -> Finding | None:
    """Numbers in another unit than they are mapped in."""
    if pair.is_orientation:
        return None
    taken_for = {1 / factor: unit for unit, factor in FACTORS.get(pair.unit, {}).items()}
    mapped = next((taken_for[one] for one in taken_for if np.isclose(one, pair.factor)), None)
    found = unit_of(pair, settings)
    if mapped is None or found is None or found == mapped:
        return None
    scale = FACTORS[pair.unit][mapped] / FACTORS[pair.unit][found]
    _, rest = _best_turn([_with(pair, scale * pair.measured)], settings)
    if rest > settings.right:
        return None
    text = (
        f"it is {_size(pair.measured):.4g} {pair.unit} (rms), and the model's own is "
        f"{_size(pair.modelled):.4g} along the motion: its numbers are in {found}, not {mapped}."
    )
    return Finding("error", pair.name, text, f"Map `unit: {found}`.")


def _with(pair: SensorPair, measured: Array) -> SensorPair:
    """The pair with other measurements."""
    return replace(pair, measured=measured)


# Turned mounts


def _axis_turns() -> Array:
    """(24, 3, 3) the rotations that take axes to axes, from the least turn to the largest."""
    found = []
    for places in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), places] = signs
            if np.linalg.det(matrix) > 0:
                found.append(matrix)
    return np.array(sorted(found, key=lambda matrix: -np.trace(matrix)))


TURNS = _axis_turns()


def _rest_of_turns(pair: SensorPair) -> tuple[Array, Array]:
    """(24,) what is left over after each turn with the better sign, and (24,) the sign."""
    turned = np.einsum("tij,nj->tni", TURNS, pair.measured)
    rest = np.array([left_over(one, pair.modelled) for one in turned])
    if pair.is_orientation:
        return rest, np.ones(len(TURNS))
    opposite = np.array([left_over(-one, pair.modelled) for one in turned])
    return np.minimum(rest, opposite), np.where(opposite < rest, -1.0, 1.0)


def _best_turn(pairs: Sequence[SensorPair], settings: SensorSettings) -> tuple[int, float]:
    """The turn that fits sensors of one mount best, the smallest of those as good, and its rest."""
    rests = np.mean([_rest_of_turns(pair)[0] for pair in pairs], axis=0)
    best = int(np.flatnonzero(rests <= rests.min() + settings.tie)[0])
    return best, float(rests[best])


def _check_mount(pairs: Sequence[SensorPair], settings: SensorSettings) -> Iterator[Finding]:
    """Sensors of one mount that are turned, or of the wrong sign."""
    as_they_are = [left_over(pair.measured, pair.modelled) for pair in pairs]
    off = [pair for pair, rest in zip(pairs, as_they_are, strict=True) if rest > settings.wrong]
    if not off:
        yield from _check_tilt(pairs, settings)
        for pair in pairs:
            yield from _check_world(pair, settings)
        return
    turn, rest = _best_turn(pairs, settings)
    names = ", ".join(pair.name for pair in off)
    share = 100 * max(0.0, 1 - float(np.mean(as_they_are)))
    if rest < settings.right:
        text = (
            f"along the motion the model's own shows otherwise ({share:.0f} % of it as it is, "
            f"{100 * (1 - rest):.0f} % turned): {_what_is_wrong(pairs, turn)}."
        )
        yield Finding("error", names, text, _advice(pairs, turn))
        return
    matrix = _free_turn(pairs)
    rest = float(np.mean([left_over(one.measured @ matrix.T, one.modelled) for one in pairs]))
    if rest < settings.right and _is_determined(pairs, settings):
        text = (
            f"along the motion the model's own shows otherwise: it is turned by {_degrees(matrix)}."
        )
        yield Finding("error", names, text, _rotation_advice(pairs[0], matrix))
        return
    text = (
        "along the motion the model's own shows something else, which no unit, sign or turn of its "
        "mount explains."
    )
    yield Finding("warning", names, text, "See whether it is another sensor, or stands elsewhere.")


def _check_tilt(pairs: Sequence[SensorPair], settings: SensorSettings) -> Iterator[Finding]:
    """A mount that is turned by little."""
    if not _is_determined(pairs, settings):
        return
    matrix = _free_turn(pairs)
    before = [left_over(one.measured, one.modelled) for one in pairs]
    after = [left_over(one.measured @ matrix.T, one.modelled) for one in pairs]
    if _angle(matrix) > settings.tilt and sum(after) < settings.wrong * sum(before):
        names = ", ".join(pair.name for pair in pairs)
        text = f"along the motion it stands turned by {_degrees(matrix)} against the model's own."
        yield Finding("warning", names, text, _rotation_advice(pairs[0], matrix))


def _check_world(pair: SensorPair, settings: SensorSettings) -> Iterator[Finding]:
    """An orientation that is measured from another world than the model's, such as from north."""
    if pair.away is None:
        return
    typical = np.median(pair.away, axis=0)
    angle = float(np.linalg.norm(typical))
    scatter = float(np.median(np.linalg.norm(pair.away - typical, axis=1)))
    if angle > settings.world and scatter < 0.5 * angle:
        axis = ", ".join(f"{one:.2f}" for one in typical / angle)
        text = (
            f"it is measured from a world that is turned by {np.degrees(angle):.0f} degrees about "
            f"[{axis}] against the model's."
        )
        advice = "Turn the orientations into the model's world first, or leave the sensor out."
        yield Finding("error", pair.name, text, advice)


def _free_turn(pairs: Sequence[SensorPair]) -> Array:
    """(3, 3) the rotation that fits sensors of one mount best (Kabsch)."""
    product = np.zeros((3, 3))
    for pair in pairs:
        product += pair.modelled.T @ pair.measured / np.sum(pair.modelled**2)
    left, _, right = np.linalg.svd(product)
    return np.asarray(left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right)


def _is_determined(pairs: Sequence[SensorPair], settings: SensorSettings) -> bool:
    """Whether sensors of one mount show more than one direction."""
    spread = sum(pair.modelled.T @ pair.modelled / np.sum(pair.modelled**2) for pair in pairs)
    values = np.linalg.eigvalsh(spread)
    return bool(values[1] > settings.determined * values.sum())


def _angle(matrix: Array) -> float:
    """The angle of a rotation [rad]."""
    return float(np.arccos(np.clip((np.trace(matrix) - 1) / 2, -1, 1)))


def _degrees(matrix: Array) -> str:
    """The angle of a rotation, for a message."""
    return f"{np.degrees(_angle(matrix)):.0f} degrees"


def _what_is_wrong(pairs: Sequence[SensorPair], turn: int) -> str:
    """What a turn and its signs mean."""
    signs = _signs(pairs, turn)
    wrong = [pair.name for pair in pairs if signs[pair.name] < 0]
    parts = [f"its mount is turned by {_degrees(TURNS[turn])}"] if turn else []
    if wrong:
        whose = "its sign is" if len(wrong) == len(pairs) else f"the sign of {', '.join(wrong)} is"
        parts.append(f"{whose} the other one")
    return ", and ".join(parts)


def _signs(pairs: Sequence[SensorPair], turn: int) -> dict[str, float]:
    """By sensor the sign that fits with a turn."""
    return {pair.name: float(_rest_of_turns(pair)[1][turn]) for pair in pairs}


def _advice(pairs: Sequence[SensorPair], turn: int) -> str:
    """The entries to write."""
    signs = _signs(pairs, turn)
    lines = []
    if turn:
        lines.append(_rotation_advice(pairs[0], TURNS[turn]).removesuffix("."))
    for pair in pairs:
        if signs[pair.name] < 0:
            lines.append(f"Map `sign: {1 if pair.negative else -1}` of {pair.name}")
    advice = ", and m".join(lines[:1] + [line[1:] for line in lines[1:]]) + "."
    if turn and len(lines) > 1:  # two faults at once are less likely than one of the joints
        advice += " Or else a joint counts the other way round: see its `sign` first."
    return advice


def _rotation_advice(pair: SensorPair, matrix: Array) -> str:
    """The rotation to write for all sensors of a mount, on top of the one that is mapped."""
    from scipy.spatial.transform import Rotation  # slow to import

    if pair.rotation is not None:
        matrix = matrix @ Rotation.from_quat(pair.rotation, scalar_first=True).as_matrix()
    if np.allclose(np.abs(matrix).max(axis=1), 1, atol=1e-6):
        axes = []
        for row in matrix:
            place = int(np.argmax(np.abs(row)))
            axes.append(("-" if row[place] < 0 else "") + "xyz"[place])
        written = ", ".join(axes)
    else:
        quaternion = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
        written = ", ".join(f"{one:.4f}" for one in quaternion)
    return f"Map `rotation: [{written}]` of all sensors of this mount."


def check_gravity(
    name: str, lengths: Array, factor: float, gravity: float, settings: SensorSettings = DEFAULTS
) -> Iterator[Finding]:
    """Find an accelerometer in another unit, by gravity, which it shows most of the time.

    Parameters
    ----------
    name : str
        The sensor, as in "sensordata.acc".
    lengths : (n,) array
        Of what it shows [m/s^2].
    factor : float
        What one of the log's unit was taken for, in m/s^2.
    gravity : float
        The model's [m/s^2].
    settings : SensorSettings, optional
        How near a unit must be.

    Yields
    ------
    Finding
        At most one.
    """
    units = FACTORS["m/s^2"]
    mapped = next((unit for unit, one in units.items() if np.isclose(1 / one, factor)), None)
    if mapped is None or gravity <= 0 or len(lengths) < settings.rows:
        return
    ratio = float(np.median(lengths)) / factor / gravity
    if ratio <= 0:
        return
    off = {unit: abs(np.log(ratio / one)) for unit, one in units.items()}
    found = min(off, key=lambda unit: off[unit])
    if found != mapped and off[found] < settings.unit_tolerance:
        text = (
            f"it shows {np.median(lengths):.4g} m/s^2 most of the time, and gravity is "
            f"{gravity:.4g}: its numbers are in {found}, not {mapped}."
        )
        yield Finding("error", name, text, f"Map `unit: {found}`.")
