"""What the data cannot tell: directions without curvature, bounds, wide intervals, false minima; and divergence."""

from collections.abc import Mapping, Sequence

import numpy as np

from labrun.arrays import FloatArray
from labrun.estimate import Estimate, rounded
from labrun.fit.problem import Problem
from labrun.fit.result import StartOutcome
from labrun.models import simulate

_FLAT = 1e-6
"""A direction this much flatter than the steepest one is not determined at all: below it is numerical noise."""
_VISIBLE = 0.1
"""Share of the strongest component above which a parameter is named as part of a direction."""
_AS_GOOD = 1.02
_WORSE = 1.10


def undetermined(
    information: FloatArray, names: Sequence[str]
) -> tuple[list[str], frozenset[str], FloatArray]:
    """Return the directions in parameter space along which the data do not change.

    A direction counts where moving every parameter of it by as much as its own value changes the outputs by less than
    their noise, or by less than a millionth of what the best determined direction does.

    Parameters
    ----------
    information : (p, p)
        J'J in units of noise and in relative changes of the parameters, prior included.

    Returns
    -------
    warnings, named
        A sentence for each direction, and the parameters in them.
    least_half_width : (p,)
        How wide their intervals are at least, relative.
    """
    values, directions = np.linalg.eigh(information)
    singular = np.sqrt(np.maximum(values, 0.0))
    warnings, named = [], set()
    least = np.zeros(len(names))
    largest = float(np.max(singular, initial=0.0))
    flat = [index for index, value in enumerate(singular) if value < max(1.0, _FLAT * largest)]
    for index in flat:
        direction = directions[:, index]
        strong = np.abs(direction) > _VISIBLE * np.max(np.abs(direction))
        members = [name for name, one in zip(names, strong, strict=True) if one]
        if len(members) == 1 and singular[index] >= _FLAT * largest:
            continue  # its interval tells: wider than its value, or around zero
        named.update(members)
        warnings.append(_described(members, direction[strong]))
        if singular[index] < _FLAT * largest:
            # resampling cannot see a direction in which no residual pulls: ten times the value stands for "anything"
            least = np.maximum(least, 10.0 * np.abs(direction))
    return warnings, frozenset(named), least


def _described(names: Sequence[str], direction: FloatArray) -> str:
    if len(names) == 1:
        return f"the data do not determine {names[0]}: it could change by its own value unnoticed"
    joined = f"{', '.join(names[:-1])} and {names[-1]}"
    sizes = np.abs(direction)
    even = float(np.min(sizes)) > 0.8 * float(np.max(sizes))
    if (even and np.all(direction > 0)) or (even and np.all(direction < 0)):
        what = "as a ratio" if len(names) == 2 else "as ratios to one another"
    elif even and len(names) == 2:
        what = "as a product"
    else:
        what = "in combination"
    fix = "fix one of them (tolerance = 0), or record trials that tell them apart"
    return f"{joined} are only determined {what}: {fix}"


def interval_warnings(
    estimates: Mapping[str, Estimate], problem: Problem, named: frozenset[str]
) -> list[str]:
    """Return warnings on bounds, on intervals wider than their value, and on values that rest on prior knowledge."""
    warnings = []
    for index, (name, estimate) in enumerate(estimates.items()):
        low, high = (
            problem.priors.lower[index] * problem.priors.scale[index],
            problem.priors.upper[index] * problem.priors.scale[index],
        )
        for bound, side in ((low, "lower"), (high, "upper")):
            if np.isfinite(bound) and abs(estimate.value - bound) <= 1e-4 * problem.priors.scale[index]:
                warnings.append(
                    f"{name} ended at its {side} bound of {bound:g} {estimate.unit}: "
                    "the data ask for more than it allows"
                )
        value, *ends = rounded(estimate)
        if name in named:
            continue
        half = 0.5 * (estimate.ci95[1] - estimate.ci95[0])
        if estimate.contains_zero:
            warnings.append(
                f"{name} is not distinguishable from zero: {value}, "
                f"95 % interval {ends[0]} ... {ends[1]} {estimate.unit}"
            )
        elif half > abs(estimate.value):
            warnings.append(
                f"the interval of {name} is wider than its value: {ends[0]} ... {ends[1]} {estimate.unit}"
            )
        sigma = problem.priors.sigma[index]
        if np.isfinite(sigma):
            stated = problem.priors.values[problem.priors.free[index]]
            away = abs(estimate.value - stated) / sigma
            if half > 0.9 * 1.96 * sigma and away <= 3.0:
                warnings.append(
                    f"{name} rests on its stated value and tolerance; the data add little to them"
                )
            if away > 3.0:
                warnings.append(
                    f"{name} ended {away:.1f} standard deviations of its tolerance away "
                    f"from the stated {stated:g} {estimate.unit}"
                )
    return warnings


def sign_warnings(estimates: Mapping[str, Estimate], problem: Problem) -> list[str]:
    """Return warnings on parameters whose sign is surely not that of the stated value."""
    return [
        f"{name} came out {'negative' if estimate.value < 0 else 'positive'} "
        f"({rounded(estimate)[0]} {estimate.unit}), the stated value is not ({stated:g}): a sign convention, or "
        "physics that the model lacks; bounds in the model (lower, upper) would hold it"
        for (name, estimate), stated in zip(
            estimates.items(), problem.priors.values[problem.priors.free], strict=True
        )
        if estimate.value * stated < 0 and not estimate.contains_zero
    ]


def start_warnings(
    outcomes: Sequence[StartOutcome], estimates: Mapping[str, Estimate], *, direction_named: bool
) -> list[str]:
    """Return warnings where starts disagree in a way that should worry: outcomes come best first."""
    if len(outcomes) < 2:
        return []
    best = outcomes[0]
    agreeing = [outcome for outcome in outcomes if outcome.misfit <= _AS_GOOD * best.misfit]
    warnings = []
    if len(agreeing) == 1 and len(outcomes) > 2:
        warnings.append(
            f"starts disagree: only {best.label} led here, the next best minimum has "
            f"{outcomes[1].misfit / best.misfit:.3g} times the misfit ({_listed(outcomes[1])})"
        )
    other = next(
        (outcome for outcome in agreeing[1:] if not direction_named and _differs(outcome, best, estimates)),
        None,
    )
    if other is not None:
        warnings.append(
            f"two sets of parameters fit almost equally well: {_listed(best)}, or {_listed(other)} "
            f"({other.misfit / best.misfit:.3f} times the misfit)"
        )
    stated = [outcome for outcome in outcomes if outcome.label.startswith("the stated values")]
    if stated and all(outcome.misfit > _WORSE * best.misfit for outcome in stated):
        worst = min(stated, key=lambda outcome: outcome.misfit)
        warnings.append(
            f"the stated values lead into a false minimum ({_listed(worst)}, "
            f"{worst.misfit / best.misfit:.2g} times the misfit); "
            f"the fit comes from {best.label}, and {len(agreeing)} of {len(outcomes)} starts found it"
        )
    return warnings


def _differs(one: StartOutcome, best: StartOutcome, estimates: Mapping[str, Estimate]) -> bool:
    """Tell whether another set of parameters is one that the intervals do not hold."""
    return any(
        abs(one.parameters[name] - best.parameters[name])
        > 0.05 * max(abs(one.parameters[name]), abs(best.parameters[name]))
        and not estimate.ci95[0] <= one.parameters[name] <= estimate.ci95[1]
        for name, estimate in estimates.items()
    )


def _listed(outcome: StartOutcome) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in outcome.parameters.items())


_NUDGE = 1e-7
"""Of every state's own course, so small that it grows as a linearised model says."""
_GROWN, _GROWN_FAR = 1e2, 1e4
"""How many times greater than it was a nudge becomes: what is unstable grows so; far more leaves no doubt."""
_LATE = 5.0
"""A nudge of an unstable model grows more than so many times in the second half; that of an integrator twice."""


def divergence_warnings(problem: Problem, z: FloatArray) -> list[str]:
    """Return a sentence if simulations of the longest trial that begin almost alike part by orders of magnitude."""
    model = problem.model
    if not model.states:
        return []
    index = int(np.argmax([trial.time_s[-1] - trial.time_s[0] for trial in problem.data.trials]))
    trial, parameters = problem.data.trials[index], problem.parameters(z)
    begin = problem.initial_state(index, problem.own(z, index))

    def course(start: FloatArray) -> FloatArray:
        return simulate(
            model, trial.time_s, problem.drives[index], parameters=parameters[: len(model.parameters)],
            condition=trial.condition, initial_state=start,
        ).states  # fmt: skip

    first = course(begin)
    size = np.std(first, axis=0)
    moving = size > 0
    if not np.isfinite(size).all() or not moving.any():
        return []
    second = course(begin + _NUDGE * size)
    grown = np.max(np.abs(second - first)[:, moving] / size[moving], axis=1) / _NUDGE
    if not np.isfinite(grown).all():
        return []
    half = len(grown) // 2
    early, most = max(float(np.max(grown[:half], initial=1.0)), 1.0), float(np.max(grown))
    if most < _GROWN or (most < _GROWN_FAR and most < _LATE * early):
        return []
    return [
        f"the simulation diverges: by its inputs alone an error at the beginning grows {most:.1g}-fold in "
        f"{trial.label}, and no simulation follows what was measured: do not rely on fitted values. "
        "labrun gap diagnose keeps a plant that a controller held on course by what was measured; "
        "or cut far shorter trials"
    ]
