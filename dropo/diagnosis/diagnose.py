"""Data and a model in; what the model gets wrong, and why, out."""

import time
from collections.abc import Callable, Collection, Mapping, Sequence, Set
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.estimator import Progress, silent, with_cost
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import BadArgument
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.tables import number, steps_text
from dropo.core.services.validation import Array, known, require
from dropo.data.outliers.without_disturbances import WithoutDisturbances, without_disturbances
from dropo.diagnosis.far_off.search import Explained, FarOffSearch, FarOffSettings
from dropo.diagnosis.far_off.start import FarOffLimits, FarOffStart, start_of
from dropo.diagnosis.findings.accuracy.every_horizon import (
    Beyond,
    EveryHorizonSettings,
    beyond_noise,
    in_words,
    worse_after,
)
from dropo.diagnosis.findings.accuracy.horizons import (
    AfterHorizon,
    after_horizons,
    errors_after,
    horizons,
    signal_noise,
    with_numbers,
)
from dropo.diagnosis.findings.accuracy.motion import motion
from dropo.diagnosis.findings.accuracy.replay import WholeRunReplay, replay
from dropo.diagnosis.findings.causes import SETTINGS as CAUSES
from dropo.diagnosis.findings.causes import causes, covariance_of, leaders, suspects
from dropo.diagnosis.findings.figures import figure_data
from dropo.diagnosis.findings.limits.detectable import Detectable, DetectableSettings, detectable
from dropo.diagnosis.findings.limits.not_identifiable import undetermined
from dropo.diagnosis.findings.premises.miswired import miswired
from dropo.diagnosis.findings.premises.numerics import numerics, refused_delay, short_delay
from dropo.diagnosis.findings.premises.still import Held, hold_still
from dropo.diagnosis.findings.remains.disturbances import left_out, outlier_runs
from dropo.diagnosis.findings.remains.remaining import are_measured, remaining
from dropo.diagnosis.findings.remains.unexplained_forces import (
    Unexplained,
    impulses,
    without_impulses,
)
from dropo.diagnosis.findings.stability import stability
from dropo.diagnosis.findings.to_type import to_type
from dropo.diagnosis.laws.discovery import LawSettings, WithLaws, find_laws
from dropo.diagnosis.parts import Cause, Leader, Remaining
from dropo.diagnosis.regression.quick import QuickSettings
from dropo.diagnosis.regression.wiring import Wiring, WiringSettings, wiring_of
from dropo.diagnosis.result import Diagnosis, HeldOut
from dropo.diagnosis.search.aliases import beside_the_rest
from dropo.diagnosis.search.arithmetic import Arithmetic, ArithmeticAlternatives
from dropo.diagnosis.search.bounds import at_bounds
from dropo.diagnosis.search.confirmation import SelectionSettings, gain_of
from dropo.diagnosis.search.invariance import invariance
from dropo.diagnosis.search.library import LAW, instances_for, robot_of
from dropo.diagnosis.search.linearization import Library, shift_linearization
from dropo.diagnosis.search.refit import other_noise
from dropo.diagnosis.search.review import Review, merge, review, reviews_so_far
from dropo.diagnosis.search.selection import STOPPING, Selection
from dropo.diagnosis.search.sets import SetSearch, SetSettings
from dropo.diagnosis.search.trials import Batch, State
from dropo.diagnosis.search.whitening import WhitenessSettings, WindowNoise, white
from dropo.diagnosis.search.window_length import (
    WindowLengthSettings,
    choose_length,
    first_noise,
    noise_floor,
)
from dropo.diagnosis.search.windows import Windows, split, spread_of
from dropo.evaluation.held_out import SETTINGS as HELD_OUT
from dropo.evaluation.held_out import HeldOutSettings
from dropo.mjmodel.options import physics_step

EACH = HeldOutSettings(maximum=120, maximum_steps=1200, minimum=10)
"""A quarter of the usual windows."""


@dataclass(frozen=True)
class DiagnosisSettings:
    """Numbers that decide in a diagnosis.

    Attributes
    ----------
    windows : int
        About how many windows are fitted, and how many are held out, unless something else is
        asked for.
    selection : SelectionSettings
        When an effect is accepted.
    window_length : WindowLengthSettings
        How the windows' horizon is chosen.
    noise : WhitenessSettings
        When the sensors' noise is not taken to be white.
    horizons : EveryHorizonSettings
        When errors after a horizon that is printed speak against an effect, or the verdict.
    detectable : DetectableSettings
        How it is found what the data of a consistent model would have shown.
    sets : SetSettings
        Which sets of effects are compared where something remains ...
    sure_effects : int
        ... or where more than this many effects are found.
    laws : LawSettings
        How laws are looked for in what known effects leave unexplained.
    wiring : WiringSettings or None
        When signs, units and places of columns are wrong: that is the finding then, and nothing
        else is looked for. Never if None.
    far_off : FarOffLimits or None
        From when on the search is that for models that are far off; never if None.
    regression : QuickSettings
        How they are found.
    motions : FarOffSettings
        How they are fitted to whole motions.
    longest : int
        Control steps at most of the windows by which such a model is evaluated ...
    evaluated : int
        ... and about how many there are on each side ...
    exactly : int
        ... or, where more exact physics steps are taken, which cost several times as much.
    each : HeldOutSettings
        The windows that say whether such a model predicts as well without one of its many effects.
    """

    windows: int = 96
    wiring: WiringSettings | None = field(default_factory=WiringSettings)
    far_off: FarOffLimits | None = field(default_factory=FarOffLimits)
    regression: QuickSettings = field(default_factory=QuickSettings)
    motions: FarOffSettings = field(default_factory=FarOffSettings)
    longest: int = 50
    evaluated: int = 48
    exactly: int = 24
    each: HeldOutSettings = field(default_factory=lambda: EACH)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    window_length: WindowLengthSettings = field(default_factory=WindowLengthSettings)
    noise: WhitenessSettings = field(default_factory=WhitenessSettings)
    horizons: EveryHorizonSettings = field(default_factory=EveryHorizonSettings)
    detectable: DetectableSettings = field(default_factory=DetectableSettings)
    sets: SetSettings = field(default_factory=SetSettings)
    sure_effects: int = 2
    laws: LawSettings = field(default_factory=LawSettings)


@dataclass(frozen=True)
class Diagnose:
    """A diagnosis of what a problem's simulator gets wrong.

    Attributes
    ----------
    effects : sequence of str, optional
        Names of effects to look for, or "effect:place"; all if None.
    length : int, optional
        Control steps in a window. If None, the problem's horizon decides, else the data
        (`choose_length`).
    windows : int, optional
        About how many windows are fitted, and how many are held out. If None, the problem's
        settings decide, else 96.
    parameters : sequence of str, optional
        The declared parameters that are fitted at the same time; the others stay as the model has
        them. If None, the problem's settings decide, else all are fitted.
    disturbances : bool
        Whether spans of time in which something else acts are looked for once the causes are known.
        They are listed and left out, and the rest is diagnosed anew. Not where the model is far
        off: whole motions are fitted robustly there.
    settings : DiagnosisSettings
        Numbers that decide.
    """

    effects: Sequence[str] | None = None
    _: KW_ONLY
    length: int | None = None
    windows: int | None = None
    parameters: Sequence[str] | None = None
    disturbances: bool = True
    settings: DiagnosisSettings = field(default_factory=DiagnosisSettings)

    def run(
        self,
        problem: Problem,
        *,
        rng: np.random.Generator | int | None = 0,
        evaluation_log: EvaluationLog | None = None,
        progress: Progress = silent,
    ) -> Diagnosis:
        """Find what the problem's simulator gets wrong, evaluated on data that nothing was fitted
        to.

        Parameters
        ----------
        problem : Problem
            Measured data and a MuJoCo model.
        rng : numpy.random.Generator, int or None
            A generator or a seed.
        evaluation_log : EvaluationLog, optional
            Where fits are recorded, for a diagnosis that can be resumed.
        progress : callable
            Called with the fraction that is done (0 to 1) and a text.

        Returns
        -------
        Diagnosis
            What was found so far, if the search is interrupted by Ctrl-C.

        Raises
        ------
        Incompatible
            If the simulator has no MuJoCo model.
        UnknownName
            If an effect, a place or a parameter does not exist.
        BadArgument
            If the problem is none, the length is below 1, the data are too few, or a signal never
            changes.
        SimulationFailed
            If the simulation diverges in too many windows.
        """
        expected = "a Problem, which dropo.load makes of a name or a file"
        require(isinstance(problem, Problem), "problem", expected, problem, "diagnose")
        long_enough = self.length is None or self.length >= 1
        require(long_enough, "length", "at least 1", self.length, "Diagnose")
        begun = time.perf_counter()
        seed = int(rng) if isinstance(rng, int | np.integer) else None
        # The simulator's threads use the cores; products of small matrices gain nothing from more.
        with threadpool_limits(1, user_api="blas"):
            log = evaluation_log or EvaluationLog()
            wiring = self._wiring(problem, progress)
            if wiring.faults and all(fault.evidence for fault in wiring.faults):
                found = miswired(problem, wiring)
            else:
                doubts = tuple(fault.text for fault in wiring.faults)
                held = hold_still(problem)
                data = problem if held is None else held.problem
                task = _Task(data, data, np.random.default_rng(rng), log, doubts, held)
                found = self._run(task, progress)
                if held is not None:
                    found = held.restored(found, self._untold(held))
        return replace(found, wall_time_s=time.perf_counter() - begun, seed=seed)

    def _wiring(self, problem: Problem, progress: Progress) -> Wiring:
        """How the columns of the data are to be read, where that is asked for."""
        if self.settings.wiring is None:
            return Wiring(())
        progress(0.0, "signs, units and places of the data's columns")
        return wiring_of(problem, self.settings.wiring)

    def _untold(self, held: Held) -> list[EffectInstance]:
        """The effects that would be looked for at joints that never move."""
        free = _free(held.problem, self.parameters)
        instances = instances_for(held.problem, self.effects, free)
        return [instance for instance in instances if held.at(instance)]

    def baseline(self, problem: Problem) -> float:
        """Evaluate the model as it is, its declared parameters fitted; `run` starts there.

        Parameters
        ----------
        problem : Problem
            Measured data and a model.

        Returns
        -------
        float
            Log-likelihood of the windows held out [nats per transition].

        Raises
        ------
        BadArgument
            If the data are too few.
        UnknownName
            If a parameter does not exist.
        SimulationFailed
            If the simulation diverges in too many windows.
        """
        length = self._length(problem)
        train, test = split(problem, length, self._windows(problem))
        library = Library(problem.simulator, (), len(problem.space))
        selection = self._selection(library, train, problem.estimated)
        free = _free(problem, self.parameters)
        setup = _Setup(problem, None, library, selection, train, test, free, 0, ())
        return per_step(setup.first())

    def _windows(self, problem: Problem) -> int:
        """About how many windows each side has."""
        if self.windows is not None:
            return int(self.windows)
        stated: Any = problem.settings.get("windows", self.settings.windows)
        return int(stated)

    def _start(self, task: "_Task", progress: Progress) -> FarOffStart | None:
        """What a model may lack that is far off, where effects need not be named."""
        settings = self.settings
        if self.effects is not None or settings.far_off is None or task.wiring:
            return None
        progress(0.0, "regression over inverse dynamics")
        free = _free(task.data, self.parameters)
        return start_of(task.data, free, settings.far_off, settings.regression)

    def _explained(
        self, start: FarOffStart, progress: Progress, log: EvaluationLog
    ) -> tuple[Explained | None, int]:
        """What a model lacks that is far off, where whole motions bear that out, and the simulator
        steps of a search that was in vain.
        """
        explained = FarOffSearch(self.settings.motions, progress, log).run(start.model, start.whole)
        # Without an effect that is certain, motions do not bear out the regression.
        certain = explained.certain & {instance.label for instance, _ in explained.model.numbers}
        if explained.interrupted or (certain and (start.sure or explained.fits)):
            return explained, 0
        return None, explained.simulator_steps

    def _length(self, problem: Problem, explained: Explained | None = None) -> int:
        """Control steps in a window."""
        if self.length is not None:
            return self.length
        if explained is not None:
            length = min(explained.length, self.settings.longest)
            while length > 1 and not self._can_diagnose(problem, length):
                length //= 2
            return length
        return choose_length(problem, self.settings.window_length)

    def _selection(
        self,
        library: Library,
        train: Windows,
        estimated: Collection[str] = (),
        progress: Progress = silent,
        log: EvaluationLog | None = None,
    ) -> Selection:
        """A search that has not begun."""
        settings = self.settings.window_length
        floor = noise_floor(library.simulator, train, settings, estimated)
        log = log or EvaluationLog()
        return Selection(library, floor, progress, self.settings.selection, log)

    def _set_up(self, task: "_Task", explained: Explained | None, progress: Progress) -> "_Setup":
        """Everything that may be wrong, and the data to find it in."""
        problem, log, wiring = task.data, task.log, task.wiring
        free = _free(problem, self.parameters)
        if explained is None:
            instances = instances_for(problem, self.effects, free)
            if task.held is not None:
                instances = [one for one in instances if not task.held.at(one)]
        else:
            problem = explained.model.problem
            instances = [instance for instance, _ in explained.model.numbers]
        simulator = robot_of(problem)
        length = self._length(problem, explained)
        everything = [*instances, *impulses(simulator.model, length)]
        library = Library(simulator.with_effects(everything), everything, len(problem.space))
        windows = self._windows(problem)
        if explained is not None:
            most = self.settings.evaluated if explained.own_steps else self.settings.exactly
            windows = min(windows, most)
        train, test = split(problem, length, windows)
        _refuse_constant(problem, train)
        estimated = problem.estimated if explained is None else ()
        with_steps = with_cost(progress, library.simulator)
        selection = self._selection(library, train, estimated, with_steps, log)
        count = len(instances)
        return _Setup(problem, explained, library, selection, train, test, free, count, wiring)

    def _run(self, task: "_Task", progress: Progress) -> Diagnosis:
        """The diagnosis of a problem, or of what is left of it without disturbances."""
        start = self._start(task, progress)
        if start is None:
            return self._by_search(task, None, progress)
        if start.sure:
            explained, in_vain = self._explained(start, progress, task.log)
            return self._by_search(replace(task, spent=task.spent + in_vain), explained, progress)
        # A model that may be far off may lack but little: a few causes that explain all go first.
        found = self._plain._run(task, progress)
        if found.interrupted or found.verdict in ("consistent", "explained"):
            return found
        explained, in_vain = self._explained(start, progress, task.log)
        spent = found.simulator_steps
        if explained is None:
            return replace(found, simulator_steps=spent + in_vain)
        if explained.interrupted:
            return replace(found, interrupted=True)
        return self._by_search(replace(task, spent=spent), explained, progress)

    @property
    def _plain(self) -> "Diagnose":
        """The same for a model that is not far off."""
        return replace(self, settings=replace(self.settings, far_off=None))

    def _by_search(
        self, task: "_Task", explained: Explained | None, progress: Progress
    ) -> Diagnosis:
        """The diagnosis by a search for effects, or by whole motions where these explain it."""
        setup = self._set_up(task, explained, progress)
        setup.selection.progress(0.0, "fitting the model as it is")
        setup = _with_noise_left(setup, task.before, self.settings.noise)
        disturbed = partial(self._without_disturbances, task)
        setup, found, undisturbed = _solved(setup, self.settings.noise, disturbed)
        try:
            if undisturbed is not None:
                spent = task.spent + setup.library.simulator.steps
                rest = replace(task, problem=setup.problem, undisturbed=undisturbed, spent=spent)
                return self._run(replace(rest, before=found.last), progress)
            if not found.interrupted:
                return self._result(task, setup, found, progress)
        except KeyboardInterrupt:
            setup.selection.progress(0.9, STOPPING)
            found = replace(found, interrupted=True)
        return self._result(task, setup, found, progress)

    def _without_disturbances(
        self, task: "_Task", setup: "_Setup", found: "_Searched"
    ) -> WithoutDisturbances | None:
        """What is left where disturbances stand out; once the causes are known, they do."""
        if not self.disturbances or setup.explained is not None or task.undisturbed is not None:
            return None
        data = setup.problem
        extended = _extended(data, setup.library, found.last)
        declared = found.last.theta[: len(data.space)]
        left = without_disturbances(data, extended.simulator, declared)
        if left is None or not self._can_diagnose(left.problem, setup.train.length):
            return None
        return left

    def _result(
        self, task: "_Task", setup: "_Setup", searched: "_Searched", progress: Progress
    ) -> Diagnosis:
        """What a search found, in figures; of one that was interrupted, only what is soon found."""
        library, selection, last = setup.library, setup.selection, searched.last
        selection.progress(0.9, "what remains")
        rest, forces = remaining(setup.problem, library, last, selection.floor, task.rng)
        further = self._further(setup, searched, rest, task.rng)
        if further is not None:
            return self._result(task, *further, progress)
        (draws,) = task.rng.spawn(1)
        after, of_each = self._errors_after(setup, searched, draws)
        worse = self._worse(of_each, searched)
        far_off = setup.explained is not None
        if worse and not far_off and len(setup.worse) < self.settings.horizons.refused:
            further = _without_worse(setup, searched, *next(iter(worse.items())))
            return self._result(task, *further, progress)
        if not far_off and not searched.interrupted:
            reviews = beside_the_rest(library, last, searched.reviews)
            searched = replace(searched, reviews=reviews)
        found = self._causes(setup, searched, of_each, worse.keys())
        if far_off and not found and not searched.interrupted:
            # Motions do not bear out what regression finds.
            spent = setup.spent(task)
            return self._plain._run(replace(task, spent=spent), progress)
        return self._reported(
            task, setup, searched, _Findings(found, worse, after, rest, forces, draws)
        )

    def _causes(
        self,
        setup: "_Setup",
        searched: "_Searched",
        after: Sequence[AfterHorizon],
        worse: Collection[str],
    ) -> tuple[Cause, ...]:
        """The effects that were accepted, as causes.

        after: errors of models, those without each effect among them.
        worse: labels of effects with which errors after some horizon are larger.
        """
        library, last, reviews, laws = setup.library, searched.last, searched.reviews, searched.laws
        complete = not searched.interrupted
        whole = after if complete else ()
        tried = setup.count if laws is None else setup.count + laws.tried
        return causes(
            library,
            last,
            reviews,
            tried,
            _errors_without_and_with(setup.problem, library, last, reviews, whole),
            setup.selection.settings,
            CAUSES if complete else replace(CAUSES, experiments=0),
            known=setup.errors(),
            named=setup.certain(last) - set(worse),
            again=partial(stability, setup.selection, partial(self._train, setup.problem))
            if complete
            else None,
            laws={} if laws is None else laws.laws,
        )

    def _reported(
        self, task: "_Task", setup: "_Setup", searched: "_Searched", findings: "_Findings"
    ) -> Diagnosis:
        """The diagnosis, with what figures and tables show."""
        data, library, selection = setup.problem, setup.library, setup.selection
        first, last = searched.first, searched.last
        complete = not searched.interrupted
        far_off = setup.explained is not None
        after, draws = findings.after, findings.draws
        nominal, fitted, with_causes = (tuple(one.models[i] for one in after) for i in range(3))
        disturbances = None
        if task.undisturbed is not None:
            # With disturbances the windows' own horizon alone, on all data held out.
            thetas = [nominal_of(library), first.theta, last.theta]
            own = replace(HELD_OUT, horizons=())
            inside = horizons(task.problem, library, thetas, last, draws, own)
            disturbances = left_out(task.undisturbed, inside)
        rest, beyond = self._after_every_horizon(setup, after, last, findings.rest, draws)
        selection.progress(0.95, "what the pictures show")
        extended = _extended(data, library, last)
        declared = last.theta[: len(data.space)]
        parameters = dict(zip(data.space.names, declared.tolist(), strict=True))
        compared = self.disturbances and not (rest.calibrated or far_off) and complete
        verdict = _verdict(findings.causes, not rest.calibrated)
        return Diagnosis(
            name=data.name,
            verdict=verdict,
            causes=findings.causes,
            suspects=suspects(selection, last, setup.count),
            leaders=_leaders(setup, last, findings.worse),
            baseline=HeldOut(per_step(first), fitted),
            extended=HeldOut(per_step(last), with_causes),
            remaining=rest,
            problem=extended,
            detectable=self._detectable(setup, searched, verdict),
            noise=_noise_by_signal(data, last),
            window_steps=setup.train.length,
            nominal=nominal if len(setup.free) and not far_off else (),
            parameters=parameters,
            undetermined=(*undetermined(library, last), *setup.ties),
            numerics=_numerics(task, setup, searched, findings.causes, rest) if complete else (),
            to_type=to_type(task.came, extended, parameters),
            disturbances=disturbances,
            outlier_runs=outlier_runs(data, extended, declared) if compared else (),
            replay=_replayed(setup, searched) if far_off and complete else None,
            figures=figure_data(
                library, selection, first, last, searched.reviews, findings.forces, setup.count
            ),
            motion=motion(data, library, first, last, fitted, with_causes),
            warnings=(
                *data.warnings,
                *setup.warnings_of(last),
                *_not_white(library, last, data.estimated),
                *beyond,
            ),
            simulator_steps=setup.spent(task),
            interrupted=searched.interrupted,
        )

    def _further(
        self, setup: "_Setup", searched: "_Searched", rest: Remaining, rng: np.random.Generator
    ) -> "tuple[_Setup, _Searched] | None":
        """A search that went on, where something remains; None where there is no more to do."""
        if searched.interrupted or setup.explained is not None:
            return None
        # What explains the data in part is no delay that is finer than the model's own steps.
        if not rest.calibrated:
            further = _without_short_delays(setup, searched)
            if further is not None:
                return further
        # Effects that were accepted one after another may stand for others that act together.
        doubtful = not rest.calibrated or len(searched.last.accepted) > self.settings.sure_effects
        if doubtful and not setup.compared:
            further = _with_another_set(setup, searched, self.settings.sets)
            if further is not None:
                return further
            setup = replace(setup, compared=True)
        # Where known effects leave something, it may follow a law that none of them stands for.
        if searched.laws is None and self._wants_laws(setup.library, searched.last, rest):
            return self._with_laws(setup, searched, rng)
        return None

    def _detectable(
        self, setup: "_Setup", searched: "_Searched", verdict: str
    ) -> tuple[Detectable, ...]:
        """The sizes of usual effects that the data of a consistent model would have shown."""
        if verdict != "consistent" or searched.interrupted or setup.explained is not None:
            return ()
        selection = setup.selection.settings
        settings = self.settings.detectable
        instances = setup.instances
        last = searched.last
        return detectable(setup.library, last, instances, setup.count, selection, settings)

    def _with_laws(
        self, setup: "_Setup", searched: "_Searched", rng: np.random.Generator
    ) -> "tuple[_Setup, _Searched] | None":
        """A search that went on with laws; None where none is confirmed."""
        laws = find_laws(
            setup.problem,
            setup.selection,
            searched.first,
            searched.last,
            setup.instances,
            rng,
            self.settings.laws,
        )
        if laws is None:
            return None
        setup = replace(setup, selection=laws.selection, library=laws.selection.library)
        return setup, _Searched(laws.first, laws.last, laws.reviews, laws=laws)

    def _errors_after(
        self, setup: "_Setup", searched: "_Searched", rng: np.random.Generator
    ) -> tuple[list[AfterHorizon], list[AfterHorizon]]:
        """The errors after every horizon of three models, as the model came, with its parameters
        fitted and with everything, then those without each effect too, where that was reviewed.

        Of a model that is far off the others are many: they are compared in fewer windows.
        """
        data, library, last = setup.problem, setup.library, searched.last
        thetas = [nominal_of(library), searched.first.theta, last.theta]
        withouts = []
        if not searched.interrupted:
            withouts = [searched.reviews[one.label].without.theta for one in last.accepted]
        if setup.explained is None:
            after = after_horizons(data, library, [*thetas, *withouts], last, rng)
            return after, after
        after = after_horizons(data, library, thetas, last, rng)
        few = self.settings.each
        return after, after_horizons(data, library, [*thetas, *withouts], last, rng, few)

    def _worse(self, after: Sequence[AfterHorizon], searched: "_Searched") -> dict[str, Leader]:
        """The effects with which errors after some horizon are larger than without, by label.

        after: of the model as it came, with its parameters fitted, with everything, and without
        each effect; of the first three alone where the search was interrupted.
        """
        if searched.interrupted or not after:
            return {}
        found = []
        for i, instance in enumerate(searched.last.accepted):
            beyond = worse_after(after, 3 + i, 2, self.settings.horizons)
            if beyond is not None:
                found.append((instance, beyond))
        found.sort(key=lambda one: -one[1].score)
        return {one.label: _worse_leader(searched, one, beyond) for one, beyond in found}

    def _after_every_horizon(
        self,
        setup: "_Setup",
        after: Sequence[AfterHorizon],
        last: State,
        rest: Remaining,
        rng: np.random.Generator,
    ) -> tuple[Remaining, tuple[str, ...]]:
        """What remains, with errors that noise does not explain after some horizon, whatever
        windows say; and what to do then, a sentence each.
        """
        settings = self.settings.horizons
        # The noise of starts that were estimated, and of control steps, is known in windows.
        other_noise = bool(setup.problem.estimated) or last.train.whiten.noise.timing > 0
        usual = setup.train.length if other_noise else None
        measured = are_measured(setup.problem)
        found = beyond_noise(after, 2, usual, settings, measured=measured)
        if found and setup.explained is None and len(last.free):
            # The numbers are not known exactly, which noise explains too.
            covariance = covariance_of(setup.library, last)
            asked = {usual, *(one.steps for one in found)}
            doubtful = [one for one in after if one.steps in asked]
            more = with_numbers(
                setup.problem, setup.library, last, covariance, doubtful, rng, settings.draws
            )
            found = beyond_noise(more, 2, usual, settings, measured=measured)
        if not found:
            return rest, ()
        beyond = _beyond(found, rest, setup.train.length)
        return replace(rest, calibrated=False, where=(*rest.where, in_words(found))), beyond

    def _wants_laws(self, library: Library, last: State, rest: Remaining) -> bool:
        """Whether a law is to be looked for: something remains, or an effect only acts like it."""
        if self.effects is not None and LAW not in self.effects:
            return False
        if not rest.calibrated:
            return True
        return any(not invariance(library, last.test, one).constant for one in last.accepted)

    def _train(self, problem: Problem, length: int) -> Windows:
        """Windows to fit of so many control steps."""
        return split(problem, length, self._windows(problem))[0]

    def _can_diagnose(self, problem: Problem, length: int) -> bool:
        """Whether the data hold enough windows."""
        try:
            split(problem, length, self._windows(problem))
        except BadArgument:
            return False
        return True


def diagnose(
    problem: Problem,
    effects: Sequence[str] | None = None,
    *,
    rng: np.random.Generator | int | None = 0,
) -> Diagnosis:
    """Show what the simulation gets wrong, name the cause, extend the model and measure the gain.

    Parameters
    ----------
    problem : Problem
        Measured data and a MuJoCo model.
    effects : sequence of str, optional
        Names of effects to look for, or "effect:place"; all of `dropo list effects` if None.
    rng : numpy.random.Generator, int or None
        A generator or a seed.

    Returns
    -------
    Diagnosis

    Raises
    ------
    Incompatible
        If the simulator has no MuJoCo model.
    UnknownName
        If an effect or a place does not exist.
    BadArgument
        If the problem is none, the data are too few, or a signal never changes.
    SimulationFailed
        If the simulation diverges in too many windows.
    """
    return Diagnose(effects).run(problem, rng=rng)


def per_step(state: State) -> float:
    """Return the log-likelihood of a state's windows held out.

    Parameters
    ----------
    state : State
        Any.

    Returns
    -------
    float
        In nats per transition.
    """
    return float(state.test.log_likelihood.sum() / state.test.windows.steps)


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


def _free(problem: Problem, parameters: Sequence[str] | None) -> Ints:
    """The indices of the declared parameters that are fitted."""
    names = problem.space.names
    wanted: Any = parameters
    if wanted is None:
        wanted = problem.settings.get("parameters", names)
    chosen = [known("parameter", str(name), names) for name in wanted]
    return np.array([names.index(name) for name in chosen], dtype=np.int64)


def _extended(problem: Problem, library: Library, last: State) -> Problem:
    """A problem whose simulator has what was found."""
    found = [(instance, last.theta[library.places[instance.label]]) for instance in last.accepted]
    return replace(problem, simulator=robot_of(problem).with_effects((), found))


@dataclass(frozen=True, eq=False)
class _Task:
    """What is to be diagnosed.

    came: with the model as it came.
    problem: with all data, and the steps that the model has by now.
    wiring: what does not fit in signs, units and names of commands, a sentence each.
    held: the joints that never move.
    undisturbed: what is left of it where disturbances were found.
    before: the model by which they were found.
    spent: simulator steps so far.
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

    @property
    def data(self) -> Problem:
        """The problem, or what is left of it."""
        return self.problem if self.undisturbed is None else self.undisturbed.problem


@dataclass(frozen=True, eq=False)
class _Setup:
    """What a search works on.

    explained: what the model lacks, where it is far off.
    free: (d,) the declared parameters that are fitted.
    count: how many effects are looked for.
    wiring: what does not fit in signs, units and names of commands, a sentence each.
    noise: the first guess where it is coloured.
    refused: by their labels, effects that are no causes, with why, a sentence each.
    won: what its steps gained over the model's own [nats]; 0 if they are those.
    worse: by their labels, effects with which errors after some horizon are larger.
    compared: whether sets of effects were compared, and a better one was found.
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
    won: float = 0.0
    worse: Mapping[str, Leader] = field(default_factory=dict)
    compared: bool = False

    @property
    def instances(self) -> list[EffectInstance]:
        """The effects that may be accepted."""
        everything = without_impulses(self.library.instances)
        out = {*self.refused, *self.worse}
        return [instance for instance in everything if instance.label not in out]

    def first(self) -> State:
        """The model as it is, with its declared parameters and the noise fitted."""
        theta = nominal_of(self.library)
        noise = self._first_noise(theta)
        return self.selection.begin(self.train, self.test, theta, noise, self.free)

    def evaluated(self) -> tuple[State, State, dict[str, Review]]:
        """The model as it came, the one that explains whole motions, and this without each effect.

        Nothing is fitted to windows but the noise.
        """
        if self.explained is None:
            raise AssertionError("only a model that is far off is explained by whole motions")
        accepted = tuple(instance for instance, _ in self.explained.model.numbers)
        free = self.explained.model.fitted
        first = self._as_it_is(nominal_of(self.library), self.free, ())
        last = self._as_it_is(self._padded(self.explained.model.theta), free, accepted)
        noise = last.train.whiten.noise
        reviews = {}
        for label, theta in self.explained.without.items():
            whole = self._padded(theta)
            kept = tuple(instance for instance in accepted if instance.label != label)
            without = State(
                shift_linearization(self.library, last.train, whole, noise),
                shift_linearization(self.library, last.test, whole, noise),
                free[~np.isin(free, self.library.places[label])],
                kept,
            )
            reviews[label] = Review(without, None, ())
        return first, last, reviews

    def certain(self, last: State) -> Set[str]:
        """The labels of a model's effects that are distinguished from nothing."""
        labels = {instance.label for instance in last.accepted}
        return labels if self.explained is None else labels & self.explained.certain

    def warnings_of(self, last: State) -> tuple[str, ...]:
        """What makes the answer doubtful, a sentence each."""
        if self.explained is not None:
            return (*self.wiring, *self.explained.warnings)
        return (*self.wiring, *at_bounds(self.library, last.theta, last.free, last.accepted))

    @property
    def ties(self) -> tuple[str, ...]:
        """What whole motions tell only together, a sentence each."""
        return () if self.explained is None else self.explained.ties

    def spent(self, task: _Task) -> int:
        """Simulator steps of a diagnosis so far."""
        in_motions = 0 if self.explained is None else self.explained.simulator_steps
        return task.spent + in_motions + self.library.simulator.steps

    def errors(self) -> Array | None:
        """Standard errors (m,) of all numbers, where whole motions say how large they are."""
        return None if self.explained is None else self._padded(self.explained.errors)

    def _as_it_is(self, theta: Array, free: Ints, accepted: tuple[EffectInstance, ...]) -> State:
        """A model with its noise estimated."""
        noise = self._first_noise(theta)
        return self.selection.as_it_is(self.train, self.test, theta, noise, free, accepted)

    def _first_noise(self, theta: Array) -> WindowNoise:
        """The noise guessed from single steps, unless it is known to be coloured."""
        if self.noise is not None:
            return self.noise
        floor = self.selection.floor
        return white(first_noise(self.problem, self.library, self.train, theta, floor))

    def _padded(self, values: Array) -> Array:
        """Values of the declared parameters and of effects, then 0 for all impulses: (m,)."""
        out = np.zeros(len(self.library.simulator.space))
        out[: len(values)] = values
        return out


@dataclass(frozen=True, eq=False)
class _Searched:
    """What a search ends with: the model as it is, the one that explains the data, the reviews of
    its effects, whether it was interrupted before its end, and the laws that were found.
    """

    first: State
    last: State
    reviews: Mapping[str, Review]
    interrupted: bool = False
    laws: WithLaws | None = None


@dataclass(frozen=True, eq=False)
class _Findings:
    """What is said of a search's end: its causes, those of its effects with which errors after some
    horizon are larger, by label, the errors of three models after every horizon, what remains, the
    forces that nothing explains, and draws for what is still to be asked.
    """

    causes: tuple[Cause, ...]
    worse: Mapping[str, Leader]
    after: Sequence[AfterHorizon]
    rest: Remaining
    forces: Unexplained
    draws: np.random.Generator


def _with_noise_left(setup: _Setup, before: State | None, settings: WhitenessSettings) -> _Setup:
    """A setup with noise that is coloured, where the model before says so of these windows."""
    if before is None or setup.explained is not None:
        return setup
    # Impulses, which come last, may be others; they are 0.
    size = min(len(before.theta), len(setup.library.simulator.space))
    theta = setup._padded(before.theta[:size])
    plain = white(before.train.whiten.sigma)
    state = setup.selection.as_it_is(
        setup.train, setup.test, theta, plain, before.free, before.accepted
    )
    noise = other_noise(setup.library, state.train, setup.selection.floor, settings)
    if noise is None:
        return setup
    return replace(setup, selection=_anew(setup, "noise that is not white"), noise=noise)


def _solved(
    setup: _Setup,
    settings: WhitenessSettings,
    disturbed: Callable[[_Setup, "_Searched"], WithoutDisturbances | None],
) -> "tuple[_Setup, _Searched, WithoutDisturbances | None]":
    """What a search ends with, the setup that led to it, and what is left where that found
    disturbances.

    Where errors of a sensor still follow each other, they may have been taken for causes: all is
    done anew with noise that is coloured, unless there are disturbances to be left out first.
    """
    setup, found = _search(setup)
    if found.interrupted:
        return setup, found, None
    try:
        left = disturbed(setup, found)
        if left is not None or setup.noise is not None:
            return setup, found, left
        noise = other_noise(setup.library, found.last.train, setup.selection.floor, settings)
        if noise is None:
            return setup, found, None
        selection = _anew(setup, "noise that is not white")
        again, anew = _search(replace(setup, selection=selection, noise=noise))
        if anew.interrupted:
            # What was found before is whole; half a search under other premises is not.
            return setup, replace(found, interrupted=True), None
        return again, anew, disturbed(again, anew)
    except KeyboardInterrupt:
        setup.selection.progress(0.9, STOPPING)
        return setup, replace(found, interrupted=True), None


def _anew(setup: _Setup, under: str) -> Selection:
    """A search that has not begun, under other premises."""
    progress = setup.selection.progress

    def further(share: float, text: str) -> None:
        """Progress does not run backward."""
        progress(0.9, f"{text}, {under}")

    selection = replace(setup.selection, progress=further, batches=[], origins={})
    selection.screening = setup.selection.screening
    return selection


def _stepped(setup: _Setup, arithmetic: Arithmetic, gain: float) -> _Setup:
    """A setup whose simulations are stepped otherwise, which gained so much."""
    library = setup.library
    simulator = robot_of(setup.problem)
    exact = arithmetic.of(library.simulator)  # type: ignore[arg-type]
    exact.steps = library.simulator.steps
    library = Library(exact, library.instances, library.declared, library.differences)
    selection = replace(_anew(setup, "exact physics steps"), library=library)
    problem = replace(setup.problem, simulator=arithmetic.of(simulator))
    return replace(setup, problem=problem, library=library, selection=selection, won=gain)


def _search(setup: _Setup) -> tuple[_Setup, _Searched]:
    """Look for effects; where that is interrupted, what was accepted so far.

    Where more exact physics steps are the better explanation, all is done anew with them.
    """
    explained = setup.explained
    if explained is not None:
        return setup, _Searched(*setup.evaluated(), explained.interrupted)
    first = setup.first()
    selection = setup.selection
    settings = selection.settings
    alternatives = ArithmeticAlternatives(
        setup.library, selection.floor, settings, selection.log, first, setup.won
    )
    try:
        last, reviews = _explain(setup, first, first, alternatives)
        if alternatives.winner is None:
            return setup, _Searched(first, last, reviews)
        return _search(_stepped(setup, alternatives.winner, alternatives.gain))
    except KeyboardInterrupt:
        selection.progress(0.9, STOPPING)
        last = selection.latest or first
        reviews = reviews_so_far(selection, last)
        return setup, _Searched(first, last, reviews, interrupted=True)


def _explain(
    setup: _Setup, first: State, begun: State, alternatives: ArithmeticAlternatives | None = None
) -> tuple[State, dict[str, Review]]:
    """The model that the search ends with, and its effects' reviews.

    It ends early where one of the alternatives is better.
    """
    selection = setup.selection
    instances = setup.instances
    last, reviews = review(selection, begun)
    while True:
        found = selection.run(first, last, instances, alternatives)
        if alternatives is not None and alternatives.winner is not None:
            return last, reviews
        if found is last:
            break
        # After an exchange, others may be confirmed.
        last, reviews = review(selection, found)
        selection.latest = last
        if last is found:
            break
    merged = merge(selection, last, instances)
    if merged is not last:
        _, reviews = review(selection, merged)
    return merged, reviews


def _without_short_delays(setup: _Setup, searched: _Searched) -> tuple[_Setup, _Searched] | None:
    """The search gone on without delays shorter than a physics step; None where there are none.

    They are what else is wrong looks like: a model says little of what happens within its steps.
    """
    library, last = setup.library, searched.last
    step = physics_step(robot_of(setup.problem).model)
    refused: dict[str, str] = {}
    indices: list[int] = []
    for instance in last.accepted:
        own = library.places[instance.label]
        size = short_delay(instance, last.theta[own], step)
        if size is not None:
            without = searched.reviews[instance.label].without
            refused[instance.label] = refused_delay(instance, size, step, without.test, last.test)
            indices += own.tolist()
    if not refused:
        return None
    selection = _without(setup.selection, refused)
    setup = replace(setup, selection=selection, refused={**setup.refused, **refused})
    theta = last.theta.copy()
    theta[indices] = 0.0
    train = shift_linearization(library, last.train, theta, last.train.whiten.noise)
    kept = tuple(one for one in last.accepted if one.label not in refused)
    begun = State(train, last.test, np.setdiff1d(last.free, indices), kept)
    # More exact steps were tried beside them, and were not better.
    further, reviews = _explain(setup, searched.first, selection.polish(begun))
    return setup, replace(searched, last=further, reviews=reviews)


def _with_another_set(
    setup: _Setup, searched: _Searched, settings: SetSettings
) -> tuple[_Setup, _Searched] | None:
    """The search gone on with a set of effects that is better; None where none is."""
    sets = SetSearch(setup.selection, searched.first, setup.instances, settings)
    better = sets.run(searched.last)
    if better is searched.last:
        return None
    last, reviews = _explain(setup, searched.first, better)
    return replace(setup, compared=True), replace(searched, last=last, reviews=reviews)


def _without_worse(
    setup: _Setup, searched: _Searched, label: str, leader: Leader
) -> tuple[_Setup, _Searched]:
    """The search gone on without an effect with which errors after some horizon are larger."""
    worse = {**setup.worse, label: leader}
    setup = replace(setup, selection=_without(setup.selection, [label]), worse=worse)
    without = searched.reviews[label].without
    further, reviews = _explain(setup, searched.first, without)
    return setup, replace(searched, last=further, reviews=reviews)


def _worse_leader(searched: _Searched, instance: EffectInstance, beyond: Beyond) -> Leader:
    """What is said of an effect with which errors after some horizon are larger."""
    gain, z = gain_of(searched.reviews[instance.label].without.test, searched.last.test)
    after = f"errors after {steps_text(beyond.steps)} are {number(beyond.ratio, 3)} times"
    return Leader(
        effect=instance.effect,
        target=instance.target,
        variant=instance.variant,
        gain=gain,
        gain_se=gain / z if z > 0 else np.nan,
        times=np.nan,
        why=f"{after} those without it ({beyond.unit})",
        steps=beyond.steps,
    )


def _without(selection: Selection, labels: Collection[str]) -> Selection:
    """A search whose batches lack the trials of some effects."""
    left = replace(
        selection,
        origins={
            label: _without_trials(batch, labels) for label, batch in selection.origins.items()
        },
        batches=[_without_trials(batch, labels) for batch in selection.batches],
    )
    left.screening = selection.screening
    return left


def _without_trials(batch: Batch, refused: Collection[str]) -> Batch:
    """A batch without the trials of some effects, by their labels."""
    kept = [trial for trial in batch.trials if trial.candidate.instance.label not in refused]
    return replace(batch, trials=kept)


def _leaders(setup: _Setup, last: State, worse: Mapping[str, Leader]) -> tuple[Leader, ...]:
    """What is not confirmed: what makes errors after some horizon larger first."""
    certain = setup.certain(last)
    return (
        *setup.worse.values(),
        *(one for label, one in worse.items() if label in certain),
        *leaders(setup.selection, last, setup.count),
    )


def _noise_by_signal(problem: Problem, last: State) -> dict[str, float]:
    """The standard deviation of each signal's noise."""
    signals = robot_of(problem).signals
    sizes = signal_noise(problem, last)
    return {signal.name: float(size) for signal, size in zip(signals, sizes, strict=True)}


def _numerics(
    task: _Task,
    setup: _Setup,
    searched: _Searched,
    found: Sequence[Cause],
    rest: Remaining,
) -> tuple[str, ...]:
    """What the integrator and its steps do, and the delays that are not told from them."""
    # Numbers of whole motions gain by being fitted to windows, whatever the steps.
    unexplained = not (rest.calibrated or setup.explained is not None)
    said = numerics(
        task.came,
        setup.problem,
        setup.library,
        searched.first,
        searched.last,
        found,
        setup.selection.floor,
        unexplained=unexplained,
    )
    return (*said, *setup.refused.values())


def _errors_without_and_with(
    problem: Problem,
    library: Library,
    last: State,
    reviews: Mapping[str, Review],
    after: Sequence[AfterHorizon],
) -> list[tuple[float, float]]:
    """For each accepted effect, the error on held-out data without it and with everything.

    after: of the model as it came, with its parameters fitted, with everything, and without each
    effect; simulated where it lacks the windows' horizon.
    """
    for one in after:
        if one.steps == last.train.windows.length:
            _, _, everything, *without = (model.rmse for model in one.models)
            return [(error, everything) for error in without]
    thetas = [reviews[instance.label].without.theta for instance in last.accepted]
    *others, whole = errors_after(problem, library, [*thetas, last.theta], last)
    return [(errors.overall, whole.overall) for errors in others]


def _replayed(setup: _Setup, searched: _Searched) -> WholeRunReplay | None:
    """Whole runs held out, by commands alone, where there are such."""
    data = setup.problem.held_out
    if data is None:
        return None
    return replay(setup.library.simulator, data, [searched.first.theta, searched.last.theta])


def _refuse_constant(problem: Problem, train: Windows) -> None:
    """Refuse signals that never change: they have no scale on which errors could be evaluated."""
    spread = spread_of(problem.simulator, train)
    for signal, size in zip(problem.simulator.signals, spread, strict=True):
        if not size > 0:
            raise BadArgument(
                f"The signal {signal.name!r} is the same in all the data: a stuck sensor? Leave "
                "it out of the observation."
            )


def _not_white(library: Library, last: State, estimated: Collection[str]) -> tuple[str, ...]:
    """What noise was taken for, where it is not white: a wrong model may look like it.

    estimated: signals whose errors follow each other by the way they were estimated.
    """
    noise = last.train.whiten.noise
    sentences = []
    following = [
        f"{signal.name} ({rho:.2f} of each in the next)"
        for signal, rho in zip(library.simulator.signals, noise.rho, strict=True)
        if rho and signal.name not in estimated
    ]
    if following:
        sentences.append(
            f"errors follow each other in {', '.join(following)}: taken for the sensors'"
        )
    if noise.timing:
        sentences.append(
            f"control steps seem to differ in length by {noise.timing:.1%} (a standard deviation), "
            "and are taken to"
        )
    return tuple(sentences)


def _beyond(misfits: Sequence[Beyond], rest: Remaining, length: int) -> tuple[str, ...]:
    """What to do where nothing remains within the windows, but after longer horizons."""
    longer = [one.steps for one in misfits if one.steps > length]
    if not rest.calibrated or not longer:
        return ()
    return (
        f"within windows of {steps_text(length)} nothing remains, beyond them something does: "
        f"diagnose with --steps {longer[0]}",
    )


def _verdict(found: Sequence[Cause], wrong: bool) -> str:
    """The finding in a word; wrong: whether something remains."""
    wrong = wrong or any(cause.acts_like for cause in found)
    if found:
        return "partly" if wrong else "explained"
    return "unexplained" if wrong else "consistent"
