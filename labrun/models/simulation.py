"""Simulate one trial at once, or in blocks between which state and memory of every effect last."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from labrun.arrays import FloatArray, IntArray
from labrun.effects import AttachedEffect
from labrun.errors import ModelError
from labrun.models.ahead import inputs_ahead, read_outputs_ahead
from labrun.models.layout import Drive, drive, filters, law_values, layout
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
        Integration steps in the sample interval that has most of them.
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
        initial = inputs.first if isinstance(inputs, Drive) else np.asarray(inputs)[0]
        initial_state = model.initial_state(condition, first=model.told_first(initial))
    if not isinstance(inputs, Drive):
        substeps = substeps or suggest_substeps(
            model, time_s, inputs, parameters=parameters, condition=condition, initial_state=initial_state,
            effects=effects,
        )  # fmt: skip
        inputs = prepare(model, time_s, inputs, substeps)
    p = model.vector(parameters, condition)
    return _run(model, inputs, p, _checked_state(model, initial_state), effects)


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
    each_step
        Whether there is a row for each step, not for the samples alone.
    """

    driven: Drive
    outputs: FloatArray
    states: FloatArray
    written: int
    each_step: bool


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
    return _integrated(model, driven, p, _checked_state(model, initial_state), effects, each_step=True)


def filtered(model: Model, before: Unfiltered, effects: Sequence[AttachedEffect]) -> Simulation:
    """Return what `simulate` gives with these effects, from the simulation before those at the outputs."""
    driven, outputs, states = before.driven, before.outputs, before.states
    effects = (*model.effects, *effects)
    chosen = layout(model, effects).after
    finite = before.written == len(outputs)
    if chosen and finite:
        outputs = outputs.copy()
        for ahead, group in groupby(chosen, lambda index: bool(effects[index].effect.ahead)):
            if ahead:
                read_outputs_ahead(model, outputs, driven.steps_s, [effects[index] for index in group])
            else:
                _filter(model, outputs, driven.steps_s, effects, tuple(group))
        finite = bool(np.isfinite(outputs).all())
    if before.each_step and driven.substeps > 1:
        states, outputs = states[driven.grid.rows], outputs[driven.grid.rows]
    return Simulation(outputs, states, finite, driven.substeps)


def _filter(
    model: Model,
    outputs: FloatArray,
    steps_s: FloatArray,
    effects: Sequence[AttachedEffect],
    chosen: tuple[int, ...],
) -> None:
    """Send outputs (steps + 1, outputs) through filters, in place."""
    from labrun.models.engine import filter_outputs

    after = filters(model, effects, chosen, float(steps_s.min()) if steps_s.size else 1.0)
    filter_outputs(outputs, np.empty((after.addresses.size, len(model.outputs))), steps_s, *after, False)


def prepare(model: Model, time_s: FloatArray, inputs: FloatArray, substeps: int | IntArray) -> Drive:
    """Lay a trial's inputs on the integrator's steps once, to simulate it many times.

    `substeps` may be a number for each interval between samples: short steps where something turns sharply.
    """
    return drive(time_s, inputs, [signal.between for signal in model.inputs], substeps)


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
    coarse: Simulation | None = None
    substeps = 1
    while substeps <= most:
        fine = _run(model, prepare(model, time_s, inputs, substeps), p, start, effects)
        if coarse is not None and coarse.finite and fine.finite:
            span = np.ptp(fine.outputs, axis=0)
            moved = np.max(np.abs(fine.outputs - coarse.outputs), axis=0, initial=0.0)
            rounding = 1e-12 * np.max(np.abs(fine.outputs), axis=0, initial=0.0)
            if np.all(moved <= tolerance * span + rounding):
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
    each_step = bool(layout(model, (*model.effects, *effects)).after)
    before = _integrated(model, driven, p, initial_state, effects, each_step=each_step)
    return filtered(model, before, effects)


def _integrated(
    model: Model,
    driven: Drive,
    p: FloatArray,
    initial_state: FloatArray,
    effects: Sequence[AttachedEffect],
    *,
    each_step: bool,
) -> Unfiltered:
    from labrun.models.engine import integrate

    effects = (*model.effects, *effects)
    memory = layout(model, effects)
    laws, own = memory.forces, len(model.states)
    u, u_last, steps_s = driven.u, driven.u_last, driven.steps_s
    for ahead, group in groupby(memory.before, lambda index: bool(effects[index].effect.ahead)):
        if ahead:
            u = _read_once(model, driven, u, u_last, [effects[index] for index in group])
        else:
            u, u_last = _filter_inputs(model, u, u_last, steps_s, effects, tuple(group))

    grid = driven.grid
    rows = np.arange(steps_s.size + 1) if each_step else grid.rows
    states = np.empty((rows.size, own + laws.states))
    outputs = np.empty((rows.size, len(model.outputs)))
    state = np.zeros(own + laws.states)
    state[:own] = initial_state
    written = integrate(
        float(driven.time_s[0]), steps_s, u, u_last, rows, False, grid.pairs, p,
        memory.derivative, memory.output, laws.site_values, laws.coupled, laws.sites, laws.laws,
        law_values(memory, effects), np.zeros(laws.scratch), state, states, outputs,
    )  # fmt: skip
    if written < rows.size:
        states[written:], outputs[written:] = np.nan, np.nan
    return Unfiltered(driven, outputs, states[:, :own] if laws.states else states, written, each_step)


def _filter_inputs(
    model: Model,
    u: FloatArray,
    u_last: FloatArray,
    steps_s: FloatArray,
    effects: Sequence[AttachedEffect],
    chosen: tuple[int, ...],
) -> tuple[FloatArray, FloatArray]:
    """Return inputs (steps, 3, inputs), and what they are at the last sample, behind filters."""
    from labrun.models.engine import filter_inputs

    shortest = float(steps_s.min()) if steps_s.size else 1.0
    before = filters(model, effects, chosen, shortest / 2)
    # one more step, over which the last sample is held, tells what the filters make of the last sample
    u = np.concatenate([u, np.broadcast_to(u_last, (1, 3, u_last.size))])
    filter_inputs(u, np.append(steps_s, shortest), *before, False)
    return u[:-1], u[-1, 0].copy()


def _read_once(
    model: Model, driven: Drive, u: FloatArray, u_last: FloatArray, effects: Sequence[AttachedEffect]
) -> FloatArray:
    """Return inputs read ahead; those of a trial itself are kept: a clock that is known reads them the same again."""
    if u is not driven.u:
        return inputs_ahead(model, u, u_last, driven.steps_s, effects)
    key = tuple((effect.site, effect.values) for effect in effects)
    ahead = driven.ahead.get(key)
    if ahead is None:
        ahead = inputs_ahead(model, u, u_last, driven.steps_s, effects)
        driven.ahead.clear()
        driven.ahead[key] = ahead
    return ahead


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

    result = np.zeros((len(time_s), 4 * len(model.sites)))
    if model.sites:
        p = model.vector(parameters, condition or {})
        force = np.zeros(len(model.sites))
        time_s, states, inputs = (
            np.ascontiguousarray(array, dtype=float) for array in (time_s, states, inputs)
        )
        evaluate_sites(model.site_values.address, time_s, states, inputs, p, force, result)
    return result.reshape(len(time_s), len(model.sites), 4)


class Stepper:
    """A model that is advanced step by step, as a simulated bench does.

    However a motion is cut into blocks, the outputs are the same to the last bit.

    Parameters
    ----------
    model
        What to simulate.
    parameters : (parameters,)
        None for the nominal values; a mapping overrides some.
    condition
        Of the trial that is going on.
    effects
        Physics to add.
    step_s
        Length of one Runge-Kutta step, s.
    initial_state : (states,)
        None begins at 0.
    """

    def __init__(
        self,
        model: Model,
        parameters: FloatArray | Mapping[str, float] | None = None,
        condition: Condition | None = None,
        effects: Sequence[AttachedEffect] = (),
        step_s: float = 1e-3,
        *,
        initial_state: ArrayLike | None = None,
    ) -> None:
        if not step_s > 0:
            raise ModelError(f"the step of a simulation must be above 0 s, not {step_s:g}")
        self.model = model
        self.step_s = float(step_s)
        self.time_s = 0.0
        self._p = model.vector(parameters, condition or {})
        effects = (*model.effects, *effects)
        self._layout = layout(model, effects)
        self._values = law_values(self._layout, effects)
        self._before = filters(model, effects, self._layout.before, self.step_s / 2)
        self._after = filters(model, effects, self._layout.after, self.step_s)
        self._last_outputs = np.zeros((self._after.addresses.size, len(model.outputs)))
        self._begun = False
        self._all = np.zeros(len(model.states) + self._layout.forces.states)
        if initial_state is not None:
            self.state = np.asarray(initial_state, dtype=float)

    @property
    def state(self) -> FloatArray:
        """The model's states, shape (states,); assign to put the model elsewhere."""
        return self._all[: len(self.model.states)].copy()

    @state.setter
    def state(self, values: ArrayLike) -> None:
        given = np.asarray(values, dtype=float)
        if given.shape != (len(self.model.states),):
            raise ModelError(
                f"model {self.model.name} has {len(self.model.states)} states; shape {given.shape} was given"
            )
        self._all[: len(self.model.states)] = given

    @property
    def finite(self) -> bool:
        """Tell whether the state is still finite: False after the model blew up."""
        # Not a number, once there, stays one in a sum; an infinity as well, or becomes not a number.
        return math.isfinite(float(self._all.sum())) or bool(np.isfinite(self._all).all())

    def advance(self, inputs: FloatArray) -> FloatArray:
        """Advance by some steps.

        Parameters
        ----------
        inputs : (steps, 3, inputs) or (steps + 1, inputs)
            At start, middle and end of each step; or at the edges of the steps, between which they are straight.

        Returns
        -------
        (steps, outputs)
            At the end of each step. From a step on in which the model blows up, NaN (see `finite`).
        """
        from labrun.models.engine import filter_inputs, filter_outputs, integrate

        u = self._on_steps(np.asarray(inputs, dtype=float))
        count = len(u)
        if count == 0:
            return np.empty((0, len(self.model.outputs)))
        steps_s = np.full(count, self.step_s)
        before, after, laws = self._before, self._after, self._layout.forces
        if before.addresses.size:
            filter_inputs(u, steps_s, *before, self._begun)
        states = np.empty((count + 1, self._all.size))
        outputs = np.empty((count + 1, len(self.model.outputs)))
        written = integrate(
            self.time_s, steps_s, u, u[-1, 2].copy(), np.arange(count + 1), True, np.zeros(count, dtype=bool), self._p,
            self._layout.derivative, self._layout.output, laws.site_values, laws.coupled, laws.sites, laws.laws,
            self._values, np.zeros(laws.scratch), self._all, states, outputs,
        )  # fmt: skip
        if written > 0 and after.addresses.size:
            filter_outputs(outputs[:written], self._last_outputs, steps_s, *after, self._begun)
        outputs[written:] = np.nan
        self._begun = True
        for _ in range(count):  # one by one, as the kernel adds them, so that blocks do not change the time
            self.time_s += self.step_s
        return outputs[1:]

    def _on_steps(self, inputs: FloatArray) -> FloatArray:
        count = len(self.model.inputs)
        if inputs.ndim == 3 and inputs.shape[1:] == (3, count):
            return np.array(inputs, order="C")
        if inputs.ndim == 2 and inputs.shape[1] == count and len(inputs) >= 1:
            steps = np.empty((len(inputs) - 1, 3, count))
            first, last = inputs[:-1], inputs[1:]
            steps[:, 0], steps[:, 1], steps[:, 2] = first, 0.5 * (first + last), last
            return steps
        raise ModelError(
            f"model {self.model.name} has {count} inputs: (steps, 3, {count}) or (steps + 1, {count}) was expected, "
            f"not {inputs.shape}"
        )

    def snapshot(self) -> dict[str, Any]:
        """Return state, time and memory of all effects as JSON-ready values."""
        return {
            "time_s": self.time_s,
            "begun": self._begun,
            "state": self._all.tolist(),
            "input_memory": self._before.memory.tolist(),
            "output_memory": self._after.memory.tolist(),
            "last_outputs": self._last_outputs.tolist(),
        }

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Take back what `snapshot` gave, on a stepper of the same model, effects and step."""
        for target, key in (
            (self._all, "state"),
            (self._before.memory, "input_memory"),
            (self._after.memory, "output_memory"),
        ):
            values = np.asarray(snapshot[key], dtype=float)
            if values.shape != target.shape:
                raise ModelError(
                    f"this snapshot is of another model or other effects: "
                    f"its {key} has {values.size} numbers, not {target.size}"
                )
            target[:] = values
        self._last_outputs[:] = np.asarray(snapshot["last_outputs"], dtype=float).reshape(
            self._last_outputs.shape
        )
        self.time_s = float(snapshot["time_s"])
        self._begun = bool(snapshot["begun"])
