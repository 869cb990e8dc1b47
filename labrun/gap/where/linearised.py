"""The linear system that small changes of a model follow along its trajectories, over all units."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from labrun.fit.dataset import FitTrial
from labrun.gap.where.difference import Difference
from labrun.models import site_course

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_STEP = 1e-5
"""Of the differences, in units of each state's range."""
_READ, _STATED = 0.02, 0.005
"""Uncertainty of initial states, in units of their range: read from the data, and stated."""


@dataclass(frozen=True)
class Linearised:
    """All units one after the other; the row of a unit's last sample has no next one and is never used.

    Attributes
    ----------
    dt_s : (n,)
    half, whole : (n, k, k)
        Transition over half an interval and over an interval.
    c : (n, m, k)
        Outputs, in units of one trial's noise, by states.
    begin : (n,)
        1 at the first sample of a unit.
    begin_sd : (k,)
        How well the state is known in which a unit begins.
    """

    dt_s: FloatArray
    half: FloatArray
    whole: FloatArray
    c: FloatArray
    begin: IntArray
    begin_sd: FloatArray


def linearised(difference: Difference) -> Linearised | None:
    """Return the linear system about the simulated trajectories; None where they, or it, are not finite."""
    parts = [_unit(difference, index) for index in range(len(difference.units.trials))]
    if any(part is None for part in parts):
        return None
    found = [part for part in parts if part is not None]
    columns = [np.concatenate([part[place] for part in found]) for place in range(4)]
    begin = np.concatenate([np.eye(1, len(part[0]), dtype=np.int64)[0] for part in found])
    if not all(np.all(np.isfinite(one)) for one in columns):
        return None
    rules = [difference.model.initial.get(state, "free") for state in difference.model.states]
    known = np.array([_READ if rule in ("free", "first") else _STATED for rule in rules])
    reach = np.max([part[4] for part in found], axis=0)
    return Linearised(columns[0], columns[1], columns[2], columns[3], begin, known * reach)


def _unit(difference: Difference, index: int) -> tuple[FloatArray, ...] | None:
    from labrun.gap.where.linear import linearise, transitions
    from labrun.models import simulate

    model, trial = difference.model, difference.units.trials[index]
    simulation = simulate(
        model,
        trial.time_s,
        difference.drives[index],
        parameters=difference.parameters,
        condition=trial.condition,
        initial_state=difference.initial[index],
        effects=difference.effects,
    )
    if not simulation.finite:
        return None
    drive = difference.drives[index]
    u = np.concatenate([drive.u[:: drive.substeps, 0], drive.u_last[None]])
    states = np.ascontiguousarray(simulation.states)
    size, channels, count = states.shape[1], len(model.outputs), len(states)
    reach = np.maximum(np.ptp(states, axis=0), np.abs(states).max(axis=0))
    steps = _STEP * np.where(reach > 0, reach, 1.0)
    a, c = np.empty((count, size, size)), np.empty((count, channels, size))
    linearise(
        trial.time_s, states, np.ascontiguousarray(u), model.vector(difference.parameters, trial.condition), steps,
        _forces(difference, trial, states, steps), model.derivative.address, model.output.address, a, c,
    )  # fmt: skip
    dt_s = np.diff(trial.time_s, append=trial.time_s[-1])
    half, whole = np.zeros((count, size, size)), np.zeros((count, size, size))
    transitions(a, dt_s[:-1], half, whole)
    return dt_s, half, whole, c / difference.noise_sd[:, None], reach


def _forces(difference: Difference, trial: FitTrial, states: FloatArray, steps: FloatArray) -> FloatArray:
    """Return what effects at the sites do with each state a step ahead and a step behind, (2, k, n, sites).

    Their internal states are held at rest, and laws that depend on acceleration see none: an effect that is part of
    the model compared is small beside the model, and here only the way a disturbance spreads depends on it.
    """
    model = difference.model
    order = [site.name for site in model.sites]
    found = np.zeros((2, states.shape[1], len(states), len(order)))
    laws = [one for one in (*model.effects, *difference.effects) if one.effect.kind in ("joint", "body")]
    for side, k in product(range(2), range(states.shape[1]) if laws else ()):
        moved = states.copy()
        moved[:, k] += (1 - 2 * side) * steps[k]
        course = site_course(
            model,
            trial.time_s,
            moved,
            trial.inputs,
            parameters=difference.parameters,
            condition=trial.condition,
        )
        for one in laws:
            law, place = one.effect.function.python, order.index(one.site)
            rest, unused = np.zeros(one.effect.states + 1), np.zeros(one.effect.states + 1)
            found[side, k, :, place] += [
                law(t, q, rate, 0.0, load, stiffness, one.values, rest, unused)
                for t, (q, rate, load, stiffness) in zip(
                    trial.time_s.tolist(), course[:, place].tolist(), strict=True
                )
            ]
    return found
