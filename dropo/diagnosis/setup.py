"""What a diagnosis works on, and what its search ends with."""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dropo.core.contracts.effect import ActiveEffects, EffectInstance
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import BadArgument
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.validation import Array, known
from dropo.data.outliers.without_disturbances import WithoutDisturbances
from dropo.diagnosis.far_off.search import Explained
from dropo.diagnosis.findings.premises.still import Held
from dropo.diagnosis.findings.remains.unexplained_forces import without_impulses
from dropo.diagnosis.laws.discovery import WithLaws
from dropo.diagnosis.parts import Leader
from dropo.diagnosis.search.arithmetic import Arithmetic
from dropo.diagnosis.search.bounds import at_bounds
from dropo.diagnosis.search.library import plugin_effects, robot_of
from dropo.diagnosis.search.linearization import Library, shift_linearization
from dropo.diagnosis.search.review import Review
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.trials import State
from dropo.diagnosis.search.whitening import WindowNoise, white
from dropo.diagnosis.search.window_length import first_noise
from dropo.diagnosis.search.windows import Windows, spread_of


def nominal_of(library: Library) -> Array:
    """Return the parameters of a library's model as it is.

    Parameters
    ----------
    library : Library
        The simulator with every effect.

    Returns
    -------
    (m,) array
        The declared parameters as the model has them, within their bounds, and no effects.
    """
    space = library.simulator.space
    nominal = np.asarray(library.simulator.nominal, dtype=float)
    return space.clip(nominal)


def free_parameters(problem: Problem, parameters: Sequence[str] | None) -> Ints:
    """Return the indices of the declared parameters that are fitted.

    Parameters
    ----------
    problem : Problem
        Whose parameters they are; its settings may name some.
    parameters : sequence of str or None
        Names of some; those of the settings, or all, if None.

    Returns
    -------
    int array

    Raises
    ------
    UnknownName
        If a parameter does not exist.
    """
    names = problem.space.names
    wanted: Any = parameters
    if wanted is None:
        wanted = problem.settings.get("parameters", names)
    chosen = [known("parameter", str(name), names) for name in wanted]
    return np.array([names.index(name) for name in chosen], dtype=np.int64)


def extended_problem(problem: Problem, library: Library, last: State) -> Problem:
    """Return a problem whose simulator has what was found.

    Parameters
    ----------
    problem : Problem
        Of the model without it.
    library : Library
        The simulator with every effect.
    last : State
        What a search ended with.

    Returns
    -------
    Problem
    """
    indices_of = library.indices_of
    labels = {instance.label for instance in last.accepted}
    # In the library's order: what changes one body in two ways acts as it did in the search.
    accepted = [instance for instance in library.instances if instance.label in labels]
    found = [(instance, last.theta[indices_of[instance.label]]) for instance in accepted]
    return replace(problem, simulator=robot_of(problem).with_effects((), found))


def refuse_constant(problem: Problem, train: Windows) -> None:
    """Refuse signals that never change: they have no scale on which errors could be evaluated.

    Parameters
    ----------
    problem : Problem
        Whose signals they are.
    train : Windows
        To be fitted.

    Raises
    ------
    BadArgument
        If a signal is the same in all of them.
    """
    spread = spread_of(problem.simulator, train)
    for signal, size in zip(problem.simulator.signals, spread, strict=True):
        if not size > 0:
            raise BadArgument(
                f"The signal {signal.name!r} is the same in all the data: a stuck sensor? Leave "
                "it out of the observation."
            )


@dataclass(frozen=True, eq=False)
class DiagnosisTask:
    """What is to be diagnosed.

    Attributes
    ----------
    came : Problem
        With the model as it came.
    problem : Problem
        With all data, and the steps that the model has by now.
    rng : numpy.random.Generator
        For what is drawn.
    log : EvaluationLog
        What was simulated, for a run that goes on after an interruption.
    wiring : tuple of str
        What does not fit in signs, units and names of commands, a sentence each.
    held : Held or None
        The joints that never move.
    undisturbed : WithoutDisturbances or None
        What is left of the problem where disturbances were found.
    before : State or None
        The model by which they were found.
    spent : int
        Simulator steps so far.
    exact : bool
        Whether the problem's model has more exact steps already than it came with.
    known : sequence of (EffectInstance, (q,) array)
        What regression is certain of.
    """

    came: Problem
    problem: Problem
    rng: np.random.Generator
    log: EvaluationLog
    wiring: tuple[str, ...] = ()
    held: Held | None = None
    undisturbed: WithoutDisturbances | None = None
    before: State | None = None
    spent: int = 0
    exact: bool = False
    known: ActiveEffects = ()

    @property
    def data(self) -> Problem:
        """The problem, or what is left of it."""
        return self.problem if self.undisturbed is None else self.undisturbed.problem


@dataclass(frozen=True, eq=False)
class SearchSetup:
    """What a search works on.

    Attributes
    ----------
    problem : Problem
        Its data, and the model that is extended.
    explained : Explained or None
        What the model lacks, where it is far off.
    library : Library
        The simulator with every effect.
    selection : Selection
        The search.
    train, test : Windows
        To be fitted, and held out.
    free : (d,) int array
        The declared parameters that are fitted.
    count : int
        How many effects are looked for.
    wiring : tuple of str
        What does not fit in signs, units and names of commands, a sentence each.
    noise : WindowNoise or None
        The first guess where it is coloured.
    refused : mapping of str to str
        By their labels, effects that are no causes, with why, a sentence each.
    exact : bool
        Whether it has more exact steps than the model, which no others are then tried beside.
    steps_chosen : bool
        Whether it is decided in which steps the search begins.
    tried : Arithmetic or None
        Other steps in which a search was made already ...
    to_beat : float
        ... and how likely the model is that it ended with: others that are better than the model's
        own are searched in only if they are better than that, too [nats].
    begun : tuple of State or None
        The model as it is, and the one that a search begins with, where they were made already.
    worse : mapping of str to Leader
        By their labels, effects with which errors after some horizon are larger.
    compared : bool
        Whether sets of effects were compared, and a better one was found.
    sought : bool
        Whether laws were looked for in vain beyond what windows show.
    known : sequence of (EffectInstance, (q,) array)
        What regression is certain of: the search begins with it, if windows confirm it.
    shortened : bool
        Whether physics steps were made shorter beside all that was found.
    scaled : bool
        Whether masses and gains were brought back to what is known of them.
    """

    problem: Problem
    explained: Explained | None
    library: Library
    selection: Selection
    train: Windows
    test: Windows
    free: Ints
    count: int
    wiring: tuple[str, ...]
    noise: WindowNoise | None = None
    refused: Mapping[str, str] = field(default_factory=dict)
    exact: bool = False
    steps_chosen: bool = False
    tried: Arithmetic | None = None
    to_beat: float = -np.inf
    begun: tuple[State, State] | None = None
    worse: Mapping[str, Leader] = field(default_factory=dict)
    compared: bool = False
    sought: bool = False
    known: ActiveEffects = ()
    shortened: bool = False
    scaled: bool = False

    @property
    def instances(self) -> list[EffectInstance]:
        """The effects that may be accepted."""
        everything = without_impulses(self.library.instances)
        out = {*self.refused, *self.worse}
        return [instance for instance in everything if instance.label not in out]

    def first(self) -> State:
        """Fit the declared parameters and the noise of the model as it is.

        Returns
        -------
        State
        """
        theta = nominal_of(self.library)
        noise = self._first_noise(theta)
        return self.selection.begin(self.train, self.test, theta, noise, self.free)

    def evaluated(self) -> tuple[State, State, dict[str, Review]]:
        """Evaluate the model that explains whole motions; nothing is fitted but the noise.

        Returns
        -------
        first, last : State
            The model as it came, and the one that explains them.
        reviews : dict of str to Review
            By the labels of its effects, what it is without each.
        """
        if self.explained is None:
            raise AssertionError("only a model that is far off is explained by whole motions")
        accepted = tuple(instance for instance, _ in self.explained.model.numbers)
        free = self.explained.model.fitted
        first = self._without_fitting(nominal_of(self.library), self.free, ())
        last = self._without_fitting(self.padded(self.explained.model.theta), free, accepted)
        noise = last.train.whiten.noise
        reviews = {}
        for label, theta in self.explained.without.items():
            whole = self.padded(theta)
            kept = tuple(instance for instance in accepted if instance.label != label)
            without = State(
                shift_linearization(self.library, last.train, whole, noise),
                shift_linearization(self.library, last.test, whole, noise),
                free[~np.isin(free, self.library.indices_of[label])],
                kept,
            )
            others = tuple(self.explained.alike.get(label, ()))
            reviews[label] = Review(without, None, (), others=others)
        return first, last, reviews

    def certain(self, last: State) -> Set[str]:
        """Return the labels of a model's effects that are distinguished from nothing.

        Parameters
        ----------
        last : State
            The model.

        Returns
        -------
        set of str
        """
        labels = {instance.label for instance in last.accepted}
        return labels if self.explained is None else labels & self.explained.certain

    def warnings_of(self, last: State) -> tuple[str, ...]:
        """Return what makes the answer doubtful, a sentence each.

        Parameters
        ----------
        last : State
            What the search ended with.

        Returns
        -------
        tuple of str
        """
        if self.explained is not None:
            return (*self.wiring, *self.explained.warnings, *_not_looked_for(self.problem))
        return (*self.wiring, *at_bounds(self.library, last.theta, last.free, last.accepted))

    @property
    def ties(self) -> tuple[str, ...]:
        """What whole motions tell only together, a sentence each."""
        return () if self.explained is None else self.explained.ties

    def spent(self, task: DiagnosisTask) -> int:
        """Return the simulator steps of a diagnosis so far.

        Parameters
        ----------
        task : DiagnosisTask
            What this is the setup of.

        Returns
        -------
        int
        """
        in_motions = 0 if self.explained is None else self.explained.simulator_steps
        return task.spent + in_motions + self.library.simulator.steps

    def errors(self) -> Array | None:
        """Return the standard errors of all numbers, where whole motions say how large they are.

        Returns
        -------
        (m,) array or None
        """
        return None if self.explained is None else self.padded(self.explained.errors)

    def _without_fitting(
        self, theta: Array, free: Ints, accepted: tuple[EffectInstance, ...]
    ) -> State:
        """A model with its noise estimated."""
        noise = self._first_noise(theta)
        return self.selection.without_fitting(self.train, self.test, theta, noise, free, accepted)

    def _first_noise(self, theta: Array) -> WindowNoise:
        """The noise guessed from single steps, unless it is known to be coloured."""
        if self.noise is not None:
            return self.noise
        floor = self.selection.floor
        return white(first_noise(self.problem, self.library, self.train, theta, floor))

    def padded(self, values: Array) -> Array:
        """Append 0 for all impulses to values of the declared parameters and of effects.

        Parameters
        ----------
        values : array
            m of them at most.

        Returns
        -------
        (m,) array
        """
        out = np.zeros(len(self.library.simulator.space))
        out[: len(values)] = values
        return out


def _not_looked_for(problem: Problem) -> list[str]:
    """That effects of plug-ins, which the robot could have, are unknown to whole motions."""
    unknown = plugin_effects(robot_of(problem))
    if not unknown:
        return []
    return [
        "The model is far off, and whole motions were fitted: effects of plug-ins were not looked"
        f" for: {', '.join(unknown)}. Diagnose the extended problem, or name them with --effects."
    ]


@dataclass(frozen=True, eq=False)
class SearchedEffects:
    """What a search ends with.

    Attributes
    ----------
    first, last : State
        The model as it is, and the one that explains the data.
    reviews : mapping of str to Review
        By the labels of its effects, what it is without each.
    interrupted : bool
        Whether it was interrupted before its end.
    laws : WithLaws or None
        The laws that were found.
    """

    first: State
    last: State
    reviews: Mapping[str, Review]
    interrupted: bool = False
    laws: WithLaws | None = None
