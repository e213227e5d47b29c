"""What a consistent model's data would have shown: the smallest size of each usual effect.

At this size the gain that is expected on the data held out passes what confirms an effect. It comes
from the linearized windows and a few simulations of each effect; nothing is searched anew.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.services.tables import Table, number
from dropo.core.services.validation import Array
from dropo.diagnosis.parts import effect_in_words
from dropo.diagnosis.search.confirmation import SelectionSettings
from dropo.diagnosis.search.linearization import Library, LinearizedWindows
from dropo.diagnosis.search.trials import State


@dataclass(frozen=True)
class DetectableSettings:
    """Which effects are asked for, and how their smallest sizes are found.

    Attributes
    ----------
    effects : tuple of str
        The usual effects, in the order in which they are listed.
    rounds : int
        How often an effect is simulated anew at the size that the last simulation says.
    close : float
        Relative change of the size below which it is settled.
    most : float
        Factor by which a size changes at most from one simulation to the next.
    none : float
        Length of a window's response, in standard deviations of its noise, at the largest size that
        is tried, below which nothing is shown.
    """

    effects: tuple[str, ...] = (
        "joint_damping",
        "joint_friction",
        "joint_armature",
        "actuator_gain",
        "actuator_delay",
        "payload",
    )
    rounds: int = 6
    close: float = 0.1
    most: float = 30.0
    none: float = 1e-6


SETTINGS = DetectableSettings()


@dataclass(frozen=True)
class Detectable:
    """The size of an effect that the data would have shown.

    Attributes
    ----------
    effect, variant : str
        Which one.
    target : str or None
        Where it would act; None where it is global.
    quantity, unit : str
        Of which number; "1" for a unit where there is none.
    size : float or None
        From which on it would have been confirmed; None where no size within the effect's bounds
        would have been.
    """

    effect: str
    target: str | None
    variant: str
    quantity: str
    unit: str
    size: float | None

    @property
    def label(self) -> str:
        """Such as "elbow 0.0021", or "elbow: none" where no size would have been shown."""
        place = self.target or "all"
        if self.size is None:
            return f"{place} at no size"
        return f"{place} {number(self.size, 2)}"

    def to_json(self) -> dict[str, Any]:
        """As diagnosis.json has it.

        Returns
        -------
        dict
            As diagnosis.json has it.
        """
        return dict(vars(self))

    @classmethod
    def from_json(cls, saved: dict[str, Any]) -> Self:
        """Make it again from its entries.

        Parameters
        ----------
        saved : mapping
            What `to_json` gave.

        Returns
        -------
        Detectable
        """
        return cls(**saved)


def detectable(
    library: Library,
    last: State,
    instances: Sequence[EffectInstance],
    count: int,
    selection: SelectionSettings,
    settings: DetectableSettings = SETTINGS,
) -> tuple[Detectable, ...]:
    """Find the sizes of usual effects that the data would have shown.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    last : State
        The model that explains the data, without any effect.
    instances : sequence of EffectInstance
        The effects that were looked for.
    count : int
        How many these are.
    selection : SelectionSettings
        When an effect is accepted.
    settings : DetectableSettings
        Which are asked for.

    Returns
    -------
    tuple of Detectable
        One of each usual effect and place; of joints the single ones, not several together.

    Notes
    -----
    A true effect whose whitened response in window w has the squared length s^2 a_w gains
    s^2 a_w / 2 +- s sqrt(a_w) nats there. What the free numbers explain of it is no gain.
    """
    usual = [
        instance
        for name in settings.effects
        for instance in instances
        if instance.effect == name and instance.time_profile is None and not instance.variant
    ]
    basis = _explained(library, last.test, last.free)
    found = []
    for instance in usual:
        size = _smallest(library, last, instance, basis, count, selection, settings)
        quantity = instance.quantities[0]
        found.append(
            Detectable(
                instance.effect,
                instance.target,
                instance.variant,
                quantity.name,
                quantity.unit,
                size,
            )
        )
    return tuple(found)


def _smallest(
    library: Library,
    last: State,
    instance: EffectInstance,
    basis: Array | None,
    count: int,
    selection: SelectionSettings,
    settings: DetectableSettings,
) -> float | None:
    """The smallest size of one effect, by the sign that needs more; None where there is none."""
    space = library.simulator.space
    indices = library.indices_of[instance.label]
    first = int(indices[0])
    theta = last.theta.copy()
    if instance.linear_in is not None:
        # It acts in proportion to its first magnitude, wherever it is.
        theta[indices[1:]] = instance.trials[0][0][1:]
    base = float(theta[first])
    room = {1.0: float(space.high[first]) - base, -1.0: base - float(space.low[first])}
    probe = min(abs(value) for value in instance.quantities[0].probes)
    sizes: list[float] = []
    for sign, most in room.items():
        if sign < 0 and most < probe:
            continue  # what cannot be less is asked for on one side
        # Where the effect is the same either way, the size of the other sign is it.
        size = min(max(sizes, default=probe), most)
        needed = None
        for _ in range(settings.rounds):
            theta[first] = base + sign * size
            squares = _squares(library, last.test, theta, basis)
            if squares is None or np.sqrt(squares.max()) < settings.none:
                needed = None
                break
            times = _times(squares, last.test, count, selection)
            if times is None:
                needed = None
                break
            needed = size * times
            if abs(times - 1) < settings.close:
                break
            size = min(size * float(np.clip(times, 1 / settings.most, settings.most)), most)
        if needed is None or needed > most * (1 + settings.close):
            continue
        sizes.append(needed)
    return max(sizes, default=None)


def _squares(
    library: Library, test: LinearizedWindows, theta: Array, basis: Array | None
) -> Array | None:
    """(W,) the squared length of each window's whitened response; None where it diverges."""
    response = library.predict(theta[None], test.windows)[0] - test.predicted
    if not np.isfinite(response[~test.lost]).all():
        return None
    whitened = test.flat(np.nan_to_num(response))
    if basis is not None:
        whitened = whitened - (whitened @ basis) @ basis.T
    return np.asarray((whitened.reshape(len(test.windows), -1) ** 2).sum(axis=1))


def _explained(library: Library, test: LinearizedWindows, free: Array) -> Array | None:
    """An orthonormal basis of what the free numbers explain."""
    if not len(free):
        return None
    jacobian = library.jacobian(test.theta, free, test.windows)
    return np.asarray(np.linalg.qr(test.flat(jacobian).T)[0])


def _times(
    squares: Array, test: LinearizedWindows, count: int, selection: SelectionSettings
) -> float | None:
    """By what multiple of a response the conditions of an effect are expected to be met."""
    needed = max(selection.needed_gain(count), selection.minimum_fitted_gain)
    _, block = np.unique(test.windows.block, return_inverse=True)
    of_block = np.bincount(block, weights=squares)
    multiples = np.geomspace(1e-4, 1e4, 801)
    for times in multiples.tolist():
        gain = 0.5 * times**2 * squares
        blocks = 0.5 * times**2 * of_block
        if gain.sum() < needed:
            continue
        if _z(blocks, times**2 * of_block) < selection.block_z:
            continue
        certain = _z(gain, times**2 * squares) > selection.window_z
        # Else most windows gain: each does with the probability of its own z-value.
        chance = 0.5 * times * np.sqrt(squares)
        most = _sign_score(chance) > selection.window_z
        responding = gain > selection.response
        few = responding.sum() >= selection.few_windows and bool(
            np.all(chance[responding] > selection.block_z)
        )
        if certain or most or few:
            return float(times)
    return None


def _z(gains: Array, variances: Array) -> float:
    """The standard errors by which a sum of gains is expected to exceed 0."""
    spread = float(gains.var(ddof=1)) + float(variances.mean()) if len(gains) > 1 else np.inf
    return float(gains.sum() / max(np.sqrt(len(gains) * spread), 1e-300))


def _sign_score(chance: Array) -> float:
    """The expected normal score of signed ranks, the windows of largest response ranked highest.

    chance: (W,) the expected gain of each window in its standard deviations.
    """
    from scipy.special import ndtr
    from scipy.stats import rankdata

    n = len(chance)
    ranks = rankdata(chance)
    signs = 2 * ndtr(chance) - 1
    return float(np.sum(signs * ranks) / np.sqrt(n * (n + 1) * (2 * n + 1) / 6))


def detectable_table(found: Sequence[Detectable]) -> Table:
    """Make a table with a row for each effect.

    Parameters
    ----------
    found : sequence of Detectable
        The sizes, those of one effect together.

    Returns
    -------
    Table
    """
    rows: dict[tuple[str, str, str], list[str]] = {}
    for one in found:
        name = effect_in_words(one.effect, None, one.variant)
        rows.setdefault((name, one.quantity, one.unit), []).append(one.label)
    listed = tuple(
        (name, f"{quantity} [{unit}]".removesuffix(" [1]"), ", ".join(labels))
        for (name, quantity, unit), labels in rows.items()
    )
    header = ("effect", "size", "shown from")
    return Table("What these data would have shown, at its smallest", header, listed)
