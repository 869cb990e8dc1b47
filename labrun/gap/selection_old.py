"""Which causes: the best candidate, whether more than one is at work, and what cannot be told from them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Each, Note, Problem
from labrun.gap import criteria
from labrun.gap.candidates import Candidate, family, without
from labrun.gap.diagnosis import Name
from labrun.gap.forms import best_form, of_a_sign, sharpened
from labrun.gap.held_out import ExcessResidual, fitted_excess, held_out_excess
from labrun.gap.intervals import may_be_nothing, scatter
from labrun.gap.learnable import learnable_share
from labrun.gap.noise import Noise
from labrun.gap.noise_threshold import NoiseThreshold, Null, noise_threshold
from labrun.gap.rating import (
    Rated,
    least_to_remove,
    more_common,
    preferred,
    promising,
    rate,
    rivals_of,
    room_for_more,
)
from labrun.gap.recalibration import fitted_in_own_units, in_units_of
from labrun.gap.screening import (
    Base,
    Screened,
    begun_where_kin_ended,
    ends_of,
    refit,
    screen_all,
    survey,
)
from labrun.gap.steps import in_longer_steps, in_steps_for

Forms = frozenset[tuple[Name, tuple[str, ...]]]
"""A set of causes, each with what of it is fitted: its shape or not, and which."""


def _forms(added: Sequence[Candidate]) -> Forms:
    return frozenset((one.name, one.fitted) for one in added)


@dataclass(frozen=True)
class Round:
    """All candidates beside one base.

    Attributes
    ----------
    learnable
        Part of what the base leaves that any model could explain; asked for beside one cause without repeats, else 1.
    """

    base: Base
    screened: list[Screened]
    threshold: NoiseThreshold
    rated: list[Rated]
    learnable: float = 1.0

    def without(self, names: set[Name]) -> "Round":
        """Return the round with fewer candidates."""
        return replace(
            self,
            screened=[one for one in self.screened if one.candidate.name not in names],
            rated=[one for one in self.rated if one.candidate.name not in names],
        )

    def find(self, candidate: Candidate) -> Screened | None:
        """Return how a candidate did."""
        return next((one for one in self.screened if one.candidate.name == candidate.name), None)


@dataclass(frozen=True)
class Chosen:
    """A cause and what cannot be told from it.

    Attributes
    ----------
    rated
        As it was rated beside all other causes that were found.
    rivals
        What explains the data as well, most probable first, with its weight; or a form that is mended in the same way,
        of next to none.
    weight
        The cause's own beside those.
    base, held_out
        The model with it and the causes before it, and what that leaves on withheld conditions.
    own_share
        Part of the gap that comes back without it, the other causes fitted again; the whole where it stands alone.
    """

    rated: Rated
    rivals: tuple[tuple[Rated, float], ...]
    weight: float
    base: Base
    held_out: ExcessResidual
    own_share: float = 1.0

    @property
    def name(self) -> Name:
        """What the cause is called."""
        return self.rated.candidate.name

    @property
    def doubts(self) -> list[Rated]:
        """The rivals that the data cannot tell from it: not those that are told beside it as its kin only."""
        return [rival for rival, weight in self.rivals if weight >= criteria.RIVAL_WEIGHT]


@dataclass(frozen=True)
class Selection:
    """What was chosen.

    Attributes
    ----------
    rounds
        Beside the recalibrated model, beside the first cause, and so on; the last finds nothing more, and is not there
        where nothing more could be found.
    final, held_out
        The model with all causes, and what it leaves on withheld conditions.
    """

    rounds: list[Round]
    chosen: tuple[Chosen, ...]
    final: Base
    held_out: ExcessResidual


@dataclass(frozen=True)
class Selector:
    """How causes are chosen: one by one, then each again beside the others.

    Attributes
    ----------
    base, reference
        The recalibrated model, and what it leaves on withheld conditions.
    null
        What candidates have to beat.
    strictness
        Factor on the threshold that noise sets.
    small_gap
        Gap from which what a cause leaves is plainly more than noise, in units of it.
    """

    base: Base
    candidates: Sequence[Candidate]
    noise: Noise
    null: Null
    reference: ExcessResidual
    strictness: float
    each: Each
    note: Note
    small_gap: float = criteria.SMALL_GAP
    _rounds: dict[Forms, Round] = field(default_factory=dict, repr=False)

    def select(self) -> Selection:
        """Choose the causes; each must beat the threshold given the others, and remove a part of the gap of its own.

        What simpler effects together explain as well is theirs: friction that differs by direction is Coulomb friction
        beside a constant pull, unless the data say more. And where one cause leaves plainly more than noise, two that
        leave next to nothing are the answer: friction and a lag look like play, nearly.
        """
        found = self._select()
        doubtful = self._doubtful(found)
        if not doubtful:
            return found
        self.note("looking whether other effects explain as much, or more")
        first = self._round(self.base)
        rounds = {
            forms: one.without(doubtful)
            for forms, one in self._rounds.items()
            if not {name for name, _ in forms} & doubtful
        }
        rest = without(self.candidates, doubtful)
        other = replace(self, candidates=rest, _rounds=rounds)._select()
        if not other.chosen or not self._better(other, found):
            return found
        alone = len(other.chosen) == 1
        chosen = tuple(
            self._beside_kin(one, other.chosen)
            if alone or any(family(one.name, left_out) for left_out in doubtful)
            else one
            for one in other.chosen
        )
        # the table is of all candidates
        return replace(other, chosen=chosen, rounds=[first, *other.rounds[1:]])

    def _beside_kin(self, one: Chosen, chosen: Sequence[Chosen]) -> Chosen:
        """Return a cause with the rivals that it has among all candidates: what was left out may be its kin."""
        several = len(chosen) > 1
        return replace(
            one, rivals=(self._judged_beside_others(one, chosen) if several else self._alone(one)).rivals
        )

    def _doubtful(self, found: Selection) -> set[Name]:
        """Return the effects without which the search is worth another look."""
        attached = {one.name: one.attached for one in self.candidates if one.attached is not None}
        chosen = [one.name for one in found.chosen]
        rich = {name for name in chosen if name in attached and attached[name].effect.contains}
        if rich:  # with all that is as rich: whether something simpler does is asked
            simple = {(effect, name.site) for name in rich for effect in attached[name].effect.contains}
            return rich | {
                name
                for name, one in attached.items()
                if one.effect.compound or simple & {(effect, name.site) for effect in one.effect.contains}
            }
        remains = found.held_out.gap >= criteria.LARGE_REMAINDER and room_for_more(
            found.held_out, self.reference
        )
        return set(chosen) if len(chosen) == 1 and remains else set()

    def _better(self, other: Selection, found: Selection) -> bool:
        """Tell whether other causes are simpler and leave no more, or leave next to nothing of what is plainly left."""
        room = criteria.SIMPLER_TOGETHER * self.reference.total
        compound = any(
            one.rated.candidate.attached is not None and one.rated.candidate.attached.effect.compound
            for one in found.chosen
        )
        simpler = other.final.problem.size < found.final.problem.size
        if not compound:  # other effects are met with all that makes them rich
            room = min(room, criteria.ONE_CAUSE_GAP**2)
            left, ours = (fitted_excess(one.final.problem, one.final.z, self.noise) for one in (other, found))
            simpler = simpler and left.gap <= criteria.SIMPLER_LEAVES * max(ours.gap, 1.0)
        if (simpler or compound) and other.held_out.total <= found.held_out.total + room:
            return True
        plain = found.held_out.gap >= criteria.LARGE_REMAINDER
        return plain and other.held_out.total <= (1.0 - criteria.SMALL_OF_LEFT) * found.held_out.total

    def _select(self) -> Selection:
        first = self._round(self.base)
        chosen, rounds = self._forward()
        if len(chosen) > 1:
            chosen, rounds = self._once_more(*self._exchanged(chosen))
        if len(chosen) > 2:
            chosen, rounds = self._fewer(chosen, rounds)
        while len(chosen) > 1 and (kept := self._without_nothing(chosen)):
            chosen, rounds = self._exchanged(kept)
        if len(chosen) > 1:
            chosen = [self._judged_beside_others(one, chosen) for one in chosen]
        # one of two causes alone may fail where it was not fitted; all that were chosen together must not
        alone = max((one.share for one in first.rated), default=0.0)
        needed = criteria.LEAST_SHARE if alone >= criteria.LEAST_SHARE else criteria.TOGETHER_SHARE
        beyond_chance = any(one.evidence > 1.0 for one in first.rated)
        if self.null.relative and beyond_chance:
            needed = (
                0.0  # what is left may be noise: how much a cause removes says little of whether it is one
            )
        if not chosen or self._share(chosen[-1].held_out) < needed:
            return Selection([first], (), self.base, self.reference)
        telling = sorted(chosen, key=lambda one: -one.rated.evidence)
        return Selection(rounds, tuple(telling), chosen[-1].base, chosen[-1].held_out)

    def _share(self, left: ExcessResidual) -> float:
        return 1.0 - left.total / self.reference.total if self.reference.total > 0 else 0.0

    def _forward(self) -> tuple[list[Chosen], list[Round]]:
        """Take in one cause after the other, each the best beside those before it.

        Where none is beyond chance alone, two may be together: the decay of a swing says little of friction as long as
        drag is taken for damping.
        """
        rounds, chosen = [self._round(self.base)], list[Chosen]()
        left_over = fitted_excess(self.base.problem, self.base.z, self.noise)
        if not self.null.relative and left_over.gap == 0.0:
            return [], rounds  # no more than noise makes: a cause would explain all of nothing
        while len(chosen) < criteria.MOST_CAUSES:
            left = chosen[-1].held_out if chosen else self.reference
            one = self._choose(rounds[-1], left)
            if one is None and not chosen:
                one = self._half_of_two(rounds[-1])
            if one is None:
                break
            self.note(f"found {one.name}; looking whether there is more")
            chosen.append(one)
            room = self._room(one.held_out, len(chosen))
            if len(chosen) < criteria.MOST_CAUSES and (
                room or len(chosen) == 1
            ):  # of several, `_exchanged` asks again
                rounds += self._beyond(one)
            if not room:
                break
        alone = len(chosen) == 1 and not any(one.evidence > 1.0 for one in rounds[0].rated)
        return ([], rounds[:1]) if alone else (chosen, rounds)

    def _half_of_two(self, first: Round) -> Chosen | None:
        likely = [one for one in first.rated if one.evidence > criteria.RIVAL_EVIDENCE and one.score > 0.0]
        if not likely or not self._room(self.reference):
            return None
        return self._taken(max(likely, key=lambda one: one.score), first)

    def _room(self, left: ExcessResidual, beside: int = 1) -> bool:
        if self.null.relative and self.reference.gap < criteria.ONE_CAUSE_GAP:
            return False
        return room_for_more(left, self.reference, beside, self.small_gap)

    def _beyond(self, last: Chosen) -> list[Round]:
        """Try every candidate beside all causes: closely only where there is room for one more."""
        if _forms(last.base.added) in self._rounds or self._room(last.held_out, len(last.base.added)):
            return [self._round(last.base)]
        return [] if self.base.brisk else [self._tried(last.base, self._others(last.base), closely=False)]

    def _exchanged(self, chosen: list[Chosen]) -> tuple[list[Chosen], list[Round]]:
        """Choose each cause again beside the others: what stood in for two of them gives way."""
        for _ in range(criteria.EXCHANGES):
            before = {one.name for one in chosen}
            for _ in range(len(chosen) if len(chosen) > 1 else 0):
                self.note(f"checking {chosen[0].name} again beside the others")
                stays = replace(chosen[0], base=chosen[-1].base, held_out=chosen[-1].held_out)
                found = self._beside(chosen, chosen[1:])
                if found is None:  # others that do not simulate without it explain nothing
                    chosen = [*chosen[1:], stays]
                    continue
                beside, left = found
                one = self._choose(beside, left)
                if one is None and self._needed(left, chosen[-1].held_out):
                    one = stays
                if one is None:  # the others do without it
                    chosen = [*chosen[1:-1], replace(chosen[-1], base=beside.base, held_out=left)]
                    break
                if not self._as_good(one, chosen[-1]):
                    one = stays
                chosen = [*chosen[1:], one]
            if {one.name for one in chosen} == before:
                break
        if len(chosen) == 1:
            chosen = [self._alone(chosen[0])]
        return chosen, [self._round(self.base), *self._beyond(chosen[-1])]

    def _once_more(self, chosen: list[Chosen], rounds: list[Round]) -> tuple[list[Chosen], list[Round]]:
        """Take in one cause more beside those that others gave way to: it was not asked for beside these."""
        last = chosen[-1]
        if not 1 < len(chosen) < criteria.MOST_CAUSES or not self._room(last.held_out, len(chosen)):
            return chosen, rounds
        one = self._choose(self._round(last.base), last.held_out)
        return (chosen, rounds) if one is None else self._exchanged([*chosen, one])

    def _as_good(self, one: Chosen, before: Chosen) -> bool:
        """Tell whether causes do about as well as others did, on withheld conditions: a fit may have lost its way."""
        simpler = one.base.problem.size < before.base.problem.size
        room = criteria.SIMPLER_TOGETHER * self.reference.total if simpler else 0.0

        def as_good(left: float, had: float) -> bool:
            return left <= max(had + room, had / criteria.AS_GOOD)

        if as_good(one.held_out.total, before.held_out.total):
            return True
        # they were rated in units of what others left
        again = [held_out_excess(each.base.problem, each.base.z, self.noise).total for each in (one, before)]
        return as_good(*again)

    @staticmethod
    def _needed(without_it: ExcessResidual, with_it: ExcessResidual) -> bool:
        """Tell whether causes leave plainly more without one that is not found again beside them.

        Fitted without it, the others may have gone where no fit with it comes back from.
        """
        return with_it.total < criteria.AS_GOOD * without_it.total

    def _alone(self, one: Chosen) -> Chosen:
        """Return a cause that is left alone with the rivals it has there, not those it had beside another."""
        first = self._round(self.base).rated
        rated = next((other for other in first if other.candidate.name == one.name), None)
        if rated is None:
            return one
        rivals, weight = rivals_of(rated, first, relative=self.null.relative)
        return replace(one, rated=rated, rivals=rivals, weight=weight)

    def _fewer(self, chosen: list[Chosen], rounds: list[Round]) -> tuple[list[Chosen], list[Round]]:
        """Return two causes in place of three, if there are two that leave hardly more than the three do.

        Whoever is found first beside nothing may stand in for another, and a third then mends what it cannot do.
        """
        enough = chosen[-1].held_out.total + criteria.NOTICED_SHARE * self.reference.total
        pair: list[Chosen] = []
        for one in chosen:
            found = self._beside(chosen, [one])
            other = None if found is None else self._choose(*found)
            if other is not None and other.held_out.total < enough:
                pair, enough = [one, other], other.held_out.total
        return self._exchanged(pair) if pair else (chosen, rounds)

    def _without_nothing(self, chosen: Sequence[Chosen]) -> list[Chosen]:
        """Return the causes without the one whose size, all of them fitted together, is least told from zero.

        Nothing where all are told from it, or where the others leave plainly more without: of friction that is greater
        at rest, neither what holds nor what slides is told from zero, but both together are.
        """
        final = chosen[-1].base
        nothing = may_be_nothing(final, scatter(final, self.null.draws(final)))
        for least in sorted(nothing, key=lambda one: nothing[one]):
            kept = [one for one in chosen if one.name != least]
            found = self._beside(chosen, kept)
            if found is None:  # nothing simulates without it: that size is no nothing
                continue
            beside, left = found
            if self._needed(left, chosen[-1].held_out):
                continue
            self.note(f"the size of {least} may be zero beside the others: it is left out")
            return [*kept[:-1], replace(kept[-1], base=beside.base, held_out=left)]
        return []

    def _judged_beside_others(self, one: Chosen, chosen: Sequence[Chosen]) -> Chosen:
        """Return a cause as it is judged beside all others that were found, not only those it was found beside."""
        found = self._beside(chosen, [other for other in chosen if other.name != one.name])
        if found is None:
            return one
        beside, left = found
        one = replace(one, own_share=self._share(chosen[-1].held_out) - self._share(left))
        rated = next((other for other in beside.rated if other.candidate.name == one.name), None)
        if rated is None:
            return one
        rivals, weight = rivals_of(rated, beside.rated, relative=self.null.relative)
        return replace(one, rated=replace(one.rated, evidence=rated.evidence), rivals=rivals, weight=weight)

    def _beside(
        self, chosen: Sequence[Chosen], kept: Sequence[Chosen]
    ) -> tuple[Round, ExcessResidual] | None:
        """Return all candidates beside some of the causes, and what these leave on withheld conditions.

        No candidates where these leave too little for a further cause. None where they do not simulate without the
        others.
        """
        names = frozenset(one.name for one in kept)
        forms = _forms([one for one in chosen[-1].base.added if one.name in names])
        found = self._rounds.get(forms)
        if found is None:
            base = self._refitted(chosen[-1].base, names)
            if base is None:
                return None
            left = held_out_excess(base.problem, base.z, self.noise)
            if names and not self._room(left, len(names)):
                return Round(base, [], NoiseThreshold(0.0, 1.0), []), left
            return self._round(base), left
        return found, held_out_excess(found.base.problem, found.base.z, self.noise)

    def _choose(self, current: Round, left: ExcessResidual) -> Chosen | None:
        least = self._least_to_remove(current.base, left, current.learnable)
        best = preferred(current.rated, left, least=least, relative=self.null.relative)
        if best is None:
            return None
        one = self._taken(more_common(best, current.rated, relative=self.null.relative), current)
        removed = left.total - best.held_out.total
        if removed >= self._least_to_remove(current.base, left, 1.0) * left.total:
            return one
        # it was enough beside what could be learned of the rest: what mends a part of what is wrong with the first
        # one's form leaves as much to be learned as before
        still = self._learned_of(one.base) * one.held_out.total
        return one if still <= (1.0 - criteria.SMALL_OF_LEFT) * current.learnable * left.total else None

    def _least_to_remove(self, base: Base, left: ExcessResidual, learnable: float) -> float:
        """Return the part of what a base leaves that a further cause has to remove; 0 for the first."""
        beside = len(base.added)
        return least_to_remove(left, self.reference, beside, learnable, self.small_gap) if beside else 0.0

    def _learnable(self, base: Base) -> float:
        return self._learned_of(base) if len(base.added) == 1 and self.null.relative else 1.0

    @staticmethod
    def _learned_of(base: Base) -> float:
        """Return the part of what a base leaves that a regression learns."""
        ways = [False, True] if len(base.problem.data.conditions) > 1 else [False]
        return max(learnable_share(base.problem, base.z, conditions=one) for one in ways)

    def _taken(self, best: Rated, current: Round) -> Chosen:
        """Return a candidate as a cause: with its rivals, and fitted in units of what it leaves."""
        rivals, weight = rivals_of(best, current.rated, relative=self.null.relative)
        problem, z = fitted_in_own_units(self.noise, best.screened.problem, best.screened.z)
        fitted = replace(best.screened, problem=problem, z=z, squares=problem.squares(z))
        noise_share = min(current.threshold.floor / best.screened.squares, 1.0)
        sharp = sharpened(current.base, fitted, current.threshold, noise_share)
        if sharp is not fitted:
            units = in_units_of(self.noise, sharp.problem, sharp.z)
            end = refit(units, sharp.z)
            left = held_out_excess(units, end, self.noise)
            # else another cause may bend the shape: the drag of an arm that rubs took another exponent for friction
            if of_a_sign(sharp) or left.total < criteria.AS_GOOD * best.held_out.total:
                best, problem, z = replace(best, screened=sharp, held_out=left), units, end
        base = self._based(problem, z, (*current.base.added, best.candidate))
        return Chosen(best, rivals, weight, base, best.held_out)

    def _round(self, base: Base) -> Round:
        """Try every candidate beside a base, once for each set of causes, in whichever order they were found."""
        forms = _forms(base.added)
        if forms not in self._rounds:
            self._rounds[forms] = self._tried(base, self._others(base))
        return self._rounds[forms]

    def _others(self, base: Base) -> list[Candidate]:
        """Return the candidates beside a base: not its causes, and not what one of them contains."""
        contained = {
            (effect, one.name.site)
            for one in base.added
            if one.attached is not None
            for effect in (one.name.effect, *one.attached.effect.contains)
        }
        return [
            one
            for one in without(self.candidates, {other.name for other in base.added})
            if (one.name.effect, one.name.site) not in contained
        ]

    def _tried(self, base: Base, candidates: Sequence[Candidate], *, closely: bool = True) -> Round:
        """Try candidates beside a base: fits, the threshold of noise, and the best of them on withheld conditions.

        Parameters
        ----------
        closely
            Whether forms and withheld conditions are looked at: not where no candidate could be taken in.
        """
        surveys = self.each(lambda one: survey(base, one), candidates)
        threshold = noise_threshold(base, surveys, self.null).times(self.strictness)
        learnable = self._learnable(base)
        least = self._least_gain(base, learnable)
        screened = screen_all(base, surveys, max(threshold.gain, least), self.each, known=self._known())
        if not closely:
            return Round(base, screened, threshold, [], learnable)
        screened = begun_where_kin_ended(base, screened, max(threshold.gain, least), self.each)
        most = max([least, *(one.gain for one in screened)])
        screened = self.each(lambda one: best_form(base, one, most, threshold), screened)
        rated = self.each(
            lambda one: rate(base, one, threshold, self.noise, self.reference),
            promising(screened, threshold, criteria.RATED, least),
        )
        return Round(base, screened, threshold, rated, learnable)

    def _least_gain(self, base: Base, learnable: float) -> float:
        """Return what a cause beside others has to gain to earn its place, about."""
        left = fitted_excess(base.problem, base.z, self.noise) if base.added else None
        if left is None or left.total <= 0.0:
            return 0.0
        least = self._least_to_remove(base, left, learnable)
        return min(least, 1.0) * base.squares * left.total / (1.0 + left.total)

    def _known(self) -> dict[Name, FloatArray]:
        """Return the sizes at which fits of candidates ended so far."""
        variables = {one.name: one.variables for one in self.candidates}
        known: dict[Name, FloatArray] = {}
        for earlier in self._rounds.values():  # with a shape fitted, sizes are of another form
            known |= ends_of(
                one
                for one in earlier.screened
                if one.candidate.variables == variables.get(one.candidate.name)
            )
        return known

    def _refitted(self, last: Base, names: frozenset[Name]) -> Base | None:
        """Return the last base with some of its causes only, fitted again; None if no fit leads to finite numbers.

        Causes hold one another: a spring that pushes away far out simulates where a limited goal keeps the joint near.
        """
        problem = self.base.problem
        at, kept, parts = problem.size, list[Candidate](), [last.z[: problem.size]]
        for candidate in last.added:
            variables = last.z[at : at + candidate.variables]
            at += candidate.variables
            if candidate.name in names:
                problem = candidate.added_to(problem)
                kept.append(candidate)
                parts.append(variables)
        # what was found with short steps may need them
        start = np.concatenate([*parts, last.problem.own_states(last.z)])
        problem, there = in_steps_for(problem.in_steps_of(last.problem), start)
        if there is None:  # no slope shows a fit the way from there
            return None
        z = refit(problem, start)
        problem = in_units_of(self.noise, problem, z)
        return self._based(problem, z, tuple(kept))

    def _based(self, problem: Problem, z: FloatArray, added: tuple[Candidate, ...]) -> Base:
        """Return a base in steps of the integrator no shorter than its causes ask for: all that follows takes them."""
        while (longer := in_longer_steps(problem, z, self.base.problem.steps)) is not problem:
            problem = longer
        return Base.of(problem, z, added, brisk=self.base.brisk)
