"""What is said of random machines' logs whose columns are not what the model takes them for.

`python benchmarks/random_machines/wiring.py COUNT FIRST_SEED` draws machines as `random_machines`
does, with what their models lack, spoils columns of each log in every way of `SPOILED`, and prints
a line each and a table. A machine is right if the fault is named with its joints, its columns and
its factor (or either of two columns that explain the same), and nothing else is; silent if nothing
is named. Rules and thresholds are chosen on seeds below 1000.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from design import DRIVES
from drawing import drawn

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.tables import Table
from dropo.diagnosis.regression.result import WiringFault
from dropo.diagnosis.regression.wiring import EITHER, wiring_faults

DEGREES = 180 / np.pi
CLOSE = 0.1
"""Relative error within which a factor is right."""
BOTH = ("angle", "command")
SPOILED = {
    "nothing": ("", ()),
    "sign of an angle": ("sign", ("angle",)),
    "sign of a command": ("sign", ("command",)),
    "sign of both": ("sign", BOTH),
    "two angles exchanged": ("exchange", ("angle",)),
    "two commands exchanged": ("exchange", ("command",)),
    "both exchanged": ("exchange", BOTH),
    "an angle in degrees": ("unit_factor", ("angle",)),
    "a command in degrees": ("unit_factor", ("command",)),
    "both in degrees": ("unit_factor", BOTH),
}
"""The kind of a fault, and whose columns have it."""


@dataclass(frozen=True)
class Spoiled:
    """A problem with a fault in its columns.

    Attributes
    ----------
    problem : Problem
        What is diagnosed.
    kind : str
        Of the fault, "" if there is none.
    joints : frozenset of str
        The joints whose columns have it.
    of : tuple of str
        Which of their columns.
    """

    problem: Problem
    kind: str
    joints: frozenset[str]
    of: tuple[str, ...]

    def is_right(self, faults: Sequence[WiringFault]) -> bool:
        """Whether what is named is what is wrong."""
        if not self.kind:
            return not faults
        named = {(fault.kind, frozenset(fault.target.split(", "))) for fault in faults}
        if named != {(self.kind, self.joints)}:
            return False
        for fault in faults:
            factor = 1.0 if fault.factor is None else fault.factor * DEGREES
            of_other = fault.of == EITHER and abs(np.log(factor) - 2 * np.log(DEGREES)) < CLOSE
            if not (fault.factor is None or abs(np.log(factor)) < CLOSE or of_other):
                return False
        told = {of for fault in faults for of in ((fault.of,) if fault.of != "both" else BOTH)}
        return EITHER in told or told == set(self.of)


def spoiled(problem: Problem, way: str, rng: np.random.Generator) -> Spoiled | None:
    """Spoil columns of a log.

    Parameters
    ----------
    problem : Problem
        A machine's, of joints "joint0", ... and drives "drive0", ... of the joints of that number.
    way : str
        One of `SPOILED`.
    rng : numpy.random.Generator
        Chooses the joints.

    Returns
    -------
    Spoiled or None
        None where no joint can have that fault: degrees of a slide, or of the command of a motor.
    """
    kind, of = SPOILED[way]
    if not kind:
        return Spoiled(problem, kind, frozenset(), of)
    model = problem.simulator.model
    servo = bool(np.any(model.actuator_biasprm))
    column_of = {int(model.actuator_trnid[i, 0]): i for i in range(model.nu)}
    driven = sorted(column_of)
    if kind == "unit_factor":
        driven = [joint for joint in driven if model.jnt_type[joint] == 3]
        if "command" in of and not servo:
            return None
    count = 2 if kind == "exchange" else 1
    if len(driven) < count:
        return None
    chosen = rng.choice(driven, count, replace=False).tolist()
    data = problem.trajectories
    angles = np.ones(model.nq)
    commands = np.ones(model.nu)
    from_angle = np.arange(model.nq)
    from_command = np.arange(model.nu)
    if kind == "exchange":
        columns = [column_of[joint] for joint in chosen]
        if "angle" in of:
            from_angle[chosen] = chosen[::-1]
        if "command" in of:
            from_command[columns] = columns[::-1]
    else:
        factor = -1.0 if kind == "sign" else DEGREES
        if "angle" in of:
            angles[chosen] = factor
        if "command" in of:
            commands[column_of[chosen[0]]] = factor
    changed = Trajectories(
        data.observations[:, from_angle] * angles,
        data.actions[:, from_command] * commands,
        data.next_observations[:, from_angle] * angles,
        data.terminals,
        data.group,
    )
    names = frozenset(f"joint{joint}" for joint in chosen)
    return Spoiled(replace(problem, trajectories=changed), kind, names, of)


def main(count: int, first: int) -> None:
    """Spoil the logs of machines, and print a line each and a table."""
    answers: dict[str, list[tuple[str, bool, bool]]] = {way: [] for way in SPOILED}
    seconds = []
    for seed in range(first, first + count):
        problem, drives, _, _ = drawn(seed)
        for number, way in enumerate(SPOILED):
            own = spoiled(problem, way, np.random.default_rng([seed, number]))
            if own is None:
                continue
            begun = time.process_time()
            faults = wiring_faults(own.problem)
            seconds.append(time.process_time() - begun)
            right = own.is_right(faults)
            answers[way].append((drives, right, not faults))
            said = [(one.kind, one.target, one.of, one.factor) for one in faults]
            print(seed, drives, way, sorted(own.joints), right, said, flush=True)
    rows = []
    for way, own in answers.items():
        cells = [way]
        for kind in DRIVES:
            of_kind = [one for one in own if one[0] == kind]
            right = sum(one[1] for one in of_kind)
            cells.append(f"{right} of {len(of_kind)}")
        silent = sum(one[2] for one in own)
        wrong = sum(not (one[1] or one[2]) for one in own)
        rows.append((*cells, str(silent), str(wrong)))
    title = f"{count} machines, seeds from {first} on, {np.median(seconds):.1f} s each"
    header = ("spoiled", *(f"{kind}: right" for kind in DRIVES), "silent", "wrong")
    print(Table(title, header, tuple(rows)))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
