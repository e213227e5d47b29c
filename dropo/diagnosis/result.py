"""What a diagnosis found: the verdict, the causes, what they gain, what remains."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.figure_data import FigureData
from dropo.core.records.predictions import Predictions
from dropo.core.services.files.atomic_write import write_json
from dropo.core.services.tables import Report, Table, number, steps_text
from dropo.data.outliers.outlier_runs import OutlierRun
from dropo.diagnosis.findings.accuracy.horizons import OF_MOTION, Horizon
from dropo.diagnosis.findings.accuracy.replay import WholeRunReplay
from dropo.diagnosis.findings.limits.detectable import Detectable, detectable_table
from dropo.diagnosis.findings.remains.disturbances import LeftOut
from dropo.diagnosis.findings.to_type import typed_lines
from dropo.diagnosis.laws.learned import Learned
from dropo.diagnosis.parts import Cause, Leader, Remaining, Suspect, are_stated
from dropo.diagnosis.regression.result import WiringFault, fault_table

SELDOM = 0.005
"""Fraction of errors below which it is not said that motion is lost."""

VERDICTS = {
    "consistent": "The simulation explains the data: nothing is missing that they could show.",
    "explained": "After adding it, nothing remains unexplained.",
    "partly": "Something remains unexplained.",
    "unexplained": "Something is missing from the simulation, and no known effect explains it.",
}

MISWIRED = (
    "Nothing else was looked for: with columns that mean something else, no search tells what is "
    "missing. Mend this and diagnose again; extended/ has the columns of the data read right."
)

INTERRUPTED = (
    "Interrupted: these are the causes so far; what else the data show was not looked for to the"
    " end."
)


@dataclass(frozen=True)
class HeldOut:
    """How a model does on data that nothing was fitted to.

    Attributes
    ----------
    log_likelihood : float
        Of the windows held out [nats per transition].
    horizons : tuple of Horizon
        The errors after few and many control steps.
    """

    log_likelihood: float
    horizons: tuple[Horizon, ...]

    def to_json(self) -> dict[str, Any]:
        """As diagnosis.json has it.

        Returns
        -------
        dict
            As diagnosis.json has it.
        """
        horizons = [horizon.to_json() for horizon in self.horizons]
        return {
            "held_out_log_likelihood": self.log_likelihood,
            "rmse": {str(at["steps"]): at["rmse"] for at in horizons},
            "horizons_s": [horizon.seconds for horizon in self.horizons],
            "horizons": horizons,
        }


@dataclass(frozen=True, repr=False, kw_only=True)
class Diagnosis(Report):
    """What the simulation gets wrong: the verdict, the causes, what they gain, what remains.

    Attributes
    ----------
    name : str
        The problem's.
    verdict : {"consistent", "explained", "partly", "unexplained"}
        What was found, in a word.
    causes : tuple of Cause
        In the order in which they were found.
    suspects : tuple of Suspect
        Effects that seemed to help and were not confirmed.
    leaders : tuple of Leader
        Those of them that would gain enough if the data were sure of it.
    baseline, extended : HeldOut
        The model as it is, its declared parameters fitted, and with the causes.
    remaining : Remaining
        What the last check found.
    problem : Problem
        The extended one, to fit or diagnose like any other.
    noise : mapping of str to float
        The standard deviation of each signal's noise, in the signal's unit.
    window_steps : int
        Control steps in a window.
    nominal : tuple of Horizon
        The errors of the model whose declared parameters are not fitted, where it has such.
    parameters : mapping of str to float
        The declared ones as fitted.
    undetermined : tuple of str
        What the data do not determine of the numbers that were fitted, a sentence each.
    numerics : tuple of str
        Where the model's arithmetic decides (its step, friction that creeps), a sentence each.
    to_type : tuple of str
        The elements of the model's MJCF with what was found, a line each.
    disturbances : LeftOut or None
        Spans in which something acts that no command explains, which were left out.
    outlier_runs : tuple of OutlierRun
        Runs that disagree with the others.
    replay : WholeRunReplay or None
        Whole runs held out, by commands alone, where the model is far off.
    figures : FigureData or None
        What figures are drawn from.
    motion : Predictions or None
        Measured and simulated motion.
    detectable : tuple of Detectable
        Where the model is consistent, the size of each usual effect that the data would have shown.
    learned : Learned or None
        Forces that were learned from what nothing explains.
    faults : tuple of WiringFault
        Columns that are not what the model takes them for; the search ended there, and each is a
        cause.
    warnings : tuple of str
        What is unusual in the data.
    seed : int or None
        Where `rng` was one.
    simulator_steps : int
        What the diagnosis cost.
    wall_time_s : float
        How long it took [s].
    interrupted : bool
        Whether it ended before its end: what was found so far.
    """

    name: str
    verdict: str
    causes: tuple[Cause, ...]
    suspects: tuple[Suspect, ...]
    baseline: HeldOut
    extended: HeldOut
    remaining: Remaining
    problem: Problem
    noise: Mapping[str, float]
    window_steps: int
    leaders: tuple[Leader, ...] = ()
    nominal: tuple[Horizon, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    undetermined: tuple[str, ...] = ()
    numerics: tuple[str, ...] = ()
    to_type: tuple[str, ...] = ()
    disturbances: LeftOut | None = None
    outlier_runs: tuple[OutlierRun, ...] = ()
    replay: WholeRunReplay | None = None
    figures: FigureData | None = None
    motion: Predictions | None = None
    detectable: tuple[Detectable, ...] = ()
    learned: Learned | None = None
    faults: tuple[WiringFault, ...] = ()
    warnings: tuple[str, ...] = ()
    seed: int | None = None
    simulator_steps: int = 0
    wall_time_s: float = 0.0
    interrupted: bool = False

    @property
    def gain(self) -> float:
        """What the causes gain on data held out [nats per transition]."""
        return self.extended.log_likelihood - self.baseline.log_likelihood

    @property
    def stated(self) -> tuple[Cause, ...]:
        """The causes that are stated as such: all where they explain the data, else none.

        Of the others it is only said that what is missing acts like them (`are_stated`), as of
        those of a diagnosis that was interrupted.
        """
        return self.causes if are_stated(self.verdict) and not self.interrupted else ()

    def alternatives(self) -> list[dict[str, Any]]:
        """The sets of causes that the data cannot tell from the one named.

        Returns
        -------
        list of dict
            causes: the effect, target and variant of each member; why: the reason. Each set has one
            cause exchanged.
        """
        sets = []
        for i, cause in enumerate(self.causes):
            for other in cause.confused_with:
                members = [other if i == j else kept for j, kept in enumerate(self.causes)]
                places = [
                    {"effect": one.effect, "target": one.target, "variant": one.variant}
                    for one in members
                ]
                sets.append({"causes": places, "why": other.why})
        return sets

    def headline(self) -> str:
        """Say what was found.

        Returns
        -------
        str
            A few sentences.
        """
        if self.faults:
            return " ".join([*(fault.sentences for fault in self.faults), MISWIRED])
        sentences = [self._error_sentence()] if self.baseline.horizons else []
        for cause in self.causes:
            sentences += [self._cause_sentence(cause), *_doubts(cause)]
        return " ".join([*sentences, *self._verdict_sentences()])

    def _cause_sentence(self, cause: Cause) -> str:
        """What one cause is, and how large."""
        return f"{'Cause' if cause in self.stated else 'Acts like'}: {cause.sentence}."

    def _verdict_sentences(self) -> list[str]:
        """What the causes explain, where something remains, and what was left out."""
        sentences = [INTERRUPTED if self.interrupted else VERDICTS[self.verdict]]
        if self.verdict in ("partly", "unexplained") and self.remaining.where:
            sentences.append(f"It shows in {'; '.join(self.remaining.where)}.")
        if self.learned:
            sentences.append(self.learned.sentence)
        if self.disturbances:
            sentences.append(f"Left out: {self.disturbances}.")
        sentences += [f"{str(run).capitalize()}." for run in self.outlier_runs]
        return sentences

    def _most(self) -> tuple[float, int, str, float, float] | None:
        """Where the simulation stands out most from the noise: how many times, after how many
        steps, in which unit, its error there and the noise's.

        Horizons count as long as the simulation follows the motion at all; None if it diverges.
        """
        horizons = [one for one in self.baseline.horizons if np.isfinite(one.rmse)]
        if not horizons:
            return None
        followed = [horizon for horizon in horizons if horizon.rmse < 1] or horizons
        found = []
        for horizon in followed:
            for unit, (_, noise) in horizon.units.items():
                error = horizon.capped[unit]
                ratio = error / max(noise, 1e-300)
                found.append((ratio, horizon.steps, unit, error, noise))
        return max(found)

    def _shown_steps(self) -> int:
        """After how many steps errors are shown by signal."""
        most = self._most()
        return self.baseline.horizons[0].steps if most is None else most[1]

    def _error_sentence(self) -> str:
        """How far the simulation is off, where that stands out most from the noise."""
        most = self._most()
        if most is None:
            return "On held-out data the simulation diverges."
        _, steps, unit, error, noise = most
        factor = 1.0
        shown = unit
        if unit in ("m", "rad", "m/s", "rad/s") and error < 0.1:
            factor = 1e3
            shown = f"m{unit}"
        off = f"{number(factor * error, 3)} {shown} after {steps_text(steps)}"
        explained = number(factor * noise, 3)
        return (
            f"On held-out data the simulation is off by {off}; sensor noise explains {explained}."
        )

    def _error_tables(self) -> list[Table]:
        """The errors by horizon, then by signal after the horizon at which they stand out."""
        models = [("as it is", self.baseline.horizons)]
        if self.nominal:
            models = [("as it came", self.nominal), ("fitted", self.baseline.horizons)]
        if self.causes or (self.learned and self.learned.used):
            models.append(("with what was found", self.extended.horizons))
        by_horizon = list(zip(*(horizons for _, horizons in models), strict=True))
        rows = [row for at in by_horizon for row in _error_rows(at)]
        names = [name for name, _ in models]
        header = ("after", "unit", *names, "by sensor noise")
        tables = [Table("Errors on held-out data", header, tuple(rows))]
        signals = self.problem.simulator.signals
        if self.replay or len(signals) <= len(by_horizon[0][0].units):
            return tables
        at = next(one for one in by_horizon if one[0].steps == self._shown_steps())
        sizes = [
            (signal.name, signal.unit, *(_number(horizon.capped_by_signal[i]) for horizon in at))
            for i, signal in enumerate(signals)
        ]
        title = f"By signal, after {steps_text(at[0].steps, at[0].seconds)}"
        return [*tables, Table(title, ("signal", "unit", *names), tuple(sizes))]

    def to_pandas(self) -> Any:
        """Make a data frame of the causes.

        Returns
        -------
        pandas.DataFrame
            A row for each quantity of each cause; empty without causes.
        """
        from dropo.core.services.data_frames import frame

        rows = [
            {
                "effect": cause.effect,
                "target": cause.target,
                "variant": cause.variant,
                "quantity": name,
                **found.to_json(),
                "p_value": cause.p_value,
                "held_out_gain": cause.held_out_gain,
                "held_out_gain_se": cause.held_out_gain_se,
                "acts_like": cause.acts_like,
                "stated": cause in self.stated,
            }
            for cause in self.causes
            for name, found in cause.estimate.items()
        ]
        return frame(rows, "effect")

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
            "status": "interrupted" if self.interrupted else "done",
            "headline": self.headline(),
            "problem": self.name,
            "causes": [
                {**cause.to_json(i + 1), "stated": cause in self.stated}
                for i, cause in enumerate(self.causes)
            ],
            **({"faults": [asdict(fault) for fault in self.faults]} if self.faults else {}),
            "suspects": [suspect.to_json() for suspect in self.suspects],
            "leaders": [leader.to_json() for leader in self.leaders],
            "alternatives": self.alternatives(),
            "baseline": self.baseline.to_json(),
            "extended": self.extended.to_json(),
            "remaining": self.remaining.to_json(),
            "noise": dict(self.noise),
            "extended_problem": "extended/problem.yaml",
            "disturbances": self.disturbances.to_json() if self.disturbances else None,
            "odd_runs": [asdict(run) for run in self.outlier_runs],
            "replay": self.replay.to_json() if self.replay else None,
            "parameters": dict(self.parameters),
            "nominal": {"horizons": [horizon.to_json() for horizon in self.nominal]},
            "undetermined": list(self.undetermined),
            "detectable": [one.to_json() for one in self.detectable],
            "learned": self.learned.to_json() if self.learned else None,
            "numerics": list(self.numerics),
            "to_type": list(self.to_type),
            "warnings": list(self.warnings),
            "seed": self.seed,
            "version": __version__,
            "simulator_steps": self.simulator_steps,
            "wall_time_s": round(self.wall_time_s, 3),
            "window_steps": self.window_steps,
            "pictures": None if self.figures is None else self.figures.to_json(),
        }

    def save(self, folder: str | Path) -> None:
        """Write diagnosis.json and predictions.npz into a folder, each whole or not at all.

        Parameters
        ----------
        folder : str or Path
            Made where it is missing.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        if self.motion is not None:
            self.motion.save(folder)
        write_json(folder / "diagnosis.json", self.to_json())

    def parts(self) -> list[str | Table]:
        """A line each cause, the verdict, what to type into the model, the errors, the evidence."""
        if self.faults:
            return [self.headline(), fault_table(self.faults), *self._warnings()]
        lines: list[str | Table] = [self._error_sentence()] if self.baseline.horizons else []
        lines += [self._cause_sentence(cause) for cause in self.causes]
        lines.append(" ".join(self._verdict_sentences()))
        lines += typed_lines(self.to_type)
        if self.baseline.horizons:
            lines += self._error_tables()
        if self.detectable:
            lines.append(detectable_table(self.detectable))
        if self.replay:
            lines.append(self.replay.table())
            lines += [f"  {one}" for one in self.replay.odd()]
        if self.disturbances:
            lines += self.disturbances.lines()
        lines += [f"  {text}" for text in self._evidence()]
        return [*lines, *self._warnings()]

    def _evidence(self) -> list[str]:
        """What is to be said beside the causes, a line each."""
        doubts = [
            f"{cause.place}: {' '.join(_doubts(cause))}" for cause in self.causes if _doubts(cause)
        ]
        suspects = ", ".join(suspect.label for suspect in self.suspects)
        return [
            *doubts,
            *self.numerics,
            *self.undetermined,
            *([f"suspects, not confirmed: {suspects}"] if suspects else []),
            *(leader.sentence for leader in self.leaders),
        ]

    def _warnings(self) -> list[str]:
        """What is unusual, a line each."""
        return [f"warning: {text}" for text in self.warnings]


def _error_rows(at: Sequence[Horizon]) -> Iterator[tuple[str, ...]]:
    """Rows of several models after one horizon: of all signals, in units of the motion, then of
    each unit. An error counts no more than motion that is lost.
    """
    last = at[-1]
    label = steps_text(last.steps, last.seconds)
    yield (label, OF_MOTION, *map(_of_motion, at), f"{last.noise:.2%}")
    for unit, (_, noise) in last.units.items():
        yield ("", unit, *(_capped(horizon, unit) for horizon in at), number(noise, 3))


def _of_motion(horizon: Horizon) -> str:
    """An error as a fraction of the motion, and how often that is lost."""
    if not np.isfinite(horizon.rmse):
        return "diverges"
    lost = f" ({horizon.lost:.0%} lost)" if horizon.lost >= SELDOM else ""
    return f"{horizon.capped[OF_MOTION]:.2%}{lost}"


def _capped(horizon: Horizon, unit: str) -> str:
    """An error in its unit."""
    return number(horizon.capped[unit], 3) if np.isfinite(horizon.rmse) else "diverges"


def _number(error: float) -> str:
    """An error in its unit."""
    return number(error, 3) if np.isfinite(error) else "diverges"


def _doubts(cause: Cause) -> list[str]:
    """What differs with a cause's size, and what it cannot be distinguished from."""
    sentences = []
    if cause.acts_like:
        sentences.append(f"Its size differs with {cause.acts_like}.")
    doubt = None if cause.stability is None else cause.stability.doubt()
    if doubt is not None:
        sentences.append(f"Other effects promise more in {doubt}.")
    if cause.confused_with:
        others = ", ".join(dict.fromkeys(other.place for other in cause.confused_with))
        sentences.append(f"These data cannot tell it from {others}.")
        first = cause.confused_with[0]
        if first.to_tell is not None:
            sentences.append(f"To tell it from {first.place}, {first.to_tell}.")
    return sentences
