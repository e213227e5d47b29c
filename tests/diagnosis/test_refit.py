"""Fits to windows where predictions bend."""

import numpy as np
import pytest

from dropo.diagnosis import refit as refitting
from dropo.diagnosis.model import Library, look, noise_of
from dropo.diagnosis.refit import refit
from dropo.diagnosis.windows import split
from tests.diagnosis import arms

TRUE = {"contact_stiffness.margin": -0.001, "body_mass:foot": -0.2, "body_inertia:foot": -0.1}


def fitted(off):
    """Errors, as shares of the truth, of three numbers that the hopper's noise-free data are fitted with, begun so far off."""
    problem = arms.problem([(label, [size]) for label, size in TRUE.items()], sigma=1e-9, name="hopper")
    atoms = [arms.atom(problem.simulator, label) for label in TRUE]
    library, declared = Library(problem.simulator.with_effects(atoms), atoms, len(problem.space)), problem.simulator.nominal
    truth, free = np.array(list(TRUE.values())), len(declared) + np.arange(len(TRUE))
    train, floor = split(problem, 5, 96)[0], np.full(len(problem.simulator.signals), 1e-6)
    begun = look(library, train, np.concatenate([declared, (1 + off) * truth]), 1e3 * floor)
    begun = look(library, train, begun.theta, noise_of(begun, begun.whiten.sigma, floor))
    return np.abs(refit(library, begun, free, floor).theta[free] / truth - 1)


@pytest.mark.parametrize("off", [-0.02, 0.02, 0.1])
def test_where_predictions_bend(off):
    """A contact's margin, to which windows answer that an impact has only just reached: found to 1e-6 of the truth, whatever is near."""
    assert fitted(off).max() < 1e-6


def test_wide_differences_alone_stop_short(monkeypatch):
    """The control: slopes over the usual widths take so small steps that the foot's mass stays 0.1 % off and more."""
    monkeypatch.setattr(refitting, "NEAR", 1.0)
    assert fitted(-0.02).max() > 1e-3
