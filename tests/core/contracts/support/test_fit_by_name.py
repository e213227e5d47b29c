"""The usual calls, and what is said of the usual mistakes."""

import subprocess
import sys

import pytest

import dropo
from dropo.core.records.parameters import Parameter, ParameterSpace
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


def test_a_parameter_of_a_fit_by_its_name():
    """`fit["mass"]` has the fit's own numbers and says them in a line; unknown names get the
    nearest.
    """
    fit = dropo.fit(dropo.load("slide"), "least-squares", rng=0)
    assert fit.names == ("mass", "damping")
    mass = fit["mass"]
    assert (mass.mean, mass.mean_se, mass.sd) == (fit.mean[0], fit.mean_se[0], fit.sd[0])
    assert mass.interval == tuple(fit.interval()[0])
    assert float(mass) == mass.mean
    assert str(mass).startswith("mass ")
    assert " kg, sd " in str(mass)
    with pytest.raises(UnknownName, match="Did you mean 'damping'"):
        fit["dampin"]


def test_a_fit_in_latex():
    """Its tables, and no sentences."""
    text = dropo.fit(dropo.load("slide"), "least-squares", rng=0).to_latex()
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") > 0
    assert "damping & " in text
    assert "simulator steps" not in text


def test_problems_and_spaces_say_themselves_in_a_line():
    """Names, intervals and the size of the data; the first parameters of many."""
    problem = dropo.load("slide")
    text = repr(problem)
    assert text.startswith("Problem('slide', ParameterSpace(mass [")
    assert "2 signals" in text
    assert f"{len(problem.trajectories):,} transitions of" in text
    assert len(text) < 200
    many = ParameterSpace(tuple(Parameter(f"p{i}", 0, 1) for i in range(40)))
    assert repr(many).endswith("p5 [0, 1], ... 40 in all)")
