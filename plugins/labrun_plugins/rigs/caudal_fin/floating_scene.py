"""The fish with one tail fin afloat, which a stiff tail turns instead of moving it (source, section 5.2)."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.errors import ExperimentError
from labrun.models import Stepper
from labrun_plugins.rigs.caudal_fin.fins import BEST_N, Fin, FinSettings, named_fin, thrust_n
from labrun_plugins.rigs.caudal_fin.scene import QUARTER_S, DelayLine
from labrun_plugins.simulated.bench import Bench, BenchSettings, model_beside, require_finite

_EVEN_N = 0.4
"""Thrust of the fin that turns the body as far as itself in the water (chosen: between 0.28 and 0.58 N the tails of
Table 5.2 swim and do not swim as printed)."""
_SWIMS_M = 0.3
"""A fish that gets farther than that swims (chosen: about its length)."""


class FloatingFish(Bench):
    """A fish on a foam float, with a tail that a person changes.

    Physics and sources: see ``floating.toml``. Before a trial a person puts the fish back, at rest. A condition names
    the fin by ``material``, ``thickness_mm`` and ``fin``. With `as_modelled` nothing changes: there is no model of it.

    Signals: ``x``, how far it got (m), its speed ``ahead`` (m/s), ``heading``, by which the body turns against its tail
    (rad), and ``tail``, the servo's angle (rad).
    """

    Settings: ClassVar[type[BenchSettings]] = FinSettings
    step_s = 0.01
    scale = Scale(coordinate=0.5, rate=0.2, acceleration=1.0, force=0.1, signal=0.5, time_s=2.0)
    joints = ("tail",)
    remembered = ("fin", "tail_rad", "inputs_before", "quarter", "servo", "stepper")
    signals: Mapping[str, str] = {"x": "m", "ahead": "m/s", "heading": "rad", "tail": "rad"}

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._any_fin = self._with_errors(model_beside(__file__, "floating.toml"))
        self._model = self._any_fin
        self._servo = self._passage(self.joints)
        self._water = self._inside()
        self._quarter = DelayLine(round(QUARTER_S / self.step_s) + 2)
        self._tail_rad = 0.0
        self._inputs_before = np.zeros((1, len(self._model.inputs)))
        self._put((self._settings.material, self._settings.thickness_mm, self._settings.fin))

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Put the fish back at rest, with the fin of the condition."""
        self._put(named_fin(condition, self._fin))

    def answer(self, what: str) -> str:
        """Return what a person sees after the trial: whether it swam.

        Raises
        ------
        ExperimentError
            Something else is asked for.
        """
        if what != "swims":
            raise ExperimentError(
                f"nobody can read {what!r} off this fish", hint="objectives.NAME.reads is swims"
            )
        return "yes" if float(self._stepper.state[0]) > _SWIMS_M else "no"

    def truth(self) -> dict[str, Any]:
        """Return the fin, parameters as they are on the bench, and hidden effects."""
        fin = dict(zip(("material", "thickness_mm", "fin"), self._fin, strict=True))
        return self._truth(self._water + self._servo.effects, fin=fin)

    def _put(self, fin: Fin) -> None:
        thrust = thrust_n(*fin)
        gain = self._any_fin.named_values["thrust_gain"]
        self._fin = fin
        self._model = self._any_fin.with_values(
            {"thrust_gain": thrust / BEST_N * gain, "reaction": thrust / _EVEN_N}
        )
        self._stepper = Stepper(self._model, effects=self._water, step_s=self.step_s)

    def _advance(self, time_s: FloatArray) -> FloatArray:
        tail = self._servo(self._drives["tail"].angles(time_s))
        rate = np.diff(tail, prepend=self._tail_rad) / self.step_s
        self._tail_rad = float(tail[-1])
        (quarter,) = self._quarter.after(rate, round(QUARTER_S / self.step_s))
        inputs = np.empty((len(time_s) + 1, len(self._model.inputs)))
        inputs[0] = self._inputs_before
        noise = self._settings.noise / math.sqrt(self.step_s) * self._rng.standard_normal(len(time_s))
        inputs[1:] = np.column_stack([rate, quarter, noise])
        course = self._stepper.advance(inputs)
        self._inputs_before = inputs[-1:].copy()
        require_finite(self._stepper, "floating fish")
        reaction = self._model.named_values["reaction"]
        return np.column_stack([course, -reaction / (1.0 + reaction) * tail, tail])

    def _recall(self, memory: Mapping[str, Any]) -> None:
        material, thickness_mm, fin = memory["fin"]
        self._put((material, thickness_mm, fin))
        super()._recall({**memory, "fin": self._fin})
