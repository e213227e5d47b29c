"""Forces at the joints that no command and no known effect explains: how large, where, and whether
they are there at all.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library, LinearizedWindows
from dropo.diagnosis.search.whitening import Whitener, learn_noise
from dropo.mjmodel.joints import degrees_of_freedom

# nats and standard errors on windows held out, from which the forces are there
GAINED = 9.0
CERTAIN = 2.5
PIECES = 10  # of a window at most, in each of which a force is drawn anew
LEARNED = 48  # windows at least that their size is learned from, where there are so many


def impulses(model: Any, length: int) -> list[EffectInstance]:
    """An atom for each piece of a window and degree of freedom: a generalised force in that piece
    alone. Its target is the joint.

    A piece is a control step, in long windows several.
    """
    named = degrees_of_freedom(model)
    pieces = min(length, PIECES)
    return [
        _impulse(model, dof, k, pieces, *named[dof])
        for k in range(pieces)
        for dof in range(len(named))
    ]


def _impulse(model: Any, dof: int, k: int, pieces: int, name: str, unit: str) -> EffectInstance:
    scale = 10.0 * max(float(model.dof_M0[dof]), 1e-9)  # what moves it by 10 rad/s^2 (m/s^2)
    force = Quantity("force", unit, -1e3 * scale, 1e3 * scale, (scale,))
    return EffectInstance(
        "unexplained_force", name, (force,), str(k), applied_force=partial(_push, model.nv, dof, k, pieces)
    )


def _push(nv: int, dof: int, k: int, pieces: int, steps: int, sizes: Array) -> Array:
    out = np.zeros((steps, nv))
    out[np.arange(steps) * pieces // steps == k, dof] = sizes[0]
    return out


@dataclass(frozen=True, eq=False)
class Unexplained:
    """sd: (nv,) of the forces [N m, N], each piece of a window anew; scale: (nv,) 1 / what moves
    each as far; gain, z: of allowing for them on windows held out [nats]; excess: (W,) that gain
    by window; answers: d residual / d force (W, n, pieces nv) of the windows that they are
    learned from and of those held out.
    """

    sd: Array
    scale: Array
    gain: float
    z: float
    excess: Array
    answers: tuple[Array, Array]

    @property
    def present(self) -> bool:
        """Whether the windows held out are better explained with them."""
        return self.gain > GAINED and self.z > CERTAIN


def unexplained_force(
    library: Library,
    train: LinearizedWindows,
    test: LinearizedWindows,
    floor: Array,
    gain_of: Callable[[LinearizedWindows, LinearizedWindows], tuple[float, float]],
    answers: tuple[Array, Array] | None = None,
) -> Unexplained:
    """Random forces w ~ N(0, diag(sd^2)) in every piece of a window beside the noise, by
    expectation-maximisation on the windows to fit.

    answers: those found under another theta, which hardly matters to them.
    """
    instances = [
        instance for instance in library.instances if instance.effect == "unexplained_force"
    ]
    train = train.take(np.arange(0, len(train.windows), max(1, len(train.windows) // LEARNED)))
    nv = len({instance.target for instance in instances})
    good = ~train.lost
    pieces = len(instances) // nv
    unit = np.array([instance.quantities[0].probes[0] for instance in instances[:nv]])
    answers = answers or (_answers(library, train, instances), _answers(library, test, instances))
    ways = [
        np.concatenate([seen.loadings, way], axis=2)
        for seen, way in zip((train, test), answers, strict=True)
    ]
    sigma, sd = learn_noise(
        ways[0][good],
        train.residuals[good],
        train.whiten.sigma,
        floor,
        unit,
        pieces=pieces,
        known=train.doubts[good],
    )
    scale = np.concatenate([np.tile(sigma, 2), np.tile(sd, pieces), np.ones(test.doubts.shape[2])])
    with_forces = replace(
        test, whiten=Whitener(np.concatenate([ways[1], test.doubts], axis=2), scale, sigma)
    )
    return Unexplained(
        sd,
        1 / unit,
        *gain_of(test, with_forces),
        with_forces.log_likelihood - test.log_likelihood,
        answers,
    )


def _answers(library: Library, seen: LinearizedWindows, instances: list[EffectInstance]) -> Array:
    """D residual / d force (W, n, pieces nv)."""
    free = np.concatenate([library.places[instance.label] for instance in instances])
    push = library.steps[free]
    tried = np.repeat(seen.theta[None], len(free), axis=0)
    tried[np.arange(len(free)), free] = push
    moved = np.nan_to_num(library.predict(tried, seen.windows) - seen.predicted)
    return np.moveaxis(moved / push[:, None, None], 0, 2)
