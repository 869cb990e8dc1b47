"""Simulate one trial."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect
from labrun.errors import ModelError
from labrun.models.inputs import Drive, drive
from labrun.models.layout import filters, law_values, layout
from labrun.models.model import Condition, Model

_MOST_SUBSTEPS = 256


@dataclass(frozen=True)
class Simulation:
    """What a model gives for one trial.

    Attributes
    ----------
    outputs : (samples, outputs)
    states : (samples, states)
        The model's own states, without those of effects.
    finite
        False when it blew up; rows from there on are NaN.
    substeps
        Integration steps per sample interval.
    """

    outputs: FloatArray
    states: FloatArray
    finite: bool
    substeps: int


def simulate(
    model: Model,
    time_s: FloatArray,
    inputs: FloatArray | Drive,
    *,
    parameters: FloatArray | Mapping[str, float] | None = None,
    condition: Condition | None = None,
    initial_state: ArrayLike | None = None,
    effects: Sequence[AttachedEffect] = (),
    substeps: int | None = None,
) -> Simulation:
    """Simulate a model over one trial.

    Parameters
    ----------
    model
        What to simulate.
    time_s : (samples,)
        Sample times, s, strictly increasing; intervals may differ.
    inputs : (samples, inputs)
        Or a `Drive` made from them by `prepare`, which saves time when one trial is simulated often.
    parameters : (parameters,)
        None for the nominal values; a mapping overrides some.
    condition
        The trial's.
    initial_state : (states,)
        None asks `Model.initial_state`, which has no measured outputs to begin at.
    effects
        Physics to add to what the model carries; their internal states and memories begin at rest.
    substeps
        Runge-Kutta steps per sample interval: an even number is taken in pairs, each as one step of order 5 (see
        `labrun.models.engine`), an odd one by steps of order 4. None finds them with `suggest_substeps`, which costs
        several simulations.

    Returns
    -------
    Simulation
        A simulation that blows up is not an error: `Simulation.finite` tells.

    Raises
    ------
    ModelError
        Something does not match the model.
    """
    condition = condition or {}
    if initial_state is None:
        told = inputs.first if isinstance(inputs, Drive) else np.asarray(inputs)[0]
        initial_state = model.initial_state(condition, first=model.told_first(told))
    if isinstance(inputs, Drive):
        driven = inputs
    else:
        driven = prepare(
            model,
            time_s,
            inputs,
            substeps
            or suggest_substeps(
                model,
                time_s,
                inputs,
                parameters=parameters,
                condition=condition,
                initial_state=initial_state,
                effects=effects,
            ),
        )
    p = model.vector(parameters, condition)
    return _run(model, driven, p, _checked_state(model, initial_state), effects)


@dataclass(frozen=True)
class Unfiltered:
    """A simulation on every step of the integrator, as it is before any effect at an output.

    Effects at outputs change nothing of what is behind them: one simulation serves all that are tried there.

    Attributes
    ----------
    driven
        The inputs it was made with.
    outputs, states : (steps + 1, ...)
    written
        Rows that are finite.
    every
        How many steps there are from row to row.
    """

    driven: Drive
    outputs: FloatArray
    states: FloatArray
    written: int
    every: int


def simulate_unfiltered(
    model: Model,
    driven: Drive,
    *,
    parameters: FloatArray | Mapping[str, float] | None = None,
    condition: Condition | None = None,
    initial_state: ArrayLike,
    effects: Sequence[AttachedEffect] = (),
) -> Unfiltered:
    """Simulate one trial up to the effects at its outputs, which `filtered` adds; arguments as for `simulate`."""
    p = model.vector(parameters, condition or {})
    return _integrated(model, driven, p, _checked_state(model, initial_state), effects, every=1)


def filtered(model: Model, before: Unfiltered, effects: Sequence[AttachedEffect]) -> Simulation:
    """Return what `simulate` gives with these effects, from the simulation before those at the outputs."""
    driven, outputs, states = before.driven, before.outputs, before.states
    effects = (*model.effects, *effects)
    chosen = layout(model, effects).after
    finite = before.written == len(outputs)
    if chosen and finite:
        from labrun.models.engine import filter_outputs

        steps_s = driven.steps_s
        after = filters(model, effects, chosen, float(steps_s.min()) if steps_s.size else 1.0)
        outputs = outputs.copy()
        filter_outputs(
            outputs, np.empty((after.addresses.size, len(model.outputs))), steps_s,
            after.addresses, after.channels, after.offsets, after.values, after.memory_offsets, after.memory, False,
        )  # fmt: skip
        finite = bool(np.isfinite(outputs).all())
    if before.every != driven.substeps:
        states, outputs = states[:: driven.substeps], outputs[:: driven.substeps]
    return Simulation(outputs, states, finite, driven.substeps)


def prepare(model: Model, time_s: FloatArray, inputs: FloatArray, substeps: int) -> Drive:
    """Lay a trial's inputs on the integrator's steps once, to simulate it many times."""
    return drive(time_s, inputs, [one.between for one in model.inputs], substeps)


def suggest_substeps(
    model: Model,
    time_s: FloatArray,
    inputs: FloatArray,
    *,
    parameters: FloatArray | Mapping[str, float] | None = None,
    condition: Condition | None = None,
    initial_state: ArrayLike | None = None,
    effects: Sequence[AttachedEffect] = (),
    tolerance: float = 1e-4,
    most: int = _MOST_SUBSTEPS,
) -> int:
    """Return the fewest substeps (1, 2, 4, ...) whose halving moves no output by more than `tolerance` of its range.

    Returns `most` where none does (a chaotic or a discontinuous model), and 1 where the simulation blows up however
    short its steps are.
    """
    if not model.states and not effects and not model.effects:
        return 1
    condition = condition or {}
    if initial_state is None:
        initial_state = model.initial_state(condition, first=model.told_first(inputs[0]))
    start = _checked_state(model, initial_state)
    p = model.vector(parameters, condition)
    exact_within = np.array([one.exact_within for one in model.outputs])
    coarse: Simulation | None = None
    substeps = 1
    while substeps <= most:
        fine = _run(model, prepare(model, time_s, inputs, substeps), p, start, effects)
        if coarse is not None and coarse.finite and fine.finite:
            span = np.ptp(fine.outputs, axis=0)
            moved = np.max(np.abs(fine.outputs - coarse.outputs), axis=0, initial=0.0)
            rounding = 1e-12 * np.max(np.abs(fine.outputs), axis=0, initial=0.0)
            if np.all(moved <= tolerance * span + rounding + exact_within):
                return substeps // 2
        coarse = fine
        substeps *= 2
    return most if coarse is not None and coarse.finite else 1


def _checked_state(model: Model, initial_state: ArrayLike) -> FloatArray:
    state = np.array(initial_state, dtype=float)
    if state.shape != (len(model.states),):
        raise ModelError(
            f"model {model.name} has the states {', '.join(model.states) or '(none)'}; "
            f"an initial state of shape {state.shape} was given"
        )
    return state


def _run(
    model: Model, driven: Drive, p: FloatArray, initial_state: FloatArray, effects: Sequence[AttachedEffect]
) -> Simulation:
    every = 1 if layout(model, (*model.effects, *effects)).after else driven.substeps
    return filtered(model, _integrated(model, driven, p, initial_state, effects, every=every), effects)


def _integrated(
    model: Model,
    driven: Drive,
    p: FloatArray,
    initial_state: FloatArray,
    effects: Sequence[AttachedEffect],
    *,
    every: int,
) -> Unfiltered:
    from labrun.models.engine import integrate

    effects = (*model.effects, *effects)
    found = layout(model, effects)
    laws, own = found.forces, len(model.states)
    u, u_last, steps_s = driven.u, driven.u_last, driven.steps_s
    if found.before:
        from labrun.models.engine import filter_inputs

        shortest = float(steps_s.min()) if steps_s.size else 1.0
        before = filters(model, effects, found.before, shortest / 2)
        # one more step, over which the last sample is held, tells what the filters make of the last sample
        u = np.concatenate([u, np.broadcast_to(u_last, (1, 3, u_last.size))])
        filter_inputs(
            u, np.append(steps_s, shortest), before.addresses, before.channels, before.offsets, before.values,
            before.memory_offsets, before.memory, False,
        )  # fmt: skip
        u, u_last = u[:-1], u[-1, 0].copy()

    rows = steps_s.size // every + 1
    states = np.empty((rows, own + laws.states))
    outputs = np.empty((rows, len(model.outputs)))
    state = np.zeros(own + laws.states)
    state[:own] = initial_state
    written = integrate(
        float(driven.time_s[0]), steps_s, u, u_last, every, False, driven.substeps % 2 == 0, p,
        found.derivative, found.output, laws.site_values, laws.coupled, laws.sites, laws.laws,
        law_values(found, effects), np.zeros(laws.scratch), state, states, outputs,
    )  # fmt: skip
    if written < rows:
        states[written:], outputs[written:] = np.nan, np.nan
    return Unfiltered(driven, outputs, states[:, :own] if laws.states else states, written, every)


def site_course(
    model: Model,
    time_s: FloatArray,
    states: FloatArray,
    inputs: FloatArray,
    *,
    parameters: FloatArray | None = None,
    condition: Condition | None = None,
) -> FloatArray:
    """Return what every joint and body site sees at the samples of a simulated trial.

    Parameters
    ----------
    states : (samples, states)
        Of `Simulation.states`.
    inputs : (samples, inputs)

    Returns
    -------
    (samples, sites, 4)
        Coordinate, rate, load and stiffness (0 where a site declares none), SI, in the order of `Model.sites`.
    """
    from labrun.models.engine import evaluate_sites

    found = np.zeros((len(time_s), 4 * len(model.sites)))
    if model.sites:
        p = model.vector(parameters, condition or {})
        force = np.zeros(len(model.sites))
        evaluate_sites(
            model.site_values.address,
            np.ascontiguousarray(time_s, dtype=float),
            np.ascontiguousarray(states, dtype=float),
            np.ascontiguousarray(inputs, dtype=float),
            p,
            force,
            found,
        )
    return found.reshape(len(time_s), len(model.sites), 4)
