"""`dropo list` names everything that the catalogue knows, each with a sentence."""

import json

import pytest

from dropo.cli.list import KINDS
from dropo.cli.main import main
from dropo.core.services import registry as catalogue


@pytest.mark.parametrize("kind", KINDS)
def test_every_name_has_a_sentence(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", kind, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert sorted(found) == catalogue.names(kind)
    assert all(text.endswith((".", ":")) and not text.startswith("(") for text in found.values()), (
        found
    )


def test_text(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def plug() -> None:
        """Does a thing (eq. 3) to e.g. a robot. And more.

        Much more.
        """

    monkeypatch.setattr(
        catalogue, "BUILT_IN", {**catalogue.BUILT_IN, "samplers": {"gone": "dropo.none:None_"}}
    )
    monkeypatch.setitem(catalogue._registered, "samplers", {"plug": plug})
    assert main(["list", "samplers"]) == 0
    assert capsys.readouterr().out == (
        "gone  (cannot be imported: No module named 'dropo.none')\n"
        "plug  Does a thing (eq. 3) to e.g. a robot.\n"
    )
