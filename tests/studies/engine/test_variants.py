"""Methods with parts exchanged: which combinations are made, and what is refused."""

import pytest

import dropo
from dropo.core.services.errors import BadArgument, Incompatible, UnknownName
from dropo.studies.engine.variants import Variant, variant_of, variants_of


def test_every_combination_of_the_parts_that_a_method_takes() -> None:
    """Uniform randomization takes none and stands once, as it is; without parts no default."""
    made = variants_of(
        ["dropo", "uniform-randomization"],
        500,
        optimizer=["cma-es", "nlopt-sbplx", "cma-es"],
        likelihood=["linear"],
    )
    assert [variant.label for variant in made] == [
        "dropo, optimizer cma-es, likelihood linear, budget 500",
        "dropo, optimizer nlopt-sbplx, likelihood linear, budget 500",
        "uniform-randomization",
    ]
    assert variants_of() == []
    assert variants_of(["dropo"]) == []


def test_the_estimator_has_these_parts() -> None:
    problem = dropo.load("slide", threads=1)
    made = variants_of(optimizer=["nlopt-bobyqa"], budget=7)[0].estimator(problem)
    assert made == dropo.DROPO(optimizer="nlopt-bobyqa", budget=7)


def test_variants_travel_as_json() -> None:
    variant = Variant("droid", {"budget": 3})
    assert Variant(**variant.to_json()) == variant


def test_a_likelihood_of_its_own_is_on_another_scale() -> None:
    assert Variant("dropo", {"optimizer": "cma-es"}).shares_likelihood(Variant())
    assert not Variant("dropo", {"likelihood": "linear"}).shares_likelihood(Variant())
    assert Variant("dropo", {"likelihood": "emulated"}).shares_likelihood(Variant())
    assert not Variant("droid").shares_likelihood(Variant())


def test_what_a_caller_in_python_gives() -> None:
    assert variant_of("droid") == Variant("droid")
    assert variant_of({"method": "droid", "budget": 3}) == Variant("droid", {"budget": 3})
    estimator = dropo.DROPO(optimizer="cma-es", epsilon=(1e-3, 1e-4))
    settings = {"optimizer": "cma-es", "epsilon": [1e-3, 1e-4]}
    assert variant_of(estimator) == Variant("dropo", settings)


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ("dropp", UnknownName, "'dropo'"),
        ({"method": "droppo"}, UnknownName, "'dropo'"),
        (3, BadArgument, "a method's name, a dict of settings with it, or an Estimator"),
    ],
)
def test_refuses(given: object, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        variant_of(given)


def test_refuses_parts() -> None:
    with pytest.raises(UnknownName, match="nlopt-bobyqa"):
        variants_of(optimizer=["nlopt-bobyqua"])
    with pytest.raises(Incompatible, match=r"takes a likelihood: droid. Leave --likelihood out"):
        variants_of(["droid"], likelihood=["linear"])
    with pytest.raises(BadArgument, match="budget"):
        variants_of(budget=0)
