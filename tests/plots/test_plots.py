"""Every figure draws what it is given into the axes it is given, as vectors, and leaves everything
else alone.
"""

import inspect
import io
from dataclasses import replace
from functools import partial

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from dropo import LeastSquares, plots
from dropo.core.records.figure_data import (
    AgainstAxis,
    Bar,
    FigureData,
    Forces,
    LawCurve,
    Similarity,
    Sizes,
    Sums,
)
from dropo.core.records.fits.fit_choices import NoiseTrial, NoiseTuning
from dropo.core.records.fits.fit_parts import PosteriorDiagnostics, PosteriorDraws
from dropo.core.services.errors import BadArgument, UnknownName
from dropo.evaluation.predictions import predict
from dropo.plots.causes import in_order, words
from dropo.plots.motion import telling
from dropo.plots.style import AFTER, BEFORE, OTHER, folded
from dropo.problems.simulated.slide import slide
from dropo.testing.statistics import Calibration, ExpectedCoverage

BARS = (
    Bar("joint_friction:knee", 7.0, 2.0, False, True),
    Bar("joint_damping:knee", 20.0, 2.0, True, True),
    Bar("actuator_lag", 18.0, 3.0, False, False),
    Bar("actuator_delay", None, None, False, False),
)
FIGURE_DATA = FigureData(
    9.1,
    (BARS, ()),
    (
        AgainstAxis(
            "joint_damping:knee",
            "qvel.knee",
            "rad/s",
            "qvel.knee",
            "rad/s",
            tuple(np.linspace(-1, 1, 40).tolist()),
            tuple(np.linspace(-2, 2, 40).tolist()),
            (0.0,) * 40,
        ),
    ),
    (Sizes("joint_damping:knee", "qvel.knee", (-1.0, 1.0), (0.9, 1.1), (0.05, 0.05), 0.04),),
    Forces(("hip", "knee"), ("N", "N m"), (0.1, 1.0), (0.1, 0.05), True, False),
    Similarity(("joint_damping:knee", "joint_friction:knee"), ((1.0, 0.8), (0.8, 1.0))),
    (Sums("joint_damping:knee", (0.5, 1.0), (0.7, 0.0)),),
    (LawCurve("law:knee", "v", "rad/s", "N m", (-1.0, 1.0), (0.9, -1.1), (0.1, 0.1), (1, -1)),),
)


@pytest.fixture(scope="module")
def fit():
    """A fit with two parameters."""
    return LeastSquares().fit(slide(), rng=0)


@pytest.fixture(scope="module")
def predictions(fit):
    """What it predicts."""
    return predict(slide(), fit)


@pytest.fixture(scope="module")
def figures(fit, predictions):
    """Every figure as a function of the axes."""
    trials = (NoiseTrial(1e-4, 2.0, 1.0, 3.0), NoiseTrial(1e-3, 1.0, 0.5, 4.0))
    tuned = replace(fit, noise_tuning=NoiseTuning(trials, 0.6))
    diagnostics = PosteriorDiagnostics({"mass": 1.0}, {"mass": 1.0}, {"mass": 200.0})
    draws = PosteriorDraws(
        "distribution",
        ("mass",),
        diagnostics,
        np.ones((50, 4, 1)),
        np.zeros((50, 4)),
        np.zeros((2, 2)),
    )
    drawn = replace(fit, posterior=draws)
    of_ranks = np.arange(100).reshape(50, 2)
    calibrated = Calibration(of_ranks, 99, np.ones(2))
    return {
        "trajectory": lambda ax: plots.trajectory(predictions, "velocity", ax),
        "horizon": lambda ax: plots.horizon(predictions, ax),
        "errors": lambda ax: plots.errors(predictions, ax),
        "calibration": lambda ax: plots.calibration(predictions, ax),
        "parameters": lambda ax: plots.parameters(fit, ax, priors={"mass": "normal(1.5, 0.3)"}),
        "correlation": lambda ax: plots.correlation(fit, ax),
        "pair": lambda ax: plots.pair(fit, 0, 1, ax),
        "convergence": lambda ax: plots.convergence([1, 2, 3], [-9, -2, -1], ax),
        "moves": lambda ax: plots.moves([[1.0, 1.0], [1.5, 0.9]], fit, ax),
        "noise": lambda ax: plots.noise(fit, predictions, ax),
        "trace": lambda ax: plots.trace(drawn, ax),
        "tuning": lambda ax: plots.tuning(tuned, ax),
        "ranks": lambda ax: plots.ranks(calibrated, ax),
        "expected_coverage": lambda ax: plots.expected_coverage(
            ExpectedCoverage(np.linspace(0, 1, 20), 1.0), ax
        ),
        **{
            name: partial(getattr(plots, name), FIGURE_DATA)
            for name in (
                "candidates",
                "residuals",
                "sizes",
                "forces",
                "law",
                "similarity",
                "changes",
            )
        },
    }


def test_every_figure_is_tried(figures):
    """Those of `dropo.plots` but `corner`, which takes a grid; each takes `ax` and says what it
    shows.
    """
    assert set(figures) == set(plots.__all__) - {"corner"}
    for name in plots.__all__:
        draw = getattr(plots, name)
        assert inspect.getdoc(draw)
        assert {"ax", "axes"} & set(inspect.signature(draw).parameters)


@pytest.mark.parametrize("name", sorted(set(plots.__all__) - {"corner"}))
def test_axes_in_and_out(figures, name):
    """The same axes come back with something drawn, written as vectors; global settings stay."""
    before = dict(mpl.rcParams)
    figure = Figure()
    ax = figure.subplots()
    assert figures[name](ax) is ax
    assert ax.lines or ax.patches or ax.collections or ax.texts
    file = io.StringIO()
    figure.savefig(file, format="svg")
    assert "<image" not in file.getvalue()
    assert dict(mpl.rcParams) == before


def test_without_axes(fit):
    """A figure of its own."""
    import matplotlib.pyplot as plt

    plt.switch_backend("Agg")
    assert plots.parameters(fit).figure is not None
    axes = plots.corner(fit)
    assert axes.shape == (2, 2)
    assert not axes[0, 1].axison
    plt.close("all")


def test_lines_are_the_numbers(predictions):
    """What is drawn is what was measured and predicted, at its time."""
    ax = plots.trajectory(predictions, "velocity", Figure().subplots())
    drawn = [line for line in ax.lines if line.get_linestyle() == "None"]
    np.testing.assert_array_equal(drawn[0].get_ydata(), predictions.measured[0, :, 1])
    np.testing.assert_array_equal(drawn[0].get_xdata(), predictions.begins[0] + 1 + np.arange(20))
    ax = plots.horizon(predictions, Figure().subplots())
    np.testing.assert_allclose(ax.lines[1].get_ydata(), 100 * predictions.after.by_horizon)


def test_candidates_begin_with_the_accepted_one():
    """Then what cannot be told from it, joined by a bracket; no bracket where all can be told."""
    assert [bar.label for bar in in_order(BARS)] == [
        "joint_damping:knee",
        "actuator_lag",
        "actuator_delay",
        "joint_friction:knee",
    ]

    def lines(bars):
        return len(
            plots.candidates(replace(FIGURE_DATA, rounds=(bars,)), Figure().subplots()).lines
        )

    assert lines(BARS) == 1 + lines(tuple(bar for bar in BARS if bar.told))
    shown = [text.get_text() for text in plots.candidates(FIGURE_DATA, Figure().subplots()).texts]
    assert shown[:2] == ["joint damping at knee", "+20"]


@pytest.mark.parametrize(
    ("label", "said"),
    [
        ("body_com:torso.x", "body com at torso (x)"),
        ("actuator_lag", "actuator lag"),
        ("joint_friction.hinges", "joint friction (hinges)"),
        ("sensor_bias:qpos.knee", "sensor bias at qpos.knee"),
        ("parameter_drift:joint_damping:knee.from", "drift of joint damping at knee (from)"),
        ("joint_cogging:knee.6-a-turn", "joint cogging at knee (6-a-turn)"),
    ],
)
def test_labels_in_words(label, said):
    """The form stands in brackets; a signal keeps its dot."""
    assert words(label) == said


def test_long_names_are_folded():
    """Behind an underscore or a dot, and nothing is lost."""
    assert folded("torso_mass") == "torso_mass"
    assert folded("left_front_knee_damping") == "left_front_\nknee_damping"
    assert folded("qvel.shoulder_joint").replace("\n", "") == "qvel.shoulder_joint"


def test_one_model_alone_is_drawn_once(predictions):
    """Where nothing was changed there is no before, and the signals shown are those that are off
    most.
    """
    alone = replace(predictions, before=predictions.after)
    for draw in (plots.errors, plots.calibration):
        assert [
            len(draw(found, Figure().subplots()).get_legend_handles_labels()[1])
            for found in (alone, predictions)
        ] == [1, 2]
    share = alone.after.by_signal / alone.spread
    assert telling(alone) == [alone.names[i] for i in np.argsort(-share)]


def test_nothing_to_draw_is_said(fit):
    """An empty round, a fit that was not tuned, one parameter: a sentence in place of a figure."""
    axes = [Figure().subplots() for _ in range(4)]
    plots.candidates(FIGURE_DATA, axes[0], found=1)
    plots.tuning(fit, axes[1])
    plots.residuals(FIGURE_DATA, axes[2], found=5)
    plots.convergence([], [], axes[3])
    assert all(len(ax.texts) == 1 and not ax.axison for ax in axes)


def test_wrong_results_are_refused(fit, predictions):
    """By type and by name."""
    with pytest.raises(BadArgument, match="Predictions, or a Diagnosis"):
        plots.horizon(fit)
    with pytest.raises(BadArgument, match="FigureData, or a Diagnosis"):
        plots.candidates(predictions)
    with pytest.raises(UnknownName, match="Did you mean 'velocity'"):
        plots.trajectory(predictions, "velocit")


def test_signals_that_change_most_come_first(predictions):
    """By squared error beside the spread."""
    change = (
        predictions.before.by_signal**2 - predictions.after.by_signal**2
    ) / predictions.spread**2
    assert telling(predictions) == [predictions.names[i] for i in np.argsort(-change)]


@pytest.mark.parametrize("missing", ["red", "green", "blue"])
def test_colors_are_told_apart_without_one_cone(missing):
    """Before, after and others differ by at least 20 in CIELAB lightness or hue for each kind of
    colour blindness (Viénot et al. 1999); the control: red and green of the same lightness do
    not for those without red or green.
    """
    pairs = [(BEFORE, AFTER), (BEFORE, OTHER), (AFTER, OTHER)]
    assert min(difference(one, two, missing) for one, two in pairs) > 20
    if missing != "blue":
        assert difference("#a06000", "#608000", missing) < 20


LMS = np.array(
    [[17.8824, 43.5161, 4.11935], [3.45565, 27.1554, 3.86714], [0.0299566, 0.184309, 1.46709]]
)
SEEN = {
    "red": np.array([[0, 2.02344, -2.52581], [0, 1, 0], [0, 0, 1]]),
    "green": np.array([[1, 0, 0], [0.494207, 0, 1.24827], [0, 0, 1]]),
    "blue": np.array([[1, 0, 0], [0, 1, 0], [-0.395913, 0.801109, 0]]),
}


def difference(one, two, missing):
    """The distance in CIELAB of two colours as they are seen without one kind of cone."""
    return float(np.linalg.norm(lab(one, missing) - lab(two, missing)))


def lab(color, missing):
    """CIELAB (D65) of a colour under a simulated deficiency."""
    rgb = np.array(to_rgb(color))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.linalg.inv(LMS) @ SEEN[missing] @ LMS @ linear, 0, 1)
    xyz = (
        np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
        @ linear
        / [0.9505, 1, 1.089]
    )
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])
