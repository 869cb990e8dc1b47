"""Before a run: how much of a search's space may run, and how many trials there will be."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.devices import Excess
from labrun.errors import PlanError
from labrun.experiment import CmaEs, Condition, Experiment, condition_key
from labrun.runner import ConditionExcess, Plan, SearchSpace, SpaceBreak, percent
from labrun.search.constraints import Feasibility, LimitExcesses, constraints, probes
from labrun.search.planned import levels_of, settings_of, start_of_search

_POINTS = 8192
"""Looked at for the constraints, which cost nothing."""
_MOTIONS = 512
"""Of the points that the constraints allow, so many are looked at for the limits, which takes a trajectory each."""
_NAMED = 3


@dataclass(frozen=True, slots=True)
class Allowed:
    """Points of a search space that its constraints allow.

    Attributes
    ----------
    conditions
        Evenly spread; the first few hundred of them.
    share
        Of all points.
    breaks
        The constraints that exclude the others.
    """

    conditions: list[Condition]
    share: float
    breaks: tuple[SpaceBreak, ...]


def allowed_points(search: CmaEs) -> Allowed:
    """Return points of the space that every `where` allows.

    Raises
    ------
    PlanError
        There is none, and the start is none either.
    ConstraintError
        A constraint cannot be computed somewhere in the space.
    """
    columns = probes(search, _POINTS)
    keep = np.ones(_POINTS, dtype=bool)
    breaks = []
    for constraint in constraints(search.where, "cmaes"):
        holds = np.broadcast_to(constraint.holds(columns), (_POINTS,))
        keep &= holds
        if not holds.all():
            breaks.append(SpaceBreak(constraint.text, 1.0 - float(holds.mean())))
    chosen = np.flatnonzero(keep)[:_MOTIONS]
    conditions: list[Condition] = [
        {name: float(column[index]) for name, column in columns.items()} for index in chosen
    ]
    return Allowed(conditions, float(keep.mean()), tuple(breaks))


def survey_space(
    experiment: Experiment, allowed: Allowed, plan: Plan, excess_of: LimitExcesses
) -> SearchSpace:
    """Return how much of a search's space may run.

    Parameters
    ----------
    experiment
        With a table [cmaes].
    allowed
        The points looked at.
    plan
        Their plan.
    excess_of
        Returns which limits a condition would leave.

    Raises
    ------
    PlanError
        No point that was looked at may run.
    """
    assert experiment.cmaes is not None  # noqa: S101  (there would be no points)
    start = Feasibility(experiment.cmaes, excess_of).of([start_of_search(experiment)])[0]
    outside = at_points(plan.excess, allowed.conditions)
    inside = 1.0 - len(outside) / len(allowed.conditions) if allowed.conditions else 0.0
    by_limits = _limit_breaks(outside, len(allowed.conditions), allowed.share)
    breaks = tuple(sorted((*allowed.breaks, *by_limits), key=lambda item: -item.share))
    space = SearchSpace(_POINTS, allowed.share * inside, breaks, start.texts)
    if space.share == 0.0 and not start.feasible:
        named = "".join(f"\n  {item}" for item in breaks[:_NAMED])
        raise PlanError(
            f"nothing of the search space may run: {percent(allowed.share)} of {_POINTS:,} points satisfy the "
            f"constraints, but none of them stays inside the limits{named}"
            if allowed.conditions
            else f"nothing of the search space may run: the constraints leave none of {_POINTS:,} points{named}",
            hint="widen the ranges of the variables, or loosen the constraint or limit that excludes most",
        )
    return space


def at_points(excess: Iterable[ConditionExcess], points: Sequence[Condition]) -> list[ConditionExcess]:
    """Return what breaks a limit at one of the points; what every trial would break is not among it."""
    keys = {condition_key(point) for point in points}
    return [item for item in excess if condition_key(item.condition) in keys]


def _limit_breaks(outside: Sequence[ConditionExcess], points: int, share: float) -> list[SpaceBreak]:
    """Return each limit that points leave, with the share of the whole space that does."""
    excesses: dict[tuple[str, float], list[Excess]] = {}
    for item in outside:
        for excess in item.excess:
            excesses.setdefault((excess.quantity, excess.bound), []).append(excess)
    return [_limit_break(several, share * len(several) / points) for several in excesses.values()]


def _limit_break(several: Sequence[Excess], share: float) -> SpaceBreak:
    worst = max(several, key=lambda item: abs(item.value - item.bound))
    side = "above" if worst.value > worst.bound else "below"
    text = f"{worst.quantity} {side} {worst.bound:.4g} {worst.unit}, at worst {worst.value:.4g} {worst.unit}"
    return SpaceBreak(text, share)


def most_trials(
    experiment: Experiment, conditions: Sequence[Condition], *, repeats: int | None = None
) -> int:
    """Return the number of trials with so many repeats of a condition, for a search the most its stop rules allow.

    Reference trials count, and those that name and confirm the honest best. A search that stagnates ends sooner, and
    candidates that may not run take no trial.

    Parameters
    ----------
    conditions
        Of a `run` or a `sweep`; of a search, which has no list, they do not matter.
    repeats
        The greatest number that the file allows, if None.
    """
    settings = len(settings_of(experiment))
    least = experiment.trial.repeats.min
    repeats = experiment.trial.repeats.max if repeats is None else repeats
    candidates, levels = len(conditions), 1
    mountings = 1 if experiment.by_hand is None else experiment.by_hand.mountings
    measured = candidates * repeats * mountings * settings
    if experiment.kind == "cmaes" and experiment.cmaes is not None:
        levels = len(levels_of(experiment))
        candidates, measured = _most_of_search(experiment.cmaes, least * settings, repeats * settings)
    reference = experiment.trial.reference
    references = 0 if reference is None else math.ceil(measured / reference.every)
    measured *= levels
    leaders = experiment.leaders
    honest = (
        0
        if experiment.goal is None
        else (min(leaders.count, candidates) + len(leaders.guests) + 1)
        * leaders.repeats
        * mountings
        * settings
        * levels
    )
    return measured + references + honest


def _most_of_search(search: CmaEs, least: int, repeats: int) -> tuple[int, int]:
    """Return the most candidates, and the most trials of them."""
    population = search.population_size * 2**search.restarts
    candidates = search.stop.iterations * population
    measured = candidates * repeats
    if search.stop.trials is not None:
        # A generation begins if its least number of repeats fits in; more repeats may carry it beyond. The first one
        # always begins.
        within = max(search.stop.trials, search.population_size * least)
        measured = min(measured, within + population * (repeats - least))
        candidates = min(candidates, within // least)
    return candidates, measured
