"""`--plugin FILE`: parts from a file of one's own, on every command."""

import hashlib
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dropo.cli.main import main
from dropo.core.contracts.effect import instances_of
from dropo.core.services import plugin_files, registry
from dropo.core.services.errors import BadFile
from dropo.core.services.plugin_files import load_plugins
from dropo.logs.readers.reader import open_log
from dropo.problems.file.writer import write_problem
from dropo.problems.loading import load
from tests.models.problem_files import TEXT, XML, simulate

PART = '''
"""An optimizer of one's own."""
from dropo import register
from dropo.optimizers.cma_es import CMAES


class Mine(CMAES):
    """CMA-ES under another name."""


register("optimizers", "mine", Mine)
'''
FIT = ("fit", "slide", "--likelihood", "monte-carlo", "--draws", "10", "--budget", "40")


@pytest.fixture
def part(tmp_path: Path) -> Iterator[Path]:
    """A file that registers the optimizer "mine", forgotten afterwards."""
    path = tmp_path / "my_part_of_the_test.py"
    path.write_text(PART)
    yield path
    registry._registered["optimizers"].pop("mine", None)
    sys.modules.pop(path.stem, None)


def test_a_command_finds_the_part_and_its_record_names_the_file(
    part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*FIT, "--optimizer", "mine", "--out", str(tmp_path / "out")]) == 2
    assert "mine" in capsys.readouterr().err
    options = ["--plugin", str(part), "--optimizer", "mine", "--out", str(tmp_path / "out")]
    assert main([*FIT, *options, "--quiet"]) == 0
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert list(record["plugins"]) == [part.name]


def test_a_changed_part_does_not_resume_the_run_of_the_old_one(
    part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--plugin", str(part), "--optimizer", "mine", "--out", str(tmp_path / "out")]
    assert main([*FIT, *options, "--quiet"]) == 0
    part.write_text(f"{PART}\n# another content\n")
    assert main([*FIT, *options, "--quiet"]) == 2
    assert "plugins" in capsys.readouterr().err


def test_it_is_listed(part: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "optimizers", "--plugin", str(part)]) == 0
    assert "CMA-ES under another name." in capsys.readouterr().out
    assert load_plugins(part) == ["optimizers: mine"]  # again


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("missing.py", None, "expected a Python file, got no file"),
        ("parts.txt", "", "which Python can import, got parts.txt"),
        ("my-parts.py", "", "which Python can import, got my-parts.py"),
        ("random.py", "", "a name that no imported module has, got random"),
        ("nothing_here.py", "x = 1\n", r"a call of dropo.register\(kind, name, plugin\)"),
        (
            "wrong_kind.py",
            "import dropo\ndropo.register('optimizer', 'x', 1)\n",
            "line 2.*Unknown",
        ),
        ("broken_part.py", "\n\nx = = 1\n", "line 3.*SyntaxError"),
        ("failing_part.py", "import no_such_module\n", "line 1.*No module named"),
    ],
)
def test_what_cannot_be_used_is_refused(
    tmp_path: Path, name: str, content: str | None, message: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(BadFile, match=message):
        load_plugins(tmp_path / name)


EFFECT = """
from functools import partial

import numpy as np

from dropo import register
from dropo.core.contracts.effect import EffectInstance, Quantity


def own_drag(robot):
    size = Quantity("drag", "N s/m", 0.0, 10.0, probes=(0.1,))
    for joint in map(robot.model.joint, range(robot.model.njnt)):
        yield EffectInstance("own_drag", joint.name, (size,), force=partial(drag, joint.dofadr[0]))


def drag(dof, state, magnitudes):
    force = np.zeros_like(state.qvel)
    force[:, dof] = -magnitudes[0] * state.qvel[:, dof]
    return force


register("effects", "own_drag", own_drag)
"""
KEYS = """
plugins: [own_drag_of_the_test.py]
effects:
- {effect: own_drag, target: slide, sizes: {drag: 0.5}}
"""


@pytest.fixture
def cart(tmp_path: Path) -> Iterator[Path]:
    """A problem file whose effect is in a file beside it, forgotten afterwards."""
    (tmp_path / "robot.xml").write_text(XML)
    data = simulate(XML, trajectories=2, steps=10, frame_skip=2)
    keys = ("observations", "actions", "next_observations", "terminals")
    np.savez(tmp_path / "data.npz", **{key: getattr(data, key) for key in keys})
    (tmp_path / "own_drag_of_the_test.py").write_text(EFFECT)
    path = tmp_path / "problem.yaml"
    path.write_text(TEXT + KEYS)
    yield path
    registry._registered["effects"].pop("own_drag", None)
    sys.modules.pop("own_drag_of_the_test", None)
    plugin_files._loaded.clear()
    plugin_files._sums.clear()


def test_a_problem_file_names_its_parts(cart: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Commands refuse to run the file unless it is trusted, or named by the caller; its sum is
    recorded, and a problem that is written elsewhere names it by its way from there.
    """
    out = cart.parent / "out"
    command = ["fit", str(cart), "--method", "least-squares", "--quiet", "--out", str(out)]
    assert main(command) == 2
    said = capsys.readouterr().err
    assert "problem.yaml: plugins.0: 'own_drag_of_the_test.py' is Python code" in said
    assert not out.exists()
    assert main([*command, "--trust"]) == 0
    record = json.loads((out / "run.json").read_text())
    expected = hashlib.sha256(EFFECT.encode()).hexdigest()
    assert record["plugins"]["own_drag_of_the_test.py"] == expected
    problem = load(cart)
    written = write_problem(problem, cart.parent / "elsewhere")
    assert "plugins:\n- ../own_drag_of_the_test.py" in written.read_text()
    assert [own.effect for own, _ in load(written).simulator.fixed] == ["own_drag"]


def test_what_is_not_known_without_its_file_says_so(
    cart: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An effect of a problem file, and a log of an unknown ending."""
    cart.write_text(TEXT + KEYS.replace("plugins: [own_drag_of_the_test.py]", ""))
    assert main(["fit", str(cart), "--method", "least-squares"]) == 2
    said = capsys.readouterr().err
    assert "effects[0].effect: expected an effect (the nearest is" in said
    assert f"got 'own_drag'. {registry.HINT}" in said
    log = cart.parent / "log.tlm"
    log.write_text("1 2 3")
    with pytest.raises(BadFile, match=r"a file '.tlm'. One of your own needs its file: --plugin"):
        open_log(log)


def forget() -> None:
    """As in a new process, no file was run."""
    registry._registered["effects"].pop("own_drag", None)
    sys.modules.pop("own_drag_of_the_test", None)
    plugin_files._loaded.clear()


def test_a_written_problem_names_the_files_that_its_effects_need(
    cart: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also where the command line gave them: no file of another part, none twice, and none where
    there is no such effect.
    """
    folder = cart.parent
    cart.write_text(TEXT)
    (folder / "other_of_the_test.py").write_text(
        "import dropo\n\ndropo.register('families', 'other', print)\n"
    )
    for part in ("own_drag_of_the_test.py", "other_of_the_test.py"):
        load_plugins(folder / part)
    plain = load(cart)
    (drag,) = instances_of(plain.simulator.effect_context, "own_drag", "slide")
    found = replace(plain, simulator=plain.simulator.with_effects((), [(drag, np.array([0.5]))]))
    assert "plugins" not in write_problem(plain, folder / "plain").read_text()
    written = write_problem(found, folder / "runs" / "extended")
    expected = "plugins:\n- ../../own_drag_of_the_test.py\n"
    assert expected in written.read_text()
    again = write_problem(load(written), folder / "runs" / "again")
    assert expected in again.read_text()
    forget()
    command = ["fit", str(written), "--method", "least-squares", "--quiet"]
    assert main(command) == 2
    assert "own_drag_of_the_test.py' is Python code, which runs only" in capsys.readouterr().err
    assert main([*command, "--trust"]) == 0
    sys.modules.pop("other_of_the_test", None)


def test_a_file_that_the_caller_names_needs_no_other_trust(cart: Path) -> None:
    part = cart.parent / "own_drag_of_the_test.py"
    command = ["data", "describe", str(cart), "--quiet"]
    assert main(command) == 2
    assert main([*command, "--plugin", str(part)]) == 0
    part.write_text(f"{EFFECT}\n# changed since\n")
    assert main(command) == 2
    assert load(cart).plugins == (str(part),)  # in Python, what is loaded is trusted


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("[missing.py]", "plugins.0: expected a Python file, by its path from this file"),
        ("own_drag_of_the_test.py", "plugins: expected a list of Python files"),
        ("[3]", "plugins"),
        ("[robot.xml]", "robot.xml: plugins of problem.yaml: expected a name like my_parts.py"),
    ],
)
def test_what_a_problem_file_cannot_name_is_refused(cart: Path, value: str, message: str) -> None:
    cart.write_text(f"{TEXT}\nplugins: {value}\n")
    with pytest.raises(BadFile, match=message):
        load(cart)


NO_NUMBERS = """
from dataclasses import dataclass, replace
from dropo import register
from dropo.estimators.least_squares import LeastSquares


@dataclass(frozen=True, kw_only=True)
class NoNumbers(LeastSquares):
    name = "no-numbers"

    def _fit(self, problem, run):
        fit = super()._fit(problem, run)
        return replace(fit, {field}=fit.{field} * float("nan"))


register("methods", "no-numbers", NoNumbers)
"""


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ("mean", "The 'mean of mass' of method 'no-numbers' must be a finite number. Got nan"),
        ("sd", "The 'sd of mass' of method 'no-numbers' must be a finite number. Got nan"),
        ("phi", "The 'phi' of method 'no-numbers' must be finite. Got [nan"),
    ],
)
def test_a_method_that_finds_no_numbers_is_refused(
    field: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In one line that names the method and the parameter; nothing is printed or written."""
    file = tmp_path / "no_numbers_of_the_test.py"
    file.write_text(NO_NUMBERS.replace("{field}", field))
    command = ["fit", "slide", "--method", "no-numbers", "--plugin", str(file)]
    for out in ([], ["--out", str(tmp_path / "out")]):
        assert main([*command, *out]) == 2
        printed, said = capsys.readouterr()
        assert (printed, said.count("\n")) == ("", 1)
        assert words in said
    assert not (tmp_path / "out").exists()
    sys.modules.pop(file.stem, None)


NO_REASON = """
from dropo import register
from dropo.core.contracts.optimizer import CallbackOptimizer


class NoReason(CallbackOptimizer):
    def _minimise(self, cost):
        cost(self.start)


register("optimizers", "no-reason", NoReason)
"""


def test_an_optimizer_that_does_not_say_why_it_stopped_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It forgot `return`: one line names the class and the rule, and nothing waits for ever."""
    file = tmp_path / "no_reason_of_the_test.py"
    file.write_text(NO_REASON)
    assert main([*FIT, "--optimizer", "no-reason", "--plugin", str(file), "--quiet"]) == 2
    printed, said = capsys.readouterr()
    assert (printed, said.count("\n")) == ("", 1)
    assert "NoReason._minimise must be a sentence that says why it stopped. Got None" in said
    registry._registered["optimizers"].pop("no-reason", None)
    sys.modules.pop(file.stem, None)


QUICK = ("diagnose", "torque-arm", "--quick", "--hide", "joint_armature:elbow=0.01", "--quiet")


def test_a_regression_says_which_effects_it_does_not_look_for(cart: Path) -> None:
    """Those of plug-ins, where there are any; else nothing is said."""
    part = cart.parent / "own_drag_of_the_test.py"
    said = []
    for out, options in (("without", []), ("with", ["--plugin", str(part)])):
        assert main([*QUICK, *options, "--out", str(cart.parent / out)]) == 0
        kept = json.loads((cart.parent / out / "diagnosis.json").read_text())
        said.append([text for text in kept["warnings"] if "own_drag" in text])
    expected = (
        "The effects of plug-ins are not looked for by regression: own_drag. A search by simulation"
        " (without --quick) does."
    )
    assert said == [[], [expected]]
