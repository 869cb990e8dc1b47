"""Fits of one problem with one candidate more: several starts, the most promising of them followed to their ends."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import FORCED
from labrun.fit import Each, Jacobian, Problem, minimise, one_by_one
from labrun.gap import criteria, numerics
from labrun.gap.candidates import Candidate, family
from labrun.gap.diagnosis import Name
from labrun.gap.lines import line_starts
from labrun.gap.nuisance import NuisanceProjection
from labrun.gap.steps import in_steps_that_follow

_STARTS_FOLLOWED = 2
"""Starts that are followed."""
_STARTS_BESIDE_KNOWN = 1
"""Starts that are followed beside the sizes at which an earlier fit of the same candidate ended."""
_STARTS_ALIKE = 0.99
"""Starts whose changes of the residuals have at least this cosine lead to one end."""
_REFIT_RENEWALS = 12
"""How often derivatives are taken at most in fits of candidates, and of what was chosen."""


_REPLACING = 2.0
"""Squares, in units of those of the base, that a start in the place of a term of the model may have."""


@dataclass(frozen=True)
class Base:
    """A fitted problem that candidates are added to.

    Attributes
    ----------
    residual : per unit
        Whitened.
    squares
        Sum of squared residuals, prior included.
    nuisance
        What its variables can imitate.
    brisk
        Whether fits of candidates carry derivatives over: see `labrun.gap.Options`.
    """

    problem: Problem
    z: FloatArray
    residual: list[FloatArray]
    squares: float
    nuisance: NuisanceProjection
    added: tuple[Candidate, ...] = ()
    brisk: bool = False

    @classmethod
    def of(
        cls, problem: Problem, z: FloatArray, added: tuple[Candidate, ...] = (), *, brisk: bool = False
    ) -> "Base":
        """Take the state of a problem at `z`."""
        residual, prior = problem.residuals(z), problem.priors.residual(z)
        squares = float(prior @ prior) + sum(float(part @ part) for part in residual)
        return cls(problem, z, residual, squares, NuisanceProjection(problem, z, residual), added, brisk)

    @cached_property
    def without_free_terms(self) -> list[tuple[FloatArray, list[FloatArray]]]:
        """The variables with one free parameter of the model at zero, and the residuals there; one for each such term.

        A free term of the wrong law stands in the way of an effect of the right one: together they have no way down.
        """
        priors, cases = self.problem.priors, []
        for variable, index in enumerate(priors.free):
            of_model = index < len(self.problem.model.parameters)
            allowed = priors.lower[variable] <= 0.0 <= priors.upper[variable]
            if not of_model or np.isfinite(priors.sigma[variable]) or not allowed or self.z[variable] == 0.0:
                continue
            z = self.z.copy()
            z[variable] = 0.0
            residual = self.problem.finite_residuals(z)
            if residual is not None:
                cases.append((z, residual))
        return cases

    def sorted_as(self, candidates: Sequence[Candidate]) -> FloatArray:
        """Return the variables in the order of a problem to which the same candidates were added in another order."""
        start = self.problem.size - sum(candidate.variables for candidate in self.added)
        parts, at = {}, start
        for candidate in self.added:
            parts[candidate.name] = self.z[at : at + candidate.variables]
            at += candidate.variables
        sizes = [parts[candidate.name] for candidate in candidates]
        return np.concatenate([self.z[:start], *sizes, self.problem.own_states(self.z)])


@dataclass(frozen=True)
class Survey:
    """A candidate looked at from a base, without any fit.

    Attributes
    ----------
    problem
        In the integrator's steps of the base.
    starts : per direction, `z` of the candidate's problem
        Most promising first; none of a candidate that gives no finite numbers at any size.
    directions : (rows, d)
        Changes of the residuals that the candidate makes at these starts, less what recalibration imitates; columns.
    whole : (d,)
        Norm of each change before that, in units of the noise.
    potential
        By how much the sum of squares would fall if one of the changes, in the best measure, were added.
    replacing
        A start in the place of a free term of the model, which is zero there; None where no term could be replaced.
    """

    candidate: Candidate
    problem: Problem
    starts: list[FloatArray]
    directions: FloatArray = field(repr=False)
    whole: FloatArray
    potential: float
    replacing: FloatArray | None = None

    def different(self, most: int) -> list[FloatArray]:
        """Return the most promising starts that change the residuals in different ways.

        Of an effect that is linear in its size, one start is as good as many.
        """
        norms = np.linalg.norm(self.directions, axis=0)
        unit = self.directions / np.where(norms > 0, norms, 1.0)
        chosen: list[int] = []
        for index in range(len(self.starts)):
            if len(chosen) == most:
                break
            if not np.any(np.abs(unit[:, chosen].T @ unit[:, index]) > _STARTS_ALIKE):
                chosen.append(index)
        return [self.starts[index] for index in chosen]

    @property
    def lines(self) -> FloatArray:
        """The directions, one long; those that are nothing left out."""
        norms = np.linalg.norm(self.directions, axis=0)
        return np.asarray(self.directions[:, norms > 0] / norms[norms > 0])


@dataclass(frozen=True)
class Screened:
    """A candidate added to a base and fitted.

    Attributes
    ----------
    z, squares
        Where the fit ended; where the survey promised nothing, its best start.
    gain
        By how much the sum of squares fell.
    """

    candidate: Candidate
    problem: Problem
    z: FloatArray
    squares: float
    gain: float
    survey: Survey = field(repr=False)

    @property
    def sizes(self) -> FloatArray:
        """The candidate's own variables."""
        size = self.problem.size
        return self.z[size - self.candidate.variables : size]

    @property
    def visible(self) -> float:
        """Norm of the largest change it makes and recalibration cannot imitate, in units of the noise.

        What recalibration cannot imitate is taken from the smallest change: of a large one the linear projection leaves
        much that parameters would follow.
        """
        whole = self.survey.whole
        if not np.any(whole > 0):
            return 0.0
        smallest = int(np.argmin(np.where(whole > 0, whole, np.inf)))
        remainder = float(np.linalg.norm(self.survey.directions[:, smallest])) / float(whole[smallest])
        return remainder * float(np.max(whole)) if remainder > criteria.IMITATED else 0.0


def survey(base: Base, candidate: Candidate) -> Survey:
    """Look at what a candidate would change, at several sizes, and order its starts.

    A start is judged by what it would leave once parameters and initial states have adapted (linearly). One whose
    simulation is not finite, with shorter steps either, says nothing: it is left out, and the survey has no starts if
    all are.
    """
    problem = candidate.added_to(base.problem)
    shared, own = base.z[: base.problem.size], base.problem.own_states(base.z)
    before = base.nuisance.remainder(base.residual, base.problem.priors.residual(base.z))
    rated: list[tuple[float, int, FloatArray, FloatArray, float]] = []
    periodic = line_starts(base.problem, base.z, candidate)
    for number, start in enumerate((*candidate.starts, *periodic)):
        z = np.concatenate([shared, start, own])
        if candidate.attached is None:
            change, whole = _released(base, problem)
            rated.append((0.0, number, z, change, whole))
            continue
        moved = in_steps_that_follow(problem, z, base.residual, candidate.pace_s(start))[1]
        if moved is None:
            continue
        parts = [after - now for after, now in zip(moved, base.residual, strict=True)]
        change = base.nuisance.remainder(parts)
        whole = float(np.sqrt(sum(float(part @ part) for part in parts)))
        rated.append((float(np.sum((before + change) ** 2)), number, z, change, whole))
    rated.sort(key=lambda pair: pair[:2])
    directions = np.column_stack([change for *_, change, _ in rated]) if rated else np.empty((len(before), 0))
    norms = np.linalg.norm(directions, axis=0)
    along = np.divide(directions.T @ before, norms, out=np.zeros_like(norms), where=norms > 0)
    potential = float(np.max(np.square(along), initial=0.0))
    replacing = _replacing_a_term(base, candidate, problem) if rated else None
    if replacing is not None:
        potential = max(potential, base.squares - problem.squares(replacing))
    return Survey(
        candidate,
        problem,
        [z for _, _, z, _, _ in rated],
        directions,
        np.array([whole for *_, whole in rated]),
        potential,
        replacing,
    )


def _replacing_a_term(base: Base, candidate: Candidate, problem: Problem) -> FloatArray | None:
    """Return the best start of a force in the place of a free term of the model; None where none is promising.

    The size of the force is the one whose change of the residuals best undoes that of leaving out the term.
    """
    attached = candidate.attached
    if attached is None or attached.effect.kind not in FORCED:
        return None
    own, best, least = base.problem.own_states(base.z), None, _REPLACING * base.squares
    start = np.array(candidate.starts[0])
    fitted = [parameter for parameter in attached.effect.parameters if not parameter.held]
    lower, upper = (np.array([getattr(item, end) for item in fitted]) for end in ("lower", "upper"))
    scales = np.array([item.neutral == 0.0 for item in fitted])
    for without, residual in base.without_free_terms:
        shared = without[: base.problem.size]
        added = problem.finite_residuals(np.concatenate([shared, start, own]))
        if added is None:
            continue
        removed = np.concatenate(residual) - np.concatenate(base.residual)
        change = np.concatenate(added) - np.concatenate(residual)
        energy = float(change @ change)
        if energy == 0.0:
            continue
        size = -float(change @ removed) / energy
        sizes = np.clip(np.where(scales, size * start, start), lower, upper)
        z = np.concatenate([shared, sizes, own])
        if problem.finite_residuals(z) is not None and (squares := problem.squares(z)) < least:
            best, least = z, squares
    return best


def rough(base: Base, surveyed: Survey, known: FloatArray | None = None) -> Screened:
    """Fit all variables from the most promising starts, roughly, and return the best of these ends.

    Parameters
    ----------
    known
        Sizes at which an earlier fit of this candidate ended, beside another base: a start like no other.
    """
    starts = surveyed.different(_STARTS_FOLLOWED if known is None else _STARTS_BESIDE_KNOWN)
    if known is not None:
        shared, own = base.z[: base.problem.size], base.problem.own_states(base.z)
        starts = [np.concatenate([shared, known, own]), *starts]
    if surveyed.replacing is not None:
        starts = [*starts, surveyed.replacing]
    # what the candidate is added to is fitted already: its derivatives do to see how far a start leads
    jacobian = base.nuisance.jacobian if surveyed.candidate.variables else None
    ends: list[tuple[float, Problem, FloatArray]] = []
    candidate, size = surveyed.candidate, surveyed.problem.size
    for start in starts:
        pace_s = candidate.pace_s(start[size - candidate.variables : size])
        problem, residuals = in_steps_that_follow(surveyed.problem, start, base.residual, pace_s)
        z = minimise(
            problem,
            start,
            tolerance=numerics.ROUGH_TOLERANCE,
            evaluations=numerics.ROUGH_EVALUATIONS,
            central=False,
            derivatives=None
            if jacobian is None
            else problem.jacobian(start, residuals, given_jacobian=jacobian),
            secant=jacobian is not None,
            confirmed=jacobian is None,
            given_jacobian=jacobian,
            residual=residuals,
        )
        ends.append((problem.squares(z), problem, z))
    squares, problem, z = min(ends, key=lambda end: end[0])
    return _screened(base, surveyed, problem, z, squares)


def derivatives_around(base: Base, candidate: Candidate) -> Jacobian | None:
    """Return the derivatives that brisk fits carry over: by what a candidate is added to, whose variables move little.

    None where fits are not brisk, and of a parameter, which is among them.
    """
    return base.nuisance.jacobian if base.brisk and candidate.variables else None


def follow(base: Base, screened: Screened) -> Screened:
    """Fit all variables to the end, from where a rough fit ended."""
    problem, derivatives = screened.problem, derivatives_around(base, screened.candidate)
    z = minimise(
        problem,
        screened.z,
        tolerance=numerics.FIT_TOLERANCE,
        evaluations=numerics.FIT_EVALUATIONS,
        central=False,
        secant=True,
        given_jacobian=derivatives,
        renewals=numerics.FIT_RENEWALS,
    )
    return _screened(base, screened.survey, problem, z, problem.squares(z))


def screen_all(
    base: Base,
    surveys: Sequence[Survey],
    each: Each = one_by_one,
    known: Mapping[Name, FloatArray] | None = None,
) -> list[Screened]:
    """Fit every candidate whose survey promises something, in their order.

    All of them roughly, and to their ends those that then are not far behind the best. What gives no finite numbers is
    not among them.

    Parameters
    ----------
    known
        Sizes at which earlier fits of candidates ended; see `rough`.
    """
    known = known or {}
    surveys = [s for s in surveys if s.starts]
    best = max((s.potential for s in surveys), default=0.0)
    needed = criteria.WORTH_FITTING * best
    top = sorted((s.potential for s in surveys), reverse=True)[: criteria.ALWAYS_FITTED]
    needed = min(needed, top[-1]) if top else needed

    def begin(surveyed: Survey) -> Screened:
        if surveyed.potential >= needed:
            return rough(base, surveyed, known.get(surveyed.candidate.name))
        expected = base.squares - surveyed.potential
        return Screened(
            surveyed.candidate, surveyed.problem, surveyed.starts[0], expected, surveyed.potential, surveyed
        )

    started = each(begin, surveys)
    gains = sorted((fit.gain for fit in started if fit.survey.potential >= needed), reverse=True)
    enough = min(criteria.WORTH_FITTING * gains[0], gains[: criteria.ALWAYS_FITTED + 1][-1]) if gains else 0.0

    def finish(screened: Screened) -> Screened:
        worthy = screened.survey.potential >= needed and screened.gain >= enough
        return follow(base, screened) if worthy else screened

    return each(finish, started)


def refit_from_related_optima(
    base: Base, screened: Sequence[Screened], each: Each = one_by_one
) -> list[Screened]:
    """Fit effects again from where a better one of their family ended whose sizes are of the same quantities.

    Related effects have their best sizes close together, and a fit from afar may have missed them.
    """
    enough = criteria.WORTH_FITTING * max((entry.gain for entry in screened), default=0.0)

    def again(start: Screened) -> Screened:
        kin = [
            other
            for other in screened
            if other.gain >= enough
            and other.gain > start.gain
            and family(start.candidate.name, other.candidate.name)
            and start.candidate.quantities == other.candidate.quantities
            and start.survey.starts
        ]
        if not kin:
            return start
        known = max(kin, key=lambda other: other.gain).sizes
        refined = follow(base, rough(base, start.survey, known))
        return refined if refined.gain > start.gain else start

    return each(again, screened)


def ends_of(screened: Iterable[Screened]) -> dict[Name, FloatArray]:
    """Return the sizes at which fits of effects ended, for later fits to start from."""
    return {
        s.candidate.name: s.sizes for s in screened if s.candidate.variables and s.z is not s.survey.starts[0]
    }


def refit(problem: Problem, z: FloatArray, *, tolerance: float = 1e-6) -> FloatArray:
    """Return the minimum that `z` leads to, followed closely."""
    return minimise(problem, z, tolerance=tolerance, evaluations=80, secant=True, renewals=_REFIT_RENEWALS)


def _screened(base: Base, surveyed: Survey, problem: Problem, z: FloatArray, squares: float) -> Screened:
    gain = max(base.squares - squares, 0.0)
    return Screened(surveyed.candidate, problem, z, squares, gain, surveyed)


def _released(base: Base, problem: Problem) -> tuple[FloatArray, float]:
    """Return the derivative by a parameter, less what the others can imitate, and its norm before that."""
    variable = next(
        index
        for index, (mine, theirs) in enumerate(
            zip(base.problem.priors.pull, problem.priors.pull, strict=True)
        )
        if mine != theirs
    )
    size = base.problem.priors.pull[variable] / base.problem.priors.scale[variable]
    parts = [shared[:, variable] * size for shared in base.nuisance.jacobian.shared]
    return base.nuisance.remainder(parts), float(np.sqrt(sum(float(part @ part) for part in parts)))
