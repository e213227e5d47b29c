"""What every estimator returns: a distribution of the parameters, and what it cost to find."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.numerics.tails import chi2_quantile, normal_of_tail, student_quantile
from dropo.core.records.fits.fit_choices import ExcludedSpans, HorizonChoice, NoiseTuning
from dropo.core.records.fits.fit_parts import (
    EmulatorCheck,
    GroupEffects,
    HeldOutErrors,
    ModelCheck,
    PosteriorDraws,
    PriorUse,
    StartFilter,
)
from dropo.core.records.fits.fitted_parameter import FittedParameter
from dropo.core.records.fits.search_records import SearchRecord
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.registry import find, service
from dropo.core.services.tables import Report, Table
from dropo.core.services.validation import Array, known, require


class Status(str, Enum):
    """How a fit ended."""

    CONVERGED = "converged"
    OUT_OF_BUDGET = "out_of_budget"
    INTERRUPTED = "interrupted"
    DONE = "done"  # nothing was searched (uniform randomization)


def interrupted(done: int | None = None, of: str = "evaluations") -> str:
    """Say that a search was interrupted, after how much of what.

    Parameters
    ----------
    done : int, optional
        How many of them; not said without.
    of : str
        What was counted.

    Returns
    -------
    str
        A sentence.
    """
    after = "" if done is None else f" after {done} {of}"
    return f"Interrupted{after}: this is the best so far."


def variance_errors(sd: Array, scale: Array, scale_se: Array) -> Array:
    """Find the standard errors of variances from those of a family's scales, to first order.

    Parameters
    ----------
    sd, scale, scale_se : (d,) array
        The distribution's standard deviations, the family's scales, and the errors of these.

    Returns
    -------
    (d,) array
        Not finite where a scale is 0.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(2 * sd**2 * scale_se / scale)


@dataclass(frozen=True, repr=False, kw_only=True)
class Fit(Report):
    """A distribution over the d parameters, and what it cost to find.

    Attributes
    ----------
    method, problem : str
        Their names.
    space : ParameterSpace
        The parameters.
    family : str
        The name of the family of distributions.
    phi : (m,) array
        Its member.
    mean, scale, sd : (d,) array
        In the parameters' units: the family's own scale, and the distribution's standard deviation.
    mean_se, scale_se : (d,) array
        Standard errors, NaN where there is none.
    variance_se : (d,) array or None
        Standard errors of the variances, also of those that are 0, whose scales have none; NaN
        where there is none. None: as the scales' say.
    correlation : (d, d) array
        Of the distribution.
    correlation_se : (d, d) array or None
        Their standard errors, 0 on the diagonal, NaN where one is on its bound; None where there
        are none, as in families without correlations.
    epsilon : (p,) array
        The noise variances [signal unit^2].
    log_likelihood : float
        Of all rows, as the method has it [nats].
    mse : float
        The mean square of (mean prediction - measured) over rows and signals.
    transitions : int
        Those fitted.
    simulator_steps, failed_simulations, objective_evaluations : int
        What the fit cost.
    inner_evaluations : int
        Evaluations beside these of local models of the objective, which simulate nothing.
    status : Status
        How it ended, and `message` in words.
    message : str
        How it ended, in a sentence or two.
    warnings : tuple of str
        What speaks against the fit, a sentence each.
    wall_time_s : float
        How long it took [s].
    seed : int or None
        Where `rng` was one.
    degrees_of_freedom : (d,) array or None
        Of the Student t behind the intervals of the means; None: normal.
    places : mapping of str to dict
        Where in a model each parameter is, of a fit that was loaded; see `model_places`.
    likelihood, optimizer : str
        The names of these parts of the method; empty where it has none.
    emulator_check : EmulatorCheck or None
        The simulator beside its emulator at the fit.
    start_filter : StartFilter or None
        How filtered start states settled.
    constant_parameters : tuple of str, or None
        Those of which the likelihood itself says that they do not vary.
    search_record : SearchRecord or None
        What other methods than maximum likelihood record of their search.
    posterior : PosteriorDraws or None
        The draws of a posterior.
    identifiability : tuple of str, or None
        What the data do not determine, a sentence each; None where that was not tested.
    model_check : ModelCheck or None
        Whether the model can be right; None where that was not tested.
    priors : PriorUse or None
        What the problem's priors are to the means, of a method that searches with them.
    truth : mapping of str to float
        The parameters that the data were simulated with, where they are known.
    held_out : HeldOutErrors or None
        Errors on trajectories that no fit has seen.
    groups : GroupEffects or None
        Each group's own parameters, and whether the groups differ.
    noise_tuning : NoiseTuning or None
        The sweep over the noise variance.
    horizon_choice : HorizonChoice or None
        The horizons that were tried.
    excluded : ExcludedSpans or None
        Spans of time that were left out.
    source : str
        What `dropo.load` took to make the problem; empty where it took none. The files of a fit do
        not keep it, but made.json of `dropo fit --out` beside them does.
    arrays, details : dict
        What outside methods found beside: arrays of fit.npz, and entries of fit.json.
    """

    method: str
    problem: str
    space: ParameterSpace
    family: str
    phi: Array
    mean: Array
    scale: Array
    sd: Array
    mean_se: Array
    scale_se: Array
    correlation: Array
    epsilon: Array
    log_likelihood: float
    mse: float
    transitions: int
    simulator_steps: int
    failed_simulations: int
    objective_evaluations: int
    status: Status
    message: str
    warnings: tuple[str, ...] = ()
    wall_time_s: float = 0.0
    inner_evaluations: int = 0
    seed: int | None = None
    variance_se: Array | None = None
    degrees_of_freedom: Array | None = None
    correlation_se: Array | None = None
    places: Mapping[str, dict[str, Any]] = field(default_factory=dict)
    likelihood: str = ""
    optimizer: str = ""
    emulator_check: EmulatorCheck | None = None
    start_filter: StartFilter | None = None
    constant_parameters: tuple[str, ...] | None = None
    search_record: SearchRecord | None = None
    posterior: PosteriorDraws | None = None
    identifiability: tuple[str, ...] | None = None
    model_check: ModelCheck | None = None
    priors: PriorUse | None = None
    truth: Mapping[str, float] = field(default_factory=dict)
    held_out: HeldOutErrors | None = None
    groups: GroupEffects | None = None
    noise_tuning: NoiseTuning | None = None
    horizon_choice: HorizonChoice | None = None
    excluded: ExcludedSpans | None = None
    source: str = ""
    arrays: dict[str, Array] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)

    def sample(self, draws: int, rng: np.random.Generator | int | None = None) -> Array:
        """Draw parameter vectors from the fitted distribution.

        Parameters
        ----------
        draws : int
            How many, K.
        rng : numpy.random.Generator or int, optional
            Without it, new ones each time.

        Returns
        -------
        (K, d) array
            All physically possible, in the parameters' units.

        Raises
        ------
        BadArgument
            For a negative number of draws.
        """
        require(draws >= 0, "draws", "0 or more", draws, "Fit.sample")
        family = find("families", self.family)(self.space)
        return family.sample(self.phi, draws, np.random.default_rng(rng))

    def randomize(self, target: Any, count: int | None = None, **options: Any) -> Any:
        """Make an environment that draws its parameters from the fit at the start of every episode.

        Parameters
        ----------
        target : str, gymnasium.Env or Problem
            The id of a Gymnasium MuJoCo environment ("Hopper-v5"), such an environment, or a
            problem with a task.
        count : int, optional
            So many of them as one vector environment, simulated together.
        **options
            Those of `dropo.randomize`.

        Returns
        -------
        gymnasium.Env or gymnasium.vector.VectorEnv
            Its observations carry the noise that the fit learned.
        """
        return service("randomize")(target, self, count, **options)

    def export(self, target: str, out: str | Path | None = None, *, problem: Any = None) -> Any:
        """Write the fit in the form of another tool.

        Parameters
        ----------
        target : str
            A name that `dropo list exports` prints: "mujoco", "mjx", "mjlab", "isaac-lab", ...
        out : str or Path, optional
            The folder to write into, or the path of the main file; by default a folder named like
            the target.
        problem : Problem, str or Path, optional
            What was fitted; by default `source`.

        Returns
        -------
        dropo.exports.export.Exported
            The files, and in sentences what the target cannot hold or holds otherwise.
        """
        return service("export")(self, target, out, problem=problem)

    def interval(self, level: float = 0.95) -> Array:
        """Confidence intervals of the means, cut at the search interval.

        They are mean -+ t mean_se, and cover where the fit is `trusted`.

        Parameters
        ----------
        level : float
            The confidence, in (0, 1).

        Returns
        -------
        (d, 2) array
            In the parameters' units; NaN without a standard error, as on a bound, where the data
            speak against one side alone.

        Raises
        ------
        BadArgument
            For a level that is not between 0 and 1.
        """
        require(0 < level < 1, "level", "between 0 and 1", level, "Fit.interval")
        half = student_quantile((1 + level) / 2, self._degrees()) * self.mean_se
        ends = np.stack([self.mean - half, self.mean + half])
        return np.asarray(self.space.clip(ends).T)

    def sd_interval(self, level: float = 0.95) -> Array:
        """Confidence intervals of the distribution's standard deviations.

        A variance is taken for chi-square with the degrees of freedom of the means, as of a sample
        from a Gaussian: so intervals are not symmetric, and their middle allows for the (G - 1) / G
        of maximum likelihood. Where its standard error is larger, the rest is an independent error
        to the lower end, whose square is added to that of the sample. To the upper end it is noise,
        which adds to the variance and is subtracted again, or, of a variance larger than its error,
        tails heavier than a Gaussian's, which leave fewer degrees: the farther one of the two. They
        end at 0 and at the width of the search interval. Tails make them too short where units of
        data are few.

        Parameters
        ----------
        level : float
            The confidence, in (0, 1).

        Returns
        -------
        (d, 2) array
            In the parameters' units; NaN without a standard error of the variance, or where no
            mean has degrees of freedom. That of a mean on its bound are the fewest of the others.

        Raises
        ------
        BadArgument
            For a level that is not between 0 and 1.

        References
        ----------
        Zou and Donner, "Construction of confidence limits about effect measures", Statistics in
        Medicine 27 (2008), eq. 4: the lower end, by the ends of its two parts.
        """
        require(0 < level < 1, "level", "between 0 and 1", level, "Fit.sd_interval")
        count = self._degrees_of_spread()
        above = (1 + level) / 2
        below = (1 - level) / 2
        variance = self.sd**2
        error = self._variance_errors()
        with np.errstate(divide="ignore", invalid="ignore"):
            known = np.isinf(count)
            larger = np.where(known, 1.0, (count + 1) / count)
            of_sample = np.where(known, 1.0, larger * count / chi2_quantile(above, count))
            rest = np.sqrt(np.maximum(error**2 - 2 * variance**2 / count, 0.0))
            low = variance - np.hypot(variance * (1 - of_sample), normal_of_tail(below) * rest)
            fewer = np.minimum(2 * (variance / error) ** 2, count)
            fewer[~(variance > error)] = np.nan
            by_tails = variance * larger * fewer / chi2_quantile(below, fewer)
            noise = np.maximum(error * np.sqrt(count / 2) - variance, 0.0)
            by_noise = (variance + noise) * larger * count / chi2_quantile(below, count) - noise
            high = np.fmax(by_tails, by_noise)
        ends = np.sqrt(np.maximum([low, high], 0.0))
        ends = np.minimum(ends, self.space.high - self.space.low)
        return np.asarray(np.where(np.isfinite(error), ends, np.nan).T)

    def _variance_errors(self) -> Array:
        """(d,) standard errors of the variances, NaN where there is none."""
        of_scales = variance_errors(self.sd, self.scale, self.scale_se)
        if self.variance_se is None:
            return of_scales
        return np.where(np.isfinite(self.variance_se), self.variance_se, of_scales)

    def correlation_interval(self, level: float = 0.95) -> Array:
        """Confidence intervals of the correlations, by Fisher's z.

        Its half width is the larger one of what the standard error says and of that of a sample
        from a Gaussian, as many as there are independent units of data.

        Parameters
        ----------
        level : float
            The confidence, in (0, 1).

        Returns
        -------
        (d, d, 2) array
            1 on the diagonal; NaN without a standard error.

        Raises
        ------
        BadArgument
            For a level that is not between 0 and 1.
        """
        require(0 < level < 1, "level", "between 0 and 1", level, "Fit.correlation_interval")
        degrees = self._degrees_of_spread()
        fewest = np.minimum(degrees[:, None], degrees)
        off = ~np.eye(len(degrees), dtype=bool)
        r = np.where(off, self.correlation, 0.0)
        errors = np.nan if self.correlation_se is None else self.correlation_se
        se = errors / (1 - r**2)
        of_sample = 1 / np.sqrt(np.maximum(fewest - 2, 1.0))
        half = student_quantile((1 + level) / 2, fewest) * np.maximum(se, of_sample)
        ends = np.tanh(np.arctanh(r)[..., None] + half[..., None] * np.array([-1.0, 1.0]))
        return np.where(off[..., None], ends, 1.0)

    def _degrees_of_spread(self) -> Array:
        """(d,) degrees of freedom of standard deviations: where the mean has none, as on a bound,
        the fewest of the others; NaN where none has any, infinite where none are known.
        """
        if self.degrees_of_freedom is None:
            return np.full(len(self.mean), np.inf)
        known = self.degrees_of_freedom
        return np.where(np.isfinite(known), known, np.fmin.reduce(known))

    def _degrees(self) -> Array:
        """(d,) degrees of freedom, infinite where there are none."""
        if self.degrees_of_freedom is None:
            return np.full(len(self.mean), np.inf)
        return np.nan_to_num(self.degrees_of_freedom, nan=np.inf)

    @property
    def trusted(self) -> bool | None:
        """Whether nothing speaks against the model, on which errors and intervals rest.

        None where that was not checked: then they hold if the model is right.
        """
        return None if self.model_check is None else self.model_check.passed

    @property
    def parameters_are_constant(self) -> bool:
        """Whether the distribution is a posterior of parameters that are the same in all data."""
        return self.posterior is not None and self.posterior.over == "parameters"

    @property
    def model_places(self) -> dict[str, dict[str, Any]]:
        """Where in a model each parameter is; others than a model's fields have no place."""
        return {**self.places, **{p.name: p.place for p in self.space if p.place}}

    def to_inference_data(
        self, draws: int = 4000, rng: np.random.Generator | int | None = None
    ) -> Any:
        """The fit as arviz.InferenceData.

        Of `Posterior` its chains, with sample_stats, observed_data, and log_likelihood where kept.
        Of every other method draws from the fitted distribution, as one chain of the group
        posterior: its attribute `draws_of` says so. They show the spread to train under, and not
        how well it is known. Needs the extra `posterior`.

        Parameters
        ----------
        draws : int
            How many, of other methods than `Posterior`.
        rng : numpy.random.Generator or int, optional
            For these draws.

        Returns
        -------
        arviz.InferenceData
        """
        from dropo._version import __version__
        from dropo.core.records.draws import Draws, from_sample

        about = {
            "method": self.method,
            "problem": self.problem,
            "seed": self.seed,
            "version": __version__,
        }
        known = {name: value for name, value in about.items() if value is not None}
        found = self.posterior
        if found is None:
            sample = self.sample(draws, rng)
            return from_sample(
                sample, self.space.names, known | {"draws_of": "the fitted distribution"}
            )
        chains = Draws(found.chain, found.log_density, found.unknowns, found.diverging)
        return chains.to_inference_data(
            log_likelihood=found.row_log_likelihood, observed=found.observed, attributes=known
        )

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the d parameters."""
        return self.space.names

    def __getitem__(self, name: str) -> FittedParameter:
        """What was found of one parameter.

        Raises
        ------
        UnknownName
            If there is no such parameter; with the nearest name.
        """
        i = self.names.index(known("parameter", name, self.names))
        low, high = self.interval()[i].tolist()
        return FittedParameter(
            name=name,
            unit=self.space[name].unit,
            mean=float(self.mean[i]),
            mean_se=float(self.mean_se[i]),
            interval=(low, high),
            scale=float(self.scale[i]),
            sd=float(self.sd[i]),
            truth=self.truth.get(name),
        )

    def summary(self) -> Any:
        """A pandas.DataFrame to read: mean, its error and 95 % interval, and sd of each parameter.

        Where the truth is known it stands beside. `to_pandas` has all numbers; both need the extra
        `tables`.

        Raises
        ------
        MissingPackage
            If pandas is not installed.
        """
        from dropo.core.services.data_frames import frame

        rows = []
        for name in self.names:
            own = self[name]
            row = {
                "parameter": name,
                "unit": own.unit,
                "mean": own.mean,
                "se": own.mean_se,
                "low": own.interval[0],
                "high": own.interval[1],
                "sd": own.sd,
            }
            rows.append(row | ({"truth": own.truth} if self.truth else {}))
        return frame(rows, "parameter")

    def to_pandas(self) -> Any:
        """Make a data frame of the parameters.

        Its columns are mean, errors, scale, sd, their 95 % intervals, unit and search interval.

        Returns
        -------
        pandas.DataFrame
            A row for each parameter.
        """
        from dropo.core.services.data_frames import frame

        intervals = self.interval()
        of_sd = self.sd_interval()
        rows = [
            {
                "parameter": p.name,
                "unit": p.unit,
                "mean": self.mean[i],
                "mean_se": self.mean_se[i],
                "mean_low": intervals[i, 0],
                "mean_high": intervals[i, 1],
                "scale": self.scale[i],
                "scale_se": self.scale_se[i],
                "sd": self.sd[i],
                "sd_low": of_sd[i, 0],
                "sd_high": of_sd[i, 1],
                "low": p.low,
                "high": p.high,
            }
            for i, p in enumerate(self.space)
        ]
        return frame(rows, "parameter")

    def to_json(self) -> dict[str, Any]:
        """Give the content of fit.json.

        Returns
        -------
        dict
            Numbers that do not exist are None.
        """
        from dropo.core.records.fits.fit_files import content_of

        return content_of(self)

    def save(self, folder: str | Path) -> None:
        """Write fit.json and fit.npz into a folder, each whole or not at all.

        Parameters
        ----------
        folder : str or Path
            Made where it is missing.
        """
        from dropo.core.records.fits.fit_files import save_fit

        save_fit(self, Path(folder))

    @classmethod
    def load(cls, folder: str | Path) -> "Fit":
        """Read the fit that `save` wrote into a folder.

        Parameters
        ----------
        folder : str or Path
            The folder, with fit.json and fit.npz.

        Returns
        -------
        Fit
            With the same numbers as the one that was saved.

        Raises
        ------
        BadFile
            Where there is none, or one that cannot be read.
        """
        from dropo.core.records.fits.fit_files import load_fit

        return load_fit(Path(folder))

    def parts(self) -> list[str | Table]:
        """The fit as a table, with what it cost beneath."""
        from dropo.core.records.fits.fit_report import fit_report

        return fit_report(self)
