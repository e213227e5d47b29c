"""What pictures are drawn from comes back as it was kept."""

from dataclasses import fields, replace

import numpy as np
import pytest

from dropo.core.records.figure_data import (
    AgainstAxis,
    Bar,
    FigureData,
    Forces,
    Similarity,
    Sizes,
    Sums,
)
from dropo.core.records.predictions import Predictions, Side, WholeRun
from dropo.core.services.errors import BadFile


def side(name, rng):
    """Numbers of the right shapes: 2 windows of 3 steps, 2 signals."""
    return Side(
        name,
        rng.random((2, 3, 2)),
        rng.random((2, 2, 3, 2)),
        rng.random(3),
        rng.random(2),
        rng.random(7),
    )


def whole_run():
    """A run of 4 steps."""
    rng = np.random.default_rng(1)
    lines = rng.random((3, 4, 2))
    lines[1, 2] = np.nan
    return WholeRun(1, 3, lines[0], rng.random((4, 3)), *lines[1:], np.arange(4) > 1)


def predictions(run=None):
    """Of a state that is observed as three columns and compared as two signals."""
    rng = np.random.default_rng(0)
    measured = rng.random((2, 3, 2))
    rows = rng.random((2, 3, 3))
    return Predictions(
        ("x", "v"),
        ("m", "m/s"),
        0.01,
        np.array([0, 3]),
        measured,
        rows,
        np.ones(2),
        np.array([1, 2, 5]),
        np.full(3, np.nan),
        1,
        True,
        side("before", rng),
        side("after", rng),
        run,
    )


def test_predictions_come_back(tmp_path):
    """Every field of both sides, bit for bit, NaN too."""
    kept = predictions()
    kept.save(tmp_path)
    found = Predictions.load(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["predictions.npz"]
    assert (found.names, found.units, found.seconds, found.rows_after, found.held_out) == (
        ("x", "v"),
        ("m", "m/s"),
        0.01,
        1,
        True,
    )
    for name in ("begins", "measured", "rows", "spread", "horizons", "noise"):
        np.testing.assert_array_equal(getattr(found, name), getattr(kept, name))
    for one, other in ((found.before, kept.before), (found.after, kept.after)):
        assert one.name == other.name
        for field in fields(Side)[1:]:
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


def test_a_whole_run_comes_back(tmp_path):
    """Bit for bit, and whole numbers as such; one of another length is refused by its name."""
    kept = predictions(whole_run())
    kept.save(tmp_path)
    found = Predictions.load(tmp_path).run
    assert (found.trajectory, found.length) == (1, 3)
    for name in ("measured", "rows", "before", "after", "held_out"):
        np.testing.assert_array_equal(getattr(found, name), getattr(kept.run, name))
    broken = replace(kept, run=replace(kept.run, after=kept.run.after[1:]))
    broken.save(tmp_path)
    with pytest.raises(BadFile, match=r"run\.after: expected .* with T = 4"):
        Predictions.load(tmp_path)


def test_other_files_are_refused(tmp_path):
    """No file, a file of other arrays, a file that is none: the sentence names it."""
    with pytest.raises(BadFile, match="no such file"):
        Predictions.load(tmp_path)
    np.savez(tmp_path / "predictions.npz", x=1)
    with pytest.raises(BadFile, match=r"names: expected an array of texts of shape \(p,\)"):
        Predictions.load(tmp_path)
    (tmp_path / "predictions.npz").write_text("words")
    with pytest.raises(BadFile, match=r"predictions\.npz"):
        Predictions.load(tmp_path)


def test_pictures_come_back():
    """From JSON as from memory, to seven digits."""
    kept = FigureData(
        9.1,
        ((Bar("a:x", 20.0, 2.0, True, True), Bar("b", None, None, False, False)),),
        (AgainstAxis("a:x", "v", "m/s", "x", "m", (1.0, 2.0), (0.1, 0.2), (0.0, 0.0)),),
        (Sizes("a:x", "v", (1.0, 2.0), (1.0, 1.1), (0.1, 0.1), 0.5),),
        Forces(("x",), ("N",), (1.0,), (0.1,), True, False),
        Similarity(("a:x", "b"), ((1.0, 0.9), (0.9, 1.0))),
        (Sums("a:x", (0.5, 1.0), (0.3, 0.0)),),
    )
    assert FigureData.from_json(kept.to_json()) == kept
