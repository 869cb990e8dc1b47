"""A law for what the library lacks: sparse regression of the rest on products of coordinate, rate, load and input."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.effects import Effect, Scale, Site, read_effects
from labrun.fit import Note, Problem, silent
from labrun.gap.candidates import site_scales
from labrun.gap.diagnosis import RestLaw, Term
from labrun.gap.held_out import ExcessResidual, held_out_excess, mean_residuals
from labrun.gap.intervals import effect_units
from labrun.gap.noise import Noise
from labrun.gap.screening import Base, refit
from labrun.models import simulate, site_course

_LEAST_SHARE = 0.3
"""Part of the excess that causes must remove on withheld conditions, however well they fit those they saw."""
_LAW_TERMS = 3
"""Most terms of a law."""
_LAW_TERM_WORTH = 0.02
"""Share of the rest, on withheld trials, that one term more has to remove."""
_LAW_TERM_NEW = 0.1
"""Part of a term that must be left once those already chosen have imitated it."""
_LAW_BLOCKS = 8
_LAW_RESAMPLES = 50
"""Blocks of time that are withheld where there is one condition."""
_LAW_SIGN_WIDTH = 0.02
"""Part of the typical rate (or signal) over which the smoothed sign changes."""

NAME = "rest-law"

_MOTION = (
    "1", "q", "q^2", "q^3", "q*abs(q)", "rate", "rate*abs(rate)", "rate^3", "sign", "q*rate", "q^2*rate",
    "abs(q)*rate", "q*rate^2", "q*sign", "abs(q)*sign", "q^2*sign", "abs(rate)",
)  # fmt: skip
_LOADED = ("load", "abs(load)*sign", "load*sign", "load*rate", "abs(load)*rate", "load^2", "load*q")
_SIGNAL = ("1", "signal^2", "signal*abs(signal)", "signal^3", "abs(signal)", "sign")


@dataclass(frozen=True)
class _Library:
    """The terms at one site, with what each changes of the outputs.

    Attributes
    ----------
    formulas
        In multiples of typical motion.
    columns : (rows, terms)
        Change of the residual by each, less what recalibration imitates.
    """

    site: Site
    scale: Scale
    formulas: tuple[str, ...]
    columns: FloatArray


def explain_rest(
    problem: Problem, z: FloatArray, noise: Noise, rng: np.random.Generator, *, note: Note = silent
) -> RestLaw | None:
    """Propose a law of at most three terms for what a fitted problem leaves, at the site where it explains most.

    The regression is in integral form: each term acts as a force (or on an input) in the simulation, the residual is
    regressed on what that changes of the outputs, so that nothing noisy is differentiated (the idea of weak SINDy:
    Messenger and Bortz, Multiscale Model. Simul. 19 (2021) 1474, with the model's own response as test function). Terms
    are chosen one by one (orthogonal matching pursuit), as many as predict withheld trials better; how often
    resamples of the trials choose them again is told (ensembles: Fasel et al., Proc. R. Soc. A 478 (2022)). The
    law is then fitted with all parameters.

    Parameters
    ----------
    problem, z
        The fit with the causes that were found.

    Returns
    -------
    RestLaw or None
        None where the model has no site that a term could act at; without terms where none predicts withheld trials.
    """
    base = Base.of(problem, z)
    rest = base.nuisance.remainder(base.residual, problem.priors.residual(z))
    folds = folds_of_rows(problem, [len(residual) for residual in base.residual], len(rest))
    libraries = [library for library in _libraries(base, note) if library.columns.shape[1]]
    if not libraries:
        return None
    note("regressing what is left on products of motion, load and input")
    errors = [_withheld(library.columns, rest, folds) for library in libraries]
    counts = [_count(error) for error in errors]
    best = max(range(len(libraries)), key=lambda index: 1.0 - errors[index][counts[index]] / errors[index][0])
    library, count, error = libraries[best], counts[best], errors[best]
    tried = sum(other_library.columns.shape[1] for other_library in libraries)
    before = _size(noise, mean_residuals(problem, z))
    if count == 0:
        return RestLaw(library.site.name, library.site.kind, (), 0.0, before, before, "", (), {}, (), tried)
    chosen = _pursued(library.columns, rest, count)
    formulas = [library.formulas[index] for index in chosen]
    text = _toml(library.site, formulas, problem.model.name)
    law = _read(text)
    sizes = -np.linalg.lstsq(library.columns[:, chosen], rest, rcond=None)[0]
    attached = law.attach(library.site.name, library.scale)
    fitted = problem.with_effects([attached], [library.scale])
    begin = np.insert(z, problem.size, np.clip(sizes, -9.9, 9.9))
    end = refit(fitted, begin)
    groups = len(problem.data.conditions)
    if groups > 1:
        remaining = _square(noise, held_out_excess(fitted, end, noise)) / max(
            _square(noise, held_out_excess(problem, z, noise)), 1e-300
        )
    else:
        remaining = error[count] / error[0]
    parameters = fitted.parameters(end)
    values = fitted.attached(parameters)[-1].values
    again = _chosen_again(library.columns, rest, folds, count, rng)
    units = effect_units(attached, problem.model, problem.data).values()
    terms = tuple(
        Term(formula, float(value), unit, float(again[index]))
        for formula, value, unit, index in zip(formulas, values, units, chosen, strict=True)
    )
    corrected = dict(
        zip(
            (parameter.name for parameter in problem.model.parameters),
            fitted.model_parameters(end).tolist(),
            strict=True,
        )
    )
    after = _size(noise, mean_residuals(fitted, end))
    share = float(np.clip(1.0 - remaining, -1.0, 1.0))
    if share < _LEAST_SHARE:
        return RestLaw(library.site.name, library.site.kind, (), share, before, before, "", (), {}, (), tried)
    return RestLaw(
        library.site.name,
        library.site.kind,
        terms,
        share,
        before,
        after,
        text,
        tuple(values),
        corrected,
        fitted.attached(parameters)[:-1],
        tried,
    )


def _square(noise: Noise, residual: ExcessResidual) -> float:
    """Return the mean square that is left, in units of one trial's noise; less the noise where repeats tell it."""
    return residual.total if noise.known else _size(noise, residual.residual) ** 2


def _size(noise: Noise, residual: Sequence[FloatArray]) -> float:
    squares = np.concatenate(
        [np.mean(np.square(trial_residual / noise.sd), axis=1) for trial_residual in residual]
    )
    return float(np.sqrt(np.mean(squares)))


def _libraries(base: Base, note: Note) -> list[_Library]:
    """Return the terms of every site where something happens."""
    problem, z = base.problem, base.z
    scales = site_scales(problem, z)
    libraries = []
    for site in problem.model.places:
        scale = scales.get((site.kind, site.name))
        if scale is None or site.kind == "output":
            continue
        formulas = _formulas(problem, z, site, scale)
        note(f"trying {len(formulas)} terms at {site.name}")
        effect = _read(_toml(site, formulas, problem.model.name))
        added = problem.with_effects([effect.attach(site.name, scale)], [scale])
        start = np.insert(z, problem.size, np.zeros(len(formulas)))
        moving = np.arange(added.size) >= problem.size
        jacobian = added.jacobian(start, base.residual, central=True, moving=moving)
        columns = base.nuisance.remainder([derivatives[:, problem.size :] for derivatives in jacobian.shared])
        seen = np.linalg.norm(columns, axis=0) > 1e-9 * np.linalg.norm(columns)
        kept = [formula for formula, is_seen in zip(formulas, seen, strict=True) if is_seen]
        libraries.append(_Library(site, scale, tuple(kept), columns[:, seen]))
    return libraries


def _formulas(problem: Problem, z: FloatArray, site: Site, scale: Scale) -> list[str]:
    """Return the terms of a site in multiples of typical motion, as an effect's equation has them."""
    if site.kind == "input":
        return [
            _in_multiples(name, signal=scale.signal, sign=f"signal/{_number(_LAW_SIGN_WIDTH * scale.signal)}")
            for name in _SIGNAL
        ]
    sizes = {"q": scale.coordinate, "rate": scale.rate}
    terms: tuple[str, ...] = _MOTION
    if site.load:
        sizes["load"] = _load_of(problem, z, site)
        terms = (*_MOTION, *_LOADED) if sizes["load"] > 0 else _MOTION
    sign = f"rate/{_number(_LAW_SIGN_WIDTH * scale.rate)}"
    return [_in_multiples(term, sign=sign, **sizes) for term in terms]


def _load_of(problem: Problem, z: FloatArray, site: Site) -> float:
    """Return the largest load that the simulation shows at a site."""
    parameters, site_index = problem.parameters(z), problem.model.sites.index(site)
    own = problem.model_parameters(z)
    largest = 0.0
    for index, trial in enumerate(problem.data.trials):
        course = simulate(
            problem.model,
            trial.time_s,
            problem.drives[index],
            parameters=own,
            condition=trial.condition,
            initial_state=problem.initial_state(index, problem.own(z, index)),
            effects=problem.attached(parameters),
        )
        if course.finite:
            seen = site_course(
                problem.model,
                trial.time_s,
                course.states,
                trial.inputs,
                parameters=own,
                condition=trial.condition,
            )
            largest = max(largest, float(np.max(np.abs(seen[:, site_index, 2]))))
    return largest


def _in_multiples(term: str, *, sign: str, **sizes: float) -> str:
    """Return a term with each quantity over its typical size: ``(rate/3.2)^3``."""
    multiples = {name: f"({name}/{_number(size)})" for name, size in sizes.items()} | {
        "sign": f"tanh({sign})"
    }
    return re.sub(r"[a-z]+", lambda match: multiples.get(match[0], match[0]), term)


def _number(value: float) -> str:
    return f"{float(f'{value:.3g}')!r}"


def _toml(site: Site, formulas: Sequence[str], model: str) -> str:
    """Return the law as a file of effects: a size for every term."""
    law = " + ".join(f"size_{number}*{formula}" for number, formula in enumerate(formulas, start=1))
    signal = site.kind == "input"
    quantity = "signal" if signal else "force"
    lines = [
        f"[{NAME}]",
        f'title  = "What the library lacked beside {model}: found by sparse regression, not derived."',
        f'kind   = "{site.kind}"',
        f'y      = "signal + {law}"' if signal else f'F      = "{law}"',
        'source = "labrun gap diagnose --explain-rest"',
    ]
    lines += [
        f'parameters.size_{number} = {{ quantity = "{quantity}", neutral = 0.0, lower = -10.0, upper = 10.0, '
        "starts = [0.1, -0.1] }"
        for number in range(1, len(formulas) + 1)
    ]
    return "\n".join(lines) + "\n"


def _read(text: str) -> Effect:
    return read_effects(f"{NAME}.toml", text=text)[0]


def folds_of_rows(problem: Problem, lengths: Sequence[int], rows: int) -> NDArray[np.intp]:
    """Return which fold each row belongs to: a condition, or a block of time where there is one; -1 for prior rows."""
    fold = np.full(rows, -1, dtype=np.intp)
    single = len(problem.data.conditions) < 2
    at = 0
    for trial, length in zip(problem.data.trials, lengths, strict=True):
        fold[at : at + length] = np.arange(length) * _LAW_BLOCKS // length if single else trial.group
        at += length
    return fold


def _pursued(columns: FloatArray, values: FloatArray, count: int) -> list[int]:
    """Return the terms that orthogonal matching pursuit takes, one after the other."""
    unit = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    remainder, others, chosen = values.copy(), unit.copy(), list[int]()
    for _ in range(min(count, columns.shape[1])):
        size = np.linalg.norm(others, axis=0)
        gain = np.where(size > _LAW_TERM_NEW, np.abs(others.T @ remainder) / np.maximum(size, 1e-300), 0.0)
        gain[chosen] = 0.0
        if not np.any(gain > 0):
            break
        chosen.append(int(np.argmax(gain)))
        along = others[:, chosen[-1]] / size[chosen[-1]]
        remainder = remainder - along * (along @ remainder)
        others = others - np.outer(along, along @ others)
    return chosen


def _withheld(columns: FloatArray, values: FloatArray, fold: NDArray[np.intp]) -> list[float]:
    """Return the squares that 0, 1, ... terms leave of folds that neither choice nor fit has seen."""
    squares = [0.0] * (_LAW_TERMS + 1)
    for index in range(int(fold.max()) + 1):
        test, train = fold == index, fold != index
        for count in range(_LAW_TERMS + 1):
            chosen = _pursued(columns[train], values[train], count)
            sizes = np.linalg.lstsq(columns[np.ix_(train, chosen)], values[train], rcond=None)[0]
            rest = values[test] - columns[np.ix_(test, chosen)] @ sizes
            squares[count] += float(rest @ rest)
    return squares


def _count(errors: Sequence[float]) -> int:
    """Return as many terms as each remove a little more on withheld folds."""
    best = 0
    for count in range(1, len(errors)):
        if errors[count] < errors[best] - _LAW_TERM_WORTH * (count - best) * errors[0]:
            best = count
    return best


def _chosen_again(
    columns: FloatArray, values: FloatArray, fold: NDArray[np.intp], count: int, rng: np.random.Generator
) -> FloatArray:
    """Return how often each term is chosen on resampled folds, (terms,)."""
    names = np.unique(fold[fold >= 0])
    rows = {name: np.flatnonzero(fold == name) for name in names}
    again = np.zeros(columns.shape[1])
    for _ in range(_LAW_RESAMPLES):
        drawn = np.concatenate([rows[index] for index in rng.choice(names, size=len(names))])
        again[_pursued(columns[drawn], values[drawn], count)] += 1.0 / _LAW_RESAMPLES
    return again
