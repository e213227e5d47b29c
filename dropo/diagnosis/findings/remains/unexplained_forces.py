"""Forces at the joints that no command and no known effect explains: how large, where, and whether
they are there at all.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library, LinearizedWindows
from dropo.diagnosis.search.noise_learning import learn_noise
from dropo.diagnosis.search.whitening import Whitener
from dropo.mjmodel.joints import degrees_of_freedom, inertias

EFFECT = "unexplained_force"
"""Name of the effect that stands for an impulse; it is no candidate for a cause."""


@dataclass(frozen=True)
class ForceSettings:
    """How unexplained forces are estimated, and when they are there.

    Attributes
    ----------
    gain : float
        Gain on windows held out [nats] ...
    z : float
        ... and the gain in standard errors by block, above which the forces are there.
    windows : int
        Windows that their size is learned from, at least, where there are so many.
    """

    gain: float = 9.0
    z: float = 2.5
    windows: int = 48


SETTINGS = ForceSettings()


def impulses(model: Any, length: int, pieces: int = 10) -> list[EffectInstance]:
    """Return an effect for each piece of a window and each degree of freedom.

    Parameters
    ----------
    model : mujoco.MjModel
        The robot.
    length : int
        Control steps in a window.
    pieces : int
        Pieces of a window, at most; in short windows each control step is one.

    Returns
    -------
    list of EffectInstance
        A generalized force [N m or N] in that piece alone; its target is the joint.
    """
    named = degrees_of_freedom(model)
    inertia = inertias(model).tolist()
    pieces = min(length, pieces)
    return [
        _impulse(inertia, dof, piece, pieces, name, unit)
        for piece in range(pieces)
        for dof, (name, unit) in enumerate(named)
    ]


def without_impulses(instances: Sequence[EffectInstance]) -> list[EffectInstance]:
    """Return the effects that may be causes.

    Parameters
    ----------
    instances : sequence of EffectInstance
        Effects and impulses.

    Returns
    -------
    list of EffectInstance
    """
    return [instance for instance in instances if instance.effect != EFFECT]


def impulses_of(library: Library) -> list[EffectInstance]:
    """Return the impulses of a library.

    Parameters
    ----------
    library : Library
        With impulses among its effects.

    Returns
    -------
    list of EffectInstance
        Those of the first piece first.
    """
    return [instance for instance in library.instances if instance.effect == EFFECT]


def _impulse(
    inertia: Sequence[float], dof: int, piece: int, pieces: int, name: str, unit: str
) -> EffectInstance:
    """The force on one degree of freedom in one piece of a window."""
    scale = 10.0 * max(inertia[dof], 1e-9)  # accelerates it by 10 rad/s^2 (m/s^2)
    force = Quantity("force", unit, -1e3 * scale, 1e3 * scale, (scale,))
    applied = partial(_force, len(inertia), dof, piece, pieces)
    return EffectInstance(EFFECT, name, (force,), str(piece), applied_force=applied)


def _force(nv: int, dof: int, piece: int, pieces: int, steps: int, sizes: Array) -> Array:
    """(steps, nv) the force in each control step of a window."""
    force = np.zeros((steps, nv))
    inside = np.arange(steps) * pieces // steps == piece
    force[inside, dof] = sizes[0]
    return force


@dataclass(frozen=True, eq=False)
class Unexplained:
    """Random forces beside everything that was found.

    Attributes
    ----------
    sd : (nv,) array
        Standard deviations of the forces, each piece of a window anew [N m, N].
    scale : (nv,) array
        The inverse of the forces that accelerate each degree of freedom alike.
    gain : float
        Of allowing for the forces, on windows held out [nats].
    z : float
        The gain in standard errors by block.
    excess : (W,) array
        The gain of each window held out [nats].
    responses : tuple of array
        d residual / d force (W, n, pieces nv), of the windows that the forces are learned from and
        of those held out.
    settings : ForceSettings
        When the forces are there.
    """

    sd: Array
    scale: Array
    gain: float
    z: float
    excess: Array
    responses: tuple[Array, Array]
    settings: ForceSettings = SETTINGS

    @property
    def present(self) -> bool:
        """Whether the windows held out are better explained with them."""
        return self.gain > self.settings.gain and self.z > self.settings.z


def unexplained_force(
    library: Library,
    train: LinearizedWindows,
    test: LinearizedWindows,
    floor: Array,
    gain_of: Callable[[LinearizedWindows, LinearizedWindows], tuple[float, float]],
    responses: tuple[Array, Array] | None = None,
    settings: ForceSettings = SETTINGS,
) -> Unexplained:
    """Estimate random forces w ~ N(0, diag(sd^2)) in every piece of a window, beside the noise.

    By expectation-maximization on the windows to fit.

    Parameters
    ----------
    library : Library
        With impulses among its effects.
    train, test : LinearizedWindows
        The windows to fit, and those held out.
    floor : (p,) array
        Lower bound of the noise.
    gain_of : callable
        Compares two models on the same windows: the gain [nats], and its z.
    responses : tuple of array, optional
        Those found under another theta, which changes them little.
    settings : ForceSettings
        How much is learned from, and when the forces are there.

    Returns
    -------
    Unexplained
    """
    instances = impulses_of(library)
    nv = len({instance.target for instance in instances})
    pieces = len(instances) // nv
    unit = np.array([instance.quantities[0].probes[0] for instance in instances[:nv]])

    # How the residuals respond to each force.
    stride = max(1, len(train.windows) // settings.windows)
    train = train.take(np.arange(0, len(train.windows), stride))
    if responses is None:
        responses = responses_to(library, train, instances), responses_to(library, test, instances)
    of_train, of_test = responses

    # The noise and the forces that the windows to fit are most likely under.
    good = ~train.lost
    noise, sd = learn_noise(
        np.concatenate([train.start_loadings, of_train], axis=2)[good],
        train.residuals[good],
        train.whiten.noise,
        floor,
        unit,
        pieces=pieces,
        known=train.known_loadings[good],
        counted=train.windows.counted,
    )

    # What they gain on the windows held out.
    known = test.known_loadings
    ones = np.ones(known.shape[2])
    scale = np.concatenate([np.tile(noise.sigma, 2), np.tile(sd, pieces), ones])
    loadings = np.concatenate([test.start_loadings, of_test, known], axis=2)
    with_forces = replace(test, whiten=Whitener(loadings, scale, noise, test.windows.counted))
    gain, z = gain_of(test, with_forces)
    excess = with_forces.log_likelihood - test.log_likelihood
    return Unexplained(sd, 1 / unit, gain, z, excess, responses, settings)


def responses_to(
    library: Library, linearized: LinearizedWindows, instances: Sequence[EffectInstance]
) -> Array:
    """Simulate how residuals respond to each force.

    Parameters
    ----------
    library : Library
        With impulses among its effects.
    linearized : LinearizedWindows
        W windows of n measurements.
    instances : sequence of EffectInstance
        The impulses, as of `impulses_of`.

    Returns
    -------
    (W, n, pieces nv) array
        d residual / d force.
    """
    free = np.concatenate([library.indices_of[instance.label] for instance in instances])
    steps = library.steps[free]
    thetas = np.repeat(linearized.theta[None], len(free), axis=0)
    thetas[np.arange(len(free)), free] = steps
    predicted = library.predict(thetas, linearized.windows)
    change = np.nan_to_num(predicted - linearized.predicted)
    return np.moveaxis(change / steps[:, None, None], 0, 2)
