"""How policies are compared: means, standard errors between runs, and differences in them."""

import numpy as np
import pytest

from dropo.studies.tiboni_2021 import transfer
from dropo.studies.tiboni_2021.transfer import (
    NOMINAL,
    TRUE,
    UNIFORM,
    apart,
    by_unit,
    comparison,
    differences,
    items,
    mean_and_error,
    verdict,
)


def runs(**distances):
    return [
        {"method": method.replace("_", " "), "number": number, "distances": row, "rewards": row}
        for method, rows in distances.items()
        for number, row in enumerate(rows)
    ]


def test_units_are_what_was_drawn():
    """Runs on data sets of their own are units; the eleventh run of uniform randomization is on the
    first bound again.
    """
    found = by_unit(
        runs(dropo=[[1.0, 3.0], [4.0, 4.0]], uniform_randomization=[[float(i)] for i in range(11)]),
        "distances",
    )
    np.testing.assert_array_equal(found["dropo"], [2, 4])
    np.testing.assert_array_equal(found["uniform randomization"], [5, *range(1, 10)])


def test_mean_and_error():
    """A single unit has no error."""
    assert mean_and_error(np.array([2.0, 4.0])) == (3.0, 1.0)
    mean, error = mean_and_error(np.array([2.0]))
    assert mean == 2
    assert np.isnan(error)


def test_differences_in_standard_errors():
    """Of both together, and none for a single unit."""
    one = np.array([1.0, 3.0])
    other = np.array([5.0, 9.0])
    assert apart(one, other) == pytest.approx(5 / np.hypot(1, 2))
    assert apart(other, one) == pytest.approx(-5 / np.hypot(1, 2))
    assert np.isnan(apart(one, other[:1]))


@pytest.mark.parametrize(
    ("uniform", "said"),
    [([[0.09], [0.11]], "more than two"), ([[0.01], [0.03]], "not more than two")],
)
def test_the_verdict_follows_the_numbers(uniform, said):
    """A clear difference is called one, and an unclear one is not."""
    told = verdict(runs(dropo=[[0.01], [0.02]], uniform_randomization=uniform), 0.05)
    assert "within 5 cm" in told[0]
    assert told[1].endswith(f": {said}.")
    assert (
        "not within 1 cm"
        in verdict(runs(dropo=[[0.01], [0.02]], uniform_randomization=uniform), 0.01)[0]
    )


def test_the_table():
    """Distances in cm, the worst run, and the share that comes near."""
    table = comparison(
        runs(dropo=[[0.01, 0.03], [0.02, 0.08]], uniform_randomization=[[0.2, 0.2]]), 0.05
    )
    assert table.rows[0] == ("dropo", "2", "3.50 +- 1.50", "5.00", "75%", "0.035 +- 0.015")
    assert table.rows[1] == ("uniform randomization", "1", "20.00", "20.00", "0%", "0.200")


def test_the_table_of_differences():
    """Rows against columns, of methods with several runs."""
    table = differences(
        runs(dropo=[[0.01], [0.03]], droid=[[0.05], [0.09]], uniform_randomization=[[0.2]])
    )
    assert table.header == ("", "dropo", "droid")
    assert table.rows == (("dropo", "-", "-2.2"), ("droid", "+2.2", "-"))


def test_items():
    """Each fitting method on every data set, every bound, two points, and the published method
    where it is asked for.
    """
    plain = items(2, 3, {}, published=False)
    assert [i["method"] for i in plain] == [m for m in transfer.FITTED for _ in range(2)] + [
        UNIFORM
    ] * 3 + [NOMINAL, TRUE]
    assert [i["number"] for i in plain if i["method"] == UNIFORM] == [0, 1, 2]
    assert len(items(2, 3, {}, published=True)) == len(plain) + 1
