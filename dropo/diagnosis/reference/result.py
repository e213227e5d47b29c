"""What a comparison with reference runs found."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dropo.core.services.files.atomic_write import write_json
from dropo.core.services.tables import Report, Table, number
from dropo.diagnosis.parts import Estimate


@dataclass(frozen=True)
class RunDifference:
    """One thing that differs in a run.

    Attributes
    ----------
    effect : str
        What it is: an effect, or "parameter".
    target : str or None
        Where it acts; of a declared parameter its name.
    variant : str
        Which of the effect's forms at that place: of a payload the site.
    quantity : str
        What is estimated.
    estimate : Estimate
        How much there is beside the reference runs.
    t : float
        The size in standard errors of a difference between two normal runs.
    confused_with : tuple of str
        Labels of others that explain the run about as well.
    """

    effect: str
    target: str | None
    variant: str
    quantity: str
    estimate: Estimate
    t: float
    confused_with: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Such as "actuator_gain:M3" or "payload:crazyflie.M4"."""
        place = f":{self.target}" if self.target else ""
        return f"{self.effect}{place}{'.' if self.variant else ''}{self.variant}"

    def to_json(self) -> dict[str, Any]:
        """Plain numbers.

        Returns
        -------
        dict
            Plain numbers and texts, by key.
        """
        return {
            "effect": self.effect,
            "target": self.target,
            "variant": self.variant,
            "estimate": {self.quantity: self.estimate.to_json()},
            "t": self.t,
            "confused_with": list(self.confused_with),
        }


@dataclass(frozen=True)
class ComparedRun:
    """One run beside the reference runs.

    Attributes
    ----------
    name : str
        Its name, or its number.
    is_reference : bool
        Whether it is a reference run itself; it is then compared with the others.
    p_value : float
        The chance of a normal run to be as far off.
    differs : bool
        Whether that is below the level.
    causes : tuple of RunDifference
        What differs, the largest first; may be empty where nothing that was looked for explains it.
    numbers : tuple of float
        The run's own numbers, in the order of `RunComparison.numbers`.
    """

    name: str
    is_reference: bool
    p_value: float
    differs: bool
    causes: tuple[RunDifference, ...]
    numbers: tuple[float, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers.

        Returns
        -------
        dict
            Plain numbers and texts, by key.
        """
        return {
            "run": self.name,
            "reference": self.is_reference,
            "differs": self.differs,
            "p_value": self.p_value,
            "causes": [cause.to_json() for cause in self.causes],
            "numbers": list(self.numbers),
        }


@dataclass(frozen=True, repr=False, kw_only=True)
class RunComparison(Report):
    """What differs in each run from the reference runs.

    Attributes
    ----------
    name : str
        The problem's.
    numbers : tuple of str
        The numbers that describe a run.
    mean, spread : tuple of float
        Their means over the reference runs, and the standard deviations between these.
    runs : tuple of ComparedRun
        All runs, in the order of the data.
    level : float
        Chance at which a normal run is said to differ.
    tolerances : tuple of str
        What may differ between normal runs beyond what the reference runs show, in words.
    simulator_steps : int
        What it cost.
    """

    name: str
    numbers: tuple[str, ...]
    mean: tuple[float, ...]
    spread: tuple[float, ...]
    runs: tuple[ComparedRun, ...]
    level: float
    tolerances: tuple[str, ...]
    simulator_steps: int

    def headline(self) -> str:
        """Say how many runs differ.

        Returns
        -------
        str
            In a sentence.
        """
        others = [run for run in self.runs if not run.is_reference]
        normal = [run for run in self.runs if run.is_reference]
        text = f"{sum(run.differs for run in others)} of {len(others)} runs differ from the"
        text += f" {len(normal)} reference runs"
        odd = sum(run.differs for run in normal)
        if odd:
            text += f"; {odd} of the reference runs differ{'s' * (odd == 1)} from the rest of them"
        return f"{text}."

    def parts(self) -> list[str | Table]:
        """The headline, a row for each run, and the numbers of the reference runs."""
        rows = []
        for run in self.runs:
            kind = "reference" if run.is_reference else ""
            p = number(run.p_value, 1)
            if not run.causes:
                what = "nothing that was looked for" if run.differs else "-"
                rows.append((run.name, kind, p, what, "", ""))
            for cause in run.causes:
                size = f"{cause.quantity} {cause.estimate}"
                others = ", ".join(cause.confused_with)
                rows.append((run.name, kind, p, cause.label, size, others))
        header = ("run", "", "p", "differs in", "by", "cannot be told from")
        of_reference = [
            (name, number(mean, 4), number(spread, 2))
            for name, mean, spread in zip(self.numbers, self.mean, self.spread, strict=True)
        ]
        lines: list[str | Table] = [
            self.headline(),
            Table("Each run beside the reference runs", header, tuple(rows)),
            Table("Reference runs", ("number", "mean", "sd between runs"), tuple(of_reference)),
        ]
        if self.tolerances:
            lines.append(f"Taken as normal, when a cause is named: {', '.join(self.tolerances)}.")
        return lines

    def to_json(self) -> dict[str, Any]:
        """The content of runs.json.

        Returns
        -------
        dict
            As runs.json has it.
        """
        from dropo._version import __version__

        return {
            "problem": self.name,
            "headline": self.headline(),
            "level": self.level,
            "numbers": [
                {"name": name, "mean": mean, "sd": spread}
                for name, mean, spread in zip(self.numbers, self.mean, self.spread, strict=True)
            ],
            "tolerances": list(self.tolerances),
            "runs": [run.to_json() for run in self.runs],
            "simulator_steps": self.simulator_steps,
            "version": __version__,
        }

    def save(self, folder: str | Path) -> None:
        """Write runs.json into a folder, whole or not at all.

        Parameters
        ----------
        folder : str or Path
            Made where it is missing.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / "runs.json", self.to_json())
