"""Which terms the equation of motion lacks: chosen on blocks of time that were held out."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from dropo.core.numerics.bounded_quadratic import bounded_minimum
from dropo.core.services.validation import Array
from dropo.diagnosis.regression.fit import (
    GAIN,
    LEAST_BETA,
    Fitter,
    Solution,
    root_mean_square,
)
from dropo.diagnosis.regression.terms import INERTIA, INERTIAL, LAWS, OWN_GAIN, families_of
from dropo.diagnosis.search.confirmation import signed_rank_score

Group = tuple[int, ...]

MEDIAN_VARIANCE = 5.4
"""Of n normal numbers, n times the relative variance of the square of their median size."""


@dataclass(frozen=True)
class ChoiceSettings:
    """When a group of terms is accepted.

    Attributes
    ----------
    folds : int
        Number of parts of the log, each of which is held out in turn.
    improvement : float
        Fraction by which a group must lower the squared error on data held out.
    block_z : float
        Number of standard errors, by block of time, by which that decrease must be above 0.
    force : float
        Force that a group must explain, as a fraction of the drives' at its joints.
    apart : float
        Force that gains of single drives must explain at some joint beyond what a gain of all
        drives does, as a fraction of the drive's, and a gain that counts as wrong: smoothing makes
        less than that.
    idle : float
        A drive that gives less than this fraction of its force explains nothing, nor columns' other
        reading: what its joint lacks has shrunk together with its noise.
    wald : float
        Smallest square of a term's size, in squares of its standard error, with which it is kept.
    decisive : float
        By how much other numbers must be likelier than those found first [nats].
    payload : float
        Fraction by which a payload must lower the spread of what is left at the joints.
    further : float
        Fraction by which each further thing of a solution must lower that spread, where another
        solution explains nearly as much in fewer things.
    lag : float
        Fraction by which lags of commands must lower that spread in the place of delays, which are
        more usual, where as many things are missing beside them.
    heavier : float
        Fraction by which a body is heavier than its model from which that is rather a payload.
    passes : int
        Number of times that weights, delay and payload are found in turn before anything is
        dropped.
    rounds : int
        Largest number of groups that are accepted one after another.
    """

    folds: int = 8
    improvement: float = 0.004
    block_z: float = 2.0
    force: float = 0.006
    apart: float = 0.02
    idle: float = 1 / 3
    wald: float = 16.0
    decisive: float = 3.0
    payload: float = 0.02
    further: float = 0.1
    lag: float = 0.25
    heavier: float = 0.5
    passes: int = 4
    rounds: int = 40


@dataclass(frozen=True, eq=False)
class BlockTables:
    """What a linear solve needs of each of B blocks of time.

    The columns are the model's needs where there are drives, all K terms, and 1 kg of the payload.

    Attributes
    ----------
    grams : (B, K + 2, K + 2) array
        Gram matrices of the weighted columns.
    moments : (B, K + 2) array
        Their products with the drives' forces.
    sizes : (B,) array
        The squared forces of the drives.
    """

    grams: Array
    moments: Array
    sizes: Array


@dataclass(eq=False)
class Chooser:
    """Chooses the terms that an equation of motion lacks.

    Attributes
    ----------
    fitter : Fitter
        Fits their sizes.
    settings : ChoiceSettings
        When a group is accepted.
    rival : Solution or None
        Other inertial numbers of one body that explain as much as a payload and gains, in as few
        things; these are chosen all the same, since the body would be far heavier than its model.
    """

    fitter: Fitter
    settings: ChoiceSettings = field(default_factory=ChoiceSettings)
    rival: Solution | None = field(default=None, init=False)

    def run(self) -> Solution:
        """Choose the terms that are missing, and fit them.

        The laws that every machine has come first, all of them at all joints; then what data held
        out do not ask for is dropped, others are added, and each number must stand on its own. The
        drives share one gain, unless a gain of each explains data held out better.

        Returns
        -------
        Solution
            The chosen terms with their sizes, the gain, the delay and the payload.
        """
        families = families_of(self.fitter.terms)
        own = families.pop(OWN_GAIN, ())
        families.pop(INERTIA, ())
        found = self._by_gains(families, own)
        for few in self._few(families, own):
            scaled = self._may_be_scaled(found) and self.has_weight_and_laws(few)
            if not scaled and not self._is_payload(few) and self._is_simpler(found, few):
                found = few
        if not (self._beside_laws(found) or self._has_inertia(found)):
            return found
        body = self._of_one_body(families, [i for i in found.terms if i in own])
        if body is None or not self._is_simpler(found, body):
            return found
        if self._is_payload(body):
            self.rival = body
            return found
        return body

    def _by_gains(self, families: dict[str, Group], own: Group) -> Solution:
        """What is chosen where all drives share a gain, or each has its own if that is better."""
        # Where each drive has a gain of its own, one of all drives says nothing new.
        common = self.fitter.equation.driven.any() and "gain" not in families
        shared = self._chosen_of(families, [(GAIN,)] if common else [])
        if not own or not self._is_large(shared):
            return shared
        apart = self._chosen_of({**families, OWN_GAIN: own}, [(i,) for i in own])
        return apart if self._is_better(shared, apart) else shared

    def _chosen_of(self, families: dict[str, Group], gains: list[Group]) -> Solution:
        """What is chosen of families where the drives' gains may be wrong together or apart."""
        groups = [families[name] for name in LAWS if name in families] + gains
        first = self._first(tuple(i for group in groups for i in group))
        return self._selected(first, families, groups)

    def _few(self, families: dict[str, Group], own: Group) -> list[Solution]:
        """What is chosen from nothing on, one thing after another: where little is missing.

        Also from the inertial numbers of the body that explains most: one of them alone may explain
        less than what merely acts like it.
        """
        begun = self._begun(())
        groups = [*self._candidates(families), *((i,) for i in own)]
        bodies = [self.fitter.refined(replace(begun, chosen=one)) for one in self._of_bodies()]
        starts = [begun, *sorted(bodies, key=self.fitter.badness)[:1]]
        return [self._one_by_one(start, groups) for start in starts]

    def _one_by_one(self, solution: Solution, groups: list[Group]) -> Solution:
        """The solution with one more thing as long as it explains data held out."""
        solution = self.without_needless(solution, self._one_each(solution))
        for _ in range(self.settings.rounds):
            larger = self.with_more(solution, groups, rounds=1)
            loaded = self._with_payload(solution)
            if loaded is not None and self.fitter.badness(loaded) < self.fitter.badness(larger):
                larger = loaded
            if larger is solution:
                break
            solution = larger
        return self.certain(self.without_needless(solution, self._one_each(solution)))

    def _with_payload(self, solution: Solution) -> Solution | None:
        """The solution with the payload that leaves least; None where it has one, or none helps."""
        fitter = self.fitter
        if solution.payload is not None or self._has_inertia(solution):
            return None
        best: Solution | None = None
        least = fitter.badness(solution) - self.settings.payload * float(fitter.equation.used.sum())
        for body in range(len(fitter.equation.by_inertia)):
            loaded = fitter.refined(fitter.solve(fitter.loaded(solution, (body,))))
            if loaded.payload is None or loaded.payload.mass > fitter.heaviest:
                continue
            if fitter.badness(loaded) < least:
                best = loaded
                least = fitter.badness(loaded)
        return best

    def _may_be_scaled(self, solution: Solution) -> bool:
        """Whether the gain of all drives is wrong, or too uncertain to say that it is not."""
        if GAIN not in solution.chosen:
            return False
        error = float(np.sqrt(self.fitter.covariance(solution)[0, 0]))
        return abs(solution.beta - 1) + error > self.settings.apart

    def has_weight_and_laws(self, solution: Solution) -> bool:
        """Tell whether a payload or a body's numbers share the scale of all forces with laws.

        Where a gain is free beside such, its error is that of all of them.

        Parameters
        ----------
        solution : Solution
            The numbers.

        Returns
        -------
        bool
        """
        laws = any(self.fitter.terms[i].family in LAWS for i in solution.terms)
        return laws and (solution.payload is not None or self._has_inertia(solution))

    def _has_inertia(self, solution: Solution) -> bool:
        """Whether a body's inertial numbers are among the terms."""
        return self._are_inertial(solution.chosen)

    def _of_bodies(self) -> list[Group]:
        """The inertial numbers of each body."""
        bodies: dict[str | None, Group] = {}
        for i, term in enumerate(self.fitter.terms):
            if term.family in INERTIAL:
                bodies[term.target] = (*bodies.get(term.target, ()), i)
        return list(bodies.values())

    def _of_one_body(self, families: dict[str, Group], weak: Iterable[int]) -> Solution | None:
        """What is chosen where the mass, its centre and the inertia of one body may be wrong.

        The other masses are right then, and there is no payload. weak: gains of single drives that
        may be wrong beside it.
        """
        fitter = self.fitter
        groups = [families[name] for name in LAWS if name in families] + [(i,) for i in weak]
        begun = self._begun(tuple(i for group in groups for i in group))
        loaded = [
            fitter.refined(replace(begun, chosen=(*begun.chosen, *own)))
            for own in self._of_bodies()
        ]
        if not loaded:
            return None
        return self._selected(min(loaded, key=fitter.badness), families, groups)

    def _candidates_in(self, solution: Solution) -> int:
        """How many things are missing: a law, a payload and a body's inertial numbers are one."""
        terms = self.fitter.terms
        shares = self.term_forces(solution)
        laws = [i for i in solution.terms if terms[i].family in LAWS]
        large = {terms[i].family for i in laws if shares[i] > self.settings.apart}
        bodies = {terms[i].target for i in solution.terms if terms[i].family in INERTIAL}
        late = self.is_late(solution)
        return len(large) + len(bodies) + self._beside_laws(solution) + int(late)

    def is_late(self, solution: Solution) -> bool:
        """Tell whether commands come later than in the model's simulation by a physics step.

        Parameters
        ----------
        solution : Solution
            The numbers.

        Returns
        -------
        bool
        """
        return solution.delay > -self.fitter.own_delay

    def _beside_laws(self, solution: Solution) -> int:
        """How many gains, payloads, springs and the like are missing, without laws and bodies."""
        terms = [self.fitter.terms[i] for i in solution.terms]
        found = {term.label for term in terms if term.family not in (*LAWS, *INERTIAL)}
        wrong = GAIN in solution.chosen and abs(solution.gain) > self.settings.apart
        if wrong:
            variance = float(self.fitter.covariance(solution)[0, 0])
            wrong = (solution.beta - 1) ** 2 > self.settings.wald * variance
        return len(found) + int(wrong) + int(solution.payload is not None)

    def _is_payload(self, solution: Solution) -> bool:
        """Whether a body is so much heavier than its model that it rather carries something."""
        return any(
            solution.sizes[i] > self.settings.heavier * (self.fitter.terms[i].model or 0.0)
            for i in solution.terms
            if self.fitter.terms[i].family == "mass"
        )

    def _is_simpler(self, found: Solution, other: Solution) -> bool:
        """Whether another solution explains as much in fewer things, or more in as many.

        Of as many things the likelier one is chosen, with a price for each of its numbers; what is
        likelier may also leave more at some joint. One of more things must be far likelier.
        """
        better = self.criterion(other) < self.criterion(found) - self.settings.decisive
        less = self._is_large(other, found)
        if (less and not better) or self._has_idle_drive(other):
            return False
        fewer = self._candidates_in(found) - self._candidates_in(other)
        if fewer < 0:
            price = self.settings.further * float(self.fitter.equation.used.sum())
            return self.criterion(other) - fewer * price < self.criterion(found)
        if fewer:
            return True
        return better or self._is_large(found, other)

    def _has_idle_drive(self, solution: Solution) -> bool:
        """Whether a drive by itself would give next to nothing."""
        return any(
            1 + solution.sizes[i] < self.settings.idle
            for i in solution.terms
            if self.fitter.terms[i].family == OWN_GAIN
        )

    def criterion(self, solution: Solution) -> float:
        """Compute Schwarz's criterion: the less, the better.

        Parameters
        ----------
        solution : Solution
            The numbers.

        Returns
        -------
        float
            The cost, with a price for each number that motions tell [nats].
        """
        count = len(solution.chosen) + self.is_late(solution) + self._told_of_payload(solution)
        rows = max(float(self.fitter.equation.used.sum()), 1.0)
        return self.fitter.badness(solution) + 0.5 * float(np.log(rows)) * count

    def criterion_of_things(self, solution: Solution) -> tuple[int, float]:
        """Count the things that are missing, and compute Schwarz's criterion with their price.

        Parameters
        ----------
        solution : Solution
            The numbers.

        Returns
        -------
        things : int
            A law, a payload and a body's inertial numbers are one each.
        criterion : float
            [nats]: `further` for each of them.
        """
        things = self._candidates_in(solution)
        rows = float(self.fitter.equation.used.sum())
        return things, self.criterion(solution) + self.settings.further * rows * things

    def _told_of_payload(self, solution: Solution) -> int:
        """How many numbers of the payload motions tell: its mass, and most often its place."""
        if solution.payload is None:
            return 0
        errors = np.sqrt(np.diagonal(self.fitter.covariance(solution)))[-4:-1]
        return 1 + int(np.sum(errors < self.fitter.reaches[solution.payload.body]))

    def _selected(
        self, solution: Solution, families: dict[str, Group], groups: list[Group]
    ) -> Solution:
        """The solution without groups that are needless, with what else data held out ask for."""
        solution = self.without_needless(solution, groups)
        solution = self.with_more(solution, self._candidates(families))
        singles = [(i,) for i in solution.chosen if i not in self.of_laws(solution)]
        solution = self.without_needless(solution, singles)
        return self.certain(solution)

    def _is_better(self, shared: Solution, apart: Solution) -> bool:
        """Whether drives with gains of their own explain data held out better, for certain.

        A wrong gain of all drives shows at other joints than those whose own gain is wrong.
        """
        own = [i for i in apart.terms if self.fitter.terms[i].family == OWN_GAIN]
        weak = [size for size in apart.sizes[own] if abs(size) > self.settings.apart]
        if self._has_idle_drive(apart):
            return False
        # Most drives off by the same share are the scale of the masses, or another drive.
        drives = [term for term in self.fitter.terms if term.family == OWN_GAIN]
        alike = bool(weak) and np.ptp(weak) <= self.settings.apart
        if not weak or (alike and 2 * len(weak) > len(drives)):
            return False
        reweighted = replace(apart, weights=shared.weights)
        without = self.held_out(shared, self.tables(shared))
        errors = self.held_out(reweighted, self.tables(reweighted))
        fraction, z = _worth(without, errors)
        certain = fraction > self.settings.improvement and z > self.settings.block_z
        return certain and self._is_large(shared, apart)

    def _is_large(self, solution: Solution, other: Solution | None = None) -> bool:
        """Whether a solution leaves a large force, or a larger one by as much than another.

        By more, too, than the spreads of so many rows differ by chance.
        """
        forces = root_mean_square(self.fitter.forces(solution.delay))
        squares = np.where(forces > 0, self.fitter.spread_of_drives(solution), 0.0) ** 2
        explained = squares
        if other is not None:
            explained = squares - self.fitter.spread_of_drives(other) ** 2
        rows = np.maximum(self.fitter.equation.used.sum(axis=0), 1)
        chance = squares * np.sqrt(MEDIAN_VARIANCE / rows)
        large = np.maximum((self.settings.apart * forces) ** 2, self.settings.block_z * chance)
        return bool(np.any(explained > large))

    def of_laws(self, solution: Solution) -> set[int]:
        """Find the chosen terms of a law that several joints have, and inertia beside a mass.

        They stay free together, even where one of them is small by itself: left out, it would be
        made up for by the others. A body of another mass has another inertia, too.

        Parameters
        ----------
        solution : Solution
            The chosen terms.

        Returns
        -------
        set of int
            Indices of those terms.
        """
        families = families_of([self.fitter.terms[i] for i in solution.terms])
        found = set()
        for name, places in families.items():
            if name in LAWS and len(places) > 1:
                found |= {solution.terms[place] for place in places}
        return found | self._beside_masses(solution)

    def _beside_masses(self, solution: Solution) -> set[int]:
        """The inertia of the bodies whose mass is among the terms, too."""
        terms = self.fitter.terms
        heavy = {terms[i].target for i in solution.terms if terms[i].family == "mass"}
        return {
            i for i in solution.terms if terms[i].family == INERTIA and terms[i].target in heavy
        }

    def _one_each(self, solution: Solution) -> list[Group]:
        """The chosen terms, each by itself; a mass with the inertia beside it."""
        terms = self.fitter.terms
        beside = self._beside_masses(solution)
        groups: list[Group] = []
        for i in solution.chosen:
            if i in beside:
                continue
            own = [k for k in beside if i != GAIN and terms[i].family == "mass"]
            groups.append((i, *(k for k in own if terms[k].target == terms[i].target)))
        return groups

    def _first(self, chosen: Group) -> Solution:
        """All the common laws with the payload on that body, or none, that leaves least.

        The bodies are tried one by one: a payload elsewhere may be a local optimum in which gain
        and masses are all off by one factor. So may a gain that is free from the beginning, beside
        a joint whose offset a payload explains: it is also freed at last. Where any gain would do
        it is the model's own, and all other numbers are in its proportion.
        """
        held = tuple(i for i in chosen if i != GAIN)
        starts = [self._begun(own) for own in dict.fromkeys((chosen, held))]
        best = self._first_from(starts, chosen)
        if best.payload is None or not self.fitter.may_have_any_gain(best):
            return best
        by_own_gain = self._first_from(starts[-1:], held)
        explains = self.fitter.badness(by_own_gain) - self.settings.decisive
        return by_own_gain if explains < self.fitter.badness(best) else best

    def _first_from(self, starts: Sequence[Solution], chosen: Group) -> Solution:
        """The solution of some terms, with a payload or none, that is reached from one start."""
        fitter = self.fitter
        freed = [fitter.refined(replace(one, chosen=chosen)) for one in starts]
        best = min(freed, key=fitter.badness)
        # A payload has four numbers, one of them not linear: it must earn its place.
        least = fitter.badness(best) - self.settings.payload * float(fitter.equation.used.sum())
        for body, start in product(range(len(fitter.equation.by_inertia)), starts):
            loaded = start
            for _ in range(2):
                loaded = fitter.solve(fitter.loaded(loaded, (body,)))
                loaded = fitter.delayed(loaded)
            loaded = fitter.refined(replace(loaded, chosen=chosen))
            heavy = loaded.payload is None or loaded.payload.mass > fitter.heaviest
            if not heavy and fitter.badness(loaded) < least:
                best = loaded
                least = fitter.badness(loaded)
        return best

    def _begun(self, chosen: Group) -> Solution:
        """Terms fitted in turn with weights and the delay."""
        solution = self.fitter.start(chosen)
        for _ in range(self.settings.passes):
            solution = self.fitter.delayed(self.fitter.solve(solution))
        return solution

    def _candidates(self, families: dict[str, Group]) -> list[Group]:
        """Whole families, single terms, and the gain of all drives where they have no own."""
        whole = [family for family in families.values() if len(family) > 1]
        singles = [(i,) for i in sorted(i for family in families.values() for i in family)]
        common = [] if {"gain", OWN_GAIN} & set(families) else [(GAIN,)]
        return [*whole, *singles, *common]

    def without_needless(self, solution: Solution, groups: Sequence[Group]) -> Solution:
        """Drop the groups, and the payload, that data held out do not ask for, one at a time.

        The one of the smallest gain goes first, and all other numbers are fitted again after each.

        Parameters
        ----------
        solution : Solution
            The numbers so far.
        groups : sequence of tuple of int
            Indices of the terms that are dropped together; of each, those that the solution has.

        Returns
        -------
        Solution
            The numbers without what is needless.
        """
        while True:
            tables = self.tables(solution)
            present = self.held_out(solution, tables)
            needless: list[tuple[float, Solution]] = []
            for group in groups:
                dropped = [i for i in solution.chosen if i in group]
                left = tuple(i for i in solution.chosen if i not in group)
                without = replace(solution, chosen=left)
                # Beside a payload the gain stays: the two share the scale of all forces.
                shared = GAIN in group and solution.payload is not None
                if dropped and not shared:
                    needless += self._if_needless(solution, without, dropped, tables, present)
            if solution.payload is not None:
                without = replace(solution, payload=None)
                needless += self._if_needless(solution, without, (GAIN,), tables, present)
            if not needless:
                return solution
            worst = min(needless, key=lambda one: one[0])[1]
            solution = self.fitter.refined(self.fitter.solve(worst))

    def _if_needless(
        self,
        solution: Solution,
        without: Solution,
        dropped: Iterable[int],
        tables: BlockTables,
        present: Array,
    ) -> list[tuple[float, Solution]]:
        """The solution without some terms, with what these gain, if that is too little."""
        errors = self.held_out(without, tables)
        if self._is_worth(errors, present, self._drive_size(solution, dropped)):
            return []
        return [(_worth(errors, present)[0], without)]

    def with_more(
        self, solution: Solution, groups: Sequence[Group], *, rounds: int | None = None
    ) -> Solution:
        """Add the groups that data held out ask for, the one that helps most first.

        A group is left out where it would free the scale of all masses a second time, and where the
        usual row, fitted again, is explained no better: the few that are have pulled it away.

        Parameters
        ----------
        solution : Solution
            The numbers so far.
        groups : sequence of tuple of int
            Indices of the terms that are added together.
        rounds : int, optional
            How many at most; by default the settings' number.

        Returns
        -------
        Solution
            The numbers with up to `rounds` more groups.
        """
        refused: set[Group] = set()
        left = self.settings.rounds if rounds is None else rounds
        while left:
            tables = self.tables(solution)
            present = self.held_out(solution, tables)
            best: tuple[float, Group, Solution | None] = (0.0, (), None)
            for group in groups:
                new = tuple(i for i in group if i not in solution.chosen)
                if not new or new in refused or self._moves_scale(solution, new):
                    continue
                larger = replace(solution, chosen=(*solution.chosen, *new))
                errors = self.held_out(larger, tables)
                if self._is_worth(present, errors, self._drive_size(solution, new)):
                    score = _worth(present, errors)[0] / np.sqrt(len(new))
                    best = max(best, (score, new, larger), key=lambda one: one[0])
            if best[2] is None:
                return solution
            larger = self.fitter.refined(self.fitter.solve(best[2]))
            if self.fitter.badness(larger) < self.fitter.badness(solution):
                solution = larger
                left -= 1
            else:
                refused.add(best[1])
        return solution

    def _moves_scale(self, solution: Solution, new: Group) -> bool:
        """Whether terms would free the scale of the masses a second time.

        The scale of masses and that of forces are one number: a gain, a payload or a mass fixes it.
        Where a drive's gain and a body's numbers are free, noise of its force is least without it.
        """
        if self._are_inertial(new):
            return self._are_gains(solution.chosen) or solution.payload is not None
        return self._are_gains(new) and self._has_inertia(solution)

    def _are_inertial(self, chosen: Group) -> bool:
        """Whether a body's inertial numbers are among some terms."""
        return any(i != GAIN and self.fitter.terms[i].family in INERTIAL for i in chosen)

    def _are_gains(self, chosen: Group) -> bool:
        """Whether the gain of all drives, or one's own, is among some terms."""
        return any(i == GAIN or self.fitter.terms[i].family == OWN_GAIN for i in chosen)

    def certain(self, solution: Solution) -> Solution:
        """Drop the terms that are small, or not certain, when all are fitted together.

        Parameters
        ----------
        solution : Solution
            The numbers so far.

        Returns
        -------
        Solution
            The numbers whose Wald statistic, size and force are large enough, and those of laws.
        """
        while True:
            solution = self.fitter.refined(solution)
            variance = np.diag(self.fitter.covariance(solution))
            offset = 1 if GAIN in solution.chosen else 0
            forces = self.term_forces(solution)
            laws = self.of_laws(solution)
            kept = []
            for place, i in enumerate(solution.terms):
                wald = solution.sizes[i] ** 2 / max(float(variance[offset + place]), 1e-300)
                large = abs(solution.sizes[i]) > self.fitter.terms[i].least * (1 + solution.gain)
                strong = forces[i] > self.settings.force
                sure = wald > self.settings.wald
                if i in laws or (large and strong and (sure or self._is_missed(solution, i))):
                    kept.append(i)
            if len(kept) == len(solution.terms):
                return solution
            sizes = np.zeros(len(solution.sizes))
            sizes[kept] = solution.sizes[kept]
            gain = (GAIN,) * offset
            solution = replace(solution, chosen=(*gain, *kept), sizes=sizes)

    def _is_missed(self, solution: Solution, term: int) -> bool:
        """Whether the other numbers, fitted again without a term, explain far less.

        Its own error may be that of a scale that it shares with all of them.
        """
        fitter = self.fitter
        chosen = tuple(i for i in solution.chosen if i != term)
        without = fitter.refined(fitter.solve(replace(solution, chosen=chosen)))
        worse = fitter.badness(without) - fitter.badness(solution)
        return worse > self.settings.payload * float(fitter.equation.used.sum())

    def term_forces(self, solution: Solution) -> Array:
        """Compute how large the force of each chosen term is.

        Parameters
        ----------
        solution : Solution
            The numbers.

        Returns
        -------
        (K,) array
            RMS force, as a fraction of the drive's, at the degree of freedom where that is largest;
            0 of terms that are not chosen.
        """
        fitter = self.fitter
        drives = fitter.forces(solution.delay)
        factors = fitter.factors(solution)
        share = np.zeros(len(fitter.terms))
        for i in solution.terms:
            own = factors * solution.sizes[i] * fitter.columns_at(solution.delay, [i])[:, :, 0]
            own = np.where(fitter.equation.used, own, np.nan)
            share[i] = float(
                np.max(root_mean_square(own) / np.maximum(root_mean_square(drives), 1e-300))
            )
        return share

    # ---- what groups gain on data held out

    def tables(self, solution: Solution) -> BlockTables:
        """Compute what linear solves need of each block, by a solution's weights and delay.

        Parameters
        ----------
        solution : Solution
            The numbers.

        Returns
        -------
        BlockTables
            Of the B blocks of time, in their order.
        """
        fitter = self.fitter
        every = range(len(fitter.terms))
        needed, terms, payload, target = fitter.linear_columns(solution, every)
        columns = np.concatenate([needed[:, :, None], terms, payload[:, :, None]], axis=2)
        columns = columns * solution.weights[:, :, None]
        target = target * solution.weights
        grams = []
        moments = []
        sizes = []
        for block in np.unique(fitter.equation.block):
            rows = fitter.equation.block == block
            own = columns[rows].reshape(-1, columns.shape[2])
            aim = target[rows].ravel()
            grams.append(own.T @ own)
            moments.append(own.T @ aim)
            sizes.append(aim @ aim)
        return BlockTables(np.array(grams), np.array(moments), np.array(sizes))

    def held_out(self, solution: Solution, tables: BlockTables) -> Array:
        """Compute the squared error of each block, fitted without the fold that it belongs to.

        Parameters
        ----------
        solution : Solution
            What is fitted: its chosen terms and its payload, at the payload's place.
        tables : BlockTables
            The tables of B blocks.

        Returns
        -------
        (B,) array
            Squared errors, in the unit of the weighted rows: about 1 for each row that is well
            explained.
        """
        terms = self.fitter.terms
        index = [0 if i == GAIN else i + 1 for i in solution.chosen]
        lowest = [
            LEAST_BETA if i == GAIN else solution.beta * terms[i].lowest for i in solution.chosen
        ]
        if solution.payload is not None:
            index.append(len(terms) + 1)
            lowest.append(0.0)
        free = np.array(index, dtype=np.int64)
        count = len(tables.sizes)
        fold = np.arange(count) * self.settings.folds // count
        errors = np.empty(count)
        # The first column stands without a coefficient where the gain is not free.
        there = np.unique([0, *index])
        grams = tables.grams[:, there[:, None], there]
        by_block = tables.moments[:, there]
        free = np.searchsorted(there, free)
        numbers = np.unique(fold)
        fold_grams = np.stack([grams[fold == number].sum(axis=0) for number in numbers])
        fold_moments = np.stack([by_block[fold == number].sum(axis=0) for number in numbers])
        for number in numbers:
            own = fold == number
            # Added up, not the sum less one fold: all may lie in that one but rounding.
            other_gram = fold_grams[numbers != number].sum(axis=0)
            other_moments = fold_moments[numbers != number].sum(axis=0)
            found = np.zeros(len(there))
            if GAIN not in solution.chosen:
                found[0] = 1.0
                other_moments = other_moments - other_gram[:, 0]
            if len(free):
                square = other_gram[free[:, None], free]
                found[free] = bounded_minimum(square, other_moments[free], np.array(lowest))
            squares = grams[own] @ found @ found
            errors[own] = tables.sizes[own] - 2 * by_block[own] @ found + squares
        return errors

    def _is_worth(self, without: Array, with_it: Array, size: float) -> bool:
        """Whether a group lowers the error on data held out by enough, and for certain.

        size: squared force of the drives at its joints, in the units of the error.
        """
        fraction, z = _worth(without, with_it)
        large = float((without - with_it).sum()) > self.settings.force**2 * size
        return large and fraction > self.settings.improvement and z > self.settings.block_z

    def _drive_size(self, solution: Solution, group: Iterable[int]) -> float:
        """The squared force of the drives, weighted as errors are, at the joints of a group.

        Of several joints the one with the least: a law may be missing at one of them alone.
        """
        drives = np.nan_to_num(self.fitter.forces(solution.delay))
        by_joint = np.sum((drives * solution.weights) ** 2, axis=0)
        touched = np.zeros(len(by_joint), dtype=bool)
        for i in group:
            touched |= i == GAIN or self.fitter.places[i]
        there = by_joint[touched & (by_joint > 0)]
        return float(there.min()) if len(there) else 0.0


def _worth(without: Array, with_it: Array) -> tuple[float, float]:
    """The fraction of the squared error (B,) that a group removes, in standard errors too.

    A few blocks that gain much more than others are no reason to doubt all of them, so the
    signed-rank score counts where it is larger.
    """
    gains = without - with_it
    error = gains.std(ddof=1) * np.sqrt(len(gains))
    fraction = float(gains.sum() / max(without.sum(), 1e-300))
    z = float(gains.sum() / error) if error > 0 else 0.0
    return fraction, max(z, signed_rank_score(gains)) if fraction > 0 else z
