"""What a diagnosis says, in typed parts: causes, alternatives to them, suspects, what remains."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from dropo.core.numerics.tails import student_quantile
from dropo.core.records.fits.fit_parts import number_or_nan, number_or_null
from dropo.core.services.tables import number, steps_text


@dataclass(frozen=True)
class Estimate:
    """A quantity of an effect.

    Attributes
    ----------
    value : float
        What is added to the model, in `unit`.
    se : float
        Its standard error; NaN where there is none.
    unit : str
        "1" for a number without one.
    model : float or None
        The model's own number; None where it has none.
    degrees : float
        Degrees of freedom of the standard error; infinite where it is as good as known.
    """

    value: float
    se: float
    unit: str
    model: float | None = None
    degrees: float = np.inf

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Give an interval by Student's t.

        Parameters
        ----------
        level : float
            How often it is to hold what is missing, between 0 and 1.

        Returns
        -------
        tuple of float
            Its ends, in `unit`; NaN where there is no standard error.
        """
        half = self.se * float(student_quantile(0.5 + level / 2, self.degrees))
        return self.value - half, self.value + half

    def __str__(self) -> str:
        """Such as "+0.79 +- 0.01 N m"."""
        error = "?" if number_or_null(self.se) is None else number(self.se, 2)
        return f"{self.value:+.3g} +- {error} {self.unit}".removesuffix(" 1")

    def to_json(self) -> dict[str, Any]:
        """As diagnosis.json has it.

        Returns
        -------
        dict
            As diagnosis.json has it.
        """
        return {
            "value": self.value,
            "se": number_or_null(self.se),
            "unit": self.unit,
            "model": self.model,
            "interval": [number_or_null(end) for end in self.interval()],
            "degrees": number_or_null(self.degrees),
        }

    @classmethod
    def from_json(cls, saved: Mapping[str, Any]) -> Self:
        """Make it again from its entries.

        Parameters
        ----------
        saved : mapping
            What `to_json` gave.

        Returns
        -------
        Estimate
        """
        se = number_or_nan(saved["se"])
        degrees = saved.get("degrees")
        freedom = np.inf if degrees is None else float(degrees)
        return cls(saved["value"], se, saved["unit"], saved.get("model"), freedom)


@dataclass(frozen=True)
class Alternative:
    """An effect that the data cannot tell from the cause.

    Attributes
    ----------
    effect, variant : str
        Which one.
    target : str or None
        Where it acts; None where it is global.
    why : str
        Why it cannot be distinguished from the cause.
    to_tell : str or None
        What to record to tell the two apart; None where nothing was found.
    formula : str
        The text of a law, else "".
    """

    effect: str
    target: str | None
    variant: str
    why: str
    to_tell: str | None = None
    formula: str = ""

    @property
    def place(self) -> str:
        """The effect and where it acts, in words."""
        return effect_in_words(self.effect, self.target, self.variant, self.formula)

    def to_json(self) -> dict[str, Any]:
        """As diagnosis.json has it.

        Returns
        -------
        dict
            As diagnosis.json has it.
        """
        found = {
            "effect": self.effect,
            "target": self.target,
            "variant": self.variant,
            "why": self.why,
        }
        if self.formula:
            found["formula"] = self.formula
        return found if self.to_tell is None else {**found, "to_tell": self.to_tell}

    @classmethod
    def from_json(cls, saved: Mapping[str, Any]) -> Self:
        """Make it again from its entries.

        Parameters
        ----------
        saved : mapping
            What `to_json` gave.

        Returns
        -------
        Alternative
        """
        return cls(
            effect=saved["effect"],
            target=saved["target"],
            variant=saved.get("variant", ""),
            why=saved["why"],
            to_tell=saved.get("to_tell"),
            formula=saved.get("formula", ""),
        )


@dataclass(frozen=True)
class Stability:
    """In which parts of the data the same cause is named.

    Attributes
    ----------
    windows : mapping of int to bool
        By the length of windows [control steps].
    halves : tuple of bool
        In the first half of the windows alone, and in the second.
    """

    windows: Mapping[int, bool]
    halves: tuple[bool, bool]

    @property
    def named(self) -> int:
        """In how many of these."""
        return sum(self.windows.values()) + sum(self.halves)

    @property
    def of(self) -> int:
        """How many there are."""
        return len(self.windows) + len(self.halves)

    def doubt(self) -> str | None:
        """Say where the cause is not named.

        Returns
        -------
        str or None
            None where it is named everywhere.
        """
        lengths = [steps_text(steps) for steps, named in self.windows.items() if not named]
        parts = [f"windows of {', '.join(lengths)}"] if lengths else []
        names = ("first", "second")
        halves = [name for name, named in zip(names, self.halves, strict=True) if not named]
        parts += [f"the {half} half of the data" for half in halves]
        return " and ".join(parts) or None

    def to_json(self) -> dict[str, Any]:
        """As diagnosis.json has it.

        Returns
        -------
        dict
            As diagnosis.json has it.
        """
        return {
            "named": self.named,
            "of": self.of,
            "windows": {str(steps): named for steps, named in self.windows.items()},
            "halves": list(self.halves),
        }

    @classmethod
    def from_json(cls, saved: Mapping[str, Any]) -> Self:
        """Make it again from its entries.

        Parameters
        ----------
        saved : mapping
            What `to_json` gave.

        Returns
        -------
        Stability
        """
        windows = {int(steps): named for steps, named in saved["windows"].items()}
        first, second = saved["halves"]
        return cls(windows, (first, second))


@dataclass(frozen=True)
class Cause:
    """An effect that the windows held out confirm.

    Attributes
    ----------
    effect, variant : str
        Which one.
    target : str or None
        Where it acts; None where it is global.
    estimate : mapping of str to Estimate
        By quantity.
    p_value : float
        For all effects that were tried.
    held_out_gain, held_out_gain_se : float
        What it gains on data held out, and its standard error [nats per transition].
    rmse_before, rmse_after : float
        The error at the end of the windows held out without it and with everything that was found,
        in units of each signal's spread.
    confused_with : tuple of Alternative
        What the data cannot tell from it.
    acts_like : str or None
        The variable with which its size differs; None where none is known. Whether the effect is
        stated as a cause is a matter of the whole diagnosis: see `Diagnosis.stated`.
    stability : Stability or None
        Where else it is named; None where that was not tried, as where whole motions were fitted.
    formula : str
        The text of a law, whose constants are in `estimate`, else "".
    called : str
        The nearest law that has a name, such as "quadratic drag"; "" where it is not known.
    to_change : str
        Of columns that are not what the model takes them for: what to change, else "".
    """

    effect: str
    target: str | None
    variant: str
    estimate: Mapping[str, Estimate]
    p_value: float
    held_out_gain: float
    held_out_gain_se: float
    rmse_before: float
    rmse_after: float
    confused_with: tuple[Alternative, ...] = ()
    acts_like: str | None = None
    stability: Stability | None = None
    formula: str = ""
    called: str = ""
    to_change: str = ""

    @property
    def place(self) -> str:
        """The effect and where it acts, in words."""
        return effect_in_words(self.effect, self.target, self.variant, self.formula)

    @property
    def sentence(self) -> str:
        """Such as "joint damping at leg_joint, damping +0.79 +- 0.01 N m s/rad"."""
        place = f"{self.place} ({self.called})" if self.called else self.place
        return ", ".join([place, *(f"{name} {e}" for name, e in self.estimate.items())])

    def to_json(self, rank: int) -> dict[str, Any]:
        """Give plain numbers and texts.

        Parameters
        ----------
        rank : int
            Its place among the causes, from 1.

        Returns
        -------
        dict
            As diagnosis.json has it.
        """
        law = {"formula": self.formula, "called": self.called} if self.formula else {}
        if self.to_change:
            law = {"to_change": self.to_change}
        return {
            "effect": self.effect,
            "target": self.target,
            "variant": self.variant,
            **law,
            "rank": rank,
            "estimate": {name: found.to_json() for name, found in self.estimate.items()},
            "p_value": self.p_value,
            "held_out_gain": self.held_out_gain,
            "held_out_gain_se": self.held_out_gain_se,
            "rmse_before": number_or_null(self.rmse_before),
            "rmse_after": number_or_null(self.rmse_after),
            "confused_with": [other.to_json() for other in self.confused_with],
            "acts_like": self.acts_like,
            "stability": None if self.stability is None else self.stability.to_json(),
        }

    @classmethod
    def from_json(cls, saved: Mapping[str, Any]) -> Self:
        """Make it again from its entries.

        Parameters
        ----------
        saved : mapping
            What `to_json` gave.

        Returns
        -------
        Cause
        """
        estimate = {name: Estimate.from_json(found) for name, found in saved["estimate"].items()}
        stability = saved.get("stability")
        return cls(
            effect=saved["effect"],
            target=saved["target"],
            variant=saved.get("variant", ""),
            estimate=estimate,
            p_value=saved["p_value"],
            held_out_gain=saved["held_out_gain"],
            held_out_gain_se=saved["held_out_gain_se"],
            rmse_before=number_or_nan(saved["rmse_before"]),
            rmse_after=number_or_nan(saved["rmse_after"]),
            confused_with=tuple(map(Alternative.from_json, saved["confused_with"])),
            acts_like=saved.get("acts_like"),
            stability=None if stability is None else Stability.from_json(stability),
            formula=saved.get("formula", ""),
            called=saved.get("called", ""),
            to_change=saved.get("to_change", ""),
        )


@dataclass(frozen=True)
class Suspect:
    """An effect that seemed to help and was not confirmed.

    Attributes
    ----------
    effect : str
        Which one.
    target : str or None
        Where it would act; None where it is global.
    p_value : float
        For all effects that were tried.
    held_out_gain : float
        On data held out [nats per transition].
    """

    effect: str
    target: str | None
    p_value: float
    held_out_gain: float

    @property
    def label(self) -> str:
        """Such as "joint_damping:elbow"."""
        return self.effect + (f":{self.target}" if self.target else "")

    def to_json(self) -> dict[str, Any]:
        """As diagnosis.json has it.

        Returns
        -------
        dict
            As diagnosis.json has it.
        """
        return dict(vars(self))

    @classmethod
    def from_json(cls, saved: Mapping[str, Any]) -> Self:
        """Make it again from its entries.

        Parameters
        ----------
        saved : mapping
            What `to_json` gave.

        Returns
        -------
        Suspect
        """
        return cls(**saved)


@dataclass(frozen=True)
class Leader:
    """An effect that gained most on the data held out, and was not confirmed.

    Attributes
    ----------
    effect, variant : str
        Which one.
    target : str or None
        Where it would act; None where it is global.
    gain, gain_se : float
        On all windows held out, and its standard error [nats].
    times : float
        How many times as much data would confirm it, if it goes on gaining like this; infinite or
        NaN where no amount would.
    why : str
        Why it is no cause all the same, where data held out are sure of the gain; else "".
    steps : int
        The horizon [control steps] that speaks against it then; else 0.
    """

    effect: str
    target: str | None
    variant: str
    gain: float
    gain_se: float
    times: float
    why: str = ""
    steps: int = 0

    @property
    def sentence(self) -> str:
        """What was not confirmed, and what to do."""
        place = effect_in_words(self.effect, self.target, self.variant)
        gain = f"{number(self.gain, 3)} +- {number(self.gain_se, 2)} nats on data held out"
        if self.why:
            return (
                f"not accepted: {place}, {gain}, but {self.why}; something else that the model "
                "lacks may act like it"
            )
        record = "record other motion"
        if np.isfinite(self.times):
            record = f"record {number(max(2.0, self.times), 2)} times as much to be sure"
        return f"not confirmed: {place}, {gain}; {record}"

    def to_json(self) -> dict[str, Any]:
        """As diagnosis.json has it.

        Returns
        -------
        dict
            As diagnosis.json has it.
        """
        return {
            **vars(self),
            "gain_se": number_or_null(self.gain_se),
            "times": number_or_null(self.times),
            "record": self.sentence.rpartition("; ")[2],
        }

    @classmethod
    def from_json(cls, saved: Mapping[str, Any]) -> Self:
        """Make it again from its entries.

        Parameters
        ----------
        saved : mapping
            What `to_json` gave.

        Returns
        -------
        Leader
        """
        return cls(
            effect=saved["effect"],
            target=saved["target"],
            variant=saved["variant"],
            gain=saved["gain"],
            gain_se=number_or_nan(saved["gain_se"]),
            times=number_or_nan(saved["times"]),
            why=saved.get("why", ""),
            steps=saved.get("steps", 0),
        )


@dataclass(frozen=True)
class Remaining:
    """What is still wrong once all that was found is there.

    Attributes
    ----------
    calibrated : bool
        Whether nothing is.
    p_value : float
        Of the stronger of the tests for forces and for structure; NaN where nothing was tested.
    where : tuple of str
        In which signals, joints and regime, in words.
    forces : mapping of str to float
        By joint and unit, the standard deviation of a force that nothing explains, each control
        step anew; empty where there is none.
    """

    calibrated: bool
    p_value: float
    where: tuple[str, ...]
    forces: Mapping[str, float]

    def to_json(self) -> dict[str, Any]:
        """As diagnosis.json has it.

        Returns
        -------
        dict
            As diagnosis.json has it.
        """
        return {
            "calibrated": self.calibrated,
            "p_value": number_or_null(self.p_value),
            "where": list(self.where),
            "forces": dict(self.forces),
        }


def are_stated(verdict: str) -> bool:
    """Say whether the effects that a diagnosis names are stated as causes.

    They are where nothing remains unexplained beside them. Elsewhere what is missing acts like
    them: something else may be behind each.

    Parameters
    ----------
    verdict : {"consistent", "explained", "partly", "unexplained"}
        Of the diagnosis.

    Returns
    -------
    bool
    """
    return verdict == "explained"


def effect_in_words(effect: str, target: str | None, variant: str, formula: str = "") -> str:
    """Write an effect and where it acts: "joint damping at knee", "contact stiffness (margin)".

    Parameters
    ----------
    effect, variant : str
        Its name, and which kind of it; empty where it has one kind.
    target : str or None
        Where it acts; None where it is global.
    formula : str
        The text of a law.

    Returns
    -------
    str
    """
    where = f" at {target}" if target else ""
    kind = f" ({variant})" if variant else ""
    name = f"the law {formula}" if formula else effect.replace("_", " ")
    return f"{name}{where}{kind}"
