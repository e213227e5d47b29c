"""The usual calls, and what is said of the usual mistakes."""

import subprocess
import sys

import pytest

import dropo
from dropo.core.services.errors import BadArgument, UnknownName


def test_a_name_in_place_of_a_problem_is_refused_with_the_way_out():
    """`fit("slide")` says how a problem is made of a name."""
    with pytest.raises(
        BadArgument, match=r"which dropo.load makes of a name or a file\. Got 'slide'"
    ):
        dropo.fit("slide")


def test_unknown_methods_and_settings_name_the_nearest():
    problem = dropo.load("slide")
    with pytest.raises(UnknownName, match="Did you mean 'dropo'"):
        dropo.fit(problem, "drpo")
    with pytest.raises(dropo.InvalidInput, match="It takes likelihood"):
        dropo.fit(problem, epsiln=1e-6)


def test_fewer_than_no_draws_are_refused():
    with pytest.raises(BadArgument, match="0 or more"):
        dropo.fit(dropo.load("slide"), "uniform-randomization").sample(-1)


def test_a_mistyped_name_of_the_package_gets_the_nearest():
    """As Python prints it."""
    done = subprocess.run(
        [sys.executable, "-c", "import dropo; dropo.diagnos"], capture_output=True, text=True
    )
    assert "Did you mean: 'diagnose'" in done.stderr
    assert "plots" in dir(dropo)
