"""Draws of a sampler, and what they say about themselves."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from dropo.core.services.errors import DropoError
from dropo.core.services.optional_dependencies import need
from dropo.core.services.tables import number, text_table
from dropo.core.services.validation import Array, check_shape, float_array, require


class ChainTooShort(DropoError, RuntimeError):
    """The chain is too short to estimate its own autocorrelation time.

    Parameters
    ----------
    message : str
        How many steps would be enough.
    estimate : (d,) array
        What the chain gives so far [steps], too low as a rule.
    """

    def __init__(self, message: str, estimate: Array):
        super().__init__(message)
        self.estimate = estimate


@dataclass(frozen=True)
class Draws:
    """The states of W walkers over S steps.

    Attributes
    ----------
    chain : (S, W, d) array
        In the parameters' own units.
    log_density : (S, W) array
        Up to a constant.
    names : tuple of str
        Of the d parameters.
    diverging : (S, W) array of bool, or None
        The steps at which the sampler's trajectory diverged, where it has such.
    notes : tuple of str
        What speaks against the draws, a sentence each.
    interrupted : bool
        Whether these are the steps until Ctrl-C.

    Raises
    ------
    BadArgument
        If there are fewer than 4 steps, or an array has another shape or is not finite.
    """

    chain: Array
    log_density: Array
    names: tuple[str, ...]
    diverging: NDArray[np.bool_] | None = None
    notes: tuple[str, ...] = ()
    interrupted: bool = False

    def __post_init__(self) -> None:
        chain = float_array("chain", self.chain, (None, None, len(self.names)), "Draws")
        enough = chain.shape[0] >= 4 and chain.shape[1] >= 1
        require(enough, "chain", "of 4 steps and 1 walker, or more", chain.shape, "Draws")
        log_density = float_array("log_density", self.log_density, chain.shape[:2], "Draws")
        object.__setattr__(self, "chain", chain)
        object.__setattr__(self, "log_density", log_density)
        if self.diverging is not None:
            check_shape("diverging", self.diverging, chain.shape[:2], "Draws")

    def flat(self, discard: int = 0, thin: int = 1) -> Array:
        """Put the draws of all walkers into one array, step by step.

        Parameters
        ----------
        discard : int
            Steps to leave out at the beginning.
        thin : int
            Keep one step of so many.

        Returns
        -------
        (K, d) array

        Raises
        ------
        BadArgument
            If no step is left, or `thin` is less than 1.
        """
        rule = f"in 0 ... {len(self.chain) - 1}"
        require(0 <= discard < len(self.chain), "discard", rule, discard, "Draws.flat")
        require(thin >= 1, "thin", "at least 1", thin, "Draws.flat")
        flat: Array = self.chain[discard::thin].reshape(-1, len(self.names))
        return flat

    def autocorrelation_time(self, *, minimum: float = 50.0) -> Array:
        """Estimate the integrated autocorrelation time of a walker, with Sokal's window.

        Parameters
        ----------
        minimum : float
            The shortest chain to trust, in autocorrelation times, as emcee has it; 0 takes any.

        Returns
        -------
        (d,) array
            In steps.

        Raises
        ------
        ChainTooShort
            If the chain is shorter.

        References
        ----------
        Goodman and Weare, Communications in Applied Mathematics and Computational Science 5
        (2010), 65.
        """
        times = np.array([_integrated_time(self.chain[:, :, i]) for i in range(len(self.names))])
        if len(self.chain) < minimum * times.max():
            worst = self.names[int(times.argmax())]
            raise ChainTooShort(
                f"{len(self.chain)} steps are fewer than {minimum:g} autocorrelation times of "
                f"{worst!r} (about {times.max():.3g} steps each). Take at least "
                f"{int(np.ceil(minimum * times.max()))} steps.",
                times,
            )
        return times

    def effective_sample_size(self) -> Array:
        """Count the independent draws that give the mean as well.

        It is S W / autocorrelation time.

        Returns
        -------
        (d,) array
        """
        return np.asarray(self.log_density.size / self.autocorrelation_time(minimum=0))

    def split_r_hat(self) -> Array:
        """Compute the rank-normalised split R-hat, the larger of bulk and folded.

        Returns
        -------
        (d,) array
            1 where the chains have converged.

        References
        ----------
        Vehtari et al., Bayesian Analysis 16 (2021), 667, section 4.
        """
        half = len(self.chain) // 2
        halves = np.concatenate([self.chain[:half], self.chain[-half:]], axis=1)  # (half, 2 W, d)
        folded = np.abs(halves - np.median(halves, axis=(0, 1)))
        worst = []
        for i in range(len(self.names)):
            bulk = _r_hat(_normal_scores(halves[:, :, i]))
            tails = _r_hat(_normal_scores(folded[:, :, i]))
            worst.append(max(bulk, tails))
        return np.array(worst)

    def summary(self) -> str:
        """Make a table with a row for each parameter.

        Returns
        -------
        str
            Mean, standard deviation, quantiles and diagnostics.
        """
        flat = self.flat()
        times = self.autocorrelation_time(minimum=0)
        ess = self.effective_sample_size()
        r_hat = self.split_r_hat()
        columns = [
            flat.mean(axis=0),
            flat.std(axis=0),
            *np.quantile(flat, [0.05, 0.5, 0.95], axis=0),
            times,
            ess,
            r_hat,
        ]
        header = ["parameter", "mean", "sd", "5 %", "median", "95 %", "autocorr.", "ESS", "R-hat"]
        rows = []
        for i, name in enumerate(self.names):
            rows.append([name, *(number(column[i]) for column in columns)])
        return text_table(header, rows)

    def to_inference_data(
        self,
        *,
        log_likelihood: Array | None = None,
        observed: Array | None = None,
        attributes: Mapping[str, Any] | None = None,
    ) -> Any:
        """Make the draws an arviz.InferenceData, whose chains are the walkers.

        Parameters
        ----------
        log_likelihood : (S, W, R) array, optional
            Of each compared row, for model comparison.
        observed : (R, p) array, optional
            The measured targets.
        attributes : mapping, optional
            What else to say about the run.

        Returns
        -------
        arviz.InferenceData

        Raises
        ------
        MissingPackage
            If arviz is not installed.
        """
        stats = {"lp": _by_chain(self.log_density)}
        if self.diverging is not None:
            stats["diverging"] = _by_chain(self.diverging)
        by_row = None if log_likelihood is None else {"measured": _by_chain(log_likelihood)}
        return _arviz().from_dict(
            posterior={name: _by_chain(self.chain[:, :, i]) for i, name in enumerate(self.names)},
            sample_stats=stats,
            log_likelihood=by_row,
            observed_data=None if observed is None else {"measured": observed},
            attrs=dict(attributes or {}),
        )


def _by_chain(values: NDArray[Any]) -> NDArray[Any]:
    """Values (S, W, ...) as (W, S, ...)."""
    return np.swapaxes(values, 0, 1)


def from_sample(sample: Array, names: Sequence[str], attributes: Mapping[str, Any]) -> Any:
    """Make independent draws an arviz.InferenceData with one chain.

    Parameters
    ----------
    sample : (K, d) array
        The draws.
    names : sequence of str
        Of the d parameters.
    attributes : mapping
        What else to say about them.

    Returns
    -------
    arviz.InferenceData

    Raises
    ------
    MissingPackage
        If arviz is not installed.
    """
    posterior = {name: sample[None, :, i] for i, name in enumerate(names)}
    return _arviz().from_dict(posterior=posterior, attrs=dict(attributes))


def _arviz() -> Any:
    """The module arviz."""
    need("arviz", extra="posterior", caller="InferenceData")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on arviz' own plans
        import arviz
    return arviz


def _integrated_time(x: Array, window: float = 5.0) -> float:
    """The time 1 + 2 sum_t rho_t of walkers (S, W), cut at the first t >= window * it (Sokal 1989).

    Walkers are compared with the mean of all, so that walkers which do not mix give a long time.
    """
    steps = len(x)
    spectrum = np.fft.rfft(x - x.mean(), n=2 * steps, axis=0)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[:steps].mean(axis=1) / steps  # (S,)
    if covariance[0] <= 0:
        return float(steps)  # nothing ever moved
    times = 2 * np.cumsum(covariance / covariance[0]) - 1
    enough = np.arange(steps) >= window * times
    return max(1.0, float(times[int(enough.argmax()) if enough.any() else -1]))


def _normal_scores(x: Array) -> Array:
    """Normal scores of the ranks (Vehtari et al. 2021, eq. 14)."""
    from scipy.stats import rankdata  # slow to import

    ranks = rankdata(x).reshape(x.shape)
    return np.asarray(ndtri((ranks - 3 / 8) / (x.size + 1 / 4)))


def _r_hat(x: Array) -> float:
    """R-hat, sqrt(var+ / W), of chains (S, M) (Gelman et al. 2013, eq. 11.4)."""
    within = x.var(axis=0, ddof=1).mean()
    between = x.mean(axis=0).var(ddof=1)
    return float(np.sqrt((len(x) - 1) / len(x) + between / within)) if within > 0 else np.inf
