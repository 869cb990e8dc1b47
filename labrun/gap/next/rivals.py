"""The explanations that are left after a diagnosis, each fitted to the data."""

from dataclasses import dataclass

from labrun.arrays import FloatArray
from labrun.fit.problem import Problem
from labrun.gap.diagnosis import Name
from labrun.gap.pipeline import Search
from labrun.gap.rating import Rated
from labrun.gap.screening import refit
from labrun.gap.selection import Round

_MOST = 6
NOTHING = "recalibration only"


@dataclass(frozen=True, eq=False)
class Rival:
    """One explanation of the data.

    Attributes
    ----------
    name
        What is special about it, for people.
    cause
        None for the recalibrated model without any effect.
    variables
        Number of variables that its cause adds.
    squares
        Sum of squared residuals on the data, prior included.
    """

    name: str
    cause: Name | None
    problem: Problem
    z: FloatArray
    variables: int
    squares: float

    @property
    def shared(self) -> FloatArray:
        """Scaled parameters and effect sizes."""
        return self.z[: self.problem.size]

    @property
    def own(self) -> FloatArray:
        """Scaled free initial states, shape (units, states)."""
        return self.z[self.problem.size :].reshape(len(self.problem.data.trials), self.problem.own_size)

    @property
    def sizes(self) -> dict[str, float]:
        """Parameters of its own effect by name, SI; empty for a parameter or without a cause."""
        if self.cause is None or self.cause.kind == "parameter":
            return {}
        attached = self.problem.attached(self.problem.parameters(self.z))
        mine = [one for one in attached if (one.effect.id, one.site) == (self.cause.effect, self.cause.site)]
        return dict(mine[-1].named_values) if mine else {}


@dataclass(frozen=True)
class Rivals:
    """What is to be told apart.

    Attributes
    ----------
    rivals
        The most probable first.
    null
        The recalibrated model: what each of them is an improvement on.
    doubt
        Whether the diagnosis itself could not tell them apart; else the cause is held against its runner-up.
    why
        What is compared with what, as a sentence.
    dispersion
        Energy of the noise in one direction, as the guard found it; 1 for white noise.
    """

    rivals: tuple[Rival, ...]
    null: Rival
    doubt: bool
    why: str
    dispersion: float

    @property
    def pairs(self) -> list[tuple[Rival, Rival]]:
        """Every two of them, each once as the truth and once as its rival."""
        return [(one, other) for one in self.rivals for other in self.rivals if one is not other]


def rivals_of(search: Search) -> Rivals:
    """Return the explanations that a search leaves, fitted again closely.

    Where the diagnosis is in doubt these are the cause and what cannot be told from it. Where it is not, the cause is
    held against the runner-up, or against recalibration alone if there is none.
    """
    selection = search.selection
    base = selection.rounds[0].base
    null = Rival(NOTHING, None, base.problem, base.z, 0, base.squares)
    dispersion = selection.rounds[0].threshold.dispersion
    doubtful = [
        (cause.rated, [rival for rival, _ in cause.rivals]) for cause in selection.chosen if cause.rivals
    ]
    if doubtful:
        # several doubtful causes: the one taken in last stands beside all others
        cause, others = doubtful[-1]
        found = [_fitted(one) for one in (cause, *others)][:_MOST]
        names = " or ".join(one.name for one in found[1:])
        return Rivals(
            tuple(found), null, True, f"The data cannot tell {found[0].name} from {names}.", dispersion
        )
    if selection.chosen:
        cause = selection.chosen[-1].rated
        runner_up = _runner_up(search.selection.rounds[-2], cause) if len(selection.chosen) == 1 else None
        found = [_fitted(cause), null if runner_up is None else _fitted(runner_up)]
        why = f"The diagnosis is not in doubt: {found[0].name} is held against {_as_runner_up(found[1])}."
        return Rivals(tuple(found), null, False, why, dispersion)
    ranked = selection.rounds[-1].rated
    found = [*(_fitted(one) for one in ranked[:2]), null]
    why = "No cause was named: the best candidates are held against recalibration alone."
    return Rivals(tuple(found), null, False, why, dispersion)


def _as_runner_up(rival: Rival) -> str:
    return f"the runner-up, {rival.name}" if rival.cause is not None else rival.name


def _runner_up(look: Round, cause: Rated) -> Rated | None:
    others = [one for one in look.rated if one.candidate.name != cause.candidate.name and one.evidence > 1.0]
    return max(others, key=lambda one: one.score, default=None)


def _fitted(rated: Rated) -> Rival:
    screened = rated.screened
    z = refit(screened.problem, screened.z)
    candidate = rated.candidate
    squares = screened.problem.squares(z)
    return Rival(str(candidate.name), candidate.name, screened.problem, z, candidate.variables, squares)
