"""Simulate in blocks: the state and the memory of every effect last from one block to the next."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect
from labrun.errors import ModelError
from labrun.models.layout import filters, law_values, layout
from labrun.models.model import Condition, Model


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
        """Whether the state is still finite: False after the model blew up."""
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
            filter_inputs(
                u, steps_s, before.addresses, before.channels, before.offsets, before.values,
                before.memory_offsets, before.memory, self._begun,
            )  # fmt: skip
        states = np.empty((count + 1, self._all.size))
        outputs = np.empty((count + 1, len(self.model.outputs)))
        written = integrate(
            self.time_s, steps_s, u, u[-1, 2].copy(), 1, True, False, self._p,
            self._layout.derivative, self._layout.output, laws.site_values, laws.coupled, laws.sites, laws.laws,
            self._values, np.zeros(laws.scratch), self._all, states, outputs,
        )  # fmt: skip
        if written > 0 and after.addresses.size:
            filter_outputs(
                outputs[:written], self._last_outputs, steps_s, after.addresses, after.channels,
                after.offsets, after.values, after.memory_offsets, after.memory, self._begun,
            )  # fmt: skip
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
