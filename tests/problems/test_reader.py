"""Problem files: what they say is what is fitted, and everything that cannot be meant is refused by
file, key and nearest name.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument, BadFile, InvalidInput, UnknownName
from dropo.core.services.files.file_content import describe_options
from dropo.core.services.files.strict_yaml import format_yaml, read_yaml
from dropo.core.services.registry import find
from dropo.problems.loading import load
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.models.problem_files import REFUSALS, TEXT, XML, simulate

BALL = """
<mujoco><worldbody><body name="ball"><freejoint name="free"/>
<geom name="shell" size="0.1" mass="1"/></body></worldbody></mujoco>
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    data = simulate(XML, frame_skip=2)
    keys = ("observations", "actions", "next_observations", "terminals")
    np.savez(tmp_path / "data.npz", **{key: getattr(data, key) for key in keys})
    (tmp_path / "robot.xml").write_text(XML)
    (tmp_path / "ball.xml").write_text(BALL)
    (tmp_path / "problem.yaml").write_text(TEXT)
    return tmp_path


def written(folder: Path, old: str = "", new: str = "") -> Path:
    """The problem file with one change."""
    assert old in TEXT
    path = folder / "problem.yaml"
    path.write_text(TEXT.replace(old, new, 1) if old else TEXT + new)
    return path


def refusal(path: Path | str) -> str:
    """The message without the folder's name."""
    before = sorted(Path(path).parent.rglob("*"))
    with pytest.raises(InvalidInput) as caught:
        load(path, threads=1)
    assert sorted(Path(path).parent.rglob("*")) == before, "a refusal wrote something"
    return str(caught.value).replace(f"{Path(path).parent}/", "")


def test_a_file_is_read_as_written(folder: Path) -> None:
    """Parameters, columns, frame skip and data are those of the file, and the model fits the data
    that it made.
    """
    problem = load(folder / "problem.yaml", threads=1)
    assert problem.name == "problem"
    assert problem.space.names == ("cart_mass", "damping")
    assert problem.horizon == 1
    assert isinstance(problem.simulator, MujocoSimulator)
    assert problem.simulator.frame_skip == 2
    assert [s.name for s in problem.simulator.signals] == [
        "qpos.slide",
        "qpos.hinge",
        "qvel.slide",
        "qvel.hinge",
    ]
    assert problem.space["cart_mass"].unit == "kg"
    assert problem.warnings == ()
    assert problem.held_out is None
    prediction = problem.simulator.predict([[2.0, 0.5]], problem.segments)[0]
    np.testing.assert_allclose(prediction, problem.simulator.targets(problem.segments), atol=1e-12)


def test_a_path_may_be_text_and_relative(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    assert load("problem.yaml", threads=1).name == "problem"


def test_further_keys(folder: Path) -> None:
    """epsilon, lambda, held_out, transitions and reset reach the problem."""
    keys = "epsilon: 1e-8\nlambda: 5\nheld_out: [2]\ntransitions: 25\nreset: {set: [qpos]}\n"
    problem = load(written(folder, new=keys), threads=1)
    assert problem.epsilon == 1e-8
    assert problem.horizon == 5
    assert problem.reset == "partial"
    assert len(problem.trajectories) == 25
    assert problem.held_out is not None
    assert len(problem.held_out) == 20
    assert problem.set_columns is not None
    assert problem.set_columns.tolist() == [True, True, False, False]


def test_the_kind_of_noise(folder: Path) -> None:
    problem = load(written(folder, new="start_noise: true\nstudent_t: 8\n"), threads=1)
    assert (problem.start_noise, problem.noise_degrees) == (True, 8.0)
    plain = load(written(folder), threads=1)
    assert (plain.start_noise, plain.noise_degrees) == (False, None)
    gaussian = load(written(folder, new="noise: gaussian\n"), threads=1)
    assert gaussian.settings == {"noise": "gaussian"}
    assert plain.settings == {}


def test_epsilon_by_signal(folder: Path) -> None:
    keys = "epsilon: {qvel.hinge: 4, qpos.slide: 1, qpos.hinge: 2, qvel.slide: 3e0}\n"
    np.testing.assert_array_equal(load(written(folder, new=keys), threads=1).epsilon, [1, 2, 3, 4])
    np.testing.assert_array_equal(
        load(written(folder, new="epsilon: [1, 2, 3, 4]\n"), threads=1).epsilon, [1, 2, 3, 4]
    )


def test_reset_start_and_held_out_file(folder: Path) -> None:
    problem = load(written(folder, new="reset: start\nheld_out: data.npz\n"), threads=1)
    assert len(problem.segments) == 3
    assert len(problem.segments.rows[0]) == 60
    assert problem.held_out is not None
    assert len(problem.held_out) == 60


def test_relative_and_kept_parameters(folder: Path) -> None:
    path = written(folder, "unit: kg}", "unit: '', target: relative, derived: keep}")
    parameter = load(path, threads=1).space["cart_mass"]
    assert parameter.relative
    assert not parameter.derived


def test_a_prior_is_read_and_refused(folder: Path) -> None:
    """Kept as its text; a bad one is refused with its key, the rule and the nearest name."""
    assert load(
        written(folder, "unit: kg}", 'unit: kg, prior: "normal(2, 0.1)"}'), threads=1
    ).priors == {"cart_mass": "normal(2, 0.1)"}
    assert load(written(folder), threads=1).priors == {}
    wrong = refusal(written(folder, "unit: kg}", 'unit: kg, prior: "norml(2, 0.1)"}'))
    assert wrong == (
        "problem.yaml: parameters.cart_mass.prior: No prior called 'norml'. Did you mean 'normal'?"
    )
    assert "mass in the search interval [1, 4]" in refusal(
        written(folder, "unit: kg}", 'unit: kg, prior: "normal(9, 0.1)"}')
    )


def test_parameters_may_be_left_out(folder: Path) -> None:
    (folder / "problem.yaml").write_text("model: robot.xml\nframe_skip: 2\ndata: data.npz\n")
    problem = load(folder / "problem.yaml", threads=1)
    assert len(problem.space) == 0
    assert problem.simulator.predict(np.empty((1, 0)), problem.segments).shape == (1, 60, 4)
    with pytest.raises(
        BadArgument,
        match=r"The 'parameters' of Problem 'problem' must be at least one\. Got 0 instead\.",
    ):
        find("methods", "least-squares")().fit(problem)


def test_a_model_may_be_a_built_in_one(folder: Path) -> None:
    rng = np.random.default_rng(0)
    rows = rng.normal(0, 0.01, (10, 11))
    np.savez(
        folder / "hopper.npz",
        observations=rows,
        next_observations=rows,
        actions=np.zeros((10, 3)),
        terminals=np.arange(10) == 9,
    )
    text = "model: hopper\nframe_skip: 4\ndata: hopper.npz\nobservation: ['qpos[1:]', qvel]\n"
    (folder / "problem.yaml").write_text(
        text + "parameters: {torso: {field: body_mass, name: torso, low: 1, high: 7}}\n"
    )
    assert load(folder / "problem.yaml", threads=1).space.names == ("torso",)


def test_actions_outside_the_control_range_are_warned_of(folder: Path) -> None:
    data = dict(np.load(folder / "data.npz"))
    data["actions"][3] = 1.5
    np.savez(folder / "data.npz", **data)
    sentence = (
        "1 of 60 actions are outside the control range [-1, 1] and are clipped; the farthest "
        "is 1.5, row 3 at 0.06 s."
    )
    assert load(folder / "problem.yaml", threads=1).warnings == (f"ctrl.push: {sentence}",)


@pytest.mark.parametrize(("old", "new", "message"), REFUSALS.values(), ids=REFUSALS)
def test_refusals(folder: Path, old: str, new: str, message: str) -> None:
    """One line that names the file, the key, what was expected and what was got; nothing is
    written.
    """
    assert refusal(written(folder, old, new)) == f"problem.yaml: {message}"


ADDED = {
    "noise: gausian": (
        "noise: expected what learned noise may be (the nearest is 'gaussian'), got 'gausian'."
    ),
    "start_noise: 1": (
        "start_noise: expected true, where the measured start states carry the noise too, or "
        "false, got 1."
    ),
    "whole_runs: 1": (
        "whole_runs: expected true, where start states are to be found along whole runs, or "
        "false, got 1."
    ),
    "reset: start\nwhole_runs: true": (
        "whole_runs: expected false with a `reset` other than `transition`, got true."
    ),
    "student_t: 2": "student_t: expected degrees of freedom, a number above 2, got 2.",
    "student_t: .inf": "student_t: expected degrees of freedom, a number above 2, got inf.",
    "epsilon: -1": "epsilon: expected a variance, 0 or more, got -1.",
    "epsilon: small": "epsilon: expected a variance, 0 or more, got 'small'.",
    "epsilon: .nan": "epsilon: expected a variance, 0 or more, got nan.",
    "epsilon: [1, 2]": (
        "epsilon: expected one number, or one for each of the 4 signals, got 2 numbers."
    ),
    "epsilon: {qpos.slid: 1}": (
        "epsilon.qpos.slid: expected a signal (the nearest is 'qpos.slide'), got 'qpos.slid'."
    ),
    "epsilon: {qpos.slide: 1}": (
        "epsilon: expected a variance for each of the 4 signals, got none for qpos.hinge, "
        "qvel.slide, qvel.hinge."
    ),
    "lambda: 0": "lambda: expected a whole number of at least 1, got 0.",
    "lambda: 21": (
        "lambda: lambda = 21 is longer than trajectory 0, which has 20 transitions. Choose "
        "a smaller lambda, or leave that trajectory out."
    ),
    "transitions: 0": "transitions: expected a whole number of at least 1, got 0.",
    "held_out: [3]": "held_out: expected trajectory numbers from 0 to 2, got 3.",
    "held_out: [0, 1, 2]": "held_out: expected some trajectories left to fit, got all 3 of them.",
    "held_out: 2": "held_out: expected a list of trajectory numbers, or data as in `data`, got 2.",
    "held_out: []": (
        "held_out: expected a list of trajectory numbers, or data as in `data`, got []."
    ),
    "reset: never": (
        "reset: expected 'transition', 'start', or {set: [observation items]}, got 'never'."
    ),
    "reset: {sat: [qpos]}": "reset.sat: expected a known key (the nearest is 'set'), got 'sat'.",
    "reset: {set: [act]}": "reset.set: The observation must have at least one column. Got none.",
    "reset: {set: [qpo]}": "reset.set: No field called 'qpo'. Did you mean 'qpos'?",
    "reset: start\nlambda: 2": (
        "lambda: expected none with `reset: start`, where a segment is a whole trajectory, got 2."
    ),
}


@pytest.mark.parametrize(("line", "message"), ADDED.items(), ids=ADDED)
def test_refusals_of_further_keys(folder: Path, line: str, message: str) -> None:
    assert refusal(written(folder, new=line + "\n")) == f"problem.yaml: {message}"


def test_a_column_that_is_not_observed_cannot_be_set(folder: Path) -> None:
    data = dict(np.load(folder / "data.npz"))
    np.savez(
        folder / "data.npz",
        **{key: value[:, :2] if "observations" in key else value for key, value in data.items()},
    )
    text = TEXT.replace("[qpos, qvel]", "[qpos]") + "reset: {set: ['qvel[0]']}\n"
    (folder / "problem.yaml").write_text(text)
    assert (
        refusal(folder / "problem.yaml")
        == "problem.yaml: reset.set: expected columns that the observation holds, got qvel.slide."
    )


def test_a_model_that_does_not_compile(folder: Path) -> None:
    (folder / "robot.xml").write_text(XML.replace('joint="slide"', 'joint="slid"'))
    message = refusal(folder / "problem.yaml")
    assert message.startswith("problem.yaml: model: ")
    assert "robot.xml: expected a model that compiles, got " in message
    assert "slid" in message
    assert "\n" not in message


def test_a_model_that_is_no_xml(folder: Path) -> None:
    (folder / "robot.xml").write_text("robot")
    message = refusal(folder / "problem.yaml")
    assert re.match(
        r"problem\.yaml: model: robot\.xml: expected a model that compiles, got XML parse error",
        message,
    ), message


def test_data_with_other_actions(folder: Path) -> None:
    data = dict(np.load(folder / "data.npz"))
    np.savez(folder / "data.npz", **{**data, "actions": np.zeros((60, 2))})
    assert refusal(folder / "problem.yaml") == (
        "problem.yaml: data: expected 1 action columns, as the action items give, got 2 in "
        "data.npz."
    )


def test_data_of_its_own_file_is_named(folder: Path) -> None:
    data = dict(np.load(folder / "data.npz"))
    data["observations"][4, 1] = np.nan
    np.savez(folder / "data.npz", **data)
    assert (
        refusal(folder / "problem.yaml")
        == "data.npz: observations: expected finite numbers, got nan at row 4, column 1."
    )


def test_no_such_data(folder: Path) -> None:
    assert refusal(written(folder, "data.npz", "dat.npz")) == (
        "dat.npz: expected an .npz file, a folder of .npy files or a Minari data set, got "
        "no such file."
    )


def test_a_quaternion_must_have_length_one(folder: Path) -> None:
    """A quaternion far from length 1 is refused; with `checked=False` it is left to `dropo data
    check`.
    """
    data = simulate(BALL)
    twice = np.where(np.arange(13) == 3, 2.0, data.observations)
    np.savez(
        folder / "ball.npz",
        observations=twice,
        actions=data.actions,
        next_observations=twice,
        terminals=data.terminals,
    )
    path = folder / "problem.yaml"
    path.write_text(
        "model: ball.xml\ndata: ball.npz\n"
        "parameters: {mass: {field: body_mass, name: ball, low: 1, high: 2}}\n"
    )
    sentence = (
        "problem.yaml: data: qpos.free: a quaternion must have length 1, and one has 2, row 0. "
        "The order is w, x, y, z."
    )
    assert (
        refusal(path)
        == f"{sentence} If they are right all the same: --unchecked, or load(..., checked=False)."
    )
    assert len(load(path, threads=1, checked=False).trajectories) == 60


def test_missing_and_empty_files(tmp_path: Path) -> None:
    assert (
        refusal(tmp_path / "none.yaml") == "none.yaml: expected a problem file, got no such file."
    )
    (tmp_path / "empty.yaml").write_text("")
    assert (
        refusal(tmp_path / "empty.yaml")
        == "empty.yaml: expected a problem file, a mapping of keys, got an empty file."
    )
    (tmp_path / "list.yaml").write_text("- model\n")
    assert (
        refusal(tmp_path / "list.yaml")
        == "list.yaml: expected a problem file, a mapping of keys, got a list."
    )
    (tmp_path / "number.yaml").write_text("1: 2\n")
    assert (
        refusal(tmp_path / "number.yaml")
        == "number.yaml: 1: expected a word as a key, got 1 (quote it)."
    )


def test_an_unknown_name_gets_the_nearest() -> None:
    with pytest.raises(
        UnknownName, match=re.escape("No problem called 'hoper'. Did you mean 'hopper'?")
    ):
        load("hoper")


def test_a_name_that_breaks_off_gets_the_whole_one() -> None:
    """Even where another name has as many letters in common."""
    told = describe_options("a field", "dof_friction", ["o_friction", "dof_frictionloss"])
    assert told == "a field (the nearest is 'dof_frictionloss')"


def test_a_folder_is_no_problem_file(folder: Path) -> None:
    """The one that is in it is named."""
    (folder / "problem.yaml").write_text("model: robot.xml\ndata: data.npz\n")
    told = rf"{folder}: expected a problem file, got a folder; give {folder}/problem.yaml"
    with pytest.raises(BadFile, match=re.escape(told)):
        load(str(folder))


def test_built_in_problems_are_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also their held-out data, where they have some: here the clock stands still."""
    whole = find("problems", "slide")()
    still = replace(whole.trajectories, time=np.zeros(len(whole.trajectories)))
    monkeypatch.setattr(
        "dropo.problems.loading.find",
        lambda kind, name: lambda threads: replace(whole, held_out=still),
    )
    with pytest.raises(
        BadArgument, match=r"^slide: held_out: time: \d+ rows are not later .* --unchecked"
    ):
        load("slide")
    assert load("slide", checked=False).held_out is still


def test_numbers_are_those_of_yaml_1_2(folder: Path) -> None:
    """`1e-1` is a number and `on` is a word."""
    assert load(written(folder, "low: 0.1", "low: 1e-1"), threads=1).space["damping"].low == 0.1
    message = refusal(written(folder, "name: cart", "name: on"))
    assert message == (
        "problem.yaml: parameters.cart_mass.name: expected the name of a body (there is "
        "cart, pole, world), got 'on'."
    )


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3),
        ("1.0e-3", 1e-3),
        ("1E3", 1000.0),
        (".5", 0.5),
        ("014", 14),
        ("0o14", 12),
        ("0x1f", 31),
        ("on", "on"),
        ("yes", "yes"),
        ("no", "no"),
        ("off", "off"),
        ("y", "y"),
        ("1:30", "1:30"),
        ("true", True),
        ("~", None),
        (".inf", np.inf),
    ],
)
def test_words_and_numbers_are_those_of_yaml_1_2(tmp_path: Path, text: str, value: object) -> None:
    """Where YAML 1.1 has booleans, octal and base 60."""
    (tmp_path / "a.yaml").write_text(f"a: {text}\n")
    found = read_yaml(tmp_path / "a.yaml", "a file")["a"]
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    "value",
    [
        1e-8,
        -1.5e300,
        0.1,
        3,
        "on",
        "1e5",
        "1:30",
        "014",
        "null",
        "",
        "a: b",
        "é",
        "x y " * 60,
        None,
        True,
    ],
)
def test_what_is_written_is_read(tmp_path: Path, value: object) -> None:
    """Texts that look like something else are quoted."""
    content = {"z": [value], "a": {"b": value}}
    (tmp_path / "a.yaml").write_text(format_yaml(content), encoding="utf-8")
    found = read_yaml(tmp_path / "a.yaml", "a file")
    assert found == content
    assert list(found) == ["z", "a"]
    assert type(found["a"]["b"]) is type(value)


def test_numbers_are_written_for_every_reader() -> None:
    """YAML 1.1 takes `1e-08` as a text."""
    assert format_yaml({"epsilon": 1e-8}) == "epsilon: 1.0e-08\n"


FORMER = """\
model: robot.xml
frame_skip: 2
data: data.npz
observation:
- qpos
- qvel
action:
- ctrl
parameters:
  cart_mass:
    field: body_mass
    low: 1
    high: 4.0
    name: cart
    unit: kg
lambda: 5
epsilon:
- 1.0e-08
- 1.0e-08
- 1.0e-06
- 1.0e-06
start_noise: true
effects:
- effect: actuator_delay
  target: push
  sizes:
    delay: 0.007
- effect: air_drag
  target: null
  variant: density
  fit:
    density: [0.0, 1.0]
"""


def test_files_of_earlier_versions_are_read(folder: Path) -> None:
    """As they were written then, with blocks, null and whole numbers."""
    (folder / "problem.yaml").write_text(FORMER)
    problem = load(folder / "problem.yaml", threads=1)
    assert problem.horizon == 5
    assert problem.start_noise
    np.testing.assert_array_equal(problem.epsilon, [1e-8, 1e-8, 1e-6, 1e-6])
    assert problem.space["cart_mass"].low == 1


FIRST = {
    "frame_skip: 2": ("frame_skip: x\nlambda: 0", "frame_skip: expected"),
    "low: 1, high: 4": ("high: x, low: y", "parameters.cart_mass.high: expected"),
    "field: dof_damping": ("field: dof_damping, index: x", "parameters.damping.index: expected"),
}


@pytest.mark.parametrize("old", FIRST)
def test_the_first_fault_of_the_file_is_told(folder: Path, old: str) -> None:
    """In the order of the file, not of the schema."""
    new, message = FIRST[old]
    assert refusal(written(folder, old, new)).startswith(f"problem.yaml: {message}")


@pytest.mark.parametrize(
    ("line", "message"),
    {
        "epsilon: null": "epsilon: expected a variance, 0 or more, got nothing.",
        "epsilon: [1, 2, x, 4]": "epsilon[2]: expected a variance, 0 or more, got 'x'.",
        "epsilon: {1: 2}": "epsilon.1: expected a word as a key, got 1 (quote it).",
        "lambda: 100000000000000000000": (
            "lambda: expected a whole number of at most 9007199254740992, got "
            "100000000000000000000."
        ),
        "motors: {slide: {gear_ratio: 0}}": (
            "motors.slide.gear_ratio: expected a number above 0, got 0."
        ),
        "motors: {slide: 3}": (
            "motors.slide: expected the name of a motor, or a mapping with its numbers, got 3."
        ),
        "task: {alive: a:b}": (
            "task.reward: expected a function as module:name, or file.py:name beside the "
            "problem file, got nothing."
        ),
        "effects: [{effect: wind, target: null, fit: {wind: 3}}]": (
            "effects[0].fit.wind: expected [low, high], two numbers, got 3."
        ),
    }.items(),
)
def test_refusals_deeper_in_the_file(folder: Path, line: str, message: str) -> None:
    """The key is given down to the place in a list."""
    assert refusal(written(folder, new=line + "\n")) == f"problem.yaml: {message}"


def test_the_error_names_file_and_key(folder: Path) -> None:
    with pytest.raises(BadFile) as caught:
        load(written(folder, "frame_skip: 2", "frame_skip: x"))
    assert caught.value.path == folder / "problem.yaml"
    assert caught.value.key == "frame_skip"


def test_a_parameter_of_several_elements(folder: Path) -> None:
    """A list of names gives each its own value, in the model's order, or all of them one."""
    old = "name: cart, low: 1, high: 4, unit: kg"
    each = load(written(folder, old, "name: [pole, cart], low: 0.1, high: 4"), threads=1)
    assert each.space.names == ("cart_cart_mass", "pole_cart_mass", "damping")
    model = each.simulator.model_of(np.array([3.0, 0.7, 0.5]))
    assert (model.body("cart").mass[0], model.body("pole").mass[0]) == (3.0, 0.7)
    new = "name: [pole, cart], shared: true, low: 0.1, high: 4"
    shared = load(written(folder, old, new), threads=1)
    assert shared.space.names == ("cart_mass", "damping")
    model = shared.simulator.model_of(np.array([1.5, 0.5]))
    assert model.body("cart").mass[0] == model.body("pole").mass[0] == 1.5
    path = written(folder, old, "name: [pole, card], low: 0.1, high: 4")
    assert refusal(path).endswith(
        "parameters.cart_mass.name: expected the name of a body (the nearest is 'cart'), got "
        "'card'."
    )
    path = written(folder, old, "name: cart, shared: true, low: 0.1, high: 4")
    assert refusal(path).endswith(
        "parameters.cart_mass.shared: expected false where `name` is no list and no pattern, got "
        "true."
    )


def test_a_model_whose_name_is_too_long_for_a_file(folder: Path) -> None:
    """It is refused as any other that is not there."""
    path = written(folder, "model: robot.xml", f"model: {'x' * 5000}")
    assert "model: expected " in refusal(path)
    assert "no such file" in refusal(path)
