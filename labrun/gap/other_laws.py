"""Laws that explain more without the causes than these do: what tells stand-ins from right causes that leave as much.

What a right cause leaves is what its form lacks, or something else beside it: no law explains that and what the cause
explains. What a stand-in leaves is the rest of one and the same thing, and a law of that thing explains both: so does a
mass on a spring of an inertia that stood for it.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, Effect, Scale, Site, read_effects
from labrun.fit import Problem
from labrun.gap import criteria
from labrun.gap.candidates import site_scales
from labrun.gap.held_out import fitted_excess
from labrun.gap.noise import Noise
from labrun.gap.noise_threshold import NoiseThreshold
from labrun.gap.rest_law import folds_of_rows
from labrun.gap.screening import Base, refit

_FORCES = {
    "time": ("1", "(t/T)", "(t/T)^2", "(t/T)^3", "exp(-5*t/T)"),
    "position": ("x", "x^2", "x^3", "x^5", "abs(x)", "x*abs(x)"),
    "rate": ("u", "u^2", "u^3", "abs(u)", "u*abs(u)", "S"),
    "position-and-rate": ("x*u", "x^2*u", "x*u^2", "abs(x)*u", "x*S", "abs(x)*S", "x^2*S"),
    "load-and-rate": ("load*S", "abs(load)*S", "load*u", "abs(load)*u", "load", "abs(load)"),
    "position-and-time": ("(t/T)*x", "(t/T)^2*x", "exp(-5*t/T)*x"),
    "rate-and-time": ("(t/T)*u", "(t/T)^2*u", "exp(-5*t/T)*u", "(t/T)*S"),
    "acceleration": ("acceleration", "x*acceleration", "x^2*acceleration", "(t/T)*acceleration"),
}
_SIGNALS = {
    "time": ("1", "(t/T)", "(t/T)^2", "(t/T)^3", "exp(-5*t/T)"),
    "signal": ("y", "y^2", "y^3", "y^5", "abs(y)", "y*abs(y)"),
    "signal-and-time": ("(t/T)*y", "(t/T)^2*y", "exp(-5*t/T)*y"),
}
"""Laws of one kind of argument each, as sums of terms in multiples of typical motion and of the longest trial."""
_SAID = {"t": "time", "q": "position"}
_HELPERS = {"x": "q/c", "u": "rate/v", "S": "tanh(50*rate/v)", "y": "signal/s"}
_SCALES = {"c": "coordinate", "v": "rate", "s": "signal", "T": "time"}
_OF_TIME_ALONE = ("force-of-time", "signal-of-time")
_STEADY = ("bias", "constant-force", "drift", "rest-offset")
_RIDER = """
[rider]
title = "A mass on a spring that rides on the joint."
kind = ["joint", "body"]
F = "mass*pull"
where = { pull = "(d/period + 2*damping_ratio*(w - rate))/period" }
states = { d = "w - rate", w = "-(d/period + 2*damping_ratio*(w - rate))/period" }
source = "Den Hartog, Mechanical Vibrations (1956), section 3.2"
[rider.parameters]
mass = { quantity = "inertia", neutral = 0.0, lower = -10.0, upper = 10.0, starts = [0.0] }
damping_ratio = { quantity = "ratio", lower = 0.0, upper = 1.0, starts = [0.03], held = true }
"""


_Fit = tuple[Problem, FloatArray]
_Law = tuple[Site, Scale, AttachedEffect]


def better_alone(
    causes: _Fit,
    bare: _Fit,
    noise: Noise,
    threshold: NoiseThreshold,
    floor: float,
    *,
    rivals: Sequence[AttachedEffect] = (),
) -> str:
    """Return the law that by itself explains plainly more than all causes do, in words; "" if there is none.

    Of the laws that predict best what the model without causes leaves of conditions (of one condition, of blocks of
    time) that they did not see, it is the one that leaves least, if that is next to nothing. A law of no other
    arguments than a cause at its site is none: the cause is then of another form. Laws are looked at in the conditions
    that leave most, and the best of them in all.

    Parameters
    ----------
    causes
        Model and causes, fitted.
    bare
        The same without any cause.
    threshold
        What chance would let a further cause gain.
    floor
        Gap that noise alone leaves.
    rivals
        What the data cannot tell from the causes: a law of no other arguments is none there, either.
    """
    problem, z = causes
    if problem.finite_residuals(z) is None:
        return ""
    bare = bare[0].with_noise(problem.noise).in_steps_of(problem), bare[1]
    units = _where_most_is_left(*bare)
    part = _part(*bare, units)
    likely = _likeliest(*part, (*problem.effects, *rivals))
    fits = [(law, alone) for law in likely if (alone := _alone(*part, law)) is not None]
    if not fits:
        return ""
    law, alone = min(fits, key=lambda one: one[1][0].squares(one[1][1]))
    better = _explains_more(_part(problem, z, units), part, alone, noise, threshold, floor)
    if better and len(units) < len(problem.data.trials):
        on_all = _alone(*bare, law, alone[1][part[0].size : alone[0].size])
        better = on_all is not None and _explains_more(causes, bare, on_all, noise, threshold, floor)
    site, _, attached = law
    return f"{_words(attached.effect)} at {site.name}" if better else ""


def _explains_more(
    causes: _Fit, bare: _Fit, alone: _Fit, noise: Noise, threshold: NoiseThreshold, floor: float
) -> bool:
    """Tell whether a law without causes leaves next to nothing, and plainly less than the causes do."""
    (problem, z), (with_law, end), (without, _) = causes, alone, bare
    gain = problem.squares(z) - with_law.squares(end)
    variables = sum(not one.held for effect in problem.effects for one in effect.effect.parameters)
    price = criteria.VARIABLE_PRICE * max(with_law.size - without.size - variables, 0)
    if threshold.evidence(gain) <= 1.0 or threshold.log_likelihood(gain) <= price:
        return False
    whole, left, less = (fitted_excess(*one, noise).total for one in (bare, causes, alone))
    more = left - less >= criteria.ALONE_EXPLAINS * abs(left)  # what is left may be less than noise leaves
    return bool(more and less <= max(criteria.ALONE_LEAVES * whole, floor**2))


def _where_most_is_left(problem: Problem, z: FloatArray) -> list[int]:
    """Return the trials of those conditions, not many, in which most is left."""
    left = np.zeros(len(problem.data.conditions))
    for trial, residual in zip(problem.data.trials, problem.residuals(z), strict=True):
        left[trial.group] += float(residual @ residual)
    most = set(np.argsort(-left)[: criteria.MOST_CONDITIONS].tolist())
    return [unit for unit, one in enumerate(problem.data.trials) if one.group in most]


def _part(problem: Problem, z: FloatArray, units: Sequence[int]) -> _Fit:
    own = [problem.own(z, unit) for unit in units]
    return problem.part(units), np.concatenate([z[: problem.size], *own])


def _likeliest(problem: Problem, z: FloatArray, causes: Sequence[AttachedEffect]) -> list[_Law]:
    """Return the few laws that predict most, each in its best shape; none that predicts nothing."""
    base = Base.of(problem, z)
    rest = base.nuisance.remainder(base.residual, problem.priors.residual(z))
    fold = folds_of_rows(problem, [len(one) for one in base.residual], len(rest))
    best = dict[tuple[str, str, str], tuple[float, _Law]]()
    for site, scale, law in _laws(problem, z):
        if not _is_own(causes, site, law.effect):
            share = _predicted(_columns(base, scale, law), rest, fold)
            key = (site.kind, site.name, law.effect.id)
            if share > max(best[key][0] if key in best else 0.0, 0.0):
                best[key] = share, (site, scale, law)
    ordered = sorted(best.values(), key=lambda one: -one[0])[: criteria.STARTS_FOLLOWED]
    return [law for share, law in ordered if share >= criteria.ALONE_NEAR_BEST * ordered[0][0]]


def _alone(problem: Problem, z: FloatArray, law: _Law, begin: FloatArray | None = None) -> _Fit | None:
    """Return a problem with a law, its shape fitted, too; None where that does not simulate."""
    _, scale, attached = law
    freed, sizes = _with_its_shape(attached, scale)
    with_law = problem.with_effects([freed], [scale])
    start = np.insert(z, problem.size, sizes if begin is None else begin)
    if with_law.finite_residuals(start) is None:
        return None
    end = refit(with_law, start)
    return None if with_law.finite_residuals(end) is None else (with_law, end)


def _with_its_shape(law: AttachedEffect, scale: Scale) -> tuple[AttachedEffect, list[float]]:
    """Return a law whose shape is fitted, too, and where a fit of it begins."""
    freed = tuple(replace(one, held=False) if one.shape else one for one in law.effect.parameters)
    pairs = zip(freed, law.values, strict=True)
    start = [value / scale.of(one.quantity) for one, value in pairs if not one.held]
    return replace(law, effect=replace(law.effect, parameters=freed)), start


def _words(law: Effect) -> str:
    *first, last = [_SAID.get(one, one) for one in sorted(law.arguments)]
    of = f"{', '.join(first)} and {last}" if first else last
    return "a mass on a spring that rides" if law.states else f"a law of {of}"


@cache
def _library() -> tuple[Effect, ...]:
    """Return the laws as effects."""
    entries = [_entry(f"force-of-{of}", '["joint", "body"]', "F", one) for of, one in _FORCES.items()]
    entries += [_entry(f"signal-of-{of}", '["input", "output"]', "y", one) for of, one in _SIGNALS.items()]
    periods = 1.0 / (2.0 * np.pi * np.geomspace(*criteria.RIDERS, criteria.RIDERS_TRIED))
    riders = (
        f'{_RIDER}period = {{ quantity = "time", lower = {periods[-1] / 2.0:.6f}, upper = {2.0 * periods[0]:.6f}, '
        f"starts = {[round(float(one), 6) for one in periods]}, held = true }}\n"
    )
    return read_effects("other-laws.toml", text="\n".join([*entries, riders]), origin="")


def _entry(name: str, kinds: str, left: str, terms: Sequence[str]) -> str:
    """Return a sum of terms as an entry of a file of effects: a size for each."""
    law = " + ".join(f"size_{n}*{one}" for n, one in enumerate(terms))
    quantities = [
        "inertia" if "acceleration" in one else "signal" if left == "y" else "force" for one in terms
    ]
    sizes = [
        f'parameters.size_{n} = {{ quantity = "{one}", neutral = 0.0, lower = -10.0, upper = 10.0, starts = [0.0] }}'
        for n, one in enumerate(quantities)
    ]
    helpers = {key: value for key, value in _HELPERS.items() if re.search(rf"\b{key}\b", law)}
    scales = [
        f'parameters.{key} = {{ quantity = "{one}", lower = 0.5, upper = 2.0, starts = [1.0], held = true }}'
        for key, one in _SCALES.items()
        if f"/{key}" in law + " ".join(helpers.values())
    ]
    where = ", ".join(f'{key} = "{value}"' for key, value in helpers.items())
    return "\n".join([
        f"[{name}]", 'title = "A series."', f"kind = {kinds}", f'{left} = "{"signal + " * (left == "y")}{law}"',
        f"where = {{ {where} }}", 'source = "a series"', *sizes, *scales, "",
    ])  # fmt: skip


def _laws(problem: Problem, z: FloatArray) -> Iterator[tuple[Site, Scale, AttachedEffect]]:
    """Return every law, in every shape, at every site it fits."""
    scales = site_scales(problem, z)
    longest_s = max(float(one.time_s[-1] - one.time_s[0]) for one in problem.data.trials)
    for site in problem.model.places:
        scale = scales.get((site.kind, site.name))
        if scale is None:
            continue
        for effect in _library():
            if effect.fits(site, scale):
                whole = {"T": longest_s} if "t" in effect.arguments else {}
                for shape in _shapes(effect, scale):
                    yield site, scale, effect.attach(site.name, scale, **whole, **shape)


def _shapes(effect: Effect, scale: Scale) -> list[dict[str, float]]:
    """Return all starts of its shape, by name; of none, one without."""
    return [
        {one.name: start} for one in effect.parameters if one.shape for start in one.start_values(scale)
    ] or [{}]


def _columns(base: Base, scale: Scale, law: AttachedEffect) -> FloatArray:
    """Return what the terms of a law change of the residual, less what all that is fitted imitates, (rows, terms)."""
    problem = base.problem
    added = problem.with_effects([law], [scale])
    terms = added.size - problem.size
    start = np.insert(base.z, problem.size, np.zeros(terms))
    jacobian = added.jacobian(start, base.residual, central=False, beside=base.nuisance.jacobian)
    return base.nuisance.remainder([one[:, problem.size :] for one in jacobian.shared])


def _predicted(columns: FloatArray, rest: FloatArray, fold: NDArray[np.intp]) -> float:
    """Return the part of the rest that terms predict in folds they were not fitted to; 0 if they are not finite."""
    if not np.all(np.isfinite(columns)):
        return 0.0
    norms = np.linalg.norm(columns, axis=0)
    seen = norms > 1e-9 * np.max(norms, initial=1e-300)
    unit = columns[:, seen] / norms[seen]
    whole, answer = unit.T @ unit, unit.T @ rest
    ridge = 1e-3 * np.eye(len(whole))
    left = total = 0.0
    for one in range(int(fold.max()) + 1):
        test = fold == one
        inside, wanted = unit[test], rest[test]
        found = np.linalg.solve(whole - inside.T @ inside + ridge, answer - inside.T @ wanted)
        left += float(np.sum(np.square(wanted - inside @ found)))
        total += float(np.sum(np.square(wanted)))
    return 1.0 - left / total if total > 0.0 else 0.0


def _is_own(causes: Sequence[AttachedEffect], site: Site, law: Effect) -> bool:
    """Tell whether a law has no other arguments than a cause at its site; those in Python may have any.

    What is constant or drifts looks the same at many sites: beside it a law of nothing but time is no other law,
    wherever it is.
    """
    return any(
        (law.id in _OF_TIME_ALONE and one.effect.id in _STEADY)
        or (one.site == site.name and one.effect.kind == site.kind and _has_arguments_of(one.effect, law))
        for one in causes
    )


def _has_arguments_of(cause: Effect, law: Effect) -> bool:
    """Tell whether a cause depends on all that a law of the same site depends on."""
    in_python = not cause.arguments and cause.kind in ("input", "output")
    return in_python or (law.arguments <= cause.arguments and not law.states)
