"""The explanations that a search leaves, as they are held against one another."""

from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.fit import Problem
from labrun.gap.diagnosis import Name
from labrun.gap.evidence import UnseenError
from labrun.gap.noise import Noise
from labrun.gap.pipeline import Search
from labrun.gap.selection import CauseSet

_MOST_EXPLANATIONS = 6
"""Explanations that are held against one another."""

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
        Number of variables of its causes.
    error
        What it leaves of recorded data that its fit has not seen.
    """

    name: str
    cause: Name | None
    problem: Problem
    z: FloatArray
    variables: int
    error: UnseenError

    @property
    def words(self) -> str:
        """Its name for people."""
        return self.name if self.cause is None else self.cause.words

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
        key = self.cause.effect, self.cause.site
        matching = [effect for effect in attached if (effect.effect.id, effect.site) == key]
        return dict(matching[-1].named_values) if matching else {}


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
    noise
        Of one trial.
    strata : (units,)
        Condition of each recorded unit of evidence.
    """

    rivals: tuple[Rival, ...]
    null: Rival
    doubt: bool
    why: str
    noise: Noise
    strata: IntArray

    @property
    def pairs(self) -> list[tuple[Rival, Rival]]:
        """Every two of them, each once as the truth and once as its rival."""
        return [(truth, other) for truth in self.rivals for other in self.rivals if truth is not other]

    def by_condition(self, values: FloatArray) -> FloatArray:
        """Return the mean of values (units,) over the units of each recorded condition."""
        return np.array([np.mean(values[self.strata == condition]) for condition in np.unique(self.strata)])


def rivals_of(search: Search) -> Rivals:
    """Return the explanations that a search leaves, fitted again closely.

    Where the diagnosis is in doubt these are the cause and what cannot be told from it. Where it is not, the cause is
    held against the runner-up, or against recalibration alone if there is none.
    """
    selection = search.selection
    reference = selection.reference
    null = Rival(NOTHING, None, reference.base.problem, reference.base.z, 0, reference.error)
    noise, strata = search.noise, search.units.strata
    last = selection.steps[-1]
    # several doubtful causes: the one that closes least stands beside all others
    doubtful = [cause for cause in selection.chosen if cause.rivals]
    if doubtful:
        cause = doubtful[-1]
        rivals = [
            _named(cause.name, last),
            *(_named(entry.candidates[-1].name, entry) for entry in cause.rivals),
        ]
        rivals = rivals[:_MOST_EXPLANATIONS]
        names = " or ".join(rival.words for rival in rivals[1:])
        why = f"The data do not separate {rivals[0].words} from {names}."
        return Rivals(tuple(rivals), null, True, why, noise, strata)
    judged = [] if selection.first is None else selection.first.extended
    if not selection.chosen:
        best = [_named(entry.candidates[-1].name, entry) for entry in judged[:2]]
        why = "No cause was named: the best candidates are compared with recalibration alone."
        return Rivals((*best, null), null, False, why, noise, strata)
    cause = selection.chosen[-1]
    others = [entry for entry in judged if entry.names != last.names]
    if len(selection.chosen) == 1 and others:
        second = _named(others[0].candidates[-1].name, others[0])
        against = f"the runner-up, {second.words}"
    else:
        second, against = null, null.name
    first = _named(cause.name, last)
    why = f"The diagnosis is not in doubt: {first.words} is compared with {against}."
    return Rivals((first, second), null, False, why, noise, strata)


def _named(name: Name, model: CauseSet) -> Rival:
    variables = sum(candidate.variables for candidate in model.candidates)
    return Rival(str(name), name, model.base.problem, model.base.z, variables, model.error)
