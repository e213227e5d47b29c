"""Forces at the joints that no command and no known effect explains: how large, where, and whether they are there at all."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.checks import Array
from dropo.core.effect import Atom, Moment, Quantity
from dropo.diagnosis.model import Library, Look
from dropo.diagnosis.whitening import Whitener, learn_noise


def impulses(model: Any, length: int, physics_steps: int) -> list[Atom]:
    """An atom for each degree of freedom and step of a window: a generalised force in that step alone."""
    return [_impulse(model, dof, k, physics_steps) for k in range(length) for dof in range(model.nv)]


def _impulse(model: Any, dof: int, k: int, physics_steps: int) -> Atom:
    scale = 10.0 * max(float(model.dof_M0[dof]), 1e-9)  # what moves it by 10 rad/s^2 (m/s^2)

    def force(moment: Moment, sizes: Array) -> Array:
        out = np.zeros_like(moment.qvel)
        out[:, dof] = sizes[0] * (moment.step // physics_steps == k)
        return out

    return Atom("unexplained_force", str(dof), (Quantity("force", "N m", -1e3 * scale, 1e3 * scale, (scale,)),), str(k), force=force)


@dataclass(frozen=True, eq=False)
class Unexplained:
    """sd: (nv,) of the forces [N m, N], each control step anew; gain, z: of allowing for them on windows held out [nats]."""

    sd: Array
    gain: float
    z: float

    @property
    def present(self) -> bool:
        """Whether the windows held out are better explained with them."""
        return self.gain > 9.0 and self.z > 2.5


def unexplained_force(
    library: Library, train: Look, test: Look, floor: Array, gain_of: Callable[[Look, Look], tuple[float, float]]
) -> Unexplained:
    """Random forces w ~ N(0, diag(sd^2)) in every step beside the noise, found by expectation-maximisation on the windows to fit."""
    atoms = [atom for atom in library.atoms if atom.effect == "unexplained_force"]
    looks = [replace(seen, whiten=_with_forces(library, seen, atoms)) for seen in (train, test)]
    p, nv = len(train.whiten.sigma), len(atoms) // train.windows.length
    first = np.array([atom.quantities[0].probes[0] for atom in atoms[:nv]]) * 1e-2
    good = ~train.lost
    sigma, sd = learn_noise(looks[0].whiten.loadings[good], train.residuals[good], train.whiten.sigma, floor, first)
    scale = np.concatenate([sigma, np.tile(sd, train.windows.length)])
    with_forces = replace(looks[1], whiten=Whitener(looks[1].whiten.loadings, scale, sigma))
    assert len(scale) == p + len(atoms)
    return Unexplained(sd, *gain_of(test, with_forces))


def _with_forces(library: Library, seen: Look, atoms: list[Atom]) -> Whitener:
    """The whitener with the forces' loadings (W, n, L nv) behind the start's; their scale is still 0."""
    free = np.concatenate([library.places[atom.label] for atom in atoms])
    pushed = np.moveaxis(library.slopes(seen.theta, free, seen.windows), 0, 2)
    loadings = np.concatenate([seen.whiten.loadings, pushed], axis=2)
    return Whitener(loadings, np.concatenate([seen.whiten.sigma, np.zeros(len(free))]), seen.whiten.sigma)
