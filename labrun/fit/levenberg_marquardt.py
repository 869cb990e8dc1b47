"""Multi-start Levenberg-Marquardt that exploits the block structure of trials."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.method import Note
from labrun.fit.problem import Jacobian, Problem
from labrun.fit.variables import Priors

_FIRST_DAMPING = 1e-4
_LEAST_DAMPING, _MOST_DAMPING = 1e-13, 1e12
_ROUNDING = 1e-14
"""A predicted gain below this share of the misfit cannot be told from rounding."""
_POOR = 0.75
"""Derivatives that foretold a gain worse than by this factor are not carried on."""


@dataclass(frozen=True)
class NormalEquations:
    """Sums of products of the derivatives, all that is kept of them: p shared, q own variables of each of T trials.

    Attributes
    ----------
    shared : (p, p), shared_pull : (p,)
        J'J and J'r by the free parameters, prior included.
    own : (T, q, q), own_pull : (T, q)
        By the trials' own initial states.
    mixed : (T, q, p)
    """

    shared: FloatArray
    shared_pull: FloatArray
    own: FloatArray
    own_pull: FloatArray
    mixed: FloatArray

    @classmethod
    def of(cls, problem: Problem, z: FloatArray, jacobian: Jacobian) -> "NormalEquations":
        """Sum up the derivatives of all trials at `z`."""
        slope = problem.priors.slope
        pairs = list(zip(jacobian.shared, jacobian.own, jacobian.residual, strict=True))
        return cls(
            np.diag(slope**2) + sum(shared.T @ shared for shared, _, _ in pairs),
            slope * problem.priors.residual(z) + sum(shared.T @ residual for shared, _, residual in pairs),
            np.array([own.T @ own for _, own, _ in pairs]),
            np.array([own.T @ residual for _, own, residual in pairs]),
            np.array([own.T @ shared for shared, own, _ in pairs]),
        )

    @property
    def diagonal(self) -> FloatArray:
        """Diagonal of the whole J'J, in the order of `z`."""
        own = np.diagonal(self.own, axis1=1, axis2=2)
        return np.concatenate([np.diag(self.shared), own.ravel()])

    def step(self, damping: FloatArray, room: tuple[FloatArray, FloatArray] | None = None) -> FloatArray:
        """Return the step that lowers the linear model's sum of squares, plus ``step' diag(damping) step``, the most.

        The own variables are eliminated trial by trial (a Schur complement), so that the cost grows with the number of
        trials and not with its cube.

        Parameters
        ----------
        room : (p,), (p,)
            How far down and up the shared variables may move; as far as they like if None.
        """
        size = len(self.shared_pull)
        own = self.own + damping[size:].reshape(self.own_pull.shape)[:, :, None] * np.eye(self.own.shape[1])
        solved = np.linalg.solve(own, np.concatenate([self.mixed, self.own_pull[:, :, None]], axis=2))
        reduced = (np.swapaxes(self.mixed, 1, 2) @ solved).sum(axis=0)
        left = self.shared + np.diag(damping[:size]) - reduced[:, :-1]
        right = reduced[:, -1] - self.shared_pull
        low, high = (np.full(size, -np.inf), np.full(size, np.inf)) if room is None else room
        moving = high > low
        left, right, low, high = left[np.ix_(moving, moving)], right[moving], low[moving], high[moving]
        step = np.zeros(size)
        step[moving] = np.linalg.solve(left, right)
        if np.any((step[moving] < low) | (step[moving] > high)):
            step[moving] = _within(left, right, low, high)
        return np.concatenate([step, (-solved[:, :, -1] - solved[:, :, :-1] @ step).ravel()])

    def gain(self, step: FloatArray) -> float:
        """Return by how much the sum of squares would fall in the linear model."""
        size = len(self.shared_pull)
        shared, own = step[:size], step[size:].reshape(self.own_pull.shape)
        first = shared @ self.shared_pull + np.sum(own * self.own_pull)
        second = shared @ self.shared @ shared + 2.0 * np.einsum("tq,tqp,p->", own, self.mixed, shared)
        second += np.einsum("tq,tqr,tr->", own, self.own, own)
        return float(-2.0 * first - second)


def minimise(
    problem: Problem,
    z: FloatArray,
    *,
    lower: FloatArray | None = None,
    upper: FloatArray | None = None,
    tolerance: float = 1e-10,
    evaluations: int = 60,
    stop: Callable[[FloatArray], bool] = lambda _: False,
    central: bool = True,
    derivatives: Jacobian | None = None,
    secant: bool = False,
    confirmed: bool = True,
    given_jacobian: Jacobian | None = None,
    renewals: float = math.inf,
    residual: list[FloatArray] | None = None,
) -> FloatArray:
    """Return the nearest minimum of the squared residuals and the prior.

    Levenberg-Marquardt: damping in units of the largest curvature each variable has shown (More 1978), adapted to how
    well the linear model predicted each gain (Nielsen 1999). Each step is the best one within the bounds.

    Parameters
    ----------
    lower, upper : (p,)
        Bounds of the scaled free parameters; those of the problem if None.
    tolerance
        Ends where the sum of squares falls, and is predicted to fall, by less than this share of itself.
    evaluations
        Most evaluations of all residuals; derivatives not counted.
    stop
        Asked with every accepted point; true ends the descent there.
    central
        Differences to both sides for the derivatives; see `Problem.jacobian`.
    derivatives
        Derivatives at, or near, `z`, where they are known already.
    secant
        Whether derivatives are carried on from step to step by what each step showed, trial by trial (Broyden 1965),
        and taken anew only where that fails: one simulation of everything for a step, not one per variable.
    confirmed
        Whether a descent ends only on derivatives that were taken where it ends.
    given_jacobian
        Derivatives by the first shared variables and the trials' own, which change little on the way: where
        derivatives have to be taken anew, only those by the variables behind them are, unless a step fails with these.
    renewals
        How often derivatives are taken at most: a descent that would need them once more ends.
    """
    size = problem.size
    if len(z) == 0:
        return z
    low = _bounds(z, problem.priors.lower if lower is None else lower, -np.inf)
    high = _bounds(z, problem.priors.upper if upper is None else upper, np.inf)
    start, z = z, np.clip(z, low, high)
    residual = problem.residuals(z) if residual is None or np.any(z != start) else residual
    squares = problem.squares(z, residual)
    damping, growth, count, scale = _FIRST_DAMPING, 2.0, 1, np.zeros(len(z))
    moving = high[:size] > low[:size]
    jacobian, fresh, partly = derivatives, False, False
    while count < evaluations and (jacobian is not None or renewals > 0) and not stop(z):
        if jacobian is None:
            renewals -= 1
            partly = given_jacobian is not None and not partly
            jacobian = problem.jacobian(
                z, residual, central=central, moving=moving, given_jacobian=given_jacobian if partly else None
            )
            fresh = not partly
        jacobian = replace(jacobian, residual=residual)
        equations = NormalEquations.of(problem, z, jacobian)
        scale = np.maximum(scale, equations.diagonal)
        scale = np.maximum(scale, 1e-20 * float(np.max(scale, initial=1e-280)))
        before, final = squares, fresh or partly or not confirmed
        while count < evaluations:
            step = equations.step(damping * scale, (low[:size] - z[:size], high[:size] - z[:size]))
            moved = np.clip(z + step, low, high)
            predicted = equations.gain(moved - z)
            if predicted <= _ROUNDING * squares or damping > _MOST_DAMPING:
                if final:
                    return z
                jacobian = None
                break
            residual_there = problem.residuals(moved)
            there = problem.squares(moved, residual_there)
            count += 1
            ratio = (squares - there) / predicted
            if there < squares:
                carried = secant and ratio > _POOR
                jacobian = _carried_on(jacobian, moved - z, residual_there, size) if carried else None
                z, residual, squares, fresh, partly = moved, residual_there, there, False, False
                damping = max(damping * max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3), _LEAST_DAMPING)
                growth = 2.0
                break
            if final and predicted < tolerance * squares:  # nor would a shorter step gain what counts
                return z
            if not fresh:  # the derivatives may be to blame
                jacobian = None
                break
            damping, growth = damping * growth, 2.0 * growth
        if before - squares < tolerance * before and predicted < tolerance * before:
            if final:
                break
            jacobian = None
    return z


def _bounds(z: FloatArray, shared: FloatArray, own: float) -> FloatArray:
    """Return bounds of all variables from those of the shared ones; `own`: that of the trials' own."""
    return np.concatenate([shared, np.full(len(z) - len(shared), own)])


def _carried_on(jacobian: Jacobian, step: FloatArray, residual: list[FloatArray], size: int) -> Jacobian:
    """Return Broyden-updated derivatives that reproduce the last step, trial by trial."""
    shared_step, own_steps = step[:size], step[size:].reshape(len(residual), -1)
    shared, own = [], []
    for mine, theirs, before, after, own_step in zip(
        jacobian.shared, jacobian.own, jacobian.residual, residual, own_steps, strict=True
    ):
        missed = after - before - mine @ shared_step - theirs @ own_step
        length = float(shared_step @ shared_step + own_step @ own_step)
        missed /= length if length > 0 else 1.0
        shared.append(mine + np.outer(missed, shared_step))
        own.append(theirs + np.outer(missed, own_step))
    return Jacobian(shared, own, residual)


def _within(left: FloatArray, right: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the minimum of ``step' left step / 2 - right' step`` within bounds.

    Cutting the free step at the bounds will not do: where two parameters stand in for each other, what is left of a
    long step leads uphill.
    """
    from scipy.optimize import lsq_linear

    scale = 1.0 / np.sqrt(np.diag(left))
    factor = np.linalg.cholesky(left * np.outer(scale, scale))
    target = np.linalg.solve(factor, right * scale)
    solution = lsq_linear(factor.T, target, bounds=(low / scale, high / scale), method="bvls")
    return np.asarray(np.clip(solution.x * scale, low, high))


_GROWTH = (0.1, 0.35)
"""Shares of every trial that a distant start is fitted to first: over a short time there are few false minima."""
_SAME = 0.01
"""Descents whose parameters differ by less than this share are in one valley."""
_ABOUT_AS_GOOD = 1.05
_DECADES = 0.5
"""Starts of a free parameter lie within this many decades of its stated value."""


@dataclass(frozen=True, slots=True)
class Minimum:
    """Where one start ended."""

    label: str
    z: FloatArray
    misfit: float


def search(problem: Problem, rng: np.random.Generator, *, starts: int, note: Note) -> list[Minimum]:
    """Return the minima that several starts lead to, best first, roughly: the best is there to be refined.

    The stated values are one start, used directly and once more through growing pieces of the trials. The others
    are drawn log-uniformly around the stated values (uniformly between finite bounds for a stated zero), screened by
    their misfit on short pieces, and the best of them followed. A descent that comes close to a minimum another one has
    found is taken to end there.

    On their way down, parameters keep the sign of their stated value: beyond zero there may be minima that fit as well
    and that nobody can build, such as a negative resistance. A descent that ends at zero is let go on through it:
    there the data demand the other sign.
    """
    priors, stated = problem.priors, problem.priors.stated
    lower = np.where(stated > 0, np.maximum(priors.lower, 0.0), priors.lower)
    upper = np.where(stated < 0, np.minimum(priors.upper, 0.0), priors.upper)
    minima: list[Minimum] = []

    def descend(
        part: Problem, z: FloatArray, tolerance: float, most: int, known: list[Minimum], signed: bool = True
    ) -> FloatArray:
        return minimise(
            part,
            z,
            lower=lower if signed else None,
            upper=upper if signed else None,
            tolerance=tolerance,
            evaluations=most,
            central=False,
            stop=lambda at: _joined(at[: part.size], known) is not None,
        )

    def ended(label: str, z: FloatArray, known: list[Minimum]) -> Minimum:
        same = _joined(z[: problem.size], known)
        return Minimum(label, z, problem.misfit(z)) if same is None else replace(same, label=label)

    def follow(label: str, start: FloatArray, *, growing: bool) -> None:
        note(f"fitting from {label}")
        z = np.concatenate([start, problem.guess(problem.parameters(start))])
        for share in _GROWTH if growing else ():
            z = descend(problem.beginning(share), z, 1e-3, 12, [])
        z = descend(problem, z, 1e-5, 30, minima)
        shared = z[: problem.size]
        at_zero = (shared <= lower) & (lower > priors.lower) | (shared >= upper) & (upper < priors.upper)
        if np.any(at_zero):
            z = descend(problem, z, 1e-5, 30, minima, signed=False)
        minima.append(ended(label, z, minima))

    follow("the stated values", stated, growing=False)
    if problem.size and starts > 1:
        follow("the stated values, piece by piece", stated, growing=True)
        for number, start in enumerate(_screened(problem, rng, starts - 2), start=1):
            follow(f"start {number} of {starts - 2}", start, growing=True)
    # those about as good as the best are followed to their ends, where most of them turn out to be one
    minima.sort(key=lambda minimum: minimum.misfit)
    best, ends = minima[0].misfit, list[Minimum]()
    for minimum in minima:
        if minimum.misfit <= _ABOUT_AS_GOOD * best:
            z = descend(problem, minimum.z, 1e-7, 40, ends, signed=False)
            minimum = ended(minimum.label, z, ends)  # noqa: PLW2901
        ends.append(minimum)
    return sorted(ends, key=lambda minimum: minimum.misfit)


def _joined(shared: FloatArray, known: Sequence[Minimum]) -> Minimum | None:
    """Return the known minimum that this point leads to."""
    for minimum in known:
        there = minimum.z[: len(shared)]
        if np.all(np.abs(shared - there) <= _SAME * np.maximum(np.abs(shared), np.abs(there))):
            return minimum
    return None


def _screened(problem: Problem, rng: np.random.Generator, wanted: int) -> list[FloatArray]:
    if wanted <= 0:
        return []
    short, rated = problem.beginning(_GROWTH[0]), list[tuple[float, int, FloatArray]]()
    for number in range(8 * wanted):
        start = _draw(problem.priors, rng)
        z = np.concatenate([start, problem.guess(problem.parameters(start))])
        rated.append((short.misfit(z), number, start))
    return [start for _, _, start in sorted(rated, key=lambda pair: pair[:2])[:wanted]]


def _draw(priors: Priors, rng: np.random.Generator) -> FloatArray:
    stated, start = priors.stated, priors.stated
    for index, (sigma, low, high) in enumerate(zip(priors.sigma, priors.lower, priors.upper, strict=True)):
        if np.isfinite(sigma):
            start[index] = stated[index] + sigma / priors.scale[index] * rng.standard_normal()
        elif stated[index] != 0:
            start[index] = stated[index] * 10.0 ** rng.uniform(-_DECADES, _DECADES)
        elif np.isfinite(low) and np.isfinite(high):
            start[index] = rng.uniform(low, high)
        start[index] = min(max(start[index], low), high)
    return start
