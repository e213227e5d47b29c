"""A study in a folder: its files, and its block in the README."""

import json

import numpy as np
import pytest

from dropo.core.services import registry
from dropo.core.services.errors import BadArgument, BadFile, Incompatible, UnknownName
from dropo.studies.engine.pages import write
from dropo.studies.engine.recover import recover
from dropo.studies.engine.study import Study, Table

TABLE = Table("numbers", ("name", "value"), (("one", "1"), ("ten", "10")))


def toy(work, seeds=None):
    """A study for this test."""
    done = work.map(double, range(seeds or 3))
    return Study(
        "toy",
        f"{len(done)} numbers",
        (TABLE,),
        ("They are few.",),
        {"done": done, "none": np.nan, 3: np.arange(2)},
        draw,
    )


def double(item):
    """A task."""
    return {"double": 2 * item}


def draw(figure):
    """A line."""
    figure.subplots().plot([0, 1], [0, 1])


@pytest.fixture(autouse=True)
def _toy(monkeypatch):
    monkeypatch.setitem(registry._registered, "studies", {"toy": toy})


def test_what_is_written(tmp_path):
    """Text, numbers and picture; the same bytes when written again; no evaluation log is left."""
    study = recover("toy", out=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["toy.json", "toy.md", "toy.svg"]
    assert str(study) in (tmp_path / "toy.md").read_text()
    assert "name  value\n----  -----\none       1\nten      10" in str(study)
    content = json.loads((tmp_path / "toy.json").read_text())
    assert content["data"] == {
        "done": [{"double": 0}, {"double": 2}, {"double": 4}],
        "none": None,
        "3": [0, 1],
    }
    before = (tmp_path / "toy.svg").read_bytes()
    write(study, tmp_path)
    assert (tmp_path / "toy.svg").read_bytes() == before
    assert b"<svg" in before


def test_the_block_of_a_readme_is_replaced(tmp_path):
    """The block alone, everything around it stays; a page without the block stays as it is."""
    page = tmp_path / "README.md"
    page.write_text(
        "# Page\n\n<!-- study: toy -->\nold\n<!-- end -->\n\n"
        "<!-- study: other -->\nkept\n<!-- end -->\nEnd.\n"
    )
    study = recover("toy", out=tmp_path)
    text = page.read_text()
    assert text.startswith("# Page\n\n<!-- study: toy -->\n```text\n3 numbers\n")
    assert text.endswith(
        "(toy.svg)\n<!-- end -->\n\n<!-- study: other -->\nkept\n<!-- end -->\nEnd.\n"
    )
    assert str(study) in text
    assert "old" not in text
    page.write_text("nothing of it\n")
    recover("toy", out=tmp_path)
    assert page.read_text() == "nothing of it\n"


def test_a_block_without_an_end_is_refused(tmp_path):
    """The page is not cut off at the next study's end."""
    page = tmp_path / "README.md"
    page.write_text(before := "<!-- study: toy -->\nold\n<!-- study: other -->\n<!-- end -->\n")
    with pytest.raises(BadFile, match="<!-- end -->"):
        recover("toy", out=tmp_path)
    assert page.read_text() == before


def test_refusals(tmp_path):
    """Unknown names with the nearest, a file for a folder, no seeds, the published method where
    there is none.
    """
    with pytest.raises(
        UnknownName, match=r"No study called 'table-6\.11'. Did you mean 'table-6\.1'\?"
    ):
        recover("table-6.11")
    (tmp_path / "file").write_text("")
    with pytest.raises(BadArgument, match="must be a folder"):
        recover("toy", out=tmp_path / "file")
    with pytest.raises(BadArgument, match="'seeds' of recover must be at least 1"):
        recover("toy", seeds=0)
    with pytest.raises(Incompatible, match="no runs of the published method"):
        recover("toy", published=True)
    with pytest.raises(Incompatible, match=r"has seeds of its own. Leave --first-seed out"):
        recover("toy", first_seed=3)
