"""`dropo schema`: the schema takes and refuses the same files as the reader, as for their form."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from dropo.cli.main import main
from dropo.core.services.files.strict_yaml import read_yaml
from dropo.problems.file.writer import write_problem
from tests.models.hidden_in_arm import UPPER, problem
from tests.models.malformed import MAPPING, PROBLEM
from tests.models.problem_files import REFUSALS, TEXT

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```yaml\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SHOWN = [
    (page.name, text)
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    for text in BLOCK.findall(page.read_text())
]
FORM = (  # of the refusals in tests/problems/test_reader.py, those of a file's form alone
    "unknown key",
    "unknown parameter key",
    "wrong type",
    "true is no number",
    "a float is not whole",
    "zero",
    "no low",
    "low is text",
    "negative index",
    "unknown target",
    "unknown derived",
    "a parameter that is no mapping",
    "no model",
    "no data",
    "observation is no list",
)


@pytest.fixture
def validators(capsys: pytest.CaptureFixture[str]) -> dict[str, Draft202012Validator]:
    """What `dropo schema` prints, by kind."""
    found = {}
    for kind in ("problem", "mapping"):
        assert main(["schema", "--of", kind]) == 0
        content = json.loads(capsys.readouterr().out)
        Draft202012Validator.check_schema(content)
        found[kind] = Draft202012Validator(content)
    return found


def content_of(text: str, folder: Path) -> dict[str, Any]:
    """The content of a YAML text."""
    (folder / "file.yaml").write_text(text)
    return read_yaml(folder / "file.yaml", "a file")


def test_problem_files_are_the_default(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    first = capsys.readouterr().out
    assert main(["schema", "--of", "problem"]) == 0
    assert capsys.readouterr().out == first
    assert main(["schema", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert main(["schema", "--of", "maping"]) == 2
    assert "Did you mean 'mapping'?" in capsys.readouterr().err


def test_every_key_has_a_sentence(validators: dict[str, Draft202012Validator]) -> None:
    """What an editor shows."""
    for validator in validators.values():
        for entry in (validator.schema, *validator.schema["$defs"].values()):
            for name, key in entry["properties"].items():
                assert key["description"].endswith("."), name


@pytest.mark.parametrize(
    "text", [text for _, text in SHOWN], ids=[f"{page}{i}" for i, (page, _) in enumerate(SHOWN)]
)
def test_files_of_the_documentation_fit(
    text: str, validators: dict[str, Draft202012Validator], tmp_path: Path
) -> None:
    content = content_of(text, tmp_path)
    kind = "problem" if "model" in content else "mapping" if "qpos" in content else None
    if kind is None:
        pytest.skip("a part of a file")
    validators[kind].validate(content)


def test_there_are_files_in_the_documentation() -> None:
    """The control of the test above."""
    texts = [text for _, text in SHOWN]
    assert sum("model:" in text for text in texts) >= 3
    assert sum("qpos:" in text for text in texts) >= 1


def test_what_is_written_fits(validators: dict[str, Draft202012Validator], tmp_path: Path) -> None:
    """With effects that stand beside the model, and without."""
    for i, effects in enumerate(([], [("actuator_delay:shoulder_motor", [0.005])])):
        path = write_problem(
            problem(effects, parameters=[UPPER], episodes=2, steps=12), tmp_path / str(i)
        )
        validators["problem"].validate(read_yaml(path, "a problem file"))


def test_rich_files_fit(validators: dict[str, Draft202012Validator]) -> None:
    validators["problem"].validate(PROBLEM)
    validators["mapping"].validate(MAPPING)


@pytest.mark.parametrize("case", FORM)
def test_wrong_problem_files_do_not_fit(
    case: str, validators: dict[str, Draft202012Validator], tmp_path: Path
) -> None:
    old, new, _ = REFUSALS[case]
    assert not validators["problem"].is_valid(content_of(TEXT.replace(old, new, 1), tmp_path))
    assert validators["problem"].is_valid(content_of(TEXT, tmp_path))


@pytest.mark.parametrize(
    "change",
    [
        {"qpos": {}},
        {"rate": 0},
        {"rate": None},
        {"poss": {}},
        {"ctrl": {}},
        {"time": {"unit": "min"}},
        {"run": {"only": "a"}},
        {"qpos": {"elbow": {"colum": "q"}}},
        {"qpos": {"elbow": {"column": "q", "unit": "degrees"}}},
        {"qpos": {"elbow": {"column": "q", "sign": 2}}},
        {"qpos": {"elbow": {"column": "q", "offset": "x"}}},
    ],
)
def test_wrong_mapping_files_do_not_fit(
    change: dict[str, Any], validators: dict[str, Draft202012Validator]
) -> None:
    assert not validators["mapping"].is_valid(MAPPING | change)
