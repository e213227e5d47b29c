"""The page of a folder: complete, self-contained, and true to the folder's numbers."""

import json
import os
import re
from html.parser import HTMLParser
from itertools import pairwise

import numpy as np
import pytest

from dropo.core.records.fits.fit import Fit
from dropo.core.records.predictions import Predictions
from dropo.core.services.files.evaluation_log import read_log
from dropo.core.services.tables import estimate
from dropo.report.build import write_report
from dropo.report.page import Cell, percent, shortened, table
from dropo.report.pages.diagnosis_page import _fitted, causes_section, finding_cards
from dropo.report.pages.fit_page import _parameters

LARGEST = 1_500_000  # bytes
VOID = {"meta", "link", "br", "img", "input"}


class Seen(HTMLParser):
    """What a page holds: its tags with attributes, its text, and whether tags close in order."""

    def __init__(self, text):
        super().__init__()
        self.tags = []
        self.text = []
        self.open = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)

    def all(self, tag):
        """The attributes of every such element."""
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(
    params=[
        pytest.param("fit", marks=pytest.mark.slow),
        pytest.param("diagnosis", marks=pytest.mark.slow),
        "unfinished",
    ]
)
def page(request, pages):
    """The page of each kind of folder; making the folders of the first two is slow."""
    return pages[request.param].read_text()


def loads(text):
    """Whatever a browser would fetch for a text: addresses in attributes and in style sheets; not
    names of namespaces.
    """
    found = re.findall(
        r"""(?:src|href|srcset|action|poster|data)\s*=\s*["']?([^"'\s>]+)""", text
    ) + re.findall(r"url\(([^)]+)\)", text)
    return [address for address in found if not address.startswith(("#", "data:,"))] + re.findall(
        r"@import[^;]+", text
    )


def test_it_is_whole_and_loads_nothing(page):
    """Every tag closes; no address but within the page; under the limit; control: addresses are
    noticed.
    """
    seen = Seen(page)
    assert seen.open == []
    assert len(page.encode()) < LARGEST
    assert loads(page) == []
    assert (
        len(loads('<img src="a.png"><link href=x><style>@import "y"; a {b: url(z)}</style>')) == 4
    )
    assert all("src" not in attributes for attributes in seen.all("script"))


def test_every_picture_says_what_it_shows(page):
    """role and words; identities are used once; colours are the page's, so that they follow light
    and dark.
    """
    seen = Seen(page)
    pictures = seen.all("svg")
    assert pictures
    assert all(p["role"] == "img" and len(p["aria-label"].split()) > 3 for p in pictures)
    names = [attributes["id"] for _, attributes in seen.tags if "id" in attributes]
    assert len(names) == len(set(names))
    used = set(re.findall(r"url\(#([^)]+)\)", page)) | {
        a["xlink:href"][1:] for a in seen.all("use")
    }
    assert used <= set(names)
    inside = page[page.index("<main>") :]
    assert set(re.findall(r"#[0-9a-fA-F]{6}\b", inside)) <= {"#ffffff", "#000000"}
    assert set(re.findall(r"var\(--([\w-]+)\)", page)) <= set(re.findall(r"--([\w-]+):", page)) | {
        "swatch"
    }


def test_headings_go_down_in_order(page):
    """One h1, sections with h2, pictures with h3."""
    levels = [int(tag[1]) for tag, _ in Seen(page).tags if re.fullmatch("h[1-6]", tag)]
    assert levels.count(1) == 1
    assert levels[0] == 1
    assert all(b <= a + 1 for a, b in pairwise(levels))


def test_a_fits_page_holds_its_numbers(fit_folder, pages):
    """Names, means, hashes, the command, errors before and after; a truth where the data are
    simulated.
    """
    text = "".join(Seen(pages["fit"].read_text()).text)
    fit = Fit.load(fit_folder)
    record = json.loads((fit_folder / "run.json").read_text())
    found = Predictions.load(fit_folder)
    for name, mean, error in zip(fit.space.names, fit.mean, fit.mean_se, strict=True):
        assert name in text
        assert estimate(mean, error) in text
    for shown in (
        record["data_sha256"],
        record["model_sha256"],
        f"dropo fit hopper --transitions 80 --out {os.path.relpath(fit_folder)}",
        "mujoco",
        "seed",
    ):
        assert shown in text
    assert percent(found.before.by_horizon[-1]) in text
    assert "Nothing in the residuals speaks against the model." in text


def test_a_diagnosis_page_names_the_cause_at_once(diagnosis_folder, pages):
    """In the headline, at its place, in the words of the first plot; the table holds size and
    unit.
    """
    seen = Seen(pages["diagnosis"].read_text())
    text = "".join(seen.text)
    content = json.loads((diagnosis_folder / "diagnosis.json").read_text())
    assert content["headline"].replace("+-", "±") in text
    assert "joint damping at elbow" in content["headline"]
    robot, tried = (picture["aria-label"] for picture in seen.all("svg")[:2])
    assert robot == "The robot, with causes marked. 1: joint damping at elbow."
    assert tried.startswith(
        "Bars: nats that each effect gains on data held out. joint damping at elbow"
    )
    assert f"{content['causes'][0]['estimate']['damping']['value']:+.4g}" in text
    assert "N m s/rad" in text
    for horizon in content["extended"]["horizons"]:
        assert percent(horizon["rmse"]) in text
    for title in (
        "What was tried",
        "Causes",
        "Is it the cause?",
        "Measured and simulated motion",
        "What remains unexplained",
    ):
        assert title in text


def test_an_interrupted_run_says_how_far_it_came(unfinished_folder, pages):
    """Evaluations, best value, how to go on."""
    text = "".join(Seen(pages["unfinished"].read_text()).text)
    _, entries = read_log(unfinished_folder / "evaluations.jsonl")
    assert len(entries) == 4
    values = np.concatenate([np.ravel(entry["answers"]) for entry in entries])
    assert f"This fit of slide was interrupted after {len(values)} evaluations." in text
    assert f"{values.max():.6g}" in text
    assert "goes on from here" in text


def test_without_what_pictures_need(fit_folder, diagnosis_folder, copy_of, tmp_path):
    """A result alone makes a page that says what is missing and how to get it."""
    folder = copy_of(fit_folder)
    for name in ("predictions.npz", "made.json", "run.json", "evaluations.jsonl"):
        (folder / name).unlink()
    text = "".join(Seen(write_report(folder).read_text()).text)
    assert "No motion is shown: predictions.npz is not in the folder" in text
    assert "torso_mass" in text
    content = json.loads((diagnosis_folder / "diagnosis.json").read_text())
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "diagnosis.json").write_text(json.dumps(content | {"pictures": None}))
    assert "joint damping at elbow" in write_report(tmp_path / "old").read_text()


def test_words_of_others_are_escaped(fit_folder, copy_of):
    """A problem's name and its warnings are text, whatever they hold."""
    folder = copy_of(fit_folder)
    (folder / "predictions.npz").unlink()
    content = json.loads((folder / "fit.json").read_text())
    content |= {
        "problem": "<script>alert(1)</script>",
        "warnings": ["a < b & c"],
        "status": "interrupted",
    }
    (folder / "fit.json").write_text(json.dumps(content))
    page = write_report(folder).read_text()
    assert "<script>alert" not in page
    assert "a &lt; b &amp; c" in page
    assert "The search was interrupted: this is the best so far." in page


def test_the_same_folder_makes_the_same_page(unfinished_folder, pages, tmp_path):
    """Byte for byte."""
    assert (
        write_report(unfinished_folder, tmp_path / "again.html").read_bytes()
        == pages["unfinished"].read_bytes()
    )


def test_cells_sort_by_value():
    """A number's own value stands beside what is shown; none beside a dash."""
    text = table(["x"], [[Cell("1.2e+03", 1234.5)], [Cell("–", np.nan)], [Cell("word")]])
    assert 'data-value="1234.5"' in text
    assert text.count("data-value") == 1


def test_what_was_left_out_and_what_disagrees_is_listed(diagnosis_folder, copy_of):
    """Spans in which something pushed, odd runs, and what the data do not tell."""
    folder = copy_of(diagnosis_folder)
    content = json.loads((folder / "diagnosis.json").read_text())
    span = {
        "run": 3,
        "held_out": True,
        "from": 1.0,
        "to": 1.5,
        "signal": "qvel.elbow",
        "unit": "rad/s",
        "off": 2.5,
        "after": 0.4,
    }
    odd = {
        "run": 2,
        "held_out": False,
        "parameter": "lower_mass",
        "unit": "kg",
        "value": 0.7,
        "se": 0.01,
        "others": 0.5,
        "spread": 0.0,
    }
    content |= {
        "disturbances": {"spans": [span]},
        "odd_runs": [odd],
        "undetermined": ["the data do not determine upper_mass"],
        "replay": {
            "units": {"rad": {"nominal": 0.0372, "extended": 0.0161}},
            "runs": [{"seconds": 9.0, "nominal": {"q": 0.0372}, "extended": {"q": 0.0161}}],
        },
    }
    (folder / "diagnosis.json").write_text(json.dumps(content))
    text = "".join(Seen(write_report(folder).read_text()).text)
    assert (
        "Left out: held-out run 3, 1.00 to 1.50 s, where qvel.elbow is 2.5 rad/s off after 0.4 s."
        in text
    )
    assert "Run 2 disagrees with the others: its lower_mass is 0.7 ± 0.01 kg, theirs 0.5." in text
    assert "the data do not determine upper_mass" in text
    assert "whole runs held out (1), by commands alone" in text
    assert "0.0161" in text


def test_long_headlines_are_cut_between_sentences():
    """As many sentences as fit, at least one; none is lost, and a number's dot ends none."""
    assert shortened("It is off by 0.5 N m. Cause: drag. So it is.", 34) == (
        "It is off by 0.5 N m. Cause: drag.",
        "So it is.",
    )
    assert shortened("It is off by 0.5 N m. Cause: drag.", 5) == (
        "It is off by 0.5 N m.",
        "Cause: drag.",
    )
    assert shortened("Short.", 50) == ("Short.", "")


@pytest.mark.parametrize(
    ("share", "shown"),
    [(0.5, "50 %"), (0.12345, "12.3 %"), (1e-9, "less than 0.001 %"), (0.0, "0 %"), (np.nan, "–")],
)
def test_percent(share, shown):
    """Three digits, none where they would be noise."""
    assert percent(share) == shown


def test_what_speaks_against_a_cause_is_on_the_page(diagnosis_folder):
    """What it may be confused with, what tells them apart, and that it only acts like the cause;
    control: of a cause without doubts nothing is said.
    """
    content = json.loads((diagnosis_folder / "diagnosis.json").read_text())
    content["verdict"] = "explained"
    for cause in content["causes"]:
        cause |= {"acts_like": None, "confused_with": []}
    plain_body = causes_section(content).body
    assert "may as well be" not in plain_body
    assert "only acts like" not in plain_body
    content["verdict"] = "partly"
    content["causes"][0] |= {
        "acts_like": "speed",
        "confused_with": [
            {
                "effect": "joint_friction",
                "target": "elbow",
                "variant": "",
                "why": "similarity 0.99",
                "to_tell": "slow motions",
            }
        ],
    }
    body = causes_section(content).body
    assert re.search(r"may as well be [^.]*elbow: similarity 0.99. To tell: slow motions", body)
    assert "only acts like the cause: its size differs with speed." in body


def test_a_cause_is_called_one_on_the_page_where_the_headline_does(diagnosis_folder):
    """The card and the remarks follow the verdict, whether the size differs with anything or not;
    control: where all is explained, the card is the cause's.
    """
    content = json.loads((diagnosis_folder / "diagnosis.json").read_text())
    for cause in content["causes"]:
        cause |= {"acts_like": None}
    content["verdict"] = "explained"
    assert finding_cards(content)[1][0] == "cause"
    content["verdict"] = "partly"
    assert finding_cards(content)[1][0] == "acts like"
    assert "only acts like the cause: something remains" in causes_section(content).body
    assert finding_cards(content | {"causes": []})[1][:2] == ("cause", "none")


def test_declared_parameters_stand_beside_their_intervals():
    """As fitted with the causes; one that the problem does not declare has no row."""
    record = {"parameters": [{"name": "mass", "unit": "kg", "low": 0.5, "high": 2.0}]}
    section = _fitted({"parameters": {"mass": 1.25, "other": 3.0}}, record)
    assert section is not None
    text = Seen(section.body).text
    assert [cell for cell in ("mass", "kg", "1.25", "0.5", "2") if cell not in text] == []
    assert "other" not in text
    assert _fitted({"parameters": {"other": 3.0}}, record) is None


def test_a_fit_with_priors_names_them(fit_folder, monkeypatch):
    """In a column of their own; what has none is uniform. Without the corner plot."""
    monkeypatch.setattr("dropo.report.pages.fit_page._joint", lambda fit: [])
    fit = Fit.load(fit_folder)
    first = fit.space.names[0]
    section = _parameters(fit, {first: "normal(3.5, 0.2)"})
    cells = Seen(section.body).text
    assert "prior" in cells
    assert "normal(3.5, 0.2)" in cells
    assert cells.count("uniform") >= len(fit.space) - 1
    assert "prior" not in Seen(_parameters(fit, {}).body).text
