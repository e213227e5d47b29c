"""A diagnosis by regression alone: what the forces of a log lack, in a second or two.

Hardly anything is simulated, so what acts through the simulation alone (play, dead zones, lags) is
not looked for, and what is found is a start for a search by simulation. Of a machine that touches
the ground, short windows are simulated for the friction there.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace

import numpy as np

from dropo.core.contracts.effect import ActiveEffects, EffectInstance, instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.tails import student_tail
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.blas_threads import one_blas_thread
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, require
from dropo.diagnosis.findings.premises.chattering import chattering_sentences
from dropo.diagnosis.findings.premises.short import ShortSettings, short_sentences
from dropo.diagnosis.findings.premises.still import StillSettings, still_sentences
from dropo.diagnosis.findings.to_type import to_type
from dropo.diagnosis.parts import Cause, Estimate
from dropo.diagnosis.regression.alike import most_plausible
from dropo.diagnosis.regression.choice import ChoiceSettings, Chooser
from dropo.diagnosis.regression.contacts import (
    ContactSettings,
    FoundFriction,
    find_friction,
    knows_starts,
)
from dropo.diagnosis.regression.equation import (
    Equation,
    EquationSettings,
    coupled_joints,
    equation_of,
    independent_joints,
)
from dropo.diagnosis.regression.fit import GAIN, FitSettings, Fitter, Solution, root_mean_square
from dropo.diagnosis.regression.missing import FoundNumber, Missing, values_of
from dropo.diagnosis.regression.readings import sides
from dropo.diagnosis.regression.resimulation import ResimulationSettings, resimulated
from dropo.diagnosis.regression.result import JointForces, QuickDiagnosis, WiringFault
from dropo.diagnosis.regression.terms import Term, terms_of
from dropo.diagnosis.regression.wiring import wiring_faults
from dropo.diagnosis.search.library import plugin_effects, robot_of
from dropo.diagnosis.search.plausibility import Plausibility
from dropo.effects.bodies.payload import FAR
from dropo.mjmodel.bodies import extent, moving_bodies, moving_mass
from dropo.mjmodel.joints import joints
from dropo.mjmodel.options import physics_step
from dropo.mjmodel.robot_simulator import RobotSimulator
from dropo.mjmodel.tendons import moved_by_tendons


@dataclass(frozen=True)
class QuickSettings:
    """Numbers that decide in a diagnosis by regression.

    Attributes
    ----------
    checked : float
        The fraction of the trajectories, or of each where they are few, that is held out where the
        problem holds out no data.
    certain : float
        Standard errors that a number must be away from 0.
    negligible : float
        Standard errors from 0 within which a law is left out at one of the joints that have it.
    large : float
        The fraction of the drives' force from which a number is named although its size is not
        certain: where a gain and a payload share the scale of all forces, all sizes are uncertain.
    reach : float
        How far a payload may be from the origin of its body, in extents of the body.
    bias : float
        The fraction of every number, with what the model has of it, that is added to its error, for
        what smoothing does to it.
    widen : float
        The factor on the kernels' widths with which all numbers are estimated once more; what
        changes is part of their standard errors.
    explained : float
        The force that is left on data held out, as a fraction of the drives', below which nothing
        remains to be explained.
    similarity : float
        The cosine of two terms' forces, with all others projected out, from which data can not
        tell them apart.
    plausibility : Plausibility
        How usual each effect is: of two that the data cannot tell apart, the more usual is named.
    same : float
        The same from which a rotor's force is that of a gain whatever moves: the scale of all
        forces is not told then.
    scale : float
        How well that scale is thought known then, as a standard deviation; every number has it.
    alike : float
        Columns are read otherwise only if numbers that are missing leave so many times the force.
    equation : EquationSettings
        How a log becomes an equation.
    fit : FitSettings
        How numbers are fitted.
    choice : ChoiceSettings
        When they are accepted.
    resimulation : ResimulationSettings
        When, and how, motions are simulated with the numbers found, to find them there again: what
        changes is part of their standard errors.
    contacts : ContactSettings
        How the friction of contacts is found, where the base is free.
    still : StillSettings
        When a joint hardly moves, which is said.
    short : ShortSettings
        When data are short, which is said.
    """

    checked: float = 0.2
    certain: float = 3.0
    negligible: float = 1.0
    large: float = 0.03
    reach: float = FAR
    bias: float = 0.02
    widen: float = 1.4
    explained: float = 0.1
    similarity: float = 0.98
    plausibility: Plausibility = field(default_factory=Plausibility)
    same: float = 0.9999
    scale: float = 0.2
    alike: float = 2.0
    equation: EquationSettings = field(default_factory=EquationSettings)
    fit: FitSettings = field(default_factory=FitSettings)
    choice: ChoiceSettings = field(default_factory=ChoiceSettings)
    resimulation: ResimulationSettings = field(default_factory=ResimulationSettings)
    contacts: ContactSettings = field(default_factory=ContactSettings)
    still: StillSettings = field(default_factory=StillSettings)
    short: ShortSettings = field(default_factory=ShortSettings)


@dataclass(frozen=True)
class QuickDiagnose:
    """A diagnosis by regression over inverse dynamics.

    Attributes
    ----------
    settings : QuickSettings
        Numbers that decide.
    """

    _: KW_ONLY
    settings: QuickSettings = field(default_factory=QuickSettings)

    def run(self, problem: Problem) -> QuickDiagnosis:
        """Find the forces that a problem's model lacks.

        Parameters
        ----------
        problem : Problem
            Measured joint positions and commands, and a MuJoCo model of hinges and slides, from a
            fixed base or from a free one whose pose is measured.

        Returns
        -------
        QuickDiagnosis

        Raises
        ------
        Incompatible
            If the robot is not one of hinges and slides (and free bases) whose positions are all
            observed and whose drives' forces are known from the state.
        BadArgument
            If the problem is none, no trajectory is long enough, or nothing moves.
        """
        expected = "a Problem, which dropo.load makes of a name or a file"
        require(isinstance(problem, Problem), "problem", expected, problem, "QuickDiagnose")
        begun = time.perf_counter()
        with one_blas_thread():
            found = self._run(problem)
        return replace(found, wall_time_s=time.perf_counter() - begun)

    def _run(self, problem: Problem) -> QuickDiagnosis:
        simulator = robot_of(problem)
        before = simulator.steps
        fitted, checked = sides(problem, self.settings.checked)
        faults = wiring_faults(problem)
        estimate = estimate_missing(problem, fitted, self.settings)
        estimate = _with_bias(problem, fitted, estimate, self.settings)
        unscaled = estimate.may_have_any_gain
        estimate = _with_scale(estimate, self.settings)
        numbers = estimate.numbers(simulator, self.settings.certain)
        unknown = [number.label for number in numbers if number.unknown]
        chattering = chattering_sentences(problem)
        causes = [] if chattering else self._causes(numbers, estimate)
        still = still_sentences(problem, self.settings.still)
        short = short_sentences(problem, self.settings.short)
        warnings = [*problem.warnings, *short, *still, *chattering]
        warnings += _warnings(simulator, estimate, bool(causes))
        warnings += _not_looked_for(simulator)
        if unscaled:
            warnings.append(
                "No motion tells the scale of all forces: the drives' gain is taken as it is."
            )
        if unknown:
            warnings.append(
                f"The data do not tell {', '.join(unknown)}, whose force is large: the error is "
                "larger than the number."
            )
        try:
            equation = _equation_like(
                estimate, problem, checked, self.settings, estimate.fitter.equation.width
            )
        except BadArgument:
            equation = estimate.fitter.equation
            warnings.append(
                "too little is held out for smoothing: the forces are those of the fitted data."
            )
        forces = self._forces(problem, equation, estimate, bool(causes))
        if faults and not (causes and self._explain_as_much(numbers, forces, faults)):
            causes = []
            forces = self._forces(problem, equation, estimate, found=False)
        else:
            faults = ()
        extended = _extended(problem, estimate) if causes else problem
        friction = None
        if not (faults or unknown or chattering):
            own = robot_of(extended).without_parameters()
            friction = self._friction(own, fitted, estimate)
            simulator.steps += own.steps
        if friction is not None:
            causes.append(_cause_of(friction))
            extended = _with_friction(extended, friction)
        by_smoothing = self._left_by_smoothing(extended, checked, estimate, forces)
        if by_smoothing:
            warnings.append(
                f"At {', '.join(map(repr, by_smoothing))} a motion simulated by the model leaves "
                "as much force: rows so far apart do not show what drives so stiff do between them."
            )
        return QuickDiagnosis(
            name=problem.name,
            verdict=self._verdict(
                causes, forces, by_smoothing, bool(faults or unknown or chattering)
            ),
            causes=tuple(causes),
            faults=faults,
            forces=forces,
            problem=extended,
            to_type=to_type(problem, extended, {}) if causes else (),
            warnings=tuple(warnings),
            simulator_steps=simulator.steps - before,
        )

    def _causes(self, numbers: list[FoundNumber], estimate: Missing) -> list[Cause]:
        """Every number that is missing as a cause, the one that gains most first."""
        found = []
        blocks = len(np.unique(estimate.fitter.equation.block))
        tries = len(estimate.fitter.terms) + 3
        for number in numbers:
            if not number.named:
                continue
            gain, error = estimate.gain_without(number.index)
            z = abs(number.estimates[0][1].value) / max(number.estimates[0][1].se, 1e-300)
            found.append(
                Cause(
                    effect=number.effect,
                    target=number.target,
                    variant=number.variant,
                    estimate=dict(number.estimates),
                    p_value=float(min(1.0, tries * 2 * student_tail(z, max(blocks - 1, 1)))),
                    held_out_gain=gain,
                    held_out_gain_se=error,
                    rmse_before=estimate.left_without(number.index),
                    rmse_after=estimate.left,
                    confused_with=(
                        *estimate.rivals(number.effect, number.target),
                        *estimate.alternatives(
                            number.index, self.settings.similarity, self.settings.same
                        ),
                    ),
                )
            )
        found.sort(key=lambda cause: -cause.held_out_gain)
        return found

    def _friction(
        self, simulator: RobotSimulator, fitted: Trajectories, estimate: Missing
    ) -> FoundFriction | None:
        """The friction of contacts, where the base is free and another one than the model's."""
        if not estimate.fitter.equation.floating or not knows_starts(simulator):
            return None
        settings = self.settings
        found = find_friction(simulator, fitted, settings.bias, settings.contacts)
        return found if found is not None and found.is_certain(settings.certain) else None

    def _forces(
        self, problem: Problem, equation: Equation, estimate: Missing, found: bool
    ) -> tuple[JointForces, ...]:
        """What the drives give at each joint along data held out, and what is not explained."""
        simulator = robot_of(problem)
        terms = terms_of(simulator, equation, along_tendons=estimate.fitter.along_tendons)
        by_label = {(term.label, term.quantity): i for i, term in enumerate(terms)}
        fitter = replace(estimate.fitter, equation=equation, terms=terms)
        solution = estimate.solution
        sizes = np.zeros(len(terms))
        chosen = [i for i in solution.chosen if i == GAIN]
        for i in solution.terms:
            term = estimate.fitter.terms[i]
            place = by_label.get((term.label, term.quantity))
            if place is not None:
                sizes[place] = solution.sizes[i]
                chosen.append(place)
        after = replace(solution, sizes=sizes, chosen=tuple(chosen))
        nothing = fitter.start(())
        before = np.where(equation.used, fitter.residuals(nothing), np.nan)
        if not found:
            # By how much the model's own physics step acts early is nothing that it lacks.
            alone = estimate.fitter.refined(estimate.fitter.start(()))
            after = replace(nothing, delay=alone.delay)
        left = np.where(equation.used, fitter.residuals(after), np.nan)
        force = root_mean_square(fitter.forces(solution.delay))
        own = independent_joints(simulator)
        dofs = [joint.qvel for joint in own]
        rows = zip(
            own,
            force[dofs],
            root_mean_square(before)[dofs],
            root_mean_square(left)[dofs],
            equation.used.mean(axis=0)[dofs],
            strict=True,
        )
        return tuple(
            JointForces(joint.name, joint.force, float(f), float(b), float(a), float(share))
            for joint, f, b, a, share in rows
        )

    def _explain_as_much(
        self,
        numbers: list[FoundNumber],
        forces: tuple[JointForces, ...],
        faults: tuple[WiringFault, ...],
    ) -> bool:
        """Whether numbers that are missing explain as much as columns that are read otherwise.

        A payload, of which readings know nothing but its weight, may look like another sign or
        unit. A drive that would give next to nothing explains nothing: turned, it is fitted so.
        """
        gains = [one.estimates[0][1].value for one in numbers if one.effect == "actuator_gain"]
        if any(1 + gain < self.settings.choice.idle for gain in gains):
            return False
        by_name = {joint.joint: joint for joint in forces}
        for fault in faults:
            if fault.evidence is None:
                return False
            most = self.settings.alike * fault.evidence.after
            named = [by_name[name] for name in fault.target.split(", ") if name in by_name]
            if any(joint.after > most * joint.drive for joint in named):
                return False
        return True

    def _is_left(self, joint: JointForces, floor: float = 0.0) -> bool:
        """Whether force remains to be explained at a joint, beside what is left in any case."""
        return joint.after**2 - floor**2 > (self.settings.explained * joint.drive) ** 2

    def _left_by_smoothing(
        self,
        extended: Problem,
        checked: Trajectories,
        estimate: Missing,
        forces: tuple[JointForces, ...],
    ) -> tuple[str, ...]:
        """The joints whose force is left by what smoothing does to the log, not by the machine.

        The same is left where the truth is known: in motions that are simulated.
        """
        doubtful = [joint for joint in forces if self._is_left(joint)]
        floating = estimate.fitter.equation.floating
        again = None
        if doubtful and not floating:
            simulator = robot_of(extended)
            again = resimulated(simulator, checked, self.settings.resimulation)
        if again is None:
            return ()
        try:
            equation = _equation_like(
                estimate, extended, again, self.settings, estimate.fitter.equation.width
            )
        except BadArgument:
            return ()
        fitter = _fitter(simulator, equation, self.settings, estimate.fitter.along_tendons)
        left = np.where(equation.used, fitter.residuals(fitter.refined(fitter.start(()))), np.nan)
        floor = root_mean_square(left)
        places = {joint.name: joint.qvel for joint in joints(simulator.model)}
        return tuple(
            joint.joint
            for joint in doubtful
            if not self._is_left(joint, float(floor[places[joint.joint]]))
        )

    def _verdict(
        self,
        causes: list[Cause],
        forces: tuple[JointForces, ...],
        by_smoothing: tuple[str, ...],
        faulty: bool,
    ) -> str:
        """The finding in a word, by the forces that are left on data held out.

        by_smoothing: joints where these are not the machine's; faulty: the wiring is wrong, or what
        explains a large force is not known.
        """
        left = [joint for joint in forces if joint.joint not in by_smoothing]
        wrong = faulty or any(map(self._is_left, left))
        if causes:
            return "partly" if wrong else "explained"
        return "unexplained" if wrong else "consistent"


def estimate_missing(
    problem: Problem, trajectories: Trajectories, settings: QuickSettings
) -> Missing:
    """Choose and fit what the equation of motion lacks along measured trajectories.

    Parameters
    ----------
    problem : Problem
        Its robot.
    trajectories : Trajectories
        What was measured.
    settings : QuickSettings
        Numbers that decide.

    Returns
    -------
    Missing

    Raises
    ------
    Incompatible, BadArgument
        As of `equation_of`.
    """
    late = _estimated(problem, trajectories, settings)
    # Where motions do not tell the scale of forces, what smoothing does looks like a lag.
    if late.may_have_any_gain or not late.chooser.is_late(late.solution):
        return late
    lagging = replace(settings, equation=replace(settings.equation, lagging=True))
    lags = _estimated(problem, trajectories, lagging)
    things, by_delay = late.chooser.criterion_of_things(late.solution)
    fewer, by_lag = lags.chooser.criterion_of_things(lags.solution)
    least = settings.choice.lag * float(late.fitter.equation.used.sum())
    gain = by_delay - by_lag
    if gain > least or (gain > 0 and fewer < things):
        return lags
    return replace(late, or_lags=gain > 0)


def _estimated(problem: Problem, trajectories: Trajectories, settings: QuickSettings) -> Missing:
    """What is missing where commands are late, or lag."""
    simulator = robot_of(problem)
    equation = equation_of(problem, trajectories, settings.equation)
    wide_equation = equation_of(
        problem, trajectories, settings.equation, width=settings.widen * equation.width
    )
    chooser, solution = _chosen(simulator, equation, settings)
    fitter = chooser.fitter
    wide = _fitter(simulator, wide_equation, settings, fitter.along_tendons)
    solution = most_plausible(fitter, solution, settings.similarity, settings.plausibility)
    bodies = [name for _, name in moving_bodies(simulator.model)]
    while True:
        errors = _errors(simulator, fitter, wide, solution, settings)
        found = Missing(fitter, chooser, solution, errors, settings.large, bodies)
        doubtful = found.doubtful(settings.certain, settings.negligible)
        if doubtful is None:
            return found
        solution = fitter.refined(fitter.solve(found.without(doubtful)))


def _equation_like(
    estimate: Missing,
    problem: Problem,
    trajectories: Trajectories,
    settings: QuickSettings,
    width: float | None = None,
) -> Equation:
    """An equation whose commands are late as those of an estimate are."""
    own = replace(settings.equation, lagging=estimate.fitter.equation.lagging)
    return equation_of(problem, trajectories, own, width=width)


def _chosen(
    simulator: RobotSimulator, equation: Equation, settings: QuickSettings
) -> tuple[Chooser, Solution]:
    """What is chosen; where drives pull tendons, of laws along these or at the joints."""
    chooser = Chooser(_fitter(simulator, equation, settings, along_tendons=True), settings.choice)
    solution = chooser.run()
    if equation.by_joint or not moved_by_tendons(simulator.model):
        return chooser, solution
    other = Chooser(_fitter(simulator, equation, settings, along_tendons=False), settings.choice)
    at_joints = other.run()
    margin = settings.choice.decisive
    if other.criterion(at_joints) < chooser.criterion(solution) - margin:
        return other, at_joints
    return chooser, solution


def _errors(
    simulator: RobotSimulator,
    fitter: Fitter,
    wide: Fitter,
    solution: Solution,
    settings: QuickSettings,
) -> Array:
    """(k,) standard errors: by rows, by the kernels' width, by the physics step, and by smoothing.

    wide: the same equation with wider kernels.
    """
    values = values_of(solution)
    by_rows = np.maximum(np.diag(fitter.covariance(solution)), 0.0)
    moved = np.full(len(values), np.inf)
    if [term.label for term in wide.terms] == [term.label for term in fitter.terms]:
        own = wide.start(solution.chosen)
        again = replace(solution, weights=own.weights, spread=own.spread)
        moved = values_of(wide.refined(wide.solve(again))) - values
    step = np.zeros(len(values))
    offset = 1 if GAIN in solution.chosen else 0
    for place, i in enumerate(solution.terms):
        step[offset + place] = 0.5 * fitter.terms[i].least * (1 + solution.gain)
    step[-1] = 0.5 * physics_step(simulator.model)
    totals = values.copy()
    for place, i in enumerate(solution.terms):
        totals[offset + place] += fitter.terms[i].model or 0.0
    return np.sqrt(by_rows + moved**2 + step**2 + (settings.bias * totals) ** 2)


def _with_bias(
    problem: Problem, trajectories: Trajectories, estimate: Missing, settings: QuickSettings
) -> Missing:
    """The estimate, whose errors have what regression is off by where the truth is known.

    The truth are the numbers found, in motions that are simulated with them.
    """
    simulator = robot_of(problem)
    solution = estimate.solution
    if estimate.fitter.equation.floating or not solution.terms:
        return estimate
    extended = simulator.with_effects((), fixed_numbers(simulator, estimate))
    again = resimulated(extended, trajectories, settings.resimulation)
    if again is None:
        return estimate
    equation = _equation_like(estimate, problem, again, settings)
    fitter = _fitter(simulator, equation, settings, estimate.fitter.along_tendons)
    if [term.label for term in fitter.terms] != [term.label for term in estimate.fitter.terms]:
        return estimate
    own = fitter.start(solution.chosen)
    begun = replace(solution, weights=own.weights, spread=own.spread)
    bias = values_of(fitter.refined(fitter.solve(begun))) - values_of(solution)
    return replace(estimate, errors=np.hypot(estimate.errors, bias))


def _with_scale(estimate: Missing, settings: QuickSettings) -> Missing:
    """The estimate, whose errors have those of the scale of all forces where no motion tells it.

    A joint by itself, with a rotor that may be anything, is such: half the gain is twice the mass.
    """
    solution = estimate.solution
    if estimate.may_have_any_gain:
        # All numbers are those of the model's own.
        estimate = estimate.with_own_gain()
        return _with_scale_error(estimate, np.abs(values_of(estimate.solution)), settings)
    if GAIN not in solution.chosen:
        return estimate
    alike = estimate.alternatives(GAIN, settings.same)
    if not any(one.effect == "joint_armature" for one in alike):
        return estimate
    sizes = np.abs(values_of(solution))
    sizes[0] = 0.0  # the gain is one of those that are not told apart, and says so
    return _with_scale_error(estimate, sizes, settings)


def _with_scale_error(estimate: Missing, sizes: Array, settings: QuickSettings) -> Missing:
    """The estimate, whose errors have a part of the sizes (k,) of the numbers that have a scale."""
    sizes[-1] = 0.0  # a delay has no scale
    if estimate.solution.payload is not None:
        sizes[-4:-1] = 0.0
    return replace(estimate, errors=np.hypot(estimate.errors, settings.scale * sizes))


def fixed_numbers(simulator: RobotSimulator, estimate: Missing) -> ActiveEffects:
    """Return all numbers that were fitted together, as effects with their magnitudes.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.
    estimate : Missing
        What it lacks. Numbers that are no causes by themselves belong to the others' values.

    Returns
    -------
    sequence of (EffectInstance, (q,) array)
    """
    return as_effects(simulator, estimate.numbers(simulator, 0.0))


def as_effects(simulator: RobotSimulator, numbers: Sequence[FoundNumber]) -> ActiveEffects:
    """Return numbers that were found as effects of a robot.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.
    numbers : sequence of FoundNumber
        What it lacks.

    Returns
    -------
    sequence of (EffectInstance, (q,) array)
    """
    fixed = []
    for number in numbers:
        for instance in instances_of(simulator.effect_context, number.effect):
            if (instance.target, instance.variant) == (number.target, number.variant):
                fixed.append((instance, _magnitudes(instance, dict(number.estimates))))
    return fixed


def _extended(problem: Problem, estimate: Missing) -> Problem:
    """The problem with all numbers that were fitted together in its simulator."""
    simulator = robot_of(problem)
    fixed = fixed_numbers(simulator, estimate)
    return replace(problem, simulator=simulator.with_effects((), fixed))


def _cause_of(friction: FoundFriction) -> Cause:
    """The friction of contacts as a cause."""
    instance = friction.instance
    z = abs(friction.size) / max(friction.se, 1e-300)
    return Cause(
        effect=instance.effect,
        target=instance.target,
        variant=instance.variant,
        estimate={
            instance.quantities[0].name: Estimate(friction.size, friction.se, "1", 1.0),
        },
        p_value=float(min(1.0, 2 * student_tail(z, max(friction.blocks - 1, 1)))),
        held_out_gain=friction.gain,
        held_out_gain_se=friction.gain_se,
        rmse_before=friction.before,
        rmse_after=friction.after,
    )


def _with_friction(problem: Problem, friction: FoundFriction) -> Problem:
    """The problem with the friction of contacts that was found."""
    fixed = [(friction.instance, np.array([friction.size]))]
    return replace(problem, simulator=robot_of(problem).with_effects((), fixed))


def _magnitudes(instance: EffectInstance, estimate: Mapping[str, Estimate]) -> Array:
    """(q,) the magnitudes of an effect; 0 of what was not estimated.

    A search by simulation bounds them by the model's own numbers, which may be far off.
    """
    names = [quantity.name for quantity in instance.quantities]
    return np.array([estimate[name].value if name in estimate else 0.0 for name in names])


def _warnings(simulator: RobotSimulator, estimate: Missing, causes: bool) -> list[str]:
    """What makes the numbers, if there are causes, less certain than their errors say."""
    found = []
    for i in estimate.solution.terms if causes else ():
        term = estimate.fitter.terms[i]
        if term.lowest < 0 and estimate.at_bound(i):
            found.append(
                f"{term.label}: the total is at its bound, 0. Something else may act like it."
            )
    for instance, _ in simulator.fixed:
        written = instance.model is not None and not instance.general
        if not (written or instance.command or instance.actuation):
            found.append(f"{instance.label} of the simulator is not known to the regression.")
    if estimate.fitter.equation.floating:
        looked_for = "" if knows_starts(simulator) else ", without velocities their friction too"
        found.append(
            "The base is free: contact forces are unknown and projected out, and what they alone "
            f"show, as how soft the ground is, is not looked for{looked_for}."
        )
    driven = estimate.fitter.equation.driven
    for one in coupled_joints(simulator):
        found.append(
            f"{one.name!r} follows {one.leader!r}: a rotor, friction or a spring at either is told "
            "as one of the latter."
        )
    for joint in independent_joints(simulator):
        if not driven[joint.qvel]:
            found.append(
                f"No drive acts at {joint.name!r}: what is found there is rough, and its errors "
                "are too small."
            )
    return found


def _not_looked_for(simulator: RobotSimulator) -> list[str]:
    """That effects of plug-ins, which the robot could have, are unknown to the regression."""
    unknown = plugin_effects(simulator)
    if not unknown:
        return []
    return [
        f"The effects of plug-ins are not looked for by regression: {', '.join(unknown)}. A search"
        " by simulation (without --quick) does."
    ]


def _fitter(
    simulator: RobotSimulator, equation: Equation, settings: QuickSettings, along_tendons: bool
) -> Fitter:
    """What fits the numbers of an equation."""
    model = simulator.model
    reaches = [settings.reach * extent(model, body) for body, _ in moving_bodies(model)]
    terms: list[Term] = terms_of(simulator, equation, along_tendons=along_tendons)
    heaviest = moving_mass(model)
    return Fitter(equation, terms, reaches, heaviest, settings.fit, along_tendons=along_tendons)
