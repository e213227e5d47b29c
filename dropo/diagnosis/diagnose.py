"""Data and a model in; what the model gets wrong, and why, out."""

import time
from collections.abc import Collection, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.estimator import Progress, silent, with_cost
from dropo.core.contracts.problem import Problem
from dropo.core.services.blas_threads import one_blas_thread
from dropo.core.services.errors import BadArgument
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.validation import require
from dropo.data.outliers.without_disturbances import WithoutDisturbances, without_disturbances
from dropo.diagnosis.far_off.same_place import alike_in_motions
from dropo.diagnosis.far_off.search import Explained, FarOffSearch
from dropo.diagnosis.far_off.start import FarOffStart, RegressionStart, start_of
from dropo.diagnosis.findings.accuracy.every_horizon import (
    beyond_noise,
    in_words,
    worse_after,
)
from dropo.diagnosis.findings.accuracy.horizons import (
    AfterHorizon,
    after_horizons,
    horizons,
    with_numbers,
)
from dropo.diagnosis.findings.accuracy.motion import motion
from dropo.diagnosis.findings.causes import SETTINGS as CAUSES
from dropo.diagnosis.findings.causes import causes, covariance_of, suspects
from dropo.diagnosis.findings.figures import figure_data
from dropo.diagnosis.findings.limits.detectable import Detectable, detectable
from dropo.diagnosis.findings.limits.not_identifiable import undetermined
from dropo.diagnosis.findings.limits.scale_of_forces import UntoldScale, untold_scales
from dropo.diagnosis.findings.limits.scale_of_forces import in_words as in_words_together
from dropo.diagnosis.findings.premises.chattering import chattering_sentences
from dropo.diagnosis.findings.premises.miswired import miswired
from dropo.diagnosis.findings.premises.still import (
    Held,
    hardly_moving_sentences,
    hold_still,
)
from dropo.diagnosis.findings.remains.disturbances import left_out, outlier_runs
from dropo.diagnosis.findings.remains.remaining import are_measured, remaining
from dropo.diagnosis.findings.remains.unexplained_forces import impulses
from dropo.diagnosis.findings.stability import stability
from dropo.diagnosis.findings.to_type import to_type
from dropo.diagnosis.laws.discovery import find_laws
from dropo.diagnosis.laws.ideas import may_stand_for_one_law
from dropo.diagnosis.laws.learned import WithLearned, learn_forces
from dropo.diagnosis.parts import Cause, Leader, Remaining
from dropo.diagnosis.regression.wiring import Wiring, wiring_of
from dropo.diagnosis.reporting import (
    Findings,
    arithmetic_of,
    beyond_windows,
    errors_without_and_with,
    leaders_of,
    noise_by_signal,
    not_white,
    per_step,
    replayed,
    verdict_of,
)
from dropo.diagnosis.result import Diagnosis, HeldOut
from dropo.diagnosis.search.aliases import beside_numbers, beside_the_rest
from dropo.diagnosis.search.invariance import invariance
from dropo.diagnosis.search.library import LAW, instances_for, robot_of
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.review import Review
from dropo.diagnosis.search.selection import STOPPING, Selection
from dropo.diagnosis.search.trials import State
from dropo.diagnosis.search.window_length import (
    choose_length,
    noise_floor,
)
from dropo.diagnosis.search.windows import Windows, split
from dropo.diagnosis.settings import DiagnosisSettings
from dropo.diagnosis.setup import (
    DiagnosisTask,
    SearchedEffects,
    SearchSetup,
    extended_problem,
    free_parameters,
    nominal_of,
    refuse_constant,
)
from dropo.diagnosis.solving import (
    in_exact_steps,
    in_shorter_steps,
    solved,
    that_may_be_nothing,
    with_another_set,
    with_known_scales,
    with_noise_left,
    without_short_delays,
    without_worse,
    worse_leader,
)
from dropo.evaluation.held_out import OF_DIAGNOSIS


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
    learned : bool
        Whether forces that are learned from what nothing explains, and that data held out confirm,
        are part of the extended model however little of that they explain.
    settings : DiagnosisSettings
        Numbers that decide.
    """

    effects: Sequence[str] | None = None
    _: KW_ONLY
    length: int | None = None
    windows: int | None = None
    parameters: Sequence[str] | None = None
    disturbances: bool = True
    learned: bool = False
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
        with one_blas_thread():
            log = evaluation_log or EvaluationLog()
            wiring = self._wiring(problem, progress)
            if wiring.faults and all(fault.evidence for fault in wiring.faults):
                found = miswired(problem, wiring)
            else:
                doubts = tuple(fault.text for fault in wiring.faults)
                held = hold_still(problem)
                data = problem if held is None else held.problem
                task = DiagnosisTask(data, data, np.random.default_rng(rng), log, doubts, held)
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
        free = free_parameters(held.problem, self.parameters)
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
        free = free_parameters(problem, self.parameters)
        setup = SearchSetup(problem, None, library, selection, train, test, free, 0, ())
        return per_step(setup.first())

    def _windows(self, problem: Problem) -> int:
        """About how many windows each side has."""
        if self.windows is not None:
            return int(self.windows)
        settings = self.settings
        usual = settings.long_windows if problem.estimated else settings.windows
        stated: Any = problem.settings.get("windows", usual)
        return int(stated)

    def _start(self, task: DiagnosisTask, progress: Progress) -> RegressionStart | None:
        """What regression says that a model lacks, where effects need not be named."""
        settings = self.settings
        if self.effects is not None or settings.far_off is None or task.wiring:
            return None
        progress(0.0, "regression over inverse dynamics")
        free = free_parameters(task.data, self.parameters)
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

    def _set_up(
        self, task: DiagnosisTask, explained: Explained | None, progress: Progress
    ) -> SearchSetup:
        """Everything that may be wrong, and the data to find it in."""
        problem, log, wiring = task.data, task.log, task.wiring
        free = free_parameters(problem, self.parameters)
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
        if task.exact:
            library = replace(library, coarse=robot_of(task.came).with_effects(everything))
        windows = self._windows(problem)
        if explained is not None:
            most = self.settings.evaluated if explained.own_steps else self.settings.exactly
            windows = min(windows, most)
        train, test = split(problem, length, windows)
        refuse_constant(problem, train)
        estimated: Collection[str] = problem.estimated
        if explained is not None:
            # Whole motions were fitted, from starts as they are: estimates count as measurements.
            estimated = ()
            train, test = (replace(side, start_sd=None) for side in (train, test))
        with_steps = with_cost(progress, library.simulator)
        selection = self._selection(library, train, estimated, with_steps, log)
        return SearchSetup(
            problem,
            explained,
            library,
            selection,
            train,
            test,
            free,
            len(instances),
            wiring,
            exact=task.exact,
            known=task.known,
        )

    def _run(self, task: DiagnosisTask, progress: Progress) -> Diagnosis:
        """The diagnosis of a problem, or of what is left of it without disturbances."""
        regression = self._start(task, progress)
        if regression is None:
            return self._by_search(task, None, progress)
        task = replace(task, known=regression.certain)
        start = regression.far_off
        if start is None:
            return self._by_search(task, None, progress)
        if start.sure:
            explained, in_vain = self._explained(start, progress, task.log)
            motions = replace(task, spent=task.spent + in_vain)
            found = self._by_search(motions, explained, progress)
            if explained is None or not start.few or _is_an_end(found):
                return found
            causes = self._plain._run(replace(task, spent=found.simulator_steps), progress)
            if causes.interrupted:
                return replace(found, interrupted=True)
            if causes.verdict == "explained":
                return causes
            return replace(found, simulator_steps=causes.simulator_steps)
        # A model that may be far off may lack but little: a few causes that explain all go first.
        found = self._plain._run(task, progress)
        if _is_an_end(found):
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
        self, task: DiagnosisTask, explained: Explained | None, progress: Progress
    ) -> Diagnosis:
        """The diagnosis by a search for effects, or by whole motions where these explain it."""
        setup = self._set_up(task, explained, progress)
        setup.selection.progress(0.0, "fitting the model as it is")
        setup = with_noise_left(setup, task.before, self.settings.noise)
        disturbed = partial(self._without_disturbances, task)
        setup, found, undisturbed = solved(setup, self.settings.noise, disturbed)
        try:
            if undisturbed is not None:
                spent = task.spent + setup.library.simulator.steps
                rest = replace(task, problem=setup.problem, undisturbed=undisturbed, spent=spent)
                rest = replace(rest, before=found.last, exact=setup.exact)
                return self._run(rest, progress)
            if not found.interrupted:
                return self._result(task, setup, found, progress)
        except KeyboardInterrupt:
            setup.selection.progress(0.9, STOPPING)
            found = replace(found, interrupted=True)
        return self._result(task, setup, found, progress)

    def _without_disturbances(
        self, task: DiagnosisTask, setup: SearchSetup, found: SearchedEffects
    ) -> WithoutDisturbances | None:
        """What is left where disturbances stand out; once the causes are known, they do."""
        if not self.disturbances or setup.explained is not None or task.undisturbed is not None:
            return None
        data = setup.problem
        extended = extended_problem(data, setup.library, found.last)
        declared = found.last.theta[: len(data.space)]
        left = without_disturbances(data, extended.simulator, declared)
        if left is None or not self._can_diagnose(left.problem, setup.train.length):
            return None
        return left

    def _result(
        self, task: DiagnosisTask, setup: SearchSetup, searched: SearchedEffects, progress: Progress
    ) -> Diagnosis:
        """What a search found, in figures; of one that was interrupted, only what is soon found."""
        library, selection, last = setup.library, setup.selection, searched.last
        selection.progress(0.9, "what remains")
        rest, forces = remaining(
            setup.problem,
            library,
            last,
            selection.floor,
            task.rng,
            by_motions=setup.explained is not None,
        )
        further = self._further(setup, searched, rest, task.rng)
        if further is not None:
            return self._result(task, *further, progress)
        (draws,) = task.rng.spawn(1)
        after, of_each = self._errors_after(setup, searched, draws)
        if self._laws_beyond_windows(setup, searched, rest, after):
            further = self._with_laws(setup, searched, task.rng)
            if further is not None:
                return self._result(task, *further, progress)
            setup = replace(setup, sought=True)
        worse = self._worse(setup, of_each, searched)
        far_off = setup.explained is not None
        most = self.settings.horizons.refused
        if worse and not far_off and len(setup.worse) < most:
            further = without_worse(setup, searched, *next(iter(worse.items())), most)
            return self._result(task, *further, progress)
        scales: tuple[UntoldScale, ...] = ()
        if not far_off and not searched.interrupted:
            reviews = beside_the_rest(library, last, searched.reviews)
            alike = setup.selection.settings.similarity
            several = [one for one in last.accepted if len(one.quantities) > 1]
            others = _of_one_number(setup.instances, last)
            reviews = beside_numbers(library, last, reviews, several, others, alike)
            searched = replace(searched, reviews=reviews)
            scales = untold_scales(library, last)
        elif not searched.interrupted:
            searched = replace(searched, reviews=_alike_in_motions(setup, searched))
        found = self._causes(setup, searched, of_each, worse.keys(), scales)
        if far_off and not found and not searched.interrupted:
            # Motions do not bear out what regression finds.
            spent = setup.spent(task)
            return self._plain._run(replace(task, spent=spent), progress)
        return self._reported(
            task, setup, searched, Findings(found, worse, after, rest, forces, draws, scales)
        )

    def _causes(
        self,
        setup: SearchSetup,
        searched: SearchedEffects,
        after: Sequence[AfterHorizon],
        worse: Collection[str],
        scales: Sequence[UntoldScale],
    ) -> tuple[Cause, ...]:
        """The effects that were accepted, as causes.

        after: errors of models, those without each effect among them.
        worse: labels of effects with which errors after some horizon are larger.
        scales: what numbers are told only together.
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
            errors_without_and_with(setup.problem, library, last, reviews, whole),
            setup.selection.settings,
            CAUSES if complete else replace(CAUSES, experiments=0),
            known=setup.errors(),
            named=setup.certain(last) - set(worse),
            again=partial(stability, setup.selection, partial(self._train, setup.problem))
            if complete
            else None,
            laws={} if laws is None else laws.laws,
            scales=scales,
        )

    def _reported(
        self, task: DiagnosisTask, setup: SearchSetup, searched: SearchedEffects, findings: Findings
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
            own = replace(OF_DIAGNOSIS, horizons=())
            inside = horizons(task.problem, library, thetas, last, draws, own)
            disturbances = left_out(task.undisturbed, inside)
        rest, beyond = self._after_every_horizon(setup, after, last, findings.rest, draws)
        learned = None if rest.calibrated else self._learned(setup, searched, draws)
        larger_setup, larger_end = _with_learned(setup, searched, learned)
        if learned is not None and learned.learned.used:
            with_causes = tuple(one.models[1] for one in learned.after)
        selection.progress(0.95, "what the pictures show")
        named = extended_problem(data, library, last)
        extended = extended_problem(data, larger_setup.library, larger_end.last)
        declared = last.theta[: len(data.space)]
        parameters = dict(zip(data.space.names, declared.tolist(), strict=True))
        compared = self.disturbances and not (rest.calibrated or far_off) and complete
        verdict = verdict_of(findings.causes, not rest.calibrated)
        return Diagnosis(
            name=data.name,
            verdict=verdict,
            causes=findings.causes,
            suspects=suspects(selection, last, setup.count),
            leaders=leaders_of(setup, last, findings.worse),
            baseline=HeldOut(per_step(first), fitted),
            extended=HeldOut(per_step(larger_end.last), with_causes),
            remaining=rest,
            problem=extended,
            detectable=self._detectable(setup, searched, verdict),
            noise=noise_by_signal(data, last),
            window_steps=setup.train.length,
            nominal=nominal if len(setup.free) and not far_off else (),
            parameters=parameters,
            undetermined=(
                *undetermined(library, last),
                *in_words_together(library, last, findings.scales),
                *setup.ties,
            ),
            numerics=arithmetic_of(task, setup, searched, findings.causes, rest)
            if complete
            else (),
            to_type=to_type(task.came, named, parameters),
            disturbances=disturbances,
            outlier_runs=outlier_runs(data, named, declared) if compared else (),
            replay=replayed(larger_setup, larger_end) if far_off and complete else None,
            figures=figure_data(
                library, selection, first, last, searched.reviews, findings.forces, setup.count
            ),
            motion=motion(
                data, larger_setup.library, larger_end.first, larger_end.last, fitted, with_causes
            ),
            learned=None if learned is None else learned.learned,
            warnings=(
                *data.warnings,
                *chattering_sentences(data),
                *hardly_moving_sentences(data),
                *setup.warnings_of(last),
                *not_white(library, last, data.estimated),
                *beyond,
            ),
            simulator_steps=setup.spent(task),
            interrupted=searched.interrupted,
        )

    def _further(
        self,
        setup: SearchSetup,
        searched: SearchedEffects,
        rest: Remaining,
        rng: np.random.Generator,
    ) -> tuple[SearchSetup, SearchedEffects] | None:
        """A search that went on, where something remains; None where there is no more to do."""
        if searched.interrupted or setup.explained is not None:
            return None
        # What explains the data in part is no delay that is finer than the model's own steps.
        if not rest.calibrated:
            further = without_short_delays(setup, searched)
        else:
            further = in_exact_steps(setup, searched)
        if further is not None:
            return further
        unsure = that_may_be_nothing(setup.library, searched, self.settings.nothing)
        if unsure is not None:
            return without_worse(setup, searched, *unsure, self.settings.horizons.refused)
        further = with_known_scales(setup, searched)
        if further is not None:
            return further
        # Effects that were accepted one after another may stand for others that act together.
        doubtful = not rest.calibrated or len(searched.last.accepted) > self.settings.sure_effects
        if doubtful and not setup.compared:
            further = with_another_set(setup, searched, self.settings.sets)
            if further is not None:
                return further
            setup = replace(setup, compared=True)
        # Where known effects leave something, it may follow a law that none of them stands for.
        if searched.laws is None and self._wants_laws(setup.library, searched.last, rest):
            further = self._with_laws(setup, searched, rng)
        # A law's force is held over a physics step, which others may have been taken for.
        if further is None and not (rest.calibrated and searched.laws is None):
            further = in_shorter_steps(setup, searched, self.settings.noise)
        return further

    def _learned(
        self, setup: SearchSetup, searched: SearchedEffects, rng: np.random.Generator
    ) -> WithLearned | None:
        """Forces learned from what remains; None where laws are not among what is looked for."""
        if searched.interrupted or not (self._names_laws or self.learned):
            return None
        setup.selection.progress(0.93, "learning what nothing explains")
        return learn_forces(
            setup.problem,
            setup.selection,
            searched.first,
            searched.last,
            rng,
            self.settings.horizons,
            asked=self.learned,
            settings=self.settings.learned,
        )

    def _detectable(
        self, setup: SearchSetup, searched: SearchedEffects, verdict: str
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
        self, setup: SearchSetup, searched: SearchedEffects, rng: np.random.Generator
    ) -> tuple[SearchSetup, SearchedEffects] | None:
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
        return setup, SearchedEffects(laws.first, laws.last, laws.reviews, laws=laws)

    def _laws_beyond_windows(
        self,
        setup: SearchSetup,
        searched: SearchedEffects,
        rest: Remaining,
        after: Sequence[AfterHorizon],
    ) -> bool:
        """Whether laws are to be looked for that windows do not ask for: errors after other
        horizons are larger than noise makes them.
        """
        ended = searched.interrupted or setup.explained is not None or setup.sought
        if ended or searched.laws is not None or not self._names_laws:
            return False
        if self._wants_laws(setup.library, searched.last, rest):
            # They were looked for already.
            return False
        usual = self._usual_horizon(setup, searched.last)
        measured = are_measured(setup.problem)
        return bool(beyond_noise(after, 2, usual, self.settings.horizons, measured=measured))

    def _usual_horizon(self, setup: SearchSetup, last: State) -> int | None:
        """The horizon of windows, where the noise is known there alone: that of control steps, or
        of starts that were estimated, of which whole motions find no better ones.
        """
        rough = setup.explained is not None and bool(setup.problem.estimated)
        return setup.train.length if rough or last.train.whiten.noise.timing > 0 else None

    def _errors_after(
        self, setup: SearchSetup, searched: SearchedEffects, rng: np.random.Generator
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

    def _worse(
        self, setup: SearchSetup, after: Sequence[AfterHorizon], searched: SearchedEffects
    ) -> dict[str, Leader]:
        """The effects with which errors after some horizon are larger than without, by label.

        Of signals that were estimated, whose errors are not those of sensors, only large ones
        count; of a model that is far off, which is fitted to what is measured, none.

        after: of the model as it came, with its parameters fitted, with everything, and without
        each effect; of the first three alone where the search was interrupted.
        """
        if searched.interrupted or not after:
            return {}
        measured = are_measured(setup.problem)
        limits = self.settings.horizons
        of_estimated = replace(limits, worse=limits.estimated)
        found = []
        for i, instance in enumerate(searched.last.accepted):
            beyond = worse_after(after, 3 + i, 2, limits, measured=measured)
            if beyond is None and setup.explained is None and setup.problem.estimated:
                beyond = worse_after(after, 3 + i, 2, of_estimated)
            if beyond is not None:
                found.append((instance, beyond))
        found.sort(key=lambda one: -one[1].score)
        return {one.label: worse_leader(searched, one, beyond) for one, beyond in found}

    def _after_every_horizon(
        self,
        setup: SearchSetup,
        after: Sequence[AfterHorizon],
        last: State,
        rest: Remaining,
        rng: np.random.Generator,
    ) -> tuple[Remaining, tuple[str, ...]]:
        """What remains, with errors that noise does not explain after some horizon, whatever
        windows say; and what to do then, a sentence each.
        """
        settings = self.settings.horizons
        usual = self._usual_horizon(setup, last)
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
        beyond = beyond_windows(found, rest, setup.train.length)
        return replace(rest, calibrated=False, where=(*rest.where, in_words(found))), beyond

    @property
    def _names_laws(self) -> bool:
        """Whether laws are among what is looked for."""
        return self.effects is None or LAW in self.effects

    def _wants_laws(self, library: Library, last: State, rest: Remaining) -> bool:
        """Whether a law is to be looked for: something remains, an effect only acts like it, or
        several effects at a joint may be one law.
        """
        if not self._names_laws:
            return False
        if not rest.calibrated or may_stand_for_one_law(library, last):
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


def _with_learned(
    setup: SearchSetup, searched: SearchedEffects, learned: WithLearned | None
) -> tuple[SearchSetup, SearchedEffects]:
    """A search and its end with the forces that were learned, where these are used."""
    if learned is None or not learned.learned.used:
        return setup, searched
    selection = learned.selection
    setup = replace(setup, selection=selection, library=selection.library)
    return setup, replace(searched, first=learned.first, last=learned.last)


def _of_one_number(instances: Sequence[EffectInstance], last: State) -> list[EffectInstance]:
    """The effects of one number that a model does not have."""
    accepted = {one.label for one in last.accepted}
    single = [one for one in instances if len(one.quantities) == 1 and one.label not in accepted]
    return [one for one in single if one.linear_in is None and not one.variant]


def _alike_in_motions(setup: SearchSetup, searched: SearchedEffects) -> dict[str, Review]:
    """What whole motions do not tell from the effects that they bear out."""
    last = searched.last
    alike = setup.selection.settings.similarity
    named = setup.certain(last)
    simulator = robot_of(setup.problem)
    return alike_in_motions(simulator, setup.library, last, searched.reviews, named, alike)


def _is_an_end(found: Diagnosis) -> bool:
    """Whether nothing is left that another kind of search might explain."""
    return found.interrupted or found.verdict in ("consistent", "explained")
