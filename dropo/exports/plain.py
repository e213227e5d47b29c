"""The target `mujoco`: MJCF at the means, and draws around them for plain MuJoCo."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from dropo._version import __version__
from dropo.core.services.source_text import SourceText
from dropo.core.services.validation import Array
from dropo.exports.support.subject import (
    NO_SPREAD,
    Subject,
    Written,
    changed_by,
    remarks_of,
)
from dropo.mjmodel.numbers import array_of, changed_numbers, derive_constants, set_number
from dropo.problems.file.plain_model import SENSOR, format_plain_model
from dropo.simulators.mujoco.plain_robot import write_numbers

HEADER = '''"""Parameters drawn from what was fitted, for plain MuJoCo.

    import mujoco, numpy as np
    import randomize                              # this file
    model = randomize.load()                      # model.xml and model.npz beside it, at the means
    rng = np.random.default_rng()
    drawn = randomize.randomize(model, rng)       # at the start of every episode

`randomize` sets the numbers of the model anew, and the constants that MuJoCo derives from them. The
spread holds what was fitted and what is not known of the means. model.py has the robot with what
is no number of a model, such as delays: Robot(model, FRAME_SKIP, EFFECTS) takes a model as drawn.
Written by dropo {version} from {name!r}.
{remarks}"""

'''
FUNCTIONS = '''DISTRIBUTION = %s
WRITER = %s


def load():
    """The model at the means."""
    folder = Path(__file__).parent
    model = mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
    with np.load(folder / "model.npz") as numbers:
        write_numbers(model, numbers)
    return model


def randomize(model, rng):
    """Draw parameters with a numpy Generator, set them in the model, and return them by name."""
    values = DISTRIBUTION.sample(1, rng)[0]
    WRITER.write(model, values)
    return dict(zip(DISTRIBUTION.names, values.tolist()))
'''


@dataclass(frozen=True, eq=False)
class ParameterWriter:
    """How parameters (d,) are set in a model.

    Attributes
    ----------
    base : tuple of (field, place, number)
        Numbers that changes add to, as they are without these.
    follows : tuple of (field, place, column, factor)
        Numbers of parameters, before the derived constants are computed.
    keeps : tuple of (field, place, number, column, factor)
        Numbers of parameters of which the derived constants are those of another number.
    declared : tuple of (function, columns, sizes)
        What changes the parameters themselves: its sizes, or the columns that hold them.
    changes : tuple of (function, columns, sizes)
        What changes the model, in the same form.
    count : int
        How many of the parameters are numbers of the model.
    """

    base: tuple[Any, ...]
    follows: tuple[Any, ...]
    keeps: tuple[Any, ...]
    declared: tuple[Any, ...]
    changes: tuple[Any, ...]
    count: int

    def write(self, model: mujoco.MjModel, values: Array) -> None:
        """Set parameters in a model, then compute the constants that MuJoCo derives from them.

        Parameters
        ----------
        model : mujoco.MjModel
            The model, which is changed.
        values : (d,) array
            Parameters in their units, in the order of the simulator's space.
        """
        own = values[: self.count]
        for function, columns, sizes in self.declared:
            own = function(own, values[list(columns)] if columns else sizes)
        for field, place, number in self.base:
            set_number(model, field, place, number)
        for field, place, number, _, _ in self.keeps:
            set_number(model, field, place, number)
        for field, place, column, factor in self.follows:
            set_number(model, field, place, factor * own[column])
        for function, columns, sizes in self.changes:
            magnitudes = values[list(columns)] if columns else sizes
            if np.any(magnitudes):
                function(model, magnitudes)
        derive_constants(model)
        for field, place, _, column, factor in self.keeps:
            set_number(model, field, place, factor * own[column])


def mujoco_python(subject: Subject) -> Written:
    """Plain MJCF at the means, with a Python file that draws parameters and sets them in the model.

    The robot with all effects beside the model, such as delays, is in model.py.

    Parameters
    ----------
    subject : Subject
        The robot at its means; randomize.py is written only where it has a distribution.

    Returns
    -------
    Written
        The files model.py, model.npz and randomize.py, and the MJCF at the means.
    """
    simulator = subject.simulator
    plain = mujoco.MjModel.from_xml_string(subject.xml)
    files: dict[str, str | bytes] = {}
    left_out = []
    if subject.distribution is not None:
        left_out += _constant(subject)
        files["randomize.py"] = _randomizing(subject, left_out)
    else:
        left_out.append(NO_SPREAD)
    files["model.py"] = format_plain_model(simulator, subject.active)
    files["model.npz"] = _npz(changed_numbers(plain, subject.model))
    for instance, _ in subject.active:
        if any(getattr(instance, name) is not None for name in SENSOR):
            left_out.append(f"{instance.label} is left out: it acts on what sensors say alone.")
    return Written(files, tuple(left_out), subject.approximated, subject.xml)


def _npz(arrays: dict[str, Array]) -> bytes:
    """The content of an .npz file."""
    buffer = io.BytesIO()
    named: dict[str, Any] = dict(arrays)
    np.savez(buffer, **named)
    return buffer.getvalue()


def _constant(subject: Subject) -> list[str]:
    """The parameters of effects beside the model, which model.py has at their means."""
    if subject.distribution is None:
        return []
    sentences = []
    for instance, _ in subject.effects:
        if instance.model is not None:
            continue
        for parameter in instance.parameters:
            if parameter.name in subject.distribution.names:
                sentences.append(
                    f"The spread of {parameter.name} is left out: {instance.label} is no number of "
                    "a model, and model.py has it at its mean."
                )
    return sentences


def writer_of(subject: Subject) -> ParameterWriter:
    """Find how the parameters of a subject are set in a plain model.

    Parameters
    ----------
    subject : Subject
        With its simulator.

    Returns
    -------
    ParameterWriter
    """
    simulator = subject.simulator
    count = len(simulator.bindings)
    follows: list[Any] = []
    keeps: list[Any] = []
    for column, binding in enumerate(simulator.bindings):
        for field, place, factor in binding.entries(simulator.model):
            if binding.parameter.derived:
                follows.append((field, place, column, factor))
            else:
                number = factor * binding.nominal()
                keeps.append((field, place, number, column, factor))
    changes = _hooks(subject, "model")
    bare = simulator.model_of(subject.values, [])
    changed = changed_by(subject.effects, bare)
    taken = {(field, place) for field, place, _, _ in follows}
    base = []
    for field, numbers in changed_numbers(changed, bare).items():
        for at in np.argwhere(numbers != array_of(changed, field)):
            place = tuple(map(int, at))
            if (field, place) not in taken:
                base.append((field, place, float(numbers[place])))
    declared = _hooks(subject, "declared")
    return ParameterWriter(tuple(base), tuple(follows), tuple(keeps), declared, changes, count)


def _hooks(subject: Subject, name: str) -> tuple[Any, ...]:
    """The hooks of one name, each with the columns of its magnitudes, or with these themselves."""
    names = subject.simulator.space.names
    found = []
    for instance, sizes in subject.effects:
        hook = getattr(instance, name)
        if hook is not None:
            own = [one.name for one in instance.parameters]
            free = instance in subject.simulator.effects
            columns = tuple(names.index(one) for one in own) if free else ()
            found.append((hook, columns, np.array(sizes)))
    return tuple(found)


def _randomizing(subject: Subject, left_out: Sequence[str]) -> str:
    """The text of randomize.py."""
    writer = writer_of(subject)
    functions = [change[0] for change in (*writer.declared, *writer.changes)]
    modules = {getattr(one, "func", one).__module__ for one in functions}
    source = SourceText(modules)
    source.imports |= {"from pathlib import Path", "import mujoco", "import numpy as np"}
    distribution = source.expression(subject.distribution)
    written = source.expression(writer)
    source.expression(write_numbers)
    remarks = remarks_of(left_out, subject.approximated)
    header = HEADER.format(version=__version__, name=subject.name, remarks=remarks)
    return header + "\n\n\n".join([source.text(), FUNCTIONS % (distribution, written)])
