"""Draws of a sampler, and what they say about themselves."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import rankdata

from dropo.core.services.errors import DropoError
from dropo.core.services.optional_dependencies import need
from dropo.core.services.tables import number, text_table
from dropo.core.services.validation import Array, check_shape, float_array, require


class ChainTooShort(DropoError, RuntimeError):
    """The chain is too short to tell its own autocorrelation time; `estimate` (d,) is what it says
    so far, too low as a rule.
    """

    def __init__(self, message: str, estimate: Array):
        super().__init__(message)
        self.estimate = estimate


@dataclass(frozen=True)
class Draws:
    """The states of W walkers over S steps.

    chain: (S, W, d) in the parameters' own units; log_density: (S, W), up to a constant; names: of
    the d parameters;
    diverging: (S, W), where the sampler tells which steps went astray; notes: what speaks against
    the draws, a sentence each.
    """

    chain: Array
    log_density: Array
    names: tuple[str, ...]
    diverging: NDArray[np.bool_] | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        chain = float_array("chain", self.chain, (None, None, len(self.names)), "Draws")
        require(
            chain.shape[0] >= 4 and chain.shape[1] >= 1,
            "chain",
            "of 4 steps and 1 walker, or more",
            chain.shape,
            "Draws",
        )
        object.__setattr__(self, "chain", chain)
        object.__setattr__(
            self,
            "log_density",
            float_array("log_density", self.log_density, chain.shape[:2], "Draws"),
        )
        if self.diverging is not None:
            check_shape("diverging", self.diverging, chain.shape[:2], "Draws")

    def flat(self, discard: int = 0, thin: int = 1) -> Array:
        """(K, d) the draws of all walkers, step by step; without the first so many steps, every so
        manyth of the others.
        """
        require(
            0 <= discard < len(self.chain),
            "discard",
            f"in 0 ... {len(self.chain) - 1}",
            discard,
            "Draws.flat",
        )
        require(thin >= 1, "thin", "at least 1", thin, "Draws.flat")
        flat: Array = self.chain[discard::thin].reshape(-1, len(self.names))
        return flat

    def autocorrelation_time(self, *, least: float = 50.0) -> Array:
        """(d,) integrated autocorrelation time of a walker [steps] (Goodman and Weare 2010), with
        Sokal's window.

        least: the shortest chain to trust, in autocorrelation times (emcee's rule); 0 takes any.
        """
        times = np.array([_integrated_time(self.chain[:, :, i]) for i in range(len(self.names))])
        if len(self.chain) < least * times.max():
            worst = self.names[int(times.argmax())]
            raise ChainTooShort(
                f"{len(self.chain)} steps are fewer than {least:g} autocorrelation times "
                f"of {worst!r} (about {times.max():.3g} steps each)."
                f" Take at least {int(np.ceil(least * times.max()))} steps.",
                times,
            )
        return times

    def effective_sample_size(self) -> Array:
        """(d,) how many independent draws tell the mean as well: S W / autocorrelation time."""
        return np.asarray(self.log_density.size / self.autocorrelation_time(least=0))

    def split_r_hat(self) -> Array:
        """(d,) rank-normalised split R-hat, the larger of bulk and folded (Vehtari et al. 2021,
        section 4); 1 where converged.
        """
        half = len(self.chain) // 2
        halves = np.concatenate([self.chain[:half], self.chain[-half:]], axis=1)  # (half, 2 W, d)
        folded = np.abs(halves - np.median(halves, axis=(0, 1)))
        return np.array(
            [
                max(_r_hat(_normal_scores(x[:, :, i])) for x in (halves, folded))
                for i in range(len(self.names))
            ]
        )

    def summary(self) -> str:
        """A table: mean, standard deviation, quantiles and the diagnostics of each parameter."""
        flat = self.flat()
        times = self.autocorrelation_time(least=0)
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
        rows = [
            [name, *(number(column[i]) for column in columns)] for i, name in enumerate(self.names)
        ]
        return text_table(
            ["parameter", "mean", "sd", "5 %", "median", "95 %", "autocorr.", "ESS", "R-hat"], rows
        )

    def to_inference_data(
        self,
        *,
        log_likelihood: Array | None = None,
        observed: Array | None = None,
        attributes: Mapping[str, Any] | None = None,
    ) -> Any:
        """The draws as arviz.InferenceData; walkers are its chains.

        log_likelihood: (S, W, R) of each compared row, for model comparison; observed: (R, p) the
        measured targets;
        attributes: what else to say about the run.
        """
        stats = {"lp": _by_chain(self.log_density)} | (
            {} if self.diverging is None else {"diverging": _by_chain(self.diverging)}
        )
        return _arviz().from_dict(
            posterior={name: _by_chain(self.chain[:, :, i]) for i, name in enumerate(self.names)},
            sample_stats=stats,
            log_likelihood=None
            if log_likelihood is None
            else {"measured": _by_chain(log_likelihood)},
            observed_data=None if observed is None else {"measured": observed},
            attrs=dict(attributes or {}),
        )


def _by_chain(values: NDArray[Any]) -> NDArray[Any]:
    """(S, W, ...) -> (W, S, ...)."""
    return np.swapaxes(values, 0, 1)


def from_sample(sample: Array, names: Sequence[str], attributes: Mapping[str, Any]) -> Any:
    """arviz.InferenceData from independent draws (K, d): one chain."""
    arviz = _arviz()
    return arviz.from_dict(
        posterior={name: sample[None, :, i] for i, name in enumerate(names)}, attrs=dict(attributes)
    )


def _arviz() -> Any:
    need("arviz", extra="posterior", caller="InferenceData")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on arviz' own plans
        import arviz
    return arviz


def _integrated_time(x: Array, window: float = 5.0) -> float:
    """1 + 2 sum_t rho_t of walkers (S, W), cut at the first t >= window * itself (Sokal 1989).

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
    ranks = rankdata(x).reshape(x.shape)
    return np.asarray(ndtri((ranks - 3 / 8) / (x.size + 1 / 4)))


def _r_hat(x: Array) -> float:
    """sqrt(var+ / W) of chains (S, M) (Gelman et al. 2013, eq. 11.4)."""
    within = x.var(axis=0, ddof=1).mean()
    between = x.mean(axis=0).var(ddof=1)
    return float(np.sqrt((len(x) - 1) / len(x) + between / within)) if within > 0 else np.inf
