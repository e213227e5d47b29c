"""The contract of likelihoods: how probable the measured segments are under a member of a family.

`Likelihood` holds settings, and `bind` makes it a `LogLikelihood`: a function of phi for given
data. Two narrower contracts refine this one. A `LocalLikelihood` uses a local model of the
simulator, and its log-likelihood knows its scores and Fisher information. A `GroupedLogLikelihood`
also integrates over one draw of the parameters for each group of rows.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.contracts.family import Family
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.array_api import constant, is_tensor
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array, check_shape, float_array

if TYPE_CHECKING:
    from dropo.core.contracts.estimator import Run
    from dropo.core.contracts.problem import Problem
    from dropo.core.contracts.support.maximize import SearchResult


AUTOMATIC = "auto"
"""In the place of a likelihood's name: "trajectory" where the data ask for it, else "emulated"."""


class LogLikelihood(ABC):
    """The log-likelihood of phi: the sum of the log densities of the R compared rows.

    A plug-in writes `_rows`, `epsilon` and `mean`.

    Attributes
    ----------
    unknowns : ParameterSpace
        The box of phi (m,): the family's unknowns, then the likelihood's own.
    has_gradients : bool
        Whether `gradient` can be called.
    simulator : Simulator or None
        What predicts the segments, where it is known.
    whitened : (R, p) array or None
        Residuals in units of their covariance at the point where it was built, where it has such.
    unexplained : tuple of (R, p) and (R, p, d) array, or None
        What is new in the residuals of each row, with its Jacobian, where noise has a memory.
    """

    unknowns: ParameterSpace
    has_gradients = False
    simulator: Simulator | None = None
    whitened: Array | None = None
    unexplained: tuple[Array, Array] | None = None

    def __call__(self, phi: ArrayLike) -> float:
        """Evaluate log L(phi), the sum over all rows.

        Parameters
        ----------
        phi : (m,) array_like
            A member of the family and the likelihood's own unknowns, array or torch tensor.

        Returns
        -------
        float
            In nats; -inf where a simulation failed; a tensor of shape () for a tensor.

        Raises
        ------
        BadArgument
            If phi has another shape or is not finite.

        References
        ----------
        Tiboni (2021), eq. 5.6.
        """
        rows = self.rows(phi)
        if is_tensor(rows):
            return rows.sum()
        return float(rows.sum()) if np.isfinite(rows).all() else -np.inf

    def rows(self, phi: ArrayLike) -> Array:
        """Evaluate the log density of each compared row.

        Parameters
        ----------
        phi : (m,) array_like
            As of `__call__`.

        Returns
        -------
        (R,) array
            In nats; -inf where one of the row's simulations failed. A torch tensor phi gives a
            tensor, with its autograd history, where likelihood and family are of closed form in
            phi.

        Raises
        ------
        BadArgument
            If phi has another shape or is not finite.
        """
        if not is_tensor(phi):
            return self._rows(float_array("phi", phi, (len(self.unknowns),), type(self).__name__))
        tensor = constant(phi, phi)
        check_shape("phi", tensor, (len(self.unknowns),), type(self).__name__)
        return self._rows(tensor)

    def gradient(self, phi: ArrayLike) -> Array:
        """Differentiate log L by phi, where `has_gradients`.

        Parameters
        ----------
        phi : (m,) array_like
            As of `__call__`.

        Returns
        -------
        (m,) array
            d log L / d phi.

        Raises
        ------
        Incompatible
            If the likelihood or its simulator gives no gradients.
        """
        raise Incompatible(
            f"{type(self).__name__} gives no gradients. Use an optimizer without, such as "
            "'cma-es' or 'nlopt-sbplx'."
        )

    @abstractmethod
    def _rows(self, phi: Array) -> Array:
        """The log densities (R,) at a checked phi (m,), arrays or tensors."""

    @abstractmethod
    def epsilon(self, phi: Array) -> Array:
        """Give the noise variance of each signal.

        Parameters
        ----------
        phi : (m,) array
            As of `__call__`.

        Returns
        -------
        (p,) array
            In squared signal units; the part of `phi` that says it, where noise is fitted.
        """

    @abstractmethod
    def mean(self, phi: Array) -> Array:
        """Predict the compared rows' mean, of which the mean squared error is taken.

        Parameters
        ----------
        phi : (m,) array
            As of `__call__`.

        Returns
        -------
        (R, p) array
            In the signals' units.
        """

    def moments(self, phi: Array) -> tuple[Array, Array] | None:
        """Give the moments of the rows, where they are normal.

        Parameters
        ----------
        phi : (m,) array
            The unknowns.

        Returns
        -------
        tuple or None
            Mean (R, p) and covariance (R, p, p) of the rows; None of another distribution.
        """
        return None

    def whitened_residuals(self, phi: Array) -> Array | None:
        """Give the residuals without their covariance, where the rows are normal.

        Parameters
        ----------
        phi : (m,) array
            The unknowns.

        Returns
        -------
        (R, p) array or None
            In units of the rows' covariance; None of another distribution.
        """
        return None


class Likelihood(ABC):
    """The settings of a likelihood; a plug-in is a frozen dataclass that writes `bind`."""

    @abstractmethod
    def bind(
        self,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        rng: np.random.Generator,
    ) -> LogLikelihood:
        """Make the log-likelihood of given segments, a function of phi.

        Parameters
        ----------
        simulator : Simulator
            Predicts the segments.
        segments : Segments
            What was measured.
        family : Family
            The distributions over the simulator's parameters.
        epsilon : float, (p,) array or Noise
            Noise variance, one or each signal's [signal unit^2]; a `Noise` says more about it.
        rng : numpy.random.Generator
            For base points that stay fixed.

        Returns
        -------
        LogLikelihood
        """


class LocalLogLikelihood(LogLikelihood):
    """A log-likelihood that holds near the point where it was built.

    Its `unknowns` are bounded by that region.

    Attributes
    ----------
    errors_from_model : bool
        Whether its information is that of all that is unknown, noise with a memory too, so that
        standard errors below those of the information are chance.
    """

    errors_from_model = False

    @abstractmethod
    def value_score_information(self, phi: Array) -> tuple[float, Array, Array]:
        """Evaluate the log-likelihood, its scores and its Fisher information.

        Parameters
        ----------
        phi : (m,) array
            As of `__call__`.

        Returns
        -------
        value : float
            In nats.
        scores : (R, m) array
            Score of each row; (G, m), one for each group, where rows of a group share draws.
        information : (m, m) array
            Fisher information.
        """

    @abstractmethod
    def predict(self, values: Array) -> Array:
        """Predict all rows by the local model, without a simulation.

        Parameters
        ----------
        values : (K, d) array
            Parameter vectors, in the parameters' units.

        Returns
        -------
        (K, R, p) array
            In the coordinates of the simulator's `predict`.
        """

    def predict_rows(self, values: Array, rows: slice | Ints) -> Array:
        """Predict some of the rows.

        Parameters
        ----------
        values : (K, d) array
            Parameter vectors.
        rows : slice or (r,) array of int
            Which of the R rows.

        Returns
        -------
        (K, r, p) array
            Of `predict`, unless overridden by what computes these rows alone.
        """
        return self.predict(values)[:, rows]

    def curvature_factor(self, phi: Array) -> float:
        """Return how much the residuals bend the likelihood in the means, over its information.

        Parameters
        ----------
        phi : (m,) array
            As of `__call__`.

        Returns
        -------
        float
            1 of Gaussian rows, whatever their residuals are.
        """
        return 1.0

    def weighed(self, phi: Array, rows: Ints, values: Array) -> Array:
        """Bring numbers of some rows to units of the noise, as the likelihood weighs residuals.

        Parameters
        ----------
        phi : (m,) array
            As of `__call__`.
        rows : (r,) array of int
            Which of the R rows.
        values : (r, p, k) array
            k numbers of each signal, such as slopes, in the signals' units.

        Returns
        -------
        (r, p, k) array
            Here divided by the noise's standard deviations.
        """
        sd = np.sqrt(np.maximum(self.epsilon(phi), 1e-300))
        return np.asarray(values / sd[:, None])

    def anchored(self, value: Array, predictions: Array) -> "LocalLogLikelihood":
        """Make the same likelihood with a local model that is right at one parameter vector.

        Parameters
        ----------
        value : (d,) array
            The parameter vector.
        predictions : (R, p) array
            The simulator's there.

        Returns
        -------
        LocalLogLikelihood
            Itself, of a local model that cannot be shifted.
        """
        return self

    def scores_of_noisy_starts(
        self, phi: Array, simulator: Simulator, segments: Segments, step: Array
    ) -> Array | None:
        """Find what noise of the start states takes from the scores of the means.

        Slopes at measured starts carry the starts' noise, and so do the residuals, in expectation
        with a product that is not 0.

        Parameters
        ----------
        phi : (m,) array
            The unknowns.
        simulator : Simulator
        segments : Segments
            With R compared rows.
        step : (d,) array
            Of the parameters, over which slopes are compared.

        Returns
        -------
        (R, d) array or None
            To be added to the rows' scores; None where starts carry no noise, or it is not known.
        """
        return None

    def scores_of_states(self, phi: Array, scores: Array, segments: Segments) -> Array:
        """Sort scores by the measured state whose noise is in them, where one row starts from the
        end of another: rows that share noise all but cancel, states are as independent as noise.

        Parameters
        ----------
        phi : (m,) array
            The unknowns.
        scores : (R, m) array
            Of `value_score_information`.
        segments : Segments
            With R compared rows.

        Returns
        -------
        (R, m) array
            With the same sum; the scores themselves where starts carry no noise.
        """
        return scores


class LocalLikelihood(Likelihood):
    """A likelihood with a local model of the simulator.

    An estimator builds it anew around the maximum that it finds. A plug-in writes `linearize_at`.
    """

    @abstractmethod
    def linearize_at(
        self,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        centre: Array,
        width: Array,
        rng: np.random.Generator,
        *,
        rough: bool = False,
    ) -> LocalLogLikelihood:
        """Make the log-likelihood of members of the family near a point.

        Parameters
        ----------
        simulator, segments, family, epsilon, rng
            As of `bind`.
        centre : (d,) array
            Means of the members are near it, in the parameters' units.
        width : (d,) array
            Scales of the members are at most about this large, in the parameters' units.
        rough : bool
            Whether a cheaper and coarser model will do.

        Returns
        -------
        LocalLogLikelihood
        """

    def bind(
        self,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        rng: np.random.Generator,
    ) -> LocalLogLikelihood:
        """Make the log-likelihood around the middle of the search box, a sixth of it wide."""
        space = simulator.space
        centre = (space.low + space.high) / 2
        width = (space.high - space.low) / 6
        return self.linearize_at(simulator, segments, family, epsilon, centre, width, rng)


@dataclass(frozen=True, eq=False)
class WholeRunsFit:
    """What a likelihood of whole runs found.

    Attributes
    ----------
    problem : Problem
        The runs from the start states that were found: its segments are the rows of `objective`.
    objective : LocalLogLikelihood
        The log-likelihood around its maximum.
    found : SearchResult
        The maximum, and how the search ended.
    epsilon : (p,) array
        Noise variance of each signal of the problem that was given [signal unit^2].
    details : dict
        For fit.json: the noise of each signal, the runs and their pieces.
    warnings : tuple of str
        What says that the model is wrong, a sentence each.
    reached : bool
        Whether the search came so close to the measurements that errors mean anything.
    """

    problem: "Problem"
    objective: LocalLogLikelihood
    found: "SearchResult"
    epsilon: Array
    details: dict[str, Any]
    warnings: tuple[str, ...] = ()
    reached: bool = True


class RunLikelihood(Likelihood):
    """A likelihood of whole runs, whose start states are unknowns that it finds itself.

    It searches parameters and starts together, and so needs no optimizer. A plug-in writes
    `fit_runs` and `bind`.
    """

    @abstractmethod
    def fit_runs(
        self, problem: "Problem", run: "Run", family: Family, noise: Epsilon, mean: Array
    ) -> WholeRunsFit:
        """Find its maximum.

        Parameters
        ----------
        problem : Problem
            Rows that follow each other.
        run : Run
            Records and counts the simulations.
        family : Family
            The distributions over the simulator's parameters.
        noise : float, (p,) array or Noise
            Noise variance of each signal; where it is learned, its memory and tails are too.
        mean : (d,) array
            Where the search begins, in the parameters' units.

        Returns
        -------
        WholeRunsFit

        Raises
        ------
        Incompatible
            If the data hold no runs, or the noise is of a kind that it does not know.
        SimulationFailed
            If simulations diverge wherever the search begins.
        """


@dataclass(frozen=True, eq=False)
class Groups:
    """What the data say of each of G groups of rows.

    Attributes
    ----------
    label : (G,) int array
        The group's number in the data.
    rows : (G,) int array
        How many compared rows it has.
    mean : (G, d) array
        The mode of its parameters under the population, in their units.
    precision : (G, d, d) array
        The information that its own rows have on its parameters.
    score : (G, d) array
        The slope of its own rows' log-likelihood at the population's mean, by its parameters.
    """

    label: Ints
    rows: Ints
    mean: Array
    precision: Array
    score: Array

    def __len__(self) -> int:
        return len(self.label)


class GroupedLogLikelihood(LocalLogLikelihood):
    """A log-likelihood whose rows are G independent groups.

    Each group has one draw of the parameters, which is integrated out.
    """

    @abstractmethod
    def groups(self, phi: Array) -> Groups:
        """Estimate the parameters of each group, under the population that `phi` names.

        Parameters
        ----------
        phi : (m,) array
            As of `__call__`.

        Returns
        -------
        Groups
            The G groups, each with the mode and the precision of its own draw.
        """

    @abstractmethod
    def mode_errors(self, phi: Array) -> Array:
        """Tell how far each group's mode is from the simulator's own.

        Parameters
        ----------
        phi : (m,) array
            As of `__call__`.

        Returns
        -------
        (G,) array
            The step to which a simulation of every group at its mode leads, in standard deviations
            of the group's parameters; infinite where the simulation fails, or where the mode is
            outside the region in which the local model holds.
        """

    @abstractmethod
    def with_own_models(
        self, phi: Array, which: NDArray[np.bool_], rng: np.random.Generator
    ) -> "GroupedLogLikelihood":
        """Make the same likelihood with local models of some groups around their own modes.

        Parameters
        ----------
        phi : (m,) array
            As of `__call__`.
        which : (G,) array of bool
            The groups; those whose simulations fail keep the model that they have.
        rng : numpy.random.Generator
            For the designs.

        Returns
        -------
        GroupedLogLikelihood
        """
