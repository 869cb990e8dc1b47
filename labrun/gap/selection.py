"""Which causes: forward by the rule of `labrun.gap.decide` with a beam of sets, then backward, then by exchange."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TypeVar

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Problem
from labrun.gap import criteria, decide, numerics
from labrun.gap.candidates import Candidate
from labrun.gap.diagnosis import Name
from labrun.gap.evidence import Units, UnseenError, unseen_error
from labrun.gap.forms import forms_of, in_fitting_range
from labrun.gap.held_out import fitted_excess
from labrun.gap.noise import Noise
from labrun.gap.progress import Progress, TimeOver
from labrun.gap.recalibration import in_units_of, settled_in_own_units
from labrun.gap.screening import (
    Base,
    Screened,
    Survey,
    ends_of,
    refit,
    refit_from_related_optima,
    screen_all,
    survey,
)
from labrun.gap.steps import in_longer_steps, in_steps_for

Argument = TypeVar("Argument")
Result = TypeVar("Result")

Forms = frozenset[tuple[Name, tuple[str, ...]]]
"""A set of causes, each with the names of its fitted parameters."""


@dataclass(frozen=True)
class CauseSet:
    """A fitted model with a set of causes, and what it leaves of data that the fit has not seen.

    Attributes
    ----------
    fitted
        Excess of the mean square over the noise floor, of the data that the fit has seen.
    """

    base: Base
    error: UnseenError
    fitted: float

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """The causes, in the order of their variables."""
        return self.base.added

    @property
    def names(self) -> frozenset[Name]:
        """Names of the causes."""
        return frozenset(candidate.name for candidate in self.base.added)

    @property
    def forms(self) -> Forms:
        """The causes with what of them is fitted."""
        return frozenset((candidate.name, candidate.fitted) for candidate in self.base.added)

    @property
    def variables(self) -> int:
        """Number of variables of the causes."""
        return sum(candidate.variables for candidate in self.base.added)

    @property
    def complexity(self) -> tuple[int, int]:
        """Number of variables of the causes, then how uncommon they are in practice."""
        variables, ranks = zip(*(candidate.complexity for candidate in self.base.added), strict=True)
        return sum(variables), sum(ranks)


@dataclass(frozen=True)
class Table:
    """All candidates beside one set of causes.

    Attributes
    ----------
    screened
        Every candidate that simulates, as far as it was worth fitting.
    extended
        The most promising of them as sets of causes, judged on unseen data, the best first.
    """

    start: CauseSet
    screened: list[Screened]
    extended: list[CauseSet]

    @property
    def judged(self) -> list[Candidate]:
        """The candidates that were judged on unseen data."""
        return [self.added(entry) for entry in self.extended]

    def find(self, name: Name) -> Screened | None:
        """Return how a candidate was fitted."""
        return next((entry for entry in self.screened if entry.candidate.name == name), None)

    def added(self, entry: CauseSet) -> Candidate:
        """Return the candidate by which an entry extends the set that the table starts from."""
        return entry.candidates[-1]


@dataclass(frozen=True)
class Chosen:
    """A cause, as it stands beside all the others.

    Attributes
    ----------
    rivals
        Sets in which another candidate takes its place and does as well by the rule, the best first.
    without
        The model with all the other causes, fitted again.
    closes, returns
        Share of the gap that it closes where the ladder adds it, and that comes back without it.
    confidence
        How often it or its first rival wins when the units of evidence are resampled.
    """

    candidate: Candidate
    rivals: tuple[CauseSet, ...]
    without: CauseSet
    closes: float
    returns: float
    confidence: float

    @property
    def name(self) -> Name:
        """Name of the cause."""
        return self.candidate.name

    @property
    def rival_names(self) -> tuple[Name, ...]:
        """Names of its rivals, the best first."""
        return tuple(rival.candidates[-1].name for rival in self.rivals)


@dataclass(frozen=True)
class Selection:
    """What the search ended with.

    Attributes
    ----------
    reference
        The recalibrated model without any cause.
    steps
        The models of the ladder: the reference, then with each cause in turn.
    first, last
        All candidates beside no cause, and beside all causes. None where nothing was searched.
    judged
        Candidates that were promising enough to be judged on unseen data, beside any set of causes.
    nested
        What is left of unseen data, in units of one trial's noise, where the choice of causes has not seen them either.
    stopped
        Why the search ended early, "interrupted" or "time"; "" where it ended by itself.
    """

    reference: CauseSet
    steps: tuple[CauseSet, ...]
    chosen: tuple[Chosen, ...]
    first: Table | None
    last: Table | None
    judged: frozenset[Name] = frozenset()
    nested: float = float("nan")
    stopped: str = ""

    @property
    def final(self) -> Base:
        """The model with all causes."""
        return self.steps[-1].base

    @property
    def error(self) -> UnseenError:
        """What it leaves of unseen data."""
        return self.steps[-1].error


@dataclass
class Selector:
    """Searches the sets of causes.

    Attributes
    ----------
    base
        The recalibrated model.
    floor
        Systematic residual that noise alone leaves at most, in units of one trial's noise; 0 where nothing tells it.
    """

    base: Base
    candidates: Sequence[Candidate]
    noise: Noise
    units: Units
    floor: float
    rng: np.random.Generator
    progress: Progress
    _tables: dict[Forms, Table] = field(default_factory=dict, repr=False)
    _fewer: dict[Forms, CauseSet | None] = field(default_factory=dict, repr=False)
    _extensions: list[CauseSet] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        gap = self._judged(self.base).error.squares
        self.units = self.units.with_form_error_of(gap)
        self._best = self.reference = self._judged(self.base)
        self._drawn = decide.resamples(self.units.strata, numerics.RESAMPLES, self.rng)

    def select(self) -> Selection:
        """Search forward, backward and by exchange, and return the causes with their rivals."""
        if not self.candidates or self._is_explained(self.reference):
            return Selection(self.reference, (self.reference,), (), None, None)
        stopped = ""
        try:
            self._forward()
            self._exchange()
        except (KeyboardInterrupt, TimeOver) as reason:
            stopped = "time" if isinstance(reason, TimeOver) else "interrupted"
            self.progress.note("stopped early: preparing the best answer so far")
            self._take_best_judged()
        chosen, steps = self._described(self._best)
        judged = {candidate.name for table in self._tables.values() for candidate in table.judged}
        first, last = self._tables.get(self.reference.forms), self._tables.get(self._best.forms)
        return Selection(
            self.reference, steps, chosen, first, last, frozenset(judged), self._nested(steps[-1]), stopped
        )

    def _nested(self, final: CauseSet) -> float:
        """Return the error of sets of causes that were each chosen without the unit that they predict.

        The choice is repeated on stored errors, among sets of as many causes at most.
        """
        others = [
            entry
            for entry in self._extensions
            if len(entry.names) <= len(final.names) and self.is_accepted(entry, self.reference)
        ]
        sets = [self.reference, final, *others]
        logs = np.array([entry.error.log for entry in sets])
        complexity = [entry.complexity if entry.candidates else (0, 0) for entry in sets]
        chosen = decide.chosen_without_each_unit(logs, complexity, self.units.strata)
        squares = sum(float(np.mean(sets[row].error.squares[unit])) for unit, row in enumerate(chosen))
        usual = float(np.sum(np.mean(final.error.squares, axis=1)))
        return final.error.in_noise * float(np.sqrt(squares / usual)) if usual > 0.0 else final.error.in_noise

    def closes(self, before: UnseenError, after: UnseenError) -> float:
        """Return the share of the gap (root mean square) that a step from one model to another closes."""
        gap = self.reference.error.in_noise
        return (before.in_noise - after.in_noise) / gap if gap > 0.0 else 0.0

    def is_accepted(self, after: CauseSet, before: CauseSet) -> bool:
        """Tell whether a richer set of causes replaces another one.

        It has to by the rule; and it has to close a visible share of the squared gap, of unseen and of seen data. What
        improves predictions without improving the fit has only made the fits of the folds steadier.
        """
        unseen = before.error.excess.total - after.error.excess.total
        return (
            self._beats(after, before)
            and unseen >= criteria.SHARE_OF_GAP * self.reference.error.excess.total
            and before.fitted - after.fitted >= criteria.SHARE_OF_GAP * self.reference.fitted
        )

    def _beats(self, after: CauseSet, before: CauseSet) -> bool:
        return decide.beats(after.error.log, before.error.log, self.units.strata)

    def _leader(self, sets: Sequence[CauseSet]) -> CauseSet:
        table = np.array([entry.error.log for entry in sets])
        return sets[decide.leader(table, [entry.complexity for entry in sets], self.units.strata)]

    def _take_best_judged(self) -> None:
        """Extend the best set by a cause that was judged before its table was complete, if one is accepted."""
        size = len(self._best.names) + 1
        larger = [
            entry for entry in self._extensions if entry.names > self._best.names and len(entry.names) == size
        ]
        if larger and self.is_accepted(leader := self._leader(larger), self._best):
            self._best = leader

    def _is_explained(self, model: CauseSet) -> bool:
        """Tell whether nothing worth explaining is left: noise, or less of the gap than a cause has to close.

        Where nothing but the residual tells the noise, that is no reason not to look for a cause.
        """
        if self.noise.known and model.fitted <= self.floor**2:
            return True
        return model is not self.reference and model.fitted < criteria.SHARE_OF_GAP * self.reference.fitted

    def _forward(self) -> None:
        """Add causes, or shapes of causes, one step after the other; the first two causes also only together.

        Beside a cause of several parameters, what predicts best with fewer stays in the beam: with a further cause it
        may explain as much by fewer parameters in all.
        """
        beam, failed = [self.reference], False
        while len(self._best.candidates) < criteria.MOST_CAUSES:
            if self._is_explained(self._best) and len(beam) < 2:
                break
            self.progress.note(f"looking for a cause {_listed(beam[0])}")
            sets = self._extended_from(beam)
            if not sets:
                break
            accepted = [entry for entry in sets if self.is_accepted(entry, self._best)]
            leader = self._leader(accepted or sets)
            if accepted:
                simpler = [entry for entry in sets if entry.variables < leader.variables]
                self._best, beam = leader, [leader, *simpler[: criteria.BEAM - 1]]
                continue
            simpler = [
                entry
                for entry in sets
                if (entry.variables, entry.error.mean) < (self._best.variables, self._best.error.mean)
                and not self._beats(self._best, entry)
            ]
            if simpler:
                self._best = self._leader(simpler)
                beam = [self._best]
                continue
            if failed or self._best is not self.reference:
                break
            # two causes may each predict badly alone: what fits the seen data best stays in the beam, too
            by_fit = min(sets, key=lambda entry: entry.fitted)
            kept = (leader, *sets[: criteria.BEAM - 1], by_fit)
            beam, failed = list({entry.forms: entry for entry in kept}.values()), True

    def _extended_from(self, beam: Sequence[CauseSet]) -> list[CauseSet]:
        """Return the sets that the tables of a beam hold, each as its best fit, the best first."""
        larger: dict[Forms, CauseSet] = {}
        for model in beam:
            for entry in self._table(model).extended:
                known = larger.get(entry.forms)
                if known is None or entry.error.mean < known.error.mean:
                    larger[entry.forms] = entry
        return sorted(larger.values(), key=lambda entry: entry.error.mean)

    def _exchange(self) -> None:
        """Drop each cause that the others do without, and exchange each for what leads in its place."""
        for _ in range(criteria.MOST_CAUSES):
            best = self._best
            for candidate in best.candidates:
                without = self._without(best, candidate.name)
                if without is None:
                    continue
                if not self.is_accepted(best, without):
                    self.progress.note(f"{candidate.name} is not needed beside the others")
                    self._best = without
                    break
                others = [
                    entry
                    for entry in self._in_place_of(best, without)[1:]
                    if self.is_accepted(entry, without)
                ]
                leader = self._leader([best, *others])
                if leader.names != best.names and not self._beats(best, leader):
                    self.progress.note(f"{leader.candidates[-1].name} takes the place of {candidate.name}")
                    self._best = leader
                    break
            else:
                return

    def _in_place_of(self, best: CauseSet, without: CauseSet) -> list[CauseSet]:
        """Return the sets that another candidate makes in the place of one cause, and the set as it is."""
        others = [
            entry
            for entry in self._table(without).extended
            if entry.names != best.names and len(entry.names) == len(best.names)
        ]
        return [best, *others]

    def _described(self, best: CauseSet) -> tuple[tuple[Chosen, ...], tuple[CauseSet, ...]]:
        """Return the causes with their rivals, and the steps of the ladder, the cause that closes most first."""
        steps = self._ladder(best)
        chosen = []
        for before, after in pairwise(steps):
            (candidate,) = (cause for cause in after.candidates if cause.name not in before.names)
            closes = self.closes(before.error, after.error)
            without = self._without(best, candidate.name)
            if without is None or without.forms not in self._tables:
                # the others do not simulate without it, or there was no time to compare it in its place
                chosen.append(Chosen(candidate, (), before, closes, closes, float("nan")))
                continue
            entries = self._in_place_of(best, without)
            table = np.array([entry.error.log for entry in entries])
            strata = self.units.strata
            wins = decide.win_frequencies(
                without.error.log, table, [entry.complexity for entry in entries], strata, self._drawn
            )
            near = [
                int(row)
                for row in decide.near_best(table, strata)
                if row != 0 and not self._is_needless_form(best, entries[row], candidate)
            ]
            frequency = float(wins[0] + (wins[near[0]] if near else 0.0))
            confidence = decide.tempered(frequency, len(self._drawn))
            returns = self.closes(without.error, best.error)
            rivals = tuple(entries[row] for row in near)
            chosen.append(Chosen(candidate, rivals, without, closes, returns, confidence))
        return tuple(chosen), steps

    def _is_needless_form(self, best: CauseSet, rival: CauseSet, cause: Candidate) -> bool:
        """Tell whether a rival is a richer form of the cause itself that improves nothing in practice."""
        other = rival.candidates[-1]
        contained = () if other.attached is None else other.attached.effect.contains
        is_richer = other.name.site == cause.name.site and cause.name.effect in contained
        return is_richer and best.error.mean - rival.error.mean <= criteria.MARGIN

    def _ladder(self, best: CauseSet) -> tuple[CauseSet, ...]:
        """Return the reference and the sets that add, one after the other, the cause that closes most."""
        steps = [best]
        while len(steps[0].candidates) > 1:
            smaller = [self._without(steps[0], candidate.name) for candidate in steps[0].candidates]
            fitted = [model for model in smaller if model is not None]
            if not fitted:
                break
            steps.insert(0, min(fitted, key=lambda model: model.error.mean))
        return (self.reference, *steps) if best.candidates else (self.reference,)

    def _table(self, start: CauseSet) -> Table:
        """Try every candidate beside a set of causes, once for each set."""
        if start.forms not in self._tables:
            self._tables[start.forms] = self._tried(start)
        return self._tables[start.forms]

    def _tried(self, start: CauseSet) -> Table:
        base = start.base
        others = _listed(start)
        surveys = self.progress(
            f"surveying candidates {others}", lambda candidate: survey(base, candidate), self._others(base)
        )

        def fitting(work: Callable[[Argument], Result], items: Iterable[Argument], /) -> list[Result]:
            return self.progress(f"fitting candidates {others}", work, items)

        screened = screen_all(base, surveys, each=fitting, known=self._known())
        screened = refit_from_related_optima(base, screened, fitting)
        promising = sorted(screened, key=lambda entry: entry.squares)[: criteria.RATED]
        promising = [entry for entry in promising if entry.gain > 0.0]
        promising = fitting(lambda entry: in_fitting_range(base, entry), promising)
        extended = self.progress(
            f"predicting unseen data {others}", lambda entry: self._extended(base, entry), promising
        )
        entries = [*self._in_other_forms(base, promising, extended), *self._in_richer_forms(start)]
        return Table(start, screened, sorted(entries, key=lambda entry: entry.error.mean))

    def _in_other_forms(
        self, base: Base, promising: Sequence[Screened], extended: Sequence[CauseSet]
    ) -> list[CauseSet]:
        """Return the sets, with fewer levels where these do as well, and with sets in which a shape is fitted.

        Only candidates nearest to the best one are looked at. The shape of the one that leads is a step of its own:
        it competes with further causes (`_in_richer_forms`).
        """
        if not extended:
            return []
        usual = list(extended)
        nearest = [int(row) for row in np.argsort([entry.error.mean for entry in extended])[: criteria.BEAM]]
        lead = extended.index(self._leader(extended))

        def forms(row: int) -> tuple[CauseSet, list[CauseSet]]:
            entry, richer = usual[row], []
            for is_richer, other in forms_of(base, promising[row], shapes=row != lead):
                variant = self._extended(base, other)
                if not is_richer and not self._beats(entry, variant):
                    entry = variant
                elif is_richer and self._beats(variant, entry):
                    richer.append(variant)
            return entry, richer

        variants: list[CauseSet] = []
        for row, (entry, richer) in zip(
            nearest, self.progress("fitting other forms", forms, nearest), strict=True
        ):
            usual[row] = entry
            variants += richer
        return [*usual, *variants]

    def _in_richer_forms(self, start: CauseSet) -> list[CauseSet]:
        """Return a set with the shape of each of its causes fitted, one at a time."""
        richer = []
        for candidate in start.candidates:
            self.progress.check()
            without = self._without(start, candidate.name)
            if without is None or candidate.attached is None:
                continue
            base = without.base
            problem = candidate.added_to(base.problem).in_steps_of(start.base.problem)
            problem = problem.with_noise(start.base.problem.noise)
            z = start.base.sorted_as((*base.added, candidate))
            squares = problem.squares(z)
            gain = max(base.squares - squares, 0.0)
            unsurveyed = Survey(candidate, problem, [z], np.empty((0, 1)), np.zeros(1), gain)
            screened = Screened(candidate, problem, z, squares, gain, unsurveyed)
            forms = forms_of(base, screened, shapes=True)
            richer += [self._extended(base, other) for is_richer, other in forms if is_richer]
        return richer

    def _extended(self, base: Base, screened: Screened) -> CauseSet:
        """Return a base with a candidate, fitted in units of what it leaves, judged on unseen data."""
        problem, z = screened.problem, screened.z
        if not self.noise.known:
            problem, z = settled_in_own_units(self.noise, problem, z)
        extension = self._judged(self._based(problem, z, (*base.added, screened.candidate)))
        self._extensions.append(extension)
        return extension

    def _judged(self, base: Base) -> CauseSet:
        problem, z = base.problem, base.z
        fitted = fitted_excess(problem, z, self.noise).total
        return CauseSet(base, unseen_error(problem, z, self.noise, self.units), fitted)

    def _others(self, base: Base) -> list[Candidate]:
        """Return the candidates beside a base: not its causes, and not what one of them contains."""
        contained = {
            (effect, cause.name.site)
            for cause in base.added
            if cause.attached is not None
            for effect in (cause.name.effect, *cause.attached.effect.contains)
        }
        names = {cause.name for cause in base.added}
        return [
            candidate
            for candidate in self.candidates
            if candidate.name not in names and (candidate.name.effect, candidate.name.site) not in contained
        ]

    def _known(self) -> dict[Name, FloatArray]:
        """Return the sizes at which fits of candidates ended so far."""
        variables = {candidate.name: candidate.variables for candidate in self.candidates}
        known: dict[Name, FloatArray] = {}
        for table in self._tables.values():
            known |= ends_of(
                entry
                for entry in table.screened
                if entry.candidate.variables == variables.get(entry.candidate.name)
            )
        return known

    def _without(self, model: CauseSet, name: Name) -> CauseSet | None:
        """Return a set without one of its causes, fitted again; None if no fit leads to finite numbers."""
        kept = frozenset(
            (candidate.name, candidate.fitted) for candidate in model.candidates if candidate.name != name
        )
        if not kept:
            return self.reference
        if kept in self._tables:
            return self._tables[kept].start
        if kept not in self._fewer:
            base = self._refitted(model.base, frozenset(cause for cause, _ in kept))
            self._fewer[kept] = None if base is None else self._judged(base)
        return self._fewer[kept]

    def _refitted(self, last: Base, names: frozenset[Name]) -> Base | None:
        """Return a base with some of its causes only, fitted again; None if no fit leads to finite numbers."""
        problem = self.base.problem
        at, kept, parts = problem.size, list[Candidate](), [last.z[: problem.size]]
        for candidate in last.added:
            variables = last.z[at : at + candidate.variables]
            at += candidate.variables
            if candidate.name in names:
                problem = candidate.added_to(problem)
                kept.append(candidate)
                parts.append(variables)
        start = np.concatenate([*parts, last.problem.own_states(last.z)])
        problem, residual = in_steps_for(problem.in_steps_of(last.problem), start)
        if residual is None:
            return None
        if not self.noise.known:
            problem, z = settled_in_own_units(self.noise, problem, start)
        else:
            z = refit(problem, start)
            problem = in_units_of(self.noise, problem, z)
        return self._based(problem, z, tuple(kept))

    def _based(self, problem: Problem, z: FloatArray, added: tuple[Candidate, ...]) -> Base:
        """Return a base in integration steps no shorter than its causes ask for."""
        while (longer := in_longer_steps(problem, z, self.base.problem.steps)) is not problem:
            problem = longer
        return Base.of(problem, z, added, brisk=self.base.brisk)


def _listed(model: CauseSet) -> str:
    names = " and ".join(str(name) for name in sorted(model.names, key=str))
    return f"beside {names}" if names else "for the whole gap"
