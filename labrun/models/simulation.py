"""Simulate one trial."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from labrun.errors import ModelError
from labrun.models.inputs import Drive, drive
from labrun.models.layout import filters, forces
from labrun.models.model import Condition, FloatArray, Model

if TYPE_CHECKING:
    from labrun.effects.effect import AttachedEffect

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
    effects: "Sequence[AttachedEffect]" = (),
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
        Physics to add; their internal states and memories begin at rest.
    substeps
        Runge-Kutta steps per sample interval; None finds them with `suggest_substeps`, which costs several simulations.

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
        initial_state = model.initial_state(condition)
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
    effects: "Sequence[AttachedEffect]" = (),
    tolerance: float = 1e-4,
    most: int = _MOST_SUBSTEPS,
) -> int:
    """Return the fewest substeps (1, 2, 4, ...) whose halving moves no output by more than `tolerance` of its range.

    Returns `most` where none does (a chaotic or a discontinuous model), and 1 where the simulation blows up however
    short its steps are.
    """
    if not model.states and not effects:
        return 1
    condition = condition or {}
    start = _checked_state(model, model.initial_state(condition) if initial_state is None else initial_state)
    p = model.vector(parameters, condition)
    coarse: Simulation | None = None
    substeps = 1
    while substeps <= most:
        fine = _run(model, prepare(model, time_s, inputs, substeps), p, start, effects)
        if coarse is not None and coarse.finite and fine.finite:
            span = np.ptp(fine.outputs, axis=0)
            moved = np.max(np.abs(fine.outputs - coarse.outputs), axis=0, initial=0.0)
            if np.all(moved <= tolerance * span + 1e-12 * np.max(np.abs(fine.outputs), axis=0, initial=0.0)):
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
    model: Model, driven: Drive, p: FloatArray, initial_state: FloatArray, effects: "Sequence[AttachedEffect]"
) -> Simulation:
    from labrun.models.filtering import filter_inputs, filter_outputs
    from labrun.models.integration import integrate

    laws = forces(model, effects)
    shortest = float(driven.steps_s.min()) if driven.steps_s.size else 1.0
    before = filters(model, effects, "input", shortest / 2)
    after = filters(model, effects, "output", shortest)
    u, u_last = driven.u, driven.u_last
    if before.addresses.size:
        # one more step, over which the last sample is held, tells what the filters make of the last sample
        u = np.concatenate([u, np.broadcast_to(u_last, (1, 3, u_last.size))])
        steps_s = np.append(driven.steps_s, shortest)
        filter_inputs(
            u, steps_s, before.addresses, before.channels, before.offsets, before.values,
            before.memory_offsets, before.memory, False,
        )  # fmt: skip
        u, u_last = u[:-1], u[-1, 0].copy()

    every = 1 if after.addresses.size else driven.substeps
    rows = driven.steps_s.size // every + 1
    states = np.empty((rows, len(model.states) + laws.states))
    outputs = np.empty((rows, len(model.outputs)))
    state = np.concatenate([initial_state, np.zeros(laws.states)])
    written = integrate(
        float(driven.time_s[0]), driven.steps_s, u, u_last, every, False, p,
        model.derivative.address, model.output.address, model.site_values.address,
        laws.rate_states, laws.addresses, laws.sites, laws.inertial, laws.offsets, laws.values, laws.state_offsets,
        state, states, outputs,
    )  # fmt: skip
    finite = written == rows
    if after.addresses.size and finite:
        filter_outputs(
            outputs, np.empty((after.addresses.size, len(model.outputs))), driven.steps_s,
            after.addresses, after.channels, after.offsets, after.values, after.memory_offsets, after.memory, False,
        )  # fmt: skip
        finite = bool(np.isfinite(outputs).all())
    states[written:], outputs[written:] = np.nan, np.nan
    thin = slice(None, None, driven.substeps if every == 1 else 1)
    return Simulation(outputs[thin], states[thin, : len(model.states)], finite, driven.substeps)
