"""Every built-in study in small, and what its numbers must say whatever their size."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.services.errors import Incompatible
from dropo.studies.engine.pages import picture
from dropo.studies.engine.variants import variants_of
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021 import distribution_recovery, figure_6_2, figure_6_4, hopper_fits
from dropo.studies.tiboni_2021.hopper_fits import fitted, item
from dropo.studies.tiboni_2021.hopper_sets import FULL, MEAN, HopperStudySize
from dropo.studies.tiboni_2021.table_6_1 import table_6_1
from dropo.studies.tiboni_2021.table_6_2 import table_6_2
from dropo.studies.tiboni_2021.table_6_4 import light_torso, table_6_4

SMALL = HopperStudySize(transitions=20, starts=1, droid=16, draws=8, published=(3, 12, 4))


@pytest.fixture(autouse=True)
def _without_external_data(monkeypatch):
    """The authors' data are left out: these tests need no files, and are the same everywhere."""
    monkeypatch.setattr(hopper_fits, "published", lambda which: [])


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """Keeps the answers of its tasks: fits that two studies share are made once."""
    return Work(path=tmp_path_factory.mktemp("work") / "kept.jsonl")


def column(study, title, name):
    """The cells below a table's column, by row."""
    table = next(table for table in study.tables if table.title == title)
    place = table.header.index(name)
    return {row[0]: row[place] for row in table.rows}


def test_table_6_1(work):
    """Both kinds of our data, all methods; without noise every mean is the truth."""
    study = table_6_1(work, 1, published=True, size=SMALL)
    found = column(study, "our data, clean, epsilon 1e-08: means", "m1")
    assert list(found) == [
        "drawn sample",
        "dropo",
        "  thesis, dropo",
        "least squares",
        "droid",
        "  thesis, droid",
        "dropo, published",
    ]
    assert found["dropo"].startswith("3.5343 (")
    assert "The authors' data are not at hand, so their tables are left out." in study.remarks
    starts = study.data["our data, clean, epsilon 1e-08"]["random_starts"]
    np.testing.assert_allclose(starts[0]["mean"], MEAN, atol=1e-6)


def test_the_published_method_at_full_size_goes_on(monkeypatch, tmp_path):
    """Interrupted within a fit, a study evaluates the rest alone, and gives the same numbers; its
    draws are anew at every evaluation, and there are no restarts.
    """
    size = replace(SMALL, full=(3, 40))
    one = item("6.1", "clean", 0, size)
    whole = hopper_fits.as_published(Work(threads=1), one)
    made = hopper_fits.estimator(hopper_fits.AS_PUBLISHED, FULL)
    assert (made.draws, made.budget, made.redraw) == (100, 5000, True)
    assert (made.likelihood, made.optimizer, made.start) == ("monte-carlo", "cma-es-once", "middle")

    path = tmp_path / "kept.jsonl"
    progress = Stop(2)
    with pytest.raises(KeyboardInterrupt):  # which a fit by itself takes for its end
        hopper_fits.as_published(Work(threads=1, path=path, progress=progress), one)
    work = Work(threads=1, path=path)
    before = len(work._answers)
    assert before == 2
    found = hopper_fits.as_published(work, one)
    assert len(work._answers) == 4
    for name in ("mean", "scale", "log_likelihood", "steps", "evaluations"):
        assert found[name] == whole[name], name


class Stop:
    """Progress that ends a run after some reports."""

    def __init__(self, reports):
        self.left = reports

    def __call__(self, fraction, text):
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt


def test_table_6_2(work, monkeypatch):
    """Two data sets without noise: random effects give each drawn sample's mean and spread."""
    monkeypatch.setattr(distribution_recovery, "EPSILON", {"clean": 1e-8})
    study = table_6_2(work, 2, size=SMALL)
    rows = study.data["clean"]["data_sets"]["random effects"]
    for row in rows:
        assert abs(row["mean"][0] - row["drawn_mean"][0]) < 0.01
    distributions = study.data["clean"]["laws"]
    assert (
        distributions["dropo"]["exact"] > distributions["law the masses were drawn from"]["exact"]
    )
    assert study.title.endswith("2 data sets")


def test_table_6_4(work):
    """The torso is 1 kg lighter and nothing else changes; the optimum is no worse than the thesis'
    solution at its epsilon.
    """
    study = table_6_4(work, 1, size=SMALL)
    values = study.data["our data set 0"]["likelihoods"]
    assert values["dropo, epsilon 1e-03"]["1e-03"] > values["thesis, dropo"]["1e-03"]
    asked = item("6.1", "clean", 0, SMALL)
    light = light_torso(asked).simulator
    whole = hopper_fits.problem_of(asked)[0].simulator
    np.testing.assert_allclose((whole.model.body_mass - light.model.body_mass)[1:], [1, 0, 0, 0])
    np.testing.assert_array_equal(whole.model.body_inertia, light.model.body_inertia)
    assert light.space.names == whole.space.names[1:]


def test_figures(work, monkeypatch):
    """Figure 6.2, without noise alone, has a panel a mass and figure 6.4 a row an epsilon; both are
    drawn.
    """
    monkeypatch.setattr(figure_6_2, "EPSILON", {"clean": 1e-8})
    distributions = figure_6_2.figure_6_2(work, size=SMALL)
    assert [table.header[0] for table in distributions.tables] == ["m1", "m2", "m3", "m4"]
    monkeypatch.setattr(figure_6_4, "SWEEP", (1e-5, 1e-4))
    sweep = figure_6_4.figure_6_4(work, 1, size=SMALL)
    assert sweep.data["mse"].shape == (1, 2)
    assert sweep.data["chosen"].tolist() == [1e-5]
    for study in (distributions, sweep):
        assert "<svg" in picture(study.draw)


def test_a_task_depends_on_its_item_alone():
    """The same item, the same numbers, whatever ran before."""
    asked = item("6.3", "noisy", 0, SMALL, method="least squares")
    first, second = (
        {key: value for key, value in fitted(asked).items() if key != "seconds"} for _ in range(2)
    )
    assert str(first) == str(second)


def test_parts_exchanged(work, monkeypatch):
    """A variant has rows beside the default's in the tables of the masses, and is tested in pairs.

    The inner optimizer is another, the maximum the same: no difference is found, and none of the
    evaluations that it makes on the emulator is missing.
    """
    monkeypatch.setattr(distribution_recovery, "EPSILON", {"clean": 1e-8})
    variants = variants_of(optimizer=["nlopt-lbfgs"])
    study = table_6_2(work, 2, variants=variants, size=SMALL)
    title = "table 6.2, clean, epsilon 1e-08"
    label = "dropo, optimizer nlopt-lbfgs"
    assert column(study, f"{title}: means", "m1")[label]
    compared = column(study, f"{title}: parts exchanged", "inner")
    assert list(compared) == ["dropo", label]
    assert int(compared[label].replace(",", "")) > 0
    rows = study.data["clean"]["data_sets"]
    for default, row in zip(rows["dropo"], rows[label], strict=True):
        assert abs(row["log_likelihood"] - default["log_likelihood"]) < 0.5
    assert any("no p below 0.5 is possible" in remark for remark in study.remarks)


def test_parts_exchanged_in_the_other_studies(work, monkeypatch):
    """Table 6.1, table 6.4 and both figures have the variant's rows too."""
    monkeypatch.setattr(figure_6_2, "EPSILON", {"clean": 1e-8})
    monkeypatch.setattr(figure_6_4, "SWEEP", (1e-5, 1e-4))
    variants = variants_of(likelihood=["linear"])
    label = "dropo, likelihood linear"
    first = table_6_1(work, 1, variants=variants, size=SMALL)
    assert label in column(first, "our data, noisy, epsilon 1e-05: parts exchanged", "steps")
    assert label in column(first, "our data, noisy, epsilon 1e-05: likelihoods", "value")
    light = table_6_4(work, 1, variants=variants, size=SMALL)
    assert label in column(light, "our data set 0: fits", "steps")
    panels = figure_6_2.figure_6_2(work, variants=variants, size=SMALL)
    assert f"{label}, clean" in column(panels, "m1, data of table 6.2", "mean [kg]")
    sweep = figure_6_4.figure_6_4(work, 1, variants=variants, size=SMALL)
    assert column(sweep, f"{label}, the same data", "chosen") == {"1e-05": "1", "1e-04": "0"}
    with pytest.raises(Incompatible, match="Leave --method out"):
        figure_6_4.figure_6_4(work, 1, variants=variants_of(["droid"]), size=SMALL)
