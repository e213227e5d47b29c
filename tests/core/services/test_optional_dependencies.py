"""A package that is not installed is named, with the extra that brings it."""

import importlib.util

import numpy as np
import pytest

from dropo import DropoError, Posterior, load
from dropo.core.records.draws import Draws
from dropo.core.services import optional_dependencies
from dropo.core.services.optional_dependencies import need


@pytest.fixture
def _bare(monkeypatch):
    """As if the packages of the extras were not installed."""
    absent = {"torch", "pyro", "arviz", "matplotlib"}
    monkeypatch.setattr(
        optional_dependencies,
        "find_spec",
        lambda name: None if name in absent else importlib.util.find_spec(name),
    )


@pytest.mark.usefixtures("_bare")
def test_what_needs_an_extra_says_so():
    """Gradient samplers, ArviZ, plots: refused with the way out, as one of the family and as an
    ImportError.
    """
    from dropo.plots.style import axes_of
    from dropo.report.svg import picture

    slide = load("slide").using(transitions=20)
    draws = Draws(np.zeros((4, 1, 1)), np.zeros((4, 1)), ("a",))
    for call, words in (
        (
            lambda: Posterior(sampler="pyro-nuts").fit(slide),
            r"pyro-nuts needs torch and pyro, .*\[posterior\]",
        ),
        (
            lambda: Posterior(sampler="pyro-svi").fit(slide),
            r"pyro-svi needs torch and pyro, .*\[posterior\]",
        ),
        (
            draws.to_inference_data,
            r"InferenceData needs arviz, which is not installed: pip install 'dropo\[posterior\]'",
        ),
        (lambda: axes_of(None), r"matplotlib, .*'dropo\[plots\]'"),
        (lambda: picture(lambda ax: None, "nothing"), r"matplotlib, .*'dropo\[plots\]'"),
    ):
        with pytest.raises(DropoError, match=words) as caught:
            call()
        assert isinstance(caught.value, ImportError)


def test_what_is_there_is_no_reason():
    need("numpy", "scipy", extra="plots", caller="A figure")
