"""What a log's equation of motion lacks: numbers with errors, and what each is mistaken for."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dropo.core.services.validation import Array
from dropo.diagnosis.parts import Alternative, Estimate
from dropo.diagnosis.regression.alike import (
    parts_of_payload,
    payload_similarities,
    term_similarities,
)
from dropo.diagnosis.regression.choice import BlockTables, Chooser
from dropo.diagnosis.regression.fit import (
    GAIN,
    LEAST_BETA,
    Fitter,
    Solution,
    root_mean_square,
)
from dropo.diagnosis.regression.terms import LoneDrive
from dropo.mjmodel.joints import actuators
from dropo.mjmodel.options import physics_step
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True, eq=False)
class FoundNumber:
    """Something that is missing.

    Attributes
    ----------
    index : int or str
        The term's place, GAIN, "delay" or "payload".
    effect, target, variant : str
        The effect.
    estimates : tuple of (str, Estimate)
        Its quantities.
    named : bool
        Whether it is certain and large enough to be a cause.
    unknown : bool
        Whether its force is large, but its error is larger than the number.
    """

    index: int | str
    effect: str
    target: str | None
    variant: str
    estimates: tuple[tuple[str, Estimate], ...]
    named: bool
    unknown: bool

    @property
    def label(self) -> str:
        """Such as "payload:hand"."""
        return self.effect if self.target is None else f"{self.effect}:{self.target}"


@dataclass(frozen=True, eq=False)
class Missing:
    """What is missing from an equation of motion, with its errors.

    Attributes
    ----------
    fitter : Fitter
        The equation and its terms.
    chooser : Chooser
        How they were chosen.
    solution : Solution
        The numbers.
    errors : (k,) array
        Standard errors: of the rows, of the kernels' widths, and of the model's physics step.
    large : float
        The fraction of the drives' force from which a term is named, however uncertain its size.
    bodies : sequence of str
        Names of the moving bodies.
    or_lags : bool
        Whether a lag of commands explains about as much as their delay.
    """

    fitter: Fitter
    chooser: Chooser
    solution: Solution
    errors: Array
    large: float
    bodies: Sequence[str]
    or_lags: bool = False

    @property
    def left(self) -> float:
        """RMS of the forces that are left, as a fraction of the drives'."""
        return self._left(self.solution)

    @property
    def left_as_it_came(self) -> float:
        """RMS of the forces that the model as it came leaves, as a fraction of the drives'."""
        return self._left(self.fitter.start(()))

    def _left(self, solution: Solution) -> float:
        """RMS over joints of what is left, each as a fraction of its drive's force."""
        equation = self.fitter.equation
        residuals = np.where(equation.used, self.fitter.residuals(solution), np.nan)
        drive = np.maximum(root_mean_square(self.fitter.forces(solution.delay)), 1e-300)
        return float(np.sqrt(np.mean((root_mean_square(residuals) / drive) ** 2)))

    def numbers(self, simulator: RobotSimulator, certain: float) -> list[FoundNumber]:
        """List all numbers that were fitted, with their errors.

        Parameters
        ----------
        simulator : RobotSimulator
            The robot, for the names of its drives.
        certain : float
            Standard errors that a number must be away from 0 to be a cause.

        Returns
        -------
        list of FoundNumber
            The gain, the terms, the payload and the delay, as far as they are there.
        """
        solution = self.solution
        errors = self.errors.tolist()
        model = simulator.model
        drives = actuators(model)
        everywhere = drives[0].name if len(drives) == 1 else None
        found = []
        shares = self.chooser.term_forces(solution)

        def add(
            index: int | str, place: tuple[str, str | None, str], least: float, **sizes: Estimate
        ) -> None:
            first = next(iter(sizes.values()))
            known = abs(first.value) > first.se
            asked = least == -np.inf
            named = (asked and known) or abs(first.value) > max(least, certain * first.se)
            unknown = asked and not known
            found.append(FoundNumber(index, *place, tuple(sizes.items()), named, unknown))

        if GAIN in solution.chosen:
            gain = Estimate(solution.gain, errors.pop(0) / solution.beta**2, "1", 1.0)
            add(GAIN, ("actuator_gain", everywhere, ""), 0.0, gain=gain)
        for i in solution.terms:
            term = self.fitter.terms[i]
            size = Estimate(float(solution.sizes[i]), errors.pop(0), term.unit, term.model)
            # A number that ends at its bound is no cause: something else may act like it.
            least = np.inf if self.at_bound(i) else term.least * (1 + solution.gain)
            # Beside a payload the scale of all forces may be uncertain; a large force is there.
            large = solution.payload is not None and shares[i] > self.large
            large = large and not self.fitter.equation.floating
            if large and abs(size.value) > least:
                least = -np.inf
            if term.drive is not None:
                quantity = "bias"
                size = self._as_bias(size, term.drive)
                least /= abs(term.drive.per_command)
            else:
                quantity = term.quantity
            add(i, self._places_of(i)[0], least, **{quantity: size})
        payload = solution.payload
        if payload is not None:
            sizes = {"mass": Estimate(payload.mass, errors.pop(0), "kg", None)}
            for letter, value in zip("xyz", payload.place, strict=True):
                error = errors.pop(0)
                # Motions may not tell a coordinate, such as the height where all axes are upright.
                if error < self.fitter.reaches[payload.body]:
                    sizes[letter] = Estimate(float(value), error, "m", None)
            # Data held out ask for it, if its mass is uncertain beside the drives' gain.
            add("payload", ("payload", self.bodies[payload.body], ""), -np.inf, **sizes)
        # A simulation of the model acts early by itself: what is to be typed makes up for that.
        delay = Estimate(solution.delay - self.fitter.own_delay, errors.pop(0), "s", None)
        if delay.value > 0:
            effect, name = ("actuator_delay", "delay")
            if self.fitter.equation.lagging:
                effect, name = ("actuator_lag", "time constant")
            add("delay", (effect, everywhere, ""), physics_step(model), **{name: delay})
        return found

    def _as_bias(self, load: Estimate, drive: LoneDrive) -> Estimate:
        """A joint's load as an offset of the command of its drive, whose gain may be another."""
        gain = 1 + self.solution.gain
        for i in self.solution.terms:
            term = self.fitter.terms[i]
            if term.effect == "actuator_gain" and term.target == drive.name:
                gain += float(self.solution.sizes[i])
        force = max(gain, LEAST_BETA) * drive.per_command
        return Estimate(load.value / force, load.se / abs(force), "command", None)

    def at_bound(self, i: int) -> bool:
        """Tell whether the total of a term's number is 0, the least that it may be.

        Parameters
        ----------
        i : int
            The term's index.

        Returns
        -------
        bool
        """
        lowest = self.fitter.terms[i].lowest
        return bool(self.solution.sizes[i] <= lowest + 1e-6 * abs(lowest))

    def is_certain_gain(self, certain: float) -> bool:
        """Tell whether the gain of all drives is known to be wrong.

        Parameters
        ----------
        certain : float
            Standard errors that it must be away from 0.

        Returns
        -------
        bool
            Also where it is not among the numbers.
        """
        if GAIN not in self.solution.chosen:
            return True
        error = float(self.errors[0]) / self.solution.beta**2
        return abs(self.solution.gain) > certain * error

    @cached_property
    def may_have_any_gain(self) -> bool:
        """Whether no motion tells the scale of all forces, of which a payload's is a part."""
        solution = self.solution
        if GAIN in solution.chosen:
            return float(self.errors[0]) > solution.beta
        return solution.payload is not None and self.fitter.may_have_any_gain(solution)

    def with_own_gain(self) -> "Missing":
        """Fit all other numbers again with the drives' gain as the model has it.

        Returns
        -------
        Missing
            With the standard errors of the rows alone; itself where it has that gain.
        """
        if GAIN not in self.solution.chosen:
            return self
        solution = self.fitter.refined(self.without(GAIN))
        errors = np.sqrt(np.diagonal(self.fitter.covariance(solution)))
        return replace(self, solution=solution, errors=errors)

    def certain_numbers(self, certain: float) -> int:
        """Count the terms, and the payload, that are certain.

        Parameters
        ----------
        certain : float
            Standard errors that a number must be away from 0.

        Returns
        -------
        int
            Without the gain and the delay of all drives.
        """
        solution = self.solution
        first = int(GAIN in solution.chosen)
        count = 0
        for i, error in zip(solution.terms, self.errors[first:].tolist(), strict=False):
            least = max(self.fitter.terms[i].least, certain * error)
            count += not self.at_bound(i) and abs(float(solution.sizes[i])) > least
        if solution.payload is not None:
            error = float(self.errors[first + len(solution.terms)])
            count += solution.payload.mass > certain * error
        return count

    def doubtful(self, certain: float, negligible: float) -> int | str | None:
        """Find the least certain number, if it is not certain.

        The gain of all drives is none: left out, others would make up for it. Nor are the laws of
        several joints, unless they are negligible and share no scale with a weight.

        Parameters
        ----------
        certain : float
            Standard errors within which of 0 a number is not certain.
        negligible : float
            The same within which a law of several joints is negligible.

        Returns
        -------
        int or None
            The term's index; None where all are certain.
        """
        solution = self.solution
        errors = self.errors.tolist()
        ratios: dict[int | str, float] = {}
        if GAIN in solution.chosen:
            # It stays free: were it left out, all other numbers would be off by its factor.
            errors.pop(0)
        laws = self.chooser.of_laws(solution)
        shared = self.chooser.has_weight_and_laws(solution)
        for i in solution.terms:
            ratio = abs(float(solution.sizes[i])) / errors.pop(0)
            if i not in laws:
                ratios[i] = ratio / certain
            elif not shared:
                ratios[i] = ratio / negligible
        least = min(ratios, key=lambda index: ratios[index], default=None)
        return None if least is None or ratios[least] > 1 else least

    def without(self, index: int | str) -> Solution:
        """Take out one of the numbers, the rest as it is.

        Parameters
        ----------
        index : int or str
            A term's index, `GAIN`, "delay" or "payload".

        Returns
        -------
        Solution
            Without it; of the delay, with that of the model's own simulation.
        """
        solution = self.solution
        if index == "delay":
            return replace(solution, delay=self.fitter.own_delay)
        if index == "payload":
            return replace(solution, payload=None)
        sizes = solution.sizes.copy()
        if index != GAIN:
            sizes[int(index)] = 0.0
        gain = 0.0 if index == GAIN else solution.gain
        chosen = tuple(i for i in solution.chosen if i != index)
        return replace(solution, chosen=chosen, sizes=sizes, gain=gain)

    def gain_without(self, index: int | str) -> tuple[float, float]:
        """Compute what a number gains on data held out.

        Everything is fitted again without each fold in turn.

        Parameters
        ----------
        index : int or str
            A term's index, `GAIN`, "delay" or "payload".

        Returns
        -------
        gain, error : float
            The gain and its standard error by blocks [nats per row of the equation].
        """
        without = self.without(index)
        # The tables of blocks depend on the delay, not on what is chosen.
        tables = self.chooser.tables(without) if index == "delay" else self._tables
        gains = 0.5 * (self.chooser.held_out(without, tables) - self._held_out)
        rows = len(self.fitter.equation)
        return float(gains.sum()) / rows, float(gains.std(ddof=1) * np.sqrt(len(gains))) / rows

    @cached_property
    def _tables(self) -> BlockTables:
        """The tables of the blocks for all numbers."""
        return self.chooser.tables(self.solution)

    @cached_property
    def _held_out(self) -> Array:
        """(B,) the squared error of each block held out, with all numbers."""
        return self.chooser.held_out(self.solution, self._tables)

    def left_without(self, index: int | str) -> float:
        """Compute what is left without a number, the others fitted again.

        Parameters
        ----------
        index : int or str
            A term's index, `GAIN`, "delay" or "payload".

        Returns
        -------
        float
            RMS of the forces that are left, as a fraction of the drives'.
        """
        return self._left(self.fitter.solve(self.without(index)))

    def alternatives(
        self, index: int | str, similarity: float, same: float = np.inf
    ) -> tuple[Alternative, ...]:
        """Find what has the same forces as a number, with all other numbers fitted again.

        Parameters
        ----------
        index : int or str
            A term's index, `GAIN`, "delay" or "payload".
        similarity : float
            Cosine of the two forces above which data cannot tell them apart.
        same : float
            That of a number and changes of a payload above which it is a part of that, in whatever
            motion.

        Returns
        -------
        tuple of Alternative
            The most similar first, payloads among them; none of a delay.
        """
        if index == "delay":
            return ()
        places: dict[tuple[str, str | None, str], float] = {}
        if index != "payload":
            cosines = term_similarities(self.fitter, self.solution, int(index))
            for i, cosine in enumerate(cosines.tolist()):
                places |= dict.fromkeys(self._places_of(i), cosine)
            if index != GAIN:  # what else the number itself is
                places |= dict.fromkeys(self._places_of(int(index))[1:], 1.0)
        if index == "payload" or self.solution.payload is None:
            without = self.without(index)
            for body, cosine in payload_similarities(self.fitter, self.solution, without).items():
                places["payload", self.bodies[body], ""] = cosine
        alike = [place for place in places if places[place] > similarity]
        alike.sort(key=lambda place: -places[place])
        found = [Alternative(*place, why=f"similarity {places[place]:.3f}") for place in alike]
        if index == "payload":
            parts = np.flatnonzero(parts_of_payload(self.fitter, self.solution) > same).tolist()
            why = "a payload of another mass at another place has it too"
            found += [Alternative(*place, why=why) for i in parts for place in self._places_of(i)]
        return tuple(found)

    def _places_of(self, i: int) -> list[tuple[str, str | None, str]]:
        """The effect, target and variant of a term; after the last one, of the drives' gain.

        The load of a joint is first of all an offset of its drive.
        """
        if i == len(self.fitter.terms):
            return [("actuator_gain", None, "")]
        term = self.fitter.terms[i]
        own = (term.effect, term.target, term.variant)
        if term.drive is None:
            return [own]
        return [("actuator_bias", term.drive.name, ""), own]

    def rivals(self, effect: str, target: str | None) -> tuple[Alternative, ...]:
        """Name what explains as much otherwise: a lag in the place of a delay, the inertial numbers
        of a body in that of a payload and gains together.

        Parameters
        ----------
        effect : str
            What was found.
        target : str or None
            Where.

        Returns
        -------
        tuple of Alternative
            None where it is neither a delay nor a payload or gain, or nothing explains as much.
        """
        if effect == "actuator_delay" and self.or_lags:
            why = "a lag of commands leaves about as much force unexplained"
            return (Alternative("actuator_lag", target, "", why=why),)
        rival = self.chooser.rival
        if rival is None or effect not in ("payload", "actuator_gain"):
            return ()
        terms = [self.fitter.terms[i] for i in rival.terms]
        heavier = next(term for term in terms if term.family == "mass")
        why = "payload and gains together act like a heavier body, with its centre and inertia"
        return (Alternative(heavier.effect, heavier.target, heavier.variant, why=why),)


def values_of(solution: Solution) -> Array:
    """List the numbers in the order of their covariance.

    Parameters
    ----------
    solution : Solution
        The numbers.

    Returns
    -------
    (k,) array
        One over the gain's factor where it is free, the terms' sizes, the payload's mass and place,
        and the delay.
    """
    values = [solution.beta] if GAIN in solution.chosen else []
    values += solution.sizes[solution.terms].tolist()
    if solution.payload is not None:
        values += [solution.payload.mass, *solution.payload.place.tolist()]
    return np.array([*values, solution.delay])
