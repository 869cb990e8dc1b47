"""Which causes: the best candidate, whether more than one is at work, and what cannot be told from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.notes import Note
from labrun.fit.workers import Each, one_by_one
from labrun.gap import criteria
from labrun.gap.candidates import Candidate, without
from labrun.gap.diagnosis import Name
from labrun.gap.held_out import Excess, excess, held_out_residuals
from labrun.gap.noise import Noise
from labrun.gap.noise_threshold import Guard, guard
from labrun.gap.rating import Rated, promising, rate, shaped, weights
from labrun.gap.screening import Base, Screened, ends_of, refit, screen_all, survey


@dataclass(frozen=True)
class Round:
    """All candidates beside one base."""

    base: Base
    screened: list[Screened]
    guard: Guard
    rated: list[Rated]

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
class Selection:
    """What was chosen.

    Attributes
    ----------
    rounds
        Beside the recalibrated model, beside the first cause, and so on; the last finds nothing more.
    chosen
        The causes with the rating they had when they were taken in.
    rivals : per cause
        What explains the data as well, most probable first, with its weight beside the cause's own.
    held_out
        Excess of the final model on withheld conditions.
    """

    rounds: list[Round]
    chosen: tuple[Rated, ...]
    rivals: tuple[tuple[tuple[Rated, float], ...], ...]
    weights: tuple[float, ...]
    final: Base
    held_out: Excess
    residual: list[FloatArray]


def look(
    base: Base,
    candidates: Sequence[Candidate],
    noise: Noise,
    draws: Sequence[Sequence[FloatArray]],
    reference: Excess,
    strictness: float = 1.0,
    each: Each = one_by_one,
    known: Mapping[Name, FloatArray] | None = None,
) -> Round:
    """Try every candidate beside a base: fit, guard, and the best of them on withheld conditions.

    Parameters
    ----------
    strictness
        Factor on the guard's threshold.
    known
        Sizes at which earlier fits of candidates ended.
    """
    surveys = each(lambda one: survey(base, one), candidates)
    threshold = guard(base, surveys, draws).times(strictness)
    screened = screen_all(base, surveys, threshold.threshold, each, known=known)
    rated = each(
        lambda one: rate(base, shaped(base, one, threshold), threshold, noise, reference),
        promising(screened, threshold, criteria.RATED),
    )
    return Round(base, screened, threshold, rated)


@dataclass(frozen=True)
class Selector:
    """How causes are chosen: one by one, then each again beside the others.

    Attributes
    ----------
    reference, residual
        Held-out excess and residuals of the recalibrated model.
    """

    first: Round
    candidates: Sequence[Candidate]
    noise: Noise
    draws: Sequence[Sequence[FloatArray]]
    reference: Excess
    residual: list[FloatArray]
    note: Note
    strictness: float = 1.0
    each: Each = one_by_one
    known: Mapping[Name, FloatArray] = field(default_factory=dict)
    _rounds: "dict[frozenset[Name], Round]" = field(default_factory=dict, repr=False)

    def select(self) -> Selection:
        """Choose the causes; each must beat the guard given the others, and remove a part of the gap of its own.

        What simpler effects together explain as well is theirs: friction that differs by direction is Coulomb friction
        beside a constant pull, unless the data say more.
        """
        found = self._select()
        compound = {
            one.name for one in self.candidates if one.attached is not None and one.attached.effect.compound
        }
        if not compound & {one.candidate.name for one in found.chosen}:
            return found
        self.note("looking whether simpler effects explain as much")
        simpler = replace(
            self,
            first=self.first.without(compound),
            candidates=without(self.candidates, compound),
            _rounds={},
        )._select()
        room = criteria.SIMPLER_TOGETHER * self.reference.total
        if not simpler.chosen or simpler.held_out.total > found.held_out.total + room:
            return found
        return replace(simpler, rounds=[self.first, *simpler.rounds[1:]])  # the table is of all candidates

    def _select(self) -> Selection:
        chosen, rounds = self._forward()
        if len(chosen) > 1:
            chosen, rounds = self._exchanged(chosen)
        if len(chosen) > 2:
            chosen, rounds = self._fewer(chosen, rounds)
        # one of two causes alone may fail where it was not fitted; all that were chosen together must not
        alone = max((one.share for one in self.first.rated), default=0.0)
        needed = criteria.LEAST_SHARE if alone >= criteria.LEAST_SHARE else criteria.TOGETHER_SHARE
        if chosen and self._share(chosen[-1].held_out) < needed:
            chosen, rounds = [], [self.first]
        base = chosen[-1].base if chosen else self.first.base
        left = chosen[-1].held_out if chosen else self.reference
        there = chosen[-1].residual if chosen else self.residual
        return Selection(
            [*rounds],
            tuple(one.rated for one in chosen),
            tuple(one.rivals for one in chosen),
            tuple(one.weight for one in chosen),
            base,
            left,
            there,
        )

    def _share(self, left: Excess) -> float:
        return 1.0 - left.total / self.reference.total if self.reference.total > 0 else 0.0

    def _forward(self) -> "tuple[list[_Chosen], list[Round]]":
        rounds, chosen = [self.first], list[_Chosen]()
        while len(chosen) < criteria.MOST_CAUSES:
            left = chosen[-1].held_out if chosen else self.reference
            one = self._choose(rounds[-1], left, further=bool(chosen))
            if one is None:
                break
            self.note(f"found {one.rated.candidate.name}; looking whether there is more")
            chosen.append(one)
            if len(chosen) < criteria.MOST_CAUSES:
                rounds.append(self._look(one.base))
        return chosen, rounds

    def _exchanged(self, chosen: "list[_Chosen]") -> "tuple[list[_Chosen], list[Round]]":
        """Choose each cause again beside the others: what stood in for two of them gives way."""
        for _sweep in range(criteria.EXCHANGES):
            before = {one.rated.candidate.name for one in chosen}
            if len(chosen) == 1:
                break
            for _ in range(len(chosen)):
                self.note(f"checking {chosen[0].rated.candidate.name} again beside the others")
                again = self._rounds.get(frozenset(one.rated.candidate.name for one in chosen[1:]))
                again = again or self._look(self._kept(chosen, set(range(1, len(chosen)))))
                base = again.base
                residual = held_out_residuals(base.problem, base.z)
                left = excess(base.problem.data, self.noise, residual)
                one = self._choose(again, left, further=True)
                if one is None:  # the others do without it
                    kept = replace(chosen[-1], base=base, held_out=left, residual=residual)
                    chosen = [*chosen[1:-1], kept]
                    break
                chosen = [*chosen[1:], one]
            if {one.rated.candidate.name for one in chosen} == before:
                break
        if len(chosen) == 1:
            chosen = [self._alone(chosen[0])]
        return chosen, [self.first, self._look(chosen[-1].base)]

    def _alone(self, one: "_Chosen") -> "_Chosen":
        """Return a cause that is left alone with the rivals it has there, not those it had beside another."""
        name = one.rated.candidate.name
        rated = next((other for other in self.first.rated if other.candidate.name == name), None)
        if rated is None:
            return one
        rivals, weight = _rivals(rated, self.first.rated)
        return replace(one, rated=rated, rivals=rivals, weight=weight)

    def _fewer(self, chosen: "list[_Chosen]", rounds: list[Round]) -> "tuple[list[_Chosen], list[Round]]":
        """Return two causes in place of three, if there are two that leave hardly more than the three do.

        Whoever is found first beside nothing may stand in for another, and a third then mends what it cannot do.
        """
        enough = chosen[-1].held_out.total + criteria.NOTICED_SHARE * self.reference.total
        pair: list[_Chosen] = []
        for place, one in enumerate(chosen):
            alone = self._rounds.get(frozenset([one.rated.candidate.name])) or self._look(
                self._kept(chosen, {place})
            )
            residual = held_out_residuals(alone.base.problem, alone.base.z)
            left = excess(alone.base.problem.data, self.noise, residual)
            other = self._choose(alone, left, further=True)
            if other is not None and other.held_out.total < enough:
                pair, enough = [one, other], other.held_out.total
        return self._exchanged(pair) if pair else (chosen, rounds)

    def _choose(self, current: Round, left: Excess, *, further: bool) -> "_Chosen | None":
        best = _best(current.rated, left, self.reference, further=further)
        if best is None:
            return None
        rivals, weight = _rivals(best, current.rated)
        base = _settled(best.screened, (*current.base.added, best.candidate))
        return _Chosen(best, rivals, weight, base, best.held_out, best.residual)

    def _look(self, base: Base) -> Round:
        """Look beside a base, once for each set of causes, in whichever order they were found."""
        names = frozenset(one.name for one in base.added)
        found = self._rounds.get(names)
        if found is None:
            rest = without(self.candidates, names)
            known = {**self.known, **ends_of(self.first.screened)}
            for earlier in self._rounds.values():
                known |= ends_of(earlier.screened)
            found = self._rounds[names] = look(
                base, rest, self.noise, self.draws, self.reference, self.strictness, self.each, known
            )
        return found

    def _kept(self, chosen: "list[_Chosen]", places: set[int]) -> Base:
        """Return the last base with some of its causes only, fitted again."""
        names = {chosen[place].rated.candidate.name for place in places}
        last = chosen[-1].base
        problem = self.first.base.problem
        at, kept, parts = problem.size, list[Candidate](), [last.z[: problem.size]]
        for candidate in last.added:
            variables = last.z[at : at + candidate.variables]
            at += candidate.variables
            if candidate.name in names:
                problem = candidate.added_to(problem)
                kept.append(candidate)
                parts.append(variables)
        z = np.concatenate([*parts, last.problem.own_states(last.z)])
        return Base.of(problem, refit(problem, z), tuple(kept))


@dataclass(frozen=True)
class _Chosen:
    """A cause, what cannot be told from it, and the model with it and those before it."""

    rated: Rated
    rivals: tuple[tuple[Rated, float], ...]
    weight: float
    base: Base
    held_out: Excess
    residual: list[FloatArray]


def _settled(screened: Screened, added: tuple[Candidate, ...]) -> Base:
    z = refit(screened.problem, screened.z)
    return Base.of(screened.problem, z, added)


def _best(rated: Sequence[Rated], left: Excess, reference: Excess, *, further: bool) -> Rated | None:
    """Return the candidate to take in; the simplest of those that do as well as the best. None if none is needed.

    Parameters
    ----------
    left
        Held-out excess without it.
    """
    passing = [one for one in rated if one.evidence > 1.0]
    if further and reference.total > 0:
        removed = [left.total - one.held_out.total for one in passing]
        passing = [
            one
            for one, less in zip(passing, removed, strict=True)
            if less >= criteria.ANOTHER_SHARE * reference.total
            or (
                less >= criteria.NOTICED_SHARE * reference.total
                and less >= criteria.NOTICED_OF_LEFT * left.total
            )
            or (
                less >= criteria.SMALL_SHARE * reference.total
                and less >= criteria.SMALL_OF_LEFT * left.total
                and left.gap >= criteria.SMALL_GAP
            )
        ]
    if not passing:
        return None
    most = max(one.share for one in passing)
    # what fits the seen conditions well and fails on the unseen has learned the wrong thing
    # ... but where all fail there alone, as each of two causes may, how badly they do says little
    fair = (
        [one for one in passing if one.share >= most - criteria.SHARE_BEHIND_BEST]
        if most >= criteria.LEAST_SHARE
        else passing
    )
    best = max(fair, key=lambda one: one.score)
    probable = weights(fair, _slack(best))
    alike = [
        one
        for one, weight in zip(fair, probable, strict=True)
        if one.candidate.variables < best.candidate.variables
        and one.share >= best.share - criteria.SIMPLER_SHARE
        and weight >= criteria.RIVAL_WEIGHT
    ]
    return max(alike, key=lambda one: one.score) if alike else best


def _rivals(best: Rated, rated: Sequence[Rated]) -> tuple[tuple[tuple[Rated, float], ...], float]:
    """Return what cannot be told from the best, most probable first, and the best one's own weight."""
    near = [
        one
        for one in rated
        if one.evidence > criteria.RIVAL_EVIDENCE
        and one.share >= best.share - criteria.RIVAL_SHARE
        and not _best_again(best, one)
    ]
    if best not in near:
        near.append(best)
    shares = weights(near, _slack(best))
    own = float(shares[near.index(best)])
    ordered = sorted(zip(near, shares, strict=True), key=lambda pair: -pair[1])
    return tuple(
        (one, float(weight)) for one, weight in ordered if one is not best and weight >= criteria.RIVAL_WEIGHT
    ), own


def _best_again(best: Rated, one: Rated) -> bool:
    """Tell whether this is the best again, a richer form at its site that earns nothing by what it has more."""
    simple, rich = best.candidate, one.candidate
    if simple.attached is None or rich.attached is None or simple.name.site != rich.name.site:
        return False
    return simple.name.effect in rich.attached.effect.contains and one.score <= best.score


def _slack(best: Rated) -> float:
    """Return how far forms are to be believed: where the best one's leaves nothing, what leaves something is not it."""
    screened = best.screened
    rows = sum(part.size for part in best.residual)
    left = max(screened.squares - rows, 0.0) / screened.gain if screened.gain > 0 else 1.0
    return float(np.clip(left, *criteria.IDEALISED_FORM))
