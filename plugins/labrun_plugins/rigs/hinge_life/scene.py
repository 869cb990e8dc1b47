"""A servo turns a hinge to and fro, a sensor under its mount feels the torque (section 2.1 of the source work).

The torque of a spring and a damper, of which a share is left: ``bench.toml``.
"""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import PositiveFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.errors import SpecError
from labrun.models import Stepper
from labrun_plugins.simulated.bench import (
    Bench,
    BenchSettings,
    Passage,
    hidden_effects,
    model_beside,
    require_finite,
)

_SCALE = Scale(coordinate=1.5, rate=4.0, acceleration=10.0, force=0.02, signal=0.1, time_s=2.0)
_JOINT_SCALE = Scale(signal=1.5, time_s=2.0)
MEDIANS: Mapping[tuple[str, int], float] = {
    ("polyester", 120): 2500.0,
    ("sandwich", 120): 200_000.0,
    ("polyester", 90): 25_000.0,
    ("sandwich", 90): 2_000_000.0,
}
"""Cycles that half of the hinges survive. Polyester turned by +-120 deg, where rigid parts strike the mount and twist
the hinge, tears at about 2500; sandwiches outlive 50,000 (source). By how much, and what +-90 deg gives, is chosen."""
SHAPE = 3.0
"""Of the Weibull distribution of lives (chosen)."""
_PER_DECADE = 0.05
"""Torque that a hinge loses while its cycles grow tenfold (chosen)."""
_TORN = 0.02
_ASIDE_RAD = 0.2
"""A hinge this far from zero is on one side: it may rest at zero between two stretches of a long motion."""


class LifeBenchSettings(BenchSettings):
    """The hinge.

    Attributes
    ----------
    layup, range_deg
        "polyester" or "sandwich", and 90 or 120; conditions ``layup`` and ``range`` change them.
    shape
        Of the Weibull distribution of lives.
    """

    layup: str = "polyester"
    range_deg: PositiveFloat = 120.0
    shape: PositiveFloat = SHAPE


class LifeBench(Bench):
    """Torque of a hinge that tires and tears.

    The torque falls by 5 % per decade of cycles; a hinge's life is drawn from a Weibull distribution as it is mounted,
    and after it a fiftieth of the torque is left. A cycle is counted when the angle has gone from one side to the other
    and back. A condition ``specimen`` names another hinge; every mounting is of a new one. With `as_modelled` hinges
    tire and do not tear.

    Signals: ``torque_z`` about the hinge (N m), ``hinge``, the angle of the servo (rad).
    """

    Settings: ClassVar[type[BenchSettings]] = LifeBenchSettings
    step_s = 0.01
    scale = _SCALE
    joints = ("hinge",)
    sensed = ("torque_z",)
    remembered = ("batch", "hinge", "cycles", "side", "inputs_before", "servo", "sensor", "stepper")
    signals: Mapping[str, str] = {"torque_z": "N m", "hinge": "rad"}

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        at_joint = [
            hidden for hidden in self._settings.hide if hidden.site in self.joints and hidden.kind == "input"
        ]
        self._servo = Passage(self.joints, at_joint, _JOINT_SCALE, self.step_s)
        self._sensor = self._passage(self.sensed)
        self._model = self._with_errors(model_beside(__file__, "bench.toml"))
        in_hinge = [
            hidden
            for hidden in self._settings.hide
            if hidden not in at_joint and hidden.site not in self.sensed
        ]
        in_model = hidden_effects(in_hinge, self._model, _SCALE)
        self._hidden = [*in_model, *self._servo.effects, *self._sensor.effects]
        self._stepper = Stepper(self._model, effects=in_model, step_s=self.step_s)
        self._inputs_before = np.array([[0.0, 1.0]])
        self._batch = int(rng.integers(2**63))
        self._put(self._settings.layup, self._settings.range_deg, "", 1)

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Mount the hinge that the condition names by ``layup``, ``range`` and ``specimen``; one in place stays."""
        layup, range_deg, specimen, _ = self._hinge
        wanted = (
            str(condition.get("layup", layup)),
            float(condition.get("range", range_deg)),
            condition.get("specimen", specimen),
        )
        if wanted != (layup, range_deg, specimen):
            self._put(*wanted, 1)

    def mount(self, number: int) -> None:
        """Mount a new hinge of the kind that is asked for."""
        self._put(*self._hinge[:3], number)

    def truth(self) -> dict[str, Any]:
        """Return the hinge, its life, how many cycles it has seen, parameters, and hidden effects."""
        return self._truth(
            self._hidden, layup=self._hinge[0], specimen=self._hinge[2], life=self._life, cycles=self._cycles
        )

    def _put(self, layup: str, range_deg: float, specimen: float | str, mounting: int) -> None:
        median = MEDIANS.get((layup, round(range_deg)))
        if median is None:
            known = "; ".join(f"{name} by {angle} deg" for name, angle in MEDIANS)
            raise SpecError(
                f"this bench knows no hinge of {layup!r} turned by {range_deg:g} deg",
                hint=f"it knows {known}",
            )
        words = [*f"{layup}/{range_deg:g}/{specimen}".encode()]
        share = float(np.random.default_rng((self._batch, mounting, *words)).random())
        share = share if self._settings.noise else 0.5
        self._life = median * (-math.log1p(-share) / math.log(2.0)) ** (1.0 / self._settings.shape)
        self._hinge = (layup, range_deg, specimen, mounting)
        self._cycles, self._side = 0, 1

    def _advance(self, time_s: FloatArray) -> FloatArray:
        angles = self._drives["hinge"].angles(time_s)
        sides = _sides(angles, self._side)
        cycles = self._cycles + np.cumsum(np.diff(sides) > 0)
        turned = self._servo(angles)
        inputs = np.column_stack([turned, self._left(cycles)])
        torque = self._stepper.advance(np.concatenate([self._inputs_before, inputs]))[:, 0]
        felt = self._sensor(torque)
        self._inputs_before, self._cycles, self._side = inputs[-1:].copy(), int(cycles[-1]), int(sides[-1])
        require_finite(self._stepper, "life bench")
        return np.column_stack([felt, turned])

    def _left(self, cycles: NDArray[np.int64]) -> FloatArray:
        """Return the share of a new hinge's torque after so many cycles."""
        tired = 1.0 - _PER_DECADE * np.log10(np.maximum(cycles, 1))
        torn = (cycles >= self._life) & (not self._settings.as_modelled)
        return np.where(torn, _TORN, tired)

    def _recall(self, memory: Mapping[str, Any]) -> None:
        self._batch = memory["batch"]
        layup, range_deg, specimen, mounting = memory["hinge"]
        self._put(layup, range_deg, specimen, mounting)
        super()._recall({**memory, "hinge": self._hinge})


def _sides(angle: FloatArray, before: int) -> NDArray[np.int64]:
    """Return on which side (-1, 1) the hinge was last, before the first angle and at each, shape (n + 1,)."""
    aside = np.where(angle > _ASIDE_RAD, 1, np.where(angle < -_ASIDE_RAD, -1, 0))
    sides = np.concatenate([[before], aside])
    last = np.maximum.accumulate(np.where(sides != 0, np.arange(len(sides)), 0))
    return np.asarray(sides[last])
