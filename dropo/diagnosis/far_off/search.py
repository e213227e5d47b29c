"""What a model that is far off lacks: regression, whole motions, what else these ask for."""

from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.services.validation import Array
from dropo.diagnosis.far_off.families import EVERYWHERE, FamilySettings, with_families
from dropo.diagnosis.far_off.fit import Fitted, OutputError, OutputErrorSettings
from dropo.diagnosis.far_off.model import FarOffModel
from dropo.diagnosis.far_off.motions import Motions, MotionSettings, motions_of
from dropo.diagnosis.search.selection import Progress


@dataclass(frozen=True)
class FarOffSettings:
    """Numbers that decide where a model lacks much.

    Attributes
    ----------
    families : FamilySettings
        Effects that are tried at every joint or drive at once, beside what regression finds.
    rounds : int
        How often they are tried at most, with all fitted again in between.
    rough : int
        The first fit takes one window of so many.
    certain : float
        Standard errors that a number must be away from 0.
    kept : tuple of str
        Effects that stay however uncertain they are: without them the scale of all forces would
        seem known.
    motions : MotionSettings
        Which windows.
    fit : OutputErrorSettings
        How numbers are fitted to them.
    """

    families: FamilySettings = field(default_factory=FamilySettings)
    rounds: int = 2
    rough: int = 3
    certain: float = 3.0
    kept: tuple[str, ...] = ("actuator_gain",)
    motions: MotionSettings = field(default_factory=MotionSettings)
    fit: OutputErrorSettings = field(default_factory=OutputErrorSettings)


@dataclass(frozen=True, eq=False)
class Explained:
    """What a model lacked, fitted to whole motions.

    Attributes
    ----------
    model : FarOffModel
        With all numbers.
    errors : (m,) array
        Their standard errors; 0 of what was not fitted.
    without : dict of str to (m,) array
        By effect's label, the numbers without it, the others moved to make up for it.
    length : int
        Control steps of the windows.
    """

    model: FarOffModel
    errors: Array
    without: dict[str, Array]
    length: int


class FarOffSearch:
    """The search for what a model lacks that is far off.

    Parameters
    ----------
    settings : FarOffSettings
        Numbers that decide.
    progress : callable
        Called with the fraction done and a text.
    """

    def __init__(self, settings: FarOffSettings, progress: Progress) -> None:
        self.settings = settings
        self.progress = progress

    def run(self, model: FarOffModel) -> Explained:
        """Fit a model's numbers to whole motions, with what else these ask for.

        Parameters
        ----------
        model : FarOffModel
            With what regression finds.

        Returns
        -------
        Explained
        """
        settings = self.settings
        self.progress(0.1, "how long windows can be")
        fitted, held_out = motions_of(model.problem, model.library, model.theta, settings.motions)
        length = fitted.windows.length
        self.progress(0.15, f"fitting {len(model.fitted)} numbers to windows of {length} steps")
        model = self._fit(model, _some(fitted, settings.rough))[0]
        for number in range(settings.rounds):
            self.progress(0.3 + 0.2 * number, "what else motions ask for")
            more = with_families(model, fitted, settings.families, settings.fit)
            if more is model:
                break
            more = self._fit(more, _some(fitted, settings.rough))[0]
            if not self._is_better(more, model, held_out):
                break
            model = more
        self.progress(0.7, f"fitting {len(model.fitted)} numbers to all windows")
        model, error, end = self._fit(model, fitted)
        while True:
            errors = _errors(model, error, end)
            kept = self._certain(model, errors)
            if kept is model:
                break
            model, error, end = self._fit(kept, fitted)
        return Explained(model, errors, _without(model, end), length)

    def _fit(self, model: FarOffModel, motions: Motions) -> tuple[FarOffModel, OutputError, Fitted]:
        """A model's numbers fitted to motions."""
        error = OutputError(model.library, motions, self.settings.fit)
        end = error.fit(model.theta, model.fitted)
        return model.at(end.theta), error, end

    def _is_better(self, more: FarOffModel, model: FarOffModel, held_out: Motions) -> bool:
        """Whether windows held out are predicted better with more numbers."""
        before = OutputError(model.library, held_out, self.settings.fit)
        residuals = before.residuals(model.theta[None])
        scale = before.scale_of(residuals[0])
        after = OutputError(more.library, held_out, self.settings.fit)
        old = before.cost(before.whitened(residuals, scale))[0]
        new = after.cost(after.whitened(after.residuals(more.theta[None]), scale))[0]
        return bool(new.sum() < old.sum())

    def _certain(self, model: FarOffModel, errors: Array) -> FarOffModel:
        """The model without the effects that are not told from nothing."""
        settings = self.settings
        doubtful = []
        for instance, sizes in model.numbers:
            place = model.library.places[instance.label][0]
            is_kept = instance.effect in settings.kept and instance.target in EVERYWHERE
            if not is_kept and abs(sizes[0]) < settings.certain * errors[place]:
                doubtful.append(instance.label)
        return model.without(doubtful) if doubtful else model


def _some(motions: Motions, every: int) -> Motions:
    """One window of so many, but no fewer than eight."""
    count = len(motions.windows)
    index = np.arange(0, count, max(1, min(every, count // 8)))
    return replace(motions, windows=motions.windows.take(index), loadings=motions.loadings[index])


def _errors(model: FarOffModel, error: OutputError, end: Fitted) -> Array:
    """Standard errors (m,): of the data, and of the physics step."""
    found = np.zeros(len(model.theta))
    variance = np.maximum(np.diag(error.covariance(end)), 0.0)
    found[end.free] = np.hypot(np.sqrt(variance), error.change_by_step(end))
    return np.nan_to_num(found, nan=np.inf)


def _without(model: FarOffModel, end: Fitted) -> dict[str, Array]:
    """By effect's label, the numbers without it, the others moved to make up for it."""
    space = model.library.simulator.space
    gram = end.gram
    found = {}
    for instance, _ in model.numbers:
        place = model.library.places[instance.label]
        own = np.isin(end.free, place)
        others = end.free[~own]
        size = np.sqrt(np.maximum(np.diag(gram)[~own], 1e-300))
        scaled = gram[np.ix_(~own, ~own)] / np.outer(size, size)
        moment = gram[np.ix_(~own, own)] @ end.theta[end.free[own]] / size
        theta = end.theta.copy()
        theta[place] = 0.0
        moved = theta[others] + np.linalg.lstsq(scaled, moment, rcond=1e-8)[0] / size
        theta[others] = np.clip(moved, space.low[others], space.high[others])
        found[instance.label] = theta
    return found
