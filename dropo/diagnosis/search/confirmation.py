"""When an effect is accepted: how large its gain on the windows held out must be, and how sure.

A gain is the increase of the log-likelihood of the same windows from one model to another [nats].
"""

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import LinearizedWindows
from dropo.diagnosis.search.plausibility import Plausibility
from dropo.diagnosis.search.refit import DEFAULTS as REFIT
from dropo.diagnosis.search.refit import RefitSettings
from dropo.diagnosis.search.screening import ScreeningSettings


@dataclass(frozen=True)
class SelectionSettings:
    """When an effect is accepted, and when another one is as good.

    Attributes
    ----------
    false_alarm : float
        The held-out gain must be above log(effects / false_alarm). For two fixed models, the
        first of them true, a split likelihood-ratio [1]_ is that large with a probability of
        false_alarm / effects at most. Here it is a threshold, and no bound on false alarms: the
        model without the effect is not fitted to the windows held out, which the bound asks for
        where it has numbers of its own, the noise is estimated, and the same windows choose among
        effects, one after another. How often wrong effects pass is counted by
        `dropo recover hidden-effects`.
    window_z : float
        Standard errors by window by which the held-out gain, or its signed ranks, must exceed 0.
    block_z : float
        Standard errors by block by which the held-out gain must exceed 0.
    minimum_fitted_gain : float
        Gain on the windows to fit that a candidate must exceed to be considered [nats].
    response : float
        Gain or loss from which a window responds to an effect [nats].
    few_windows : int
        Windows that must respond, and gain, of an effect that acts seldom.
    minimum_fraction : float
        A later effect must gain this fraction of what the earlier ones gained together.
    batch_size : int
        Candidates that are refitted before any of them may be accepted.
    maximum_batches : int
        How many batches are tried at most for one more effect.
    maximum_effects : int
        Effects that are accepted at most.
    maximum_polished : int
        Trials of a batch that are fitted to the end, at most, if those before are then not
        confirmed.
    similarity : float
        Cosine of two whitened responses from which two effects do the same to the data.
    plausibility : Plausibility
        How usual each effect is: what decides between those that do the same to the data.
    more_usual : float
        Difference of log odds from which one effect is more usual than another.
    usual_margin : float
        Nats by which a less usual effect must be better than a more usual one, to be named in its
        place: what misfit of other kinds makes of two that do nearly the same.
    negligible_gain : float
        Difference of two models' log-likelihoods below which neither is better [nats].
    first_noise_stride : int
        The first estimate of the noise takes one window of so many.
    maximum_diverging : float
        Fraction of diverging windows beyond which the model is refused.
    indistinguishable_z : float
        An alternative within so many standard errors, or within `negligible_gain`, cannot be
        distinguished.
    alternative_fraction : float
        An alternative to an accepted effect must have more than this fraction of the penalized
        gain that the effect had in the same batch, to be tried in its place.
    maximum_alternatives : int
        Alternatives that are tried in the place of an accepted effect, at most.
    polished_fraction : float
        An alternative tried there must gain more than this fraction of what the effect gains, to
        be fitted to the end.
    screening : ScreeningSettings
        How effects are screened.
    refit : RefitSettings
        How theta and the noise are fitted.

    References
    ----------
    .. [1] Wasserman, Ramdas and Balakrishnan, Universal inference, PNAS 117, 2020.
    """

    false_alarm: float = 0.01
    window_z: float = 3.0
    block_z: float = 1.5
    minimum_fitted_gain: float = 5.0
    response: float = 1.0
    few_windows: int = 5
    minimum_fraction: float = 0.01
    batch_size: int = 6
    maximum_batches: int = 3
    maximum_effects: int = 12
    maximum_polished: int = 3
    similarity: float = 0.98
    plausibility: Plausibility = field(default_factory=Plausibility)
    more_usual: float = 1.0
    usual_margin: float = 30.0
    negligible_gain: float = 4.0
    first_noise_stride: int = 3
    maximum_diverging: float = 0.3
    indistinguishable_z: float = 2.0
    alternative_fraction: float = 0.5
    maximum_alternatives: int = 2
    polished_fraction: float = 0.9
    screening: ScreeningSettings = field(default_factory=ScreeningSettings)
    refit: RefitSettings = REFIT

    def needed_gain(self, effects: int) -> float:
        """Return the gain that confirms one of so many effects.

        Parameters
        ----------
        effects : int
            How many are looked for.

        Returns
        -------
        float
            On the windows held out [nats].
        """
        return float(np.log(max(effects, 1) / self.false_alarm))

    def more_usual_by(self, effects: Collection[str], others: Collection[str]) -> float:
        """Return by how much some effects are more usual than as many others.

        Parameters
        ----------
        effects, others : collection of str
            Their names.

        Returns
        -------
        float
            Difference of log odds [nats].
        """
        odds = self.plausibility
        return sum(odds.of(name) for name in effects) - sum(odds.of(name) for name in others)

    def margin(self, more_usual: float) -> float:
        """Return the nats by which less usual effects must be better than as many others.

        Parameters
        ----------
        more_usual : float
            By how much one side is more usual than the other, as of `more_usual_by`.

        Returns
        -------
        float
        """
        clearly = abs(more_usual) >= self.more_usual
        return self.usual_margin if clearly else self.negligible_gain

    def margin_in_place_of(self, effects: Collection[str], others: Collection[str]) -> float:
        """Return the nats by which a model must be better that has some effects for others.

        Parameters
        ----------
        effects, others : collection of str
            Names of those that come, and of as many that go.

        Returns
        -------
        float
            The least that counts, if those that come are the more usual ones.
        """
        more_usual = self.more_usual_by(effects, others)
        return self.negligible_gain if more_usual > 0 else self.margin(more_usual)


SETTINGS = SelectionSettings()


def gain_by_block(before: LinearizedWindows, after: LinearizedWindows) -> Array:
    """Sum what windows gain over each of their blocks.

    Parameters
    ----------
    before, after : LinearizedWindows
        The same windows under two models.

    Returns
    -------
    (B,) array
        The gain of each block [nats], in ascending order of the blocks' numbers.
    """
    gains = after.log_likelihood - before.log_likelihood
    # Blocks may have any numbers: count them from 0 on, and add up the gains of each.
    _, block_of_window = np.unique(before.windows.block, return_inverse=True)
    return np.asarray(np.bincount(block_of_window, weights=gains), dtype=float)


def gain_of(before: LinearizedWindows, after: LinearizedWindows) -> tuple[float, float]:
    """Compare two models on the same windows.

    Parameters
    ----------
    before, after : LinearizedWindows
        The windows under both.

    Returns
    -------
    gain : float
        Of the second model [nats].
    z : float
        The gain in standard errors by block; 0 where there is no standard error.
    """
    gains = gain_by_block(before, after)
    gain = float(gains.sum())
    if len(gains) < 2:
        return gain, 0.0
    # Of a sum of B independent gains.
    standard_error = gains.std(ddof=1) * np.sqrt(len(gains))
    if not standard_error > 0:
        return gain, 0.0
    return gain, float(gains.sum() / standard_error)


def is_confirmed(
    before: LinearizedWindows,
    after: LinearizedWindows,
    needed: float,
    settings: SelectionSettings = SETTINGS,
) -> bool:
    """Decide whether windows held out confirm a model.

    Neither a single block nor a few windows may make the gain alone: the total gain is certain, or
    most windows gain. Of an effect that acts seldom, such as a joint's limit, a few windows are
    enough if none that responds loses.

    Parameters
    ----------
    before, after : LinearizedWindows
        The windows held out without and with the effect.
    needed : float
        Gain that is needed [nats].
    settings : SelectionSettings
        How sure the gain must be.

    Returns
    -------
    bool
    """
    # The gain is large enough, and more than a single block makes it.
    gain, block_z = gain_of(before, after)
    if not (gain > needed and block_z > settings.block_z):
        return False
    # It is certain in standard errors by window ...
    gains = after.log_likelihood - before.log_likelihood
    standard_error = float(gains.std(ddof=1)) * np.sqrt(len(gains))
    if float(gains.sum()) > settings.window_z * standard_error:
        return True
    # ... or most windows gain ...
    if signed_rank_score(gains) > settings.window_z:
        return True
    # ... or only a few respond, and all of these gain.
    responding = gains[np.abs(gains) > settings.response]
    if len(responding) < settings.few_windows:
        return False
    return bool(responding.min() > 0)


def has_less_noise(
    before: LinearizedWindows, after: LinearizedWindows, settings: SelectionSettings = SETTINGS
) -> bool:
    """Decide whether some signal's noise has fallen much.

    Then the linearization in the noise of the windows' start states, which a trial keeps, is not
    right any more. This is so where an error of a sensor was taken for noise: the trial of its
    cause goes only part of the way.

    Parameters
    ----------
    before, after : LinearizedWindows
        The same windows under two models.
    settings : SelectionSettings
        Its `refit.other_noise` is the ratio of noises that counts.

    Returns
    -------
    bool
    """
    limit = before.whiten.sigma / settings.refit.other_noise
    return bool(np.any(after.whiten.sigma < limit))


def signed_rank_score(gains: Array) -> float:
    """Return the normal score of the signed-rank test that most windows gain.

    Parameters
    ----------
    gains : (W,) array
        Of the windows [nats].

    Returns
    -------
    float
        Standard deviations above chance.

    References
    ----------
    Wilcoxon, Individual comparisons by ranking methods, Biometrics Bulletin 1, 1945.
    """
    n = len(gains)
    _, place, ties = np.unique(np.abs(gains), return_inverse=True, return_counts=True)
    # Equal sizes share the mean of their ranks.
    ranks = (np.cumsum(ties) - (ties - 1) / 2)[place]
    # By chance, each rank has either sign: the variance of their sum is 1^2 + 2^2 + ... + n^2.
    standard_deviation = np.sqrt(n * (n + 1) * (2 * n + 1) / 6)
    return float(np.sum(np.sign(gains) * ranks) / standard_deviation)
