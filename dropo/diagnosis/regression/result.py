"""What a diagnosis by regression found."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

from dropo.core.contracts.problem import Problem
from dropo.core.services.files.atomic_write import write_json
from dropo.core.services.tables import Report, Table, number
from dropo.diagnosis.findings.to_type import typed_lines
from dropo.diagnosis.parts import Cause
from dropo.diagnosis.regression.contacts import EFFECT

VERDICTS = {
    "consistent": "No force is missing that this log could show.",
    "explained": "With these numbers the forces along the log are explained.",
    "partly": "With these numbers a part of the forces remains unexplained.",
    "unexplained": "Forces are missing that none of the linear laws explains.",
}


@dataclass(frozen=True)
class Evidence:
    """How much of the forces a fault explains, on data held out.

    Attributes
    ----------
    removed : float
        The fraction of the squared unexplained force, at the joints that it names, that is gone
        once the columns are read right.
    gain, gain_se : float
        The same [nats per row of the equation of motion], and its standard error over blocks.
    before, after : float
        Root mean square of the unexplained force, as a fraction of the joints' forces.
    p_value : float
        Of the gain, for all readings that were tried.
    """

    removed: float
    gain: float
    gain_se: float
    before: float
    after: float
    p_value: float


@dataclass(frozen=True)
class WiringFault:
    """Commands or angles that do not mean what the model takes them for.

    Attributes
    ----------
    kind : {"sign", "unit_factor", "exchange", "torque_command"}
        What is wrong.
    target : str
        The joint, or those that are exchanged or share a unit.
    text : str
        A sentence.
    of : {"angle", "command", ""}
        Whose column is wrong; empty where either explains the same.
    factor : float or None
        What it is to be multiplied by, where its unit is another.
    to_change : str
        What to change in the mapping, the data or the model; empty where that is not known.
    evidence : Evidence or None
        None where the forces of the log cannot be computed.
    """

    kind: str
    target: str
    text: str
    of: str = ""
    factor: float | None = None
    to_change: str = ""
    evidence: Evidence | None = None

    @property
    def sentences(self) -> str:
        """What is wrong, how much of the error that is, and what to change."""
        sentences = [self.text]
        if self.evidence is not None:
            sentences.append(
                f"Read right, {self.evidence.removed:.1%} of the squared error of the forces there "
                "is gone on data held out."
            )
        if self.to_change:
            sentences.append(f"To mend it, {self.to_change}")
        return " ".join(sentences)

    @classmethod
    def from_json(cls, saved: Mapping[str, Any]) -> Self:
        """Make it again from its entries.

        Parameters
        ----------
        saved : mapping
            What `dataclasses.asdict` gave.

        Returns
        -------
        WiringFault
        """
        evidence = saved.get("evidence")
        return cls(
            kind=saved["kind"],
            target=saved["target"],
            text=saved["text"],
            of=saved.get("of", ""),
            factor=saved.get("factor"),
            to_change=saved.get("to_change", ""),
            evidence=None if evidence is None else Evidence(**evidence),
        )


def fault_table(faults: Sequence[WiringFault]) -> Table:
    """Make a table of faults with their evidence.

    Parameters
    ----------
    faults : sequence of WiringFault
        Those that forces show; others have dashes.

    Returns
    -------
    Table
    """
    rows = []
    for fault in faults:
        factor = "-" if fault.factor is None else number(fault.factor, 3)
        found = fault.evidence
        cells = ["-"] * 4
        if found is not None:
            gain = f"{number(found.gain, 2)} +- {number(found.gain_se, 2)}"
            cells = [f"{found.before:.0%}", f"{found.after:.0%}", f"{found.removed:.1%}", gain]
        rows.append((fault.kind, fault.target, fault.of or "either", factor, *cells))
    header = (
        "wrong",
        "joints",
        "column of",
        "times",
        "forces unexplained",
        "read right",
        "error removed",
        "nats a row, held out",
    )
    return Table("Columns that mean something else", header, tuple(rows))


@dataclass(frozen=True)
class JointForces:
    """What a joint's drive gives, and what is not explained of it on data held out.

    Attributes
    ----------
    joint, unit : str
        Its name, and N or N m.
    drive : float
        RMS of the drive's force, or of what the motion needs where there is no drive.
    before, after : float
        RMS of what the model leaves unexplained, as it is and with what was found.
    used : float
        Fraction of the rows in which the joint moves freely.
    """

    joint: str
    unit: str
    drive: float
    before: float
    after: float
    used: float


@dataclass(frozen=True, repr=False, kw_only=True)
class QuickDiagnosis(Report):
    """What a regression over inverse dynamics found.

    Attributes
    ----------
    name : str
        The problem's.
    verdict : {"consistent", "explained", "partly", "unexplained"}
        By the forces that are left on data held out.
    causes : tuple of Cause
        What is missing, the largest gain first; gains are in nats per row of the equation, errors
        in fractions of the drives' forces. The friction of contacts comes last: its gain is in nats
        per simulated window, its errors in each signal's.
    faults : tuple of WiringFault
        Signs, units or names that are wrong; nothing else is looked for then.
    forces : tuple of JointForces
        What is explained at each joint.
    problem : Problem
        The extended one: its simulator has what is missing.
    to_type : tuple of str
        The elements of the model's MJCF with what was found, a line each.
    warnings : tuple of str
        What is unusual in the data.
    wall_time_s : float
        How long it took [s].
    simulator_steps : int
        Physics steps of the windows that were simulated for the friction of contacts.
    """

    name: str
    verdict: str
    causes: tuple[Cause, ...]
    faults: tuple[WiringFault, ...]
    forces: tuple[JointForces, ...]
    problem: Problem
    to_type: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    wall_time_s: float = 0.0
    simulator_steps: int = 0

    @property
    def parameters(self) -> Mapping[str, float]:
        """Declared parameters as fitted: none, regression leaves them as they are."""
        return {}

    @property
    def interrupted(self) -> bool:
        """Never: a regression that is interrupted has no result."""
        return False

    def headline(self) -> str:
        """Say what was found.

        Returns
        -------
        str
            A few sentences.
        """
        if self.faults:
            return " ".join(fault.sentences for fault in self.faults)
        count = len(self.causes)
        verdict = VERDICTS[self.verdict]
        if not count:
            return verdict
        noun = "number is" if count == 1 else "numbers are"
        simulated = any(cause.effect == EFFECT for cause in self.causes)
        how = "by regression and short simulations" if simulated else "by regression alone"
        return f"{count} {noun} missing or wrong, {how}. {verdict}"

    def parts(self) -> list[str | Table]:
        """The headline, the causes, what to type into the model, and the forces."""
        lines: list[str | Table] = [self.headline()]
        if self.faults:
            lines.append(fault_table(self.faults))
        if self.causes:
            lines.append(self._cause_table())
        lines += typed_lines(self.to_type)
        lines.append(self._force_table())
        if self.causes:
            lines.append(
                "With --out, extended/ has these numbers: diagnose it without --quick to confirm "
                "them by simulation."
            )
        return [*lines, *(f"warning: {text}" for text in self.warnings)]

    def _cause_table(self) -> Table:
        """A row for each quantity of each cause."""
        rows = []
        for cause in self.causes:
            gain = f"{number(cause.held_out_gain, 2)} +- {number(cause.held_out_gain_se, 2)}"
            others = ", ".join(other.place for other in cause.confused_with[:3])
            label = cause.place
            for name, found in cause.estimate.items():
                model = "-" if found.model is None else number(found.model, 3)
                rows.append((label, name, str(found), model, gain, others))
                label = gain = others = ""
        header = (
            "missing",
            "quantity",
            "add",
            "the model has",
            "nats a row, held out",
            "cannot be told from",
        )
        return Table("", header, tuple(rows))

    def _force_table(self) -> Table:
        """A row for each joint."""
        rows = []
        for joint in self.forces:
            cells = [number(value, 3) for value in (joint.drive, joint.before, joint.after)]
            rows.append((joint.joint, joint.unit, *cells, f"{joint.used:.0%}"))
        header = ("joint", "unit", "drive", "unexplained as it is", "with what was found", "used")
        return Table("RMS forces on held-out data", header, tuple(rows))

    def to_json(self) -> dict[str, Any]:
        """The content of diagnosis.json.

        Returns
        -------
        dict
            As diagnosis.json has it.
        """
        from dropo._version import __version__

        return {
            "verdict": self.verdict,
            "method": "regression",
            "headline": self.headline(),
            "problem": self.name,
            "causes": [cause.to_json(i + 1) for i, cause in enumerate(self.causes)],
            "faults": [asdict(fault) for fault in self.faults],
            "suspects": [],
            "leaders": [],
            "alternatives": [],
            "forces": [asdict(joint) for joint in self.forces],
            "extended_problem": "extended/problem.yaml",
            "to_type": list(self.to_type),
            "warnings": list(self.warnings),
            "seed": None,
            "version": __version__,
            "simulator_steps": self.simulator_steps,
            "wall_time_s": round(self.wall_time_s, 3),
        }

    def save(self, folder: str | Path) -> None:
        """Write diagnosis.json into a folder, whole or not at all.

        Parameters
        ----------
        folder : str or Path
            Made where it is missing.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / "diagnosis.json", self.to_json())
