"""Which columns of a torque regression are causes: the rule of `labrun.gap.decide`, forward, backward and by exchange.

Candidates of a joint are judged by that joint's torque, those of the whole robot and of coupled motors by the torques
of all joints that they act on, each in units of what is left there.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.gap import criteria, decide
from labrun.gap.robot.linear_evidence import LinearEvidence, log_errors, units_of
from labrun.gap.robot.torque_columns import NUISANCE, WHOLE, Column, Regression

_DRAWS = 100
"""Resamples of the units behind how often a cause wins."""
_MOST_ROUNDS = 12
"""Rounds of the search per joint, at most: each adds or exchanges one cause."""
_POSITIVE = ("coulomb", "viscous", "load", "stribeck", "coupled-inertia", "coupled-coulomb")
_GAIN_ERRORS = (-0.9, 2.0)
"""Range of the error of a drive's gain, as in the library of effects."""
_MOST_TIGHTENING = 20
"""Steps that quarter the variance of links until none is beyond its tolerance."""
COUPLED = "coupled "
"""Before the name of an effect whose motor acts on the joint before, too."""
FORMS: Sequence[tuple[str, tuple[str, ...], str]] = (
    ("coulomb-friction", (), "coulomb"),
    ("viscous-damping", (), "viscous"),
    ("constant-force", (), "offset"),
    ("added-inertia", (), "inertia"),
    ("asymmetric-friction", ("coulomb",), "asymmetry"),
    ("load-dependent-friction", (), "load"),
    ("stribeck-friction", ("coulomb",), "stribeck"),
    ("asymmetric-damping", (), "damping-difference"),
    ("drive-gain", (), "scale"),
    ("added-stiffness", (), "stiffness"),
    ("cogging", (), "cogging"),
    (COUPLED + "added-inertia", (), "coupled-inertia"),
    (COUPLED + "coulomb-friction", (), "coupled-coulomb"),
)
"""Effects of a joint, the most common first: the columns that they share with simpler ones, and their own."""


@dataclass(frozen=True)
class Candidate:
    """What a joint, or the robot, may lack.

    Attributes
    ----------
    effect
        Id in the library.
    joint
        Place of the joint; `WHOLE` of the robot.
    site
        Name of the joint, of the body that carries a load, or ``base``.
    columns
        Places of its own columns in the regression.
    needs
        Places of the columns of a simpler form that must be a cause already: friction is asymmetric, or rises at low
        speed, in addition to its level.
    shapes
        Parameters beside its coefficients: a speed or a number of periods, from a grid.
    rank
        How uncommon it is in practice.
    detail
        Of its own columns.
    scope
        The looked-at joints that it is judged by.
    """

    effect: str
    joint: int
    site: str
    columns: frozenset[int]
    rank: int
    scope: tuple[int, ...]
    shapes: int = 0
    detail: float = 0.0
    needs: frozenset[int] = frozenset()

    @property
    def name(self) -> tuple[str, str]:
        """What it is and where; candidates that differ by a shape only share it."""
        return self.effect, self.site


@dataclass(frozen=True)
class Selected:
    """A cause.

    Attributes
    ----------
    wins
        Share of resamples of the units in which it leads beside the other causes.
    rivals
        What predicts about as well in its place.
    without
        Root mean square error on unseen data at its joints without it, the others refitted, in units of that with it.
    """

    candidate: Candidate
    wins: float = 0.0
    rivals: tuple[Candidate, ...] = ()
    without: float = 1.0


@dataclass(frozen=True)
class Selection:
    """The causes of all joints, with the errors on the way to them.

    Attributes
    ----------
    evidence
        In units of what the causes leave.
    base : (nuisance columns,)
    causes
        In the order in which they were accepted.
    stated, recalibrated, after : (units, joints)
        Mean squared errors as stated, and on unseen data; NaN where a joint rests.
    ladder
        After each cause in turn: root mean square error on unseen data, (joints,).
    tried
        Every candidate.
    """

    regression: Regression
    evidence: LinearEvidence
    base: IntArray
    causes: tuple[Selected, ...]
    stated: FloatArray
    recalibrated: FloatArray
    after: FloatArray
    ladder: tuple[FloatArray, ...] = ()
    tried: tuple[Candidate, ...] = field(default=(), repr=False)

    @property
    def active(self) -> IntArray:
        """All columns of the final model."""
        return _union(self.base, [selected.candidate for selected in self.causes])


def candidates(regression: Regression, library: Collection[str]) -> list[Candidate]:
    """Return what may be missing, of the effects in the library."""
    made = []
    for rank, (effect, shared, own) in enumerate(FORMS):
        if effect.removeprefix(COUPLED) not in library:
            continue
        for joint in regression.looked_at:
            others = [int(location) for kind in shared for location in regression.columns_of(kind, joint)]
            if len(others) < len(shared):
                continue
            details = sorted(
                {regression.columns[location].detail for location in regression.columns_of(own, joint)}
            )
            for detail in details:
                columns = frozenset(map(int, regression.columns_of(own, joint, detail)))
                scope = sorted({number for column in columns for number in regression.acting(column)})
                shapes = int(own in ("stribeck", "cogging"))
                site = regression.log.joints[joint]
                made.append(
                    Candidate(
                        effect, joint, site, columns, rank, tuple(scope), shapes, detail, frozenset(others)
                    )
                )
    everywhere = tuple(range(len(regression.looked_at)))
    if "gravity-tilt" in library and len(regression.columns_of("tilt")):
        columns = frozenset(map(int, regression.columns_of("tilt")))
        made.append(Candidate("gravity-tilt", WHOLE, "base", columns, len(FORMS), everywhere))
    for body, name in enumerate(regression.log.regressor.bodies if "payload" in library else ()):
        columns = frozenset(map(int, regression.columns_of("freed", None, float(body))))
        if columns:
            rank = len(FORMS) + 1 + (body != regression.log.regressor.tip)
            made.append(Candidate("payload", WHOLE, name, columns, rank, everywhere, 0, float(body)))
    return made


def select(
    regression: Regression, library: Collection[str], rng: np.random.Generator, always: Collection[int] = ()
) -> Selection:
    """Find the causes.

    Parameters
    ----------
    library
        Ids of the effects that may be causes.
    always
        Places of columns that are part of every model.
    """
    base = np.array(
        sorted({*always, *(int(location) for kind in NUISANCE for location in regression.columns_of(kind))}),
        dtype=np.int64,
    )
    every = candidates(regression, library)
    search = _Search(regression, regression.evidence, base, every)
    stated = np.column_stack(
        [gram.mean_squares(np.zeros(len(gram.columns))) for gram in search.evidence.grams]
    )
    search.reweigh([])
    recalibrated = search.evidence.unseen(base)
    search.recalibrated = recalibrated
    causes = search.forward(search.of_the_whole())
    for _ in range(3):
        before = causes
        causes = search.backward(causes)
        causes = search.exchange(causes)
        causes = search.forward(causes)
        if causes == before:
            break
    causes = search.backward(causes)
    after = search.evidence.unseen(search.active(causes))
    ladder = tuple(
        np.sqrt(np.nanmean(search.evidence.unseen(search.active(causes[: count + 1])), axis=0))
        for count in range(len(causes))
    )
    selected = tuple(search.rated(causes, candidate, rng) for candidate in causes)
    return Selection(
        regression, search.evidence, base, selected, stated, recalibrated, after, ladder, tuple(every)
    )


@dataclass
class _Search:
    """A search for causes, in units of what the best model so far leaves."""

    regression: Regression
    evidence: LinearEvidence
    base: IntArray
    every: Sequence[Candidate]
    recalibrated: FloatArray = field(default_factory=lambda: np.empty(0))

    def active(self, causes: Sequence[Candidate]) -> IntArray:
        return _union(self.base, causes)

    def reweigh(self, causes: Sequence[Candidate]) -> None:
        """Tell everything in units of what these causes leave, with links that stay within their tolerances."""
        active = self.active(causes)
        self.evidence = replace(self.evidence, precision=self.regression.evidence.precision)
        for _ in range(2):
            errors = self.evidence.unseen(active)
            self.evidence = self.evidence.reweighed(errors, self.regression.independent)
        self.evidence = self.tightened(active)

    def tightened(self, active: IntArray) -> LinearEvidence:
        """Return the evidence with links held so closely to what is stated that a model needs none beyond tolerance."""
        links = self.regression.columns_of("link")
        precision = self.regression.evidence.precision
        # in units of their tolerances the squares of base parameters add up to a chi-square variable
        most = len(links) + criteria.WITHIN_TOLERANCES * np.sqrt(2.0 * len(links))
        evidence = replace(self.evidence, precision=precision)
        for _ in range(_MOST_TIGHTENING):
            if float(np.sum(np.square(evidence.fit(active)[links]))) <= most:
                break
            precision = precision.copy()
            precision[links] *= 4.0
            evidence = replace(evidence, precision=precision)
        return evidence

    def of_the_whole(self) -> list[Candidate]:
        """Return what the robot as a whole lacks, beside friction and offsets of any size at all joints.

        A load is told first: without it friction would stand in for its weight, and beside friction it cannot do so for
        friction.
        """
        friction = [
            int(location)
            for kind in ("coulomb", "viscous", "offset")
            for location in self.regression.columns_of(kind)
        ]
        others = replace(self, base=np.array(sorted({*self.base.tolist(), *friction}), dtype=np.int64))
        others.reweigh([])
        others.recalibrated = others.evidence.unseen(others.base)
        whole, causes = (
            [[candidate] for candidate in self.every if candidate.joint == WHOLE],
            list[Candidate](),
        )
        while added := others.best(causes, whole):
            causes += added
            others.reweigh(causes)
        return causes

    def forward(self, causes: list[Candidate]) -> list[Candidate]:
        """Add causes one by one; where none helps alone, two of one joint together."""
        causes = list(causes)
        for _ in range(_MOST_ROUNDS * len(self.regression.looked_at)):
            self.reweigh(causes)
            added = self.best(causes, [[candidate] for candidate in self._offered(causes)])
            if not added:
                added = self.best(causes, list(self._pairs()))
            if not added:
                break
            causes += added
        return causes

    def _offered(self, causes: Sequence[Candidate]) -> Iterator[Candidate]:
        """Yield the candidates whose simpler forms are causes, and at joints without another richer form."""
        known = {column for cause in causes for column in cause.columns}
        richer = {cause.joint for cause in causes if cause.needs}
        for candidate in self.every:
            if candidate.needs <= known and not (candidate.needs and candidate.joint in richer):
                yield candidate

    def _pairs(self) -> Iterator[list[Candidate]]:
        simple = [
            candidate
            for candidate in self.every
            if len(candidate.columns) == 1 and len(candidate.scope) == 1 and not candidate.needs
        ]
        for first, other in combinations(simple, 2):
            if first.joint == other.joint:
                yield [first, other]

    def best(self, causes: Sequence[Candidate], sets: Sequence[list[Candidate]]) -> list[Candidate]:
        """Return the candidates, if any, that lead at their joints and gain most over all joints."""
        active = self.active(causes)
        known = set(active.tolist())
        new = [(each, frozenset().union(*(candidate.columns for candidate in each)) - known) for each in sets]
        new = [(each, columns) for each, columns in new if columns]
        if not new:
            return []
        before = self.evidence.unseen(active)
        tables = self.admissible(
            self.evidence, active, [columns for _, columns in new], [each[0].scope for each, _ in new], before
        )
        gains = [
            sum(
                float(np.mean(self.logs(before, [joint]) - self.logs(after, [joint])))
                for joint in each[0].scope
            )
            for (each, _), after in zip(new, tables, strict=True)
        ]
        leaders = []
        for scope in dict.fromkeys(each[0].scope for each, _ in new):
            rows = [number for number, (each, _) in enumerate(new) if each[0].scope == scope]
            base = self.logs(before, scope)
            errors = np.array([self.logs(tables[number], scope) for number in rows])
            complexity = [self.complexity(*new[number]) for number in rows]
            row = decide.leader(errors, complexity, units_of(errors))
            if decide.beats(errors[row], base, units_of(base)):
                leaders.append(rows[row])
        if not leaders:
            return []
        return new[max(leaders, key=lambda number: gains[number])][0]

    def admissible(
        self,
        evidence: LinearEvidence,
        active: IntArray,
        groups: Sequence[Collection[int]],
        scopes: Sequence[Sequence[int]],
        before: FloatArray,
    ) -> list[FloatArray]:
        """Return the errors with each group of columns; those before where its sizes are none that nature has."""
        ordered = [np.array(sorted(group)) for group in groups]
        made = evidence.unseen_with(active, ordered, scopes)
        return [
            errors
            if all(
                map(_is_possible, (self.regression.columns[index] for index in group), values.mean(axis=0))
            )
            else before
            for group, (errors, values) in zip(ordered, made, strict=True)
        ]

    def complexity(self, each: Sequence[Candidate], columns: Collection[int]) -> tuple[int, int]:
        shapes = sum(candidate.shapes for candidate in each)
        # the coefficients of a load are those of one thing: where it is, and how heavy
        return len(columns) + shapes, sum(candidate.rank for candidate in each)

    def logs(self, errors: FloatArray, scope: Sequence[int]) -> FloatArray:
        return log_errors(errors, scope, np.nanmean(self.recalibrated, axis=0))

    def backward(self, causes: list[Candidate]) -> list[Candidate]:
        """Take out causes that predict no better by the rule, the least helpful first."""
        causes = list(causes)
        while causes:
            self.reweigh(causes)
            active = self.active(causes)
            after, values = self.evidence.unseen(active), self.evidence.fit(active)
            needless = []
            for candidate in causes:
                others = _without(causes, candidate)
                active = self.active(others)
                before = self.tightened(active).unseen(active)
                base, with_it = (self.logs(errors, candidate.scope) for errors in (before, after))
                possible = all(
                    _is_possible(self.regression.columns[column], values[column])
                    for column in candidate.columns
                )
                if not (possible and decide.beats(with_it, base, units_of(base))):
                    needless.append((float(np.mean(base - with_it)), others))
            if not needless:
                break
            causes = min(needless, key=lambda pair: pair[0])[1]
        return causes

    def exchange(self, causes: list[Candidate]) -> list[Candidate]:
        """Hold each cause against all others in its place."""
        causes = list(causes)
        for candidate in causes:
            if candidate not in causes:
                continue
            others = _without(causes, candidate)
            rows, errors, complexity, _ = self.in_place_of(candidate, others)
            leader = rows[decide.leader(errors, complexity, units_of(errors))]
            if leader.columns != candidate.columns:
                causes = [
                    *others,
                    leader,
                    *(cause for cause in causes if cause.needs and cause.needs <= leader.columns),
                ]
        return causes

    def in_place_of(
        self, candidate: Candidate, others: Sequence[Candidate]
    ) -> tuple[list[Candidate], FloatArray, list[tuple[int, int]], FloatArray]:
        """Return what could stand in a cause's place, with log errors, complexity, and the log errors without any."""
        active = self.active(others)
        known = set(active.tolist())
        rows = [
            other
            for other in self._offered(others)
            if not other.columns <= known
            and (other.scope == candidate.scope or (candidate.joint == WHOLE and other.joint == WHOLE))
        ]
        evidence = self.tightened(active)
        before = evidence.unseen(active)
        tables = self.admissible(
            evidence, active, [other.columns - known for other in rows], [candidate.scope] * len(rows), before
        )
        errors = np.array([self.logs(table, candidate.scope) for table in tables])
        complexity = [self.complexity([other], other.columns - known) for other in rows]
        return rows, errors, complexity, self.logs(before, candidate.scope)

    def rated(self, causes: Sequence[Candidate], candidate: Candidate, rng: np.random.Generator) -> Selected:
        """Return a cause with how often it wins, and its rivals."""
        others = _without(causes, candidate)
        rows, errors, complexity, base = self.in_place_of(candidate, others)
        own = next(number for number, row in enumerate(rows) if row.columns == candidate.columns)
        near = [rows[number] for number in decide.near_best(errors, units_of(errors)) if number != own]
        known = set(self.active(others).tolist())
        size = complexity[own][0]
        rivals = [
            row
            for row in near
            if row.name != candidate.name and len(row.columns - known) + row.shapes <= size
        ]
        strata = self.regression.evidence.strata
        seen = np.isfinite(self.evidence.unseen(self.active(others))[:, list(candidate.scope)]).any(axis=1)
        drawn = decide.resamples(strata[seen], _DRAWS, rng)
        wins = decide.win_frequencies(base, errors, complexity, units_of(base), drawn)
        share = sum(float(wins[number]) for number, row in enumerate(rows) if row.name == candidate.name)
        without = float(np.exp(0.5 * np.mean(base - errors[own])))
        unique = {row.name: row for row in reversed(rivals)}
        return Selected(candidate, decide.tempered(share, _DRAWS), tuple(reversed(unique.values())), without)


def _is_possible(column: Column, value: float) -> bool:
    """Tell whether a coefficient is one that nature has: friction brakes, and a drive's gain has a range."""
    if column.kind in _POSITIVE:
        return value >= 0.0
    if column.kind == "scale":
        low, high = _GAIN_ERRORS
        return 1.0 / (1.0 + high) <= 1.0 + value <= 1.0 / (1.0 + low)
    return True


def _union(base: IntArray, causes: Sequence[Candidate]) -> IntArray:
    return np.array(
        sorted({*map(int, base), *(column for cause in causes for column in cause.columns)}), dtype=np.int64
    )


def _without(causes: Sequence[Candidate], candidate: Candidate) -> list[Candidate]:
    """Return the other causes, without those that are richer forms of this one."""
    return [cause for cause in causes if cause is not candidate and not cause.needs & candidate.columns]


def told_together(causes: Sequence[Selected]) -> list[Selected]:
    """Return causes with each richer form in place of the simpler one that it contains."""
    richer = {column: cause for cause in causes for column in cause.candidate.needs}
    messages = []
    for cause in causes:
        if cause.candidate.needs:
            continue
        form = next((richer[column] for column in cause.candidate.columns if column in richer), None)
        if form is None:
            messages.append(cause)
            continue
        both = replace(form.candidate, columns=form.candidate.columns | cause.candidate.columns)
        messages.append(replace(form, candidate=both, wins=min(form.wins, cause.wins), without=cause.without))
    return messages
