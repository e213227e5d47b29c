"""The search for the hopper's policy, by training's augmented random search."""

import json
from dataclasses import replace
from itertools import islice

import numpy as np

from dropo.problems.hopper.model import hopper_model
from dropo.studies.tiboni_2021 import find_hopper_policy
from dropo.studies.tiboni_2021.find_hopper_policy import as_json, found, returns, run, search


def test_search_improves_the_policy():
    """From 40 fresh starts the policy after eight updates travels further than the first."""
    model = hopper_model()
    policies = list(islice(search(model, np.random.default_rng(7)), 8))
    gain = [
        returns(model, run(model, p, 40, np.random.default_rng(8)))
        for p in (policies[0], policies[-1])
    ]
    assert gain[1].mean() > gain[0].mean() + 4.5 * np.hypot(*(g.std() / np.sqrt(40) for g in gain))


def test_search_is_deterministic(capsys, monkeypatch):
    """Two searches of two updates; each says how far it came."""
    fewer = replace(find_hopper_policy.ALGORITHM, directions=4, best=2, trials=4)
    monkeypatch.setattr(find_hopper_policy, "ALGORITHM", fewer)
    twice = [as_json(*found(hopper_model(), seed=1, updates=2)) for _ in range(2)]
    assert twice[0] == twice[1]
    assert "update 2: return" in capsys.readouterr().err


def test_the_command_writes_what_the_search_finds(capsys, monkeypatch, tmp_path):
    """To a file or to the standard output, the same for the same seed."""
    fewer = replace(find_hopper_policy.ALGORITHM, directions=2, best=1, trials=2)
    monkeypatch.setattr(find_hopper_policy, "ALGORITHM", fewer)
    place = tmp_path / "policy.json"
    arguments = ["find_hopper_policy", "--seed", "1", "--updates", "1"]
    monkeypatch.setattr("sys.argv", [*arguments, "--out", str(place)])
    find_hopper_policy.main()
    assert capsys.readouterr().out == ""
    monkeypatch.setattr("sys.argv", arguments)
    find_hopper_policy.main()
    assert capsys.readouterr().out == place.read_text()
    content = json.loads(place.read_text())
    assert content
