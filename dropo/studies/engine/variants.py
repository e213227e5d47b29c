"""Methods with parts exchanged, as `recover` and `compare` take them."""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from itertools import product
from typing import Any

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.likelihood import AUTOMATIC
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.fit_by_name import estimator_for
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import require

PARTS = {"likelihood": "likelihoods", "optimizer": "optimizers", "family": "families"}
"""Settings that are parts with a name, and the kind of each."""
DEFAULT = "dropo"
"""The method that stands in the first row."""


@dataclass(frozen=True)
class Variant:
    """A method with some of its settings exchanged.

    Attributes
    ----------
    method : str
        Its name.
    settings : mapping of str to object
        What differs from its own, as JSON holds it.
    """

    method: str = DEFAULT
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Such as "dropo, optimizer nlopt-sbplx"; the method alone where nothing differs."""
        settings = [f"{name} {value}" for name, value in self.settings.items()]
        return ", ".join([self.method, *settings])

    def estimator(self, problem: Problem) -> Estimator:
        """Make the method for a problem.

        Parameters
        ----------
        problem : Problem
            What it is to fit, whose own settings hold where the variant has none.

        Returns
        -------
        Estimator

        Raises
        ------
        InvalidInput
            If a name does not exist, or the method takes no such setting.
        """
        return estimator_for(problem, self.method, dict(self.settings))

    def shares_likelihood(self, other: "Variant") -> bool:
        """Tell whether log-likelihoods of two variants are on one scale.

        Parameters
        ----------
        other : Variant
            The other one.

        Returns
        -------
        bool
            Whether both have the same method and likelihood.

        Raises
        ------
        UnknownName
            If one of the methods does not exist.
        """
        return self._scale() == other._scale()

    def _scale(self) -> tuple[str, Any]:
        """The method, and the name of its likelihood, if it has one."""
        own = getattr(find("methods", self.method), "likelihood", None)
        # What is chosen by itself is this one, but for logs of which starts must be found.
        usual = "emulated" if own == AUTOMATIC else own
        return self.method, self.settings.get("likelihood", usual)

    def to_json(self) -> dict[str, Any]:
        """Give the variant as the item of a task holds it.

        Returns
        -------
        dict
            `Variant(**item)` reads it.
        """
        return {"method": self.method, "settings": dict(self.settings)}


def variants_of(
    methods: Sequence[str] = (), budget: int | None = None, **parts: Sequence[str]
) -> list[Variant]:
    """List every method with every combination of the parts that it takes.

    Parameters
    ----------
    methods : sequence of str
        Names of methods; the default's alone where empty.
    budget : int or None
        Evaluations at most, for the methods that take a budget.
    **parts : sequence of str
        Names by part: `likelihood`, `optimizer`, `family`.

    Returns
    -------
    list of Variant
        Without the default itself, which stands beside them.

    Raises
    ------
    UnknownName
        If a name does not exist; the message gives the nearest one.
    Incompatible
        If none of the methods takes a part that is named.
    """
    for part, names in parts.items():
        for name in names:
            find(PARTS[part], name)
    methods = tuple(methods) or (DEFAULT,)
    takes = {method: _settings(method) for method in methods}
    named: dict[str, tuple[Any, ...]] = {}
    for part, names in parts.items():
        if names:
            named[part] = tuple(dict.fromkeys(names))
    if budget is not None:
        require(budget >= 1, "budget", "at least 1", budget, "recover")
        named["budget"] = (budget,)
    for part in named:
        if not any(part in taken for taken in takes.values()):
            raise Incompatible(
                f"No method of these takes a {part}: {', '.join(methods)}. Leave --{part} out."
            )
    found = []
    for method in dict.fromkeys(methods):
        own = {part: names for part, names in named.items() if part in takes[method]}
        for chosen in product(*own.values()):
            found.append(Variant(method, dict(zip(own, chosen, strict=True))))
    return [variant for variant in found if variant != Variant()]


def variant_of(given: Any) -> Variant:
    """Read a variant from what a caller in Python gives.

    Parameters
    ----------
    given : str, mapping, Variant or Estimator
        A method's name; settings with the name as "method"; or the method itself, with settings
        that JSON can hold.

    Returns
    -------
    Variant

    Raises
    ------
    UnknownName
        If a name does not exist.
    BadArgument
        If it is none of these, or a setting is no number, text or list.
    """
    if isinstance(given, Variant):
        return given
    if isinstance(given, str):
        find("methods", given)
        return Variant(given)
    if isinstance(given, Mapping):
        settings = dict(given)
        method = settings.pop("method", DEFAULT)
        find("methods", method)
        return Variant(method, settings)
    rule = "a method's name, a dict of settings with it, or an Estimator"
    require(isinstance(given, Estimator), "estimators", rule, given, "compare")
    find("methods", given.name)
    return Variant(given.name, _changed(given))


def _settings(method: str) -> set[str]:
    """The names of the settings that a method takes."""
    return {setting.name for setting in fields(find("methods", method))}


def _changed(estimator: Any) -> dict[str, Any]:
    """The settings of an estimator that are not its class's own."""
    changed = {}
    for setting in fields(estimator):
        value = getattr(estimator, setting.name)
        if setting.default is not MISSING and value == setting.default:
            continue
        if setting.default_factory is not MISSING and value == setting.default_factory():
            continue
        if not isinstance(value, bool | int | float | str | list | tuple | None):
            raise BadArgument(
                f"{type(estimator).__name__}: {setting.name}: a comparison takes settings that a"
                f" file can hold: numbers, texts and lists. Got {type(value).__name__}."
            )
        changed[setting.name] = list(value) if isinstance(value, tuple) else value
    return changed
