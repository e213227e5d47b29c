"""Files broken in any way: one line or a result, at once, and nothing written by a refusal."""

from pathlib import Path

import pytest

from tests.faults.fuzz import build, run_case

SEED = 0
CASES = 300
EACH = 30


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Whole files of every kind."""
    folder = tmp_path_factory.mktemp("whole")
    build(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, CASES, EACH))
def test_broken_files(whole: Path, tmp_path: Path, first: int) -> None:
    numbers = range(first, first + EACH)
    found = [run_case(whole, tmp_path / "case", number, SEED) for number in numbers]
    assert [one for one in found if one is not None] == []
