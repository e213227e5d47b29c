"""A fit in a folder: every typed part comes back, and what outside methods keep beside."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from dropo.core.records.fits.fit import Fit
from dropo.core.records.fits.fit_choices import (
    ExcludedSpan,
    ExcludedSpans,
    HorizonChoice,
    HorizonTrial,
    NoiseTrial,
    NoiseTuning,
)
from dropo.core.records.fits.fit_files import PARTS
from dropo.core.records.fits.fit_parts import (
    EmulatorCheck,
    GroupEffects,
    HeldOutErrors,
    ModelCheck,
    PosteriorDiagnostics,
    PosteriorDraws,
    PriorUse,
    ResidualSize,
    ResidualStructure,
    StartFilter,
    VarianceComponentTests,
    VarianceTest,
)
from dropo.core.records.fits.search_records import (
    SEARCH_RECORDS,
    DistanceSearch,
    GaussianHistory,
    IntervalHistory,
    NeuralPosterior,
    ParticlePosterior,
    ReturnSearch,
)
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadFile
from tests.models.cart_task import fit_of

SPACE = ParameterSpace((Parameter("a", 0.0, 1.0, "kg"), Parameter("b", 0.0, 2.0)))
RNG = np.random.default_rng(0)
EMPTY = fit_of(SPACE, np.array([0.5, 1.0]), np.array([0.1, 0.2]))

NAMED = {"a": 0.25, "b": np.nan}
TEST = VarianceTest(3.0, 0.04)
FULL = {
    "emulator_check": EmulatorCheck(32, 100, -12.5, np.nan),
    "start_filter": StartFilter((0.5, 0.01), 3),
    "posterior": PosteriorDraws(
        over="parameters",
        unknowns=("a", "b"),
        diagnostics=PosteriorDiagnostics(NAMED, NAMED, NAMED),
        chain=RNG.standard_normal((5, 4, 2)),
        log_density=RNG.standard_normal((5, 4)),
        observed=RNG.standard_normal((6, 1)),
        diverging=np.zeros((5, 4), dtype=bool),
    ),
    "model_check": ModelCheck(
        False, ResidualSize(4.0, 0.1), ResidualStructure("y", "sign(y)", 9.0, "x", 7.0)
    ),
    "priors": PriorUse({"a": "normal(0.5, 0.1)"}, NAMED, {"a": np.nan}),
    "held_out": HeldOutErrors(40, 5, {"m": 0.1, "rad": np.nan}, {"m": 0.2, "rad": 0.3}),
    "groups": GroupEffects(
        kind="trajectories",
        fewest_rows=3,
        most_rows=4,
        shrinkage={"a": 0.1, "b": 0.9},
        median_sd=NAMED,
        predictive_sd=NAMED,
        tests=VarianceComponentTests(TEST, {"a": TEST, "b": TEST}),
        number=np.arange(3.0),
        mean=RNG.standard_normal((3, 2)),
        covariance=RNG.standard_normal((3, 2, 2)),
    ),
    "noise_tuning": NoiseTuning((NoiseTrial(1e-4, 2.0, 0.1, -3.0),), 0.11),
    "horizon_choice": HorizonChoice(
        (
            HorizonTrial(1, np.nan, 0.0, False, (0.5, 1.0), (0.1, np.nan)),
            HorizonTrial(5, 0.0, 0.0, True, (0.5, 1.0), (0.1, 0.2)),
        )
    ),
    "excluded": ExcludedSpans((ExcludedSpan(2, True, 1.0, 1.5, "y", "rad", 0.3, 0.4, 9.0),)),
}
RECORDS = {
    "adr": IntervalHistory(RNG.standard_normal((3, 2, 2)), target_transitions=600),
    "bayrn": ReturnSearch(
        RNG.standard_normal((2, 4)), np.ones(2), np.zeros(2), 1.5, target_transitions=9
    ),
    "droid": DistanceSearch(0.25),
    "epopt": ParticlePosterior(np.ones((3, 2)), np.ones((3, 2)), np.ones(3), np.ones(2), 2.5),
    "npe": NeuralPosterior(np.ones((3, 2)), np.ones((2, 2, 2)), "maf", "moments"),
    "simopt": GaussianHistory(np.ones((2, 2)), np.ones((2, 2, 2)), target_transitions=7),
    "uniform-randomization": IntervalHistory(np.ones((1, 2, 2))),
}


def saved_and_loaded(fit, folder):
    """The fit as its folder has it."""
    fit.save(folder)
    return Fit.load(folder)


def assert_same(one, other):
    """Two parts of the same kind with the same values; NaN is NaN."""
    assert type(one) is type(other)
    for item in fields(one):
        np.testing.assert_equal(getattr(one, item.name), getattr(other, item.name))


def test_each_kind_of_part_is_tried():
    assert set(FULL) == set(PARTS)
    assert set(RECORDS) == set(SEARCH_RECORDS)


@pytest.mark.parametrize("name", FULL)
def test_a_part_comes_back_alone(name, tmp_path):
    """With the same entries, the same arrays, and no entry left for outside methods."""
    fit = replace(EMPTY, **{name: FULL[name]})
    again = saved_and_loaded(fit, tmp_path)
    assert again.to_json() == fit.to_json()
    assert (again.details, again.arrays) == ({}, {})
    assert_same(getattr(again, name), FULL[name])
    assert all(getattr(again, other) is None for other in PARTS if other != name)


@pytest.mark.parametrize("method", RECORDS)
def test_a_search_record_comes_back(method, tmp_path):
    """Of the kind that its method makes."""
    fit = replace(EMPTY, method=method, search_record=RECORDS[method])
    again = saved_and_loaded(fit, tmp_path)
    assert again.to_json() == fit.to_json()
    assert (again.details, again.arrays) == ({}, {})
    assert_same(again.search_record, RECORDS[method])


def test_what_outside_methods_keep_comes_back(tmp_path):
    """Their own entries and arrays stand beside the typed parts."""
    texts = {
        "likelihood": "emulated",
        "optimizer": "cma-es",
        "constant_parameters": ("a",),
        "identifiability": (),
        "truth": {"a": 0.5, "b": 1.0},
    }
    arrays = {"kept": np.arange(3.0)}
    fit = replace(EMPTY, **FULL, **texts, details={"tried": [1, 2]}, arrays=arrays)
    again = saved_and_loaded(fit, tmp_path)
    assert again.to_json() == fit.to_json()
    assert {name: getattr(again, name) for name in texts} == texts
    assert again.details == {"tried": [1, 2]}
    assert set(again.arrays) == {"kept"}
    np.testing.assert_array_equal(again.arrays["kept"], arrays["kept"])


def test_the_keys_of_the_file(tmp_path):
    """Those that readers of fit.json and fit.npz rely on."""
    replace(EMPTY, **FULL, constant_parameters=("a",)).save(tmp_path)
    content = json.loads((tmp_path / "fit.json").read_text())
    keys = "emulator_check filter certified over unknowns posterior model_check held_out groups"
    keys += " groups_differ predictive_sd tuning mse_threshold lambda_choice disturbances"
    assert [key for key in content if key in keys.split()] == keys.split()
    assert set(content["groups"]) == {
        "of",
        "count",
        "fewest_rows",
        "most_rows",
        "shrinkage",
        "median_sd",
    }
    assert set(content["lambda_choice"][0]) == {
        "lambda",
        "below_best",
        "paired_error",
        "chosen",
        "mean",
        "mean_se",
    }
    assert content["held_out"]["rmse"] == {"m": 0.1, "rad": None}
    assert content["disturbances"][0]["off"] == 0.3
    kept = "phi correlation epsilon chain log_density diverging observed"
    kept += " group group_mean group_covariance"
    assert set(np.load(tmp_path / "fit.npz").files) == set(kept.split())


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("version", "99.0", "version: expected .* or older"),
        ("method", None, "method: expected .*, got nothing"),
        ("transitions", 0, "transitions: expected .*greater than or equal to 1, got 0"),
        ("status", "asleep", "status: expected 'converged', .*, got 'asleep'"),
        ("parameters", {}, "parameters: expected"),
        ("parameters", [1], r"parameters: expected .*, got \[1\]"),
        ("parameters", {"mass": {"mean": "x"}}, r"parameters\.mass\.mean: expected .*, got 'x'"),
        ("warnings", "text", "warnings: expected .*array, got 'text'"),
        ("phi", [None], r"phi\[0\]: expected .*number, got nothing"),
        ("emulator_check", {"draws": 1}, r"emulator_check\.rows: expected what a run writes"),
        ("tuning", [{}], r"tuning\[0\]\.epsilon: expected what a run writes, got nothing"),
    ],
)
def test_entries_of_other_types_are_refused(tmp_path, key, value, message):
    """By file, key, rule and what was got, in a line."""
    EMPTY.save(tmp_path)
    path = tmp_path / "fit.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(BadFile, match=message) as caught:
        Fit.load(tmp_path)
    assert str(caught.value).startswith(f"{path}: {key}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["fit.json", "fit.npz"])
def test_files_that_were_cut_off_are_refused(tmp_path, name):
    """Wherever they end."""
    EMPTY.save(tmp_path)
    path = tmp_path / name
    whole = path.read_bytes()
    for size in [*range(0, len(whole) - 2, 1 + len(whole) // 40)]:
        path.write_bytes(whole[:size])
        with pytest.raises(BadFile, match=name.replace(".", r"\.")):
            Fit.load(tmp_path)
    path.unlink()
    with pytest.raises(BadFile, match="no such file"):
        Fit.load(tmp_path)


def test_arrays_of_other_shapes_are_refused(tmp_path):
    EMPTY.save(tmp_path)
    with np.load(tmp_path / "fit.npz") as kept:
        arrays = dict(kept)
    for changed, message in (
        ({"phi": np.zeros((2, 2))}, r"phi: expected an array of finite numbers of shape \(m,\)"),
        ({"phi": np.zeros(7)}, "phi: expected .* numbers, which name a member of the family"),
        ({"correlation": np.zeros((1, 2))}, r"correlation: .* with d = 1"),
        ({"epsilon": np.array(["a"])}, "epsilon: expected an array of finite numbers"),
    ):
        np.savez(tmp_path / "fit.npz", **{**arrays, **changed})
        with pytest.raises(BadFile, match=message):
            Fit.load(tmp_path)
