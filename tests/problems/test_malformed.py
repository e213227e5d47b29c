"""Malformed problem and mapping files end in success or in a refusal that names a file, never in a
traceback.
"""

import copy
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dropo.core.services.errors import InvalidInput
from dropo.logs.mapping import read_mapping
from dropo.mjmodel.joints import load_model_joints
from dropo.problems.file.reader import read_inputs
from dropo.problems.loading import load
from tests.models.malformed import MAPPING, PROBLEM

XML = """
<mujoco><option timestep="0.01"/><worldbody><body name="cart">
<joint name="slide" type="slide" axis="1 0 0" damping="0.5"/>
<geom name="box" type="box" size="0.1 0.1 0.1" mass="2"/><body name="pole" pos="0 0 0.1">
<joint name="hinge" axis="0 1 0" damping="0.1"/>
<geom name="rod" type="capsule" size="0.02" fromto="0 0 0 0 0 0.5" mass="0.5"/></body></body>
<body name="cube" pos="3 0 0"><freejoint name="cube"/><geom size="0.1" mass="1"/></body></worldbody>
<actuator><motor name="push" joint="slide" ctrllimited="true" ctrlrange="-1 1"/></actuator></mujoco>
"""
TASK = (
    "import numpy as np\n\ndef reward(before, actions, after):\n    return np.zeros(len(after))\n"
)


@dataclass(frozen=True)
class Raw:
    """YAML written as it is."""

    text: str


JUNK = [
    Raw(text)
    for text in (
        "null",
        "true",
        ".nan",
        ".inf",
        "-.inf",
        "0",
        "-1",
        "0.5",
        "1e400",
        "-1e400",
        "1" * 400,
        "1" * 5000,
        "0x" + "f" * 5000,
        "''",
        "x",
        "on",
        "0o14",
        '"\\0"',
        "x" * 300,
        "[]",
        "{}",
        "[[]]",
        "[1, x]",
        "[x, x]",
        "[null]",
        "{a: 1}",
        "{1: 2}",
        "{null: 1}",
        "{[1]: 2}",
        "{? {a: 1} : 2}",
        "{a: 1, a: 2}",
        "!!int x",
        "!!bool x",
        "!!set {a}",
        "!!omap [a: 1]",
        "!!binary aGk=",
        "!!python/name:os.system x",
        "!foo x",
        "2001-01-01",
        "&a [*a]",
        "&a {a: *a}",
        "*missing",
        "{<<: 3}",
        "{<<: {a: 1}}",
        "@",
        "%",
        "{",
        "]",
        "\t",
        "'..'",
        "'.'",
        "'x[0:999999999999]'",
        "'x[5:2]'",
        "qpos",
        "ctrl",
        "'qpos[0'",
        "minari:none",
        "a:b",
        "os:getcwd",
        "os:sep",
        "task.py:",
        "data.npz",
        "robot.xml",
        "[data.npz, data.npz]",
        "[[[[[[" * 40 + "]]]]]]" * 40,
        "1_000",
        "1:30",
        "=",
        "'é'",
        "{<list>: 1}",
        "'[key]'",
    )
]


def emit(value: Any) -> str:
    """A value in YAML's flow style."""
    if isinstance(value, Raw):
        return value.text
    if isinstance(value, dict):
        return "{" + ", ".join(f"{emit(key)}: {emit(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(emit, value)) + "]"
    return json.dumps(value)


def places(content: Any) -> list[tuple[Any, Any]]:
    """Every container in a content with each of its keys or places."""
    keys = (
        content
        if isinstance(content, dict)
        else range(len(content))
        if isinstance(content, list)
        else ()
    )
    return [found for key in keys for found in [(content, key), *places(content[key])]]


def mutate(content: Any, draw: Any) -> None:
    """Changes one entry: it is taken away, replaced, wrapped, renamed, or gets a neighbour."""
    container, key = draw(st.sampled_from(places(content)))
    old = container[key]
    junk = draw(st.sampled_from(JUNK))
    kind = draw(st.sampled_from(("delete", "replace", "swap", "list", "mapping", "rename", "add")))
    if kind in ("delete", "rename"):
        del container[key]
    if kind in ("rename", "add"):
        container.insert(0, junk) if isinstance(container, list) else container.update({junk: old})
    if kind == "swap":
        other, there = draw(st.sampled_from(places(content)))
        container[key] = copy.deepcopy(other[there])
    elif kind not in ("delete", "rename", "add"):
        container[key] = {"replace": junk, "list": [old], "mapping": {"a": old}}[kind]


@st.composite
def files(draw: Any, valid: dict[str, Any]) -> bytes:
    """A valid file after one to three changes of its entries, and now and then of its bytes."""
    content = json.loads(json.dumps(valid))
    for _ in range(draw(st.integers(1, 3))):
        if places(content):
            mutate(content, draw)
    lines = [f"{emit(key)}: {emit(value)}\n" for key, value in content.items()]
    found = "".join(lines).encode()
    if draw(st.integers(0, 9)) == 0:
        cut = draw(st.integers(0, len(found)))
        found = (
            found[:cut]
            + draw(
                st.sampled_from(
                    [b"\xff", b"\t", b"\0", b"\n", b"---\n", b"&a ", b"", b"\xef\xbb\xbf"]
                )
            )
            + found[cut:]
        )
    if draw(st.integers(0, 19)) == 0:
        found = found[: draw(st.integers(0, len(found)))]
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The model, data and task that the valid files name."""
    place = tmp_path_factory.mktemp("malformed")
    (place / "robot.xml").write_text(XML)
    (place / "task.py").write_text(TASK)
    model = mujoco.MjModel.from_xml_string(XML)
    rows = np.zeros((30, 4))
    actions = np.zeros((30, model.nu))
    arrays = {
        "observations": rows,
        "next_observations": rows,
        "actions": actions,
        "terminals": np.arange(30) % 10 == 9,
    }
    np.savez(place / "data.npz", **arrays, **{"actions.commanded": actions})
    return place


MANY = settings(
    max_examples=80,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def test_the_files_without_a_change_are_read(folder: Path) -> None:
    """The control of the tests below."""
    for name, content in (("problem.yaml", PROBLEM), ("map.yaml", MAPPING)):
        (folder / name).write_text(
            "".join(f"{emit(key)}: {emit(value)}\n" for key, value in content.items())
        )
    assert len(load(folder / "problem.yaml", threads=1).trajectories) == 15
    assert (
        len(read_mapping(folder / "map.yaml", load_model_joints(folder / "robot.xml")).channels)
        == 5
    )


def refusal(read: Callable[[], object]) -> str | None:
    """The message of a refusal; None where reading succeeds."""
    try:
        read()
    except InvalidInput as error:
        return str(error)
    return None


@MANY
@given(data=files(PROBLEM))
def test_problem_files(folder: Path, data: bytes) -> None:
    """Reading gives a problem, or a refusal that names the file or a file beside it."""
    path = folder / "problem.yaml"
    path.write_bytes(data)
    for read in (partial(load, path, threads=1, checked=False), partial(read_inputs, path)):
        message = refusal(read)
        assert message is None or str(folder) in message or "minari" in message
        assert len(message or "") < 10_000


@MANY
@given(data=files(MAPPING))
def test_mapping_files(folder: Path, data: bytes) -> None:
    """Likewise."""
    path = folder / "map.yaml"
    path.write_bytes(data)
    robot = load_model_joints(folder / "robot.xml")
    message = refusal(lambda: read_mapping(path, robot))
    assert message is None or str(path) in message
    assert len(message or "") < 10_000
