"""A tensile tester: a strip between a grip on a linear stage and a load cell (source, sections 2.1 and 3.1)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.errors import SpecError
from labrun.models import Stepper
from labrun_plugins.simulated.bench import Bench, BenchSettings, model_beside, require_finite

HARDENING_SHARE = 1.0 / 20.0
"""Slope beyond the yield stress, as a share of Young's modulus (chosen)."""
YOUNG_PA, YIELD_PA = 4383.27e6, 42.84e6
"""Means of the source's eleven specimens (section 3.1)."""
THICKNESS_M, WIDTH_M, GRIPS_M = 0.127e-3, 15e-3, 0.1
"""Of the sheet; the source gives no width and no distance of the grips: chosen."""
_SCALE = Scale(coordinate=1e-3, rate=2e-4, acceleration=1e-3, force=20.0, signal=80.0, time_s=5.0)
_GRIP_SCALE = Scale(signal=2e-3, time_s=5.0)
_BETWEEN_SPECIMENS = (0.02, 0.03, 0.05)
"""Relative scatter of Young's modulus, yield stress and load at fracture from specimen to specimen (chosen)."""
_MOST_SLACK = 0.005
"""A strip is mounted up to this strain too long, evenly spread (chosen)."""
_NOMINAL_SLACK = 0.0025
_AT_ZERO_M = 1e-5
"""Here a person clamps the strip."""


@dataclass(frozen=True, slots=True)
class Layup:
    """What is pulled: its slope beyond the yield stress, as a share of Young's modulus, and where 15 mm break, N."""

    hardening: float
    breaks_n: float


LAYUPS: Mapping[str, Layup] = {
    "polyester": Layup(HARDENING_SHARE, 120.0),
    "sandwich": Layup(1.6 * HARDENING_SHARE, 145.0),
}
"""The plain sheet, and fabric - polyester - fabric. That they begin with the same slope and the sandwich bears more the
source says (section 2.1); by how much, it shows in a picture: chosen."""


class TensileBenchSettings(BenchSettings):
    """The strip and its grips.

    Attributes
    ----------
    layup
        "polyester" or "sandwich"; a condition ``layup`` changes it.
    thickness_mm, width_mm, grips_mm
        Of the sheet, and from grip to grip.
    scatter
        Factor on the scatter between specimens, and of the slack they are mounted with.
    """

    layup: str = "polyester"
    thickness_mm: PositiveFloat = 1e3 * THICKNESS_M
    width_mm: PositiveFloat = 1e3 * WIDTH_M
    grips_mm: PositiveFloat = 1e3 * GRIPS_M
    scatter: NonNegativeFloat = 1.0


class TensileBench(Bench):
    """Force on a strip over the displacement of its grip.

    Stress is ``E w ln(1 + exp((e - slack) / w))`` to the yield stress, with a toe of width w, and rises with a
    twentieth of E from there; a strip unloads straight, and is longer for good. It breaks at a force, and bears none
    then. E and yield stress are the source's means (section 3.1); everything else is chosen, see ``bench.toml``.
    A condition ``specimen`` names another strip of the same sheet; mounting it anew gives another slack. A person
    clamps a strip when the grip stands still at zero. With `as_modelled` specimens do not scatter, slack is 0.25 %, and
    nothing breaks.

    The joint ``pusher`` is driven in metres. Signals: ``force`` (N) and ``position`` of the grip (m).
    """

    Settings: ClassVar[type[BenchSettings]] = TensileBenchSettings
    step_s = 0.005
    scale = _SCALE
    joints = ("pusher",)
    sensed = ("force",)
    remembered = (
        "batch", "layup", "specimen", "mounting", "farthest", "whole", "clamped",
        "told_before", "inputs_before", "grip", "cell", "stepper",
    )  # fmt: skip
    signals: Mapping[str, str] = {"force": "N", "position": "m"}

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._grip, self._cell = self._passage(self.joints, _GRIP_SCALE), self._passage(self.sensed)
        self._batch = int(rng.integers(2**63))
        self._told_before, self._inputs_before = np.zeros(1), np.array([[0.0, 0.0, 0.0, 1.0]])
        self._put(self._settings.layup, "", 1)

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Mount the strip that the condition names by ``layup`` and ``specimen``; one that is in place stays."""
        layup = str(condition.get("layup", self._layup))
        specimen = condition.get("specimen", self._specimen)
        if (layup, specimen) != (self._layup, self._specimen):
            self._put(layup, specimen, 1)

    def mount(self, number: int) -> None:
        """Mount the strip anew: it is as slack as it comes, and whole."""
        self._put(self._layup, self._specimen, number)

    def tow(self, from_m: float, to_m: float, speed_m_s: float, start_s: float) -> None:
        """Move the grip at constant speed from `start_s` on; a slow stage starts and stops within a step."""
        self._push("pusher", from_m, to_m, speed_m_s, start_s)

    def truth(self) -> dict[str, Any]:
        """Return the strip, its parameters and slack as they are on the bench, and hidden effects."""
        return self._truth(
            (*self._hidden, *self._grip.effects, *self._cell.effects),
            layup=self._layup, specimen=self._specimen, slack=self._slack, broken=not self._whole,
        )  # fmt: skip

    def _put(self, layup: str, specimen: float | str, mounting: int) -> None:
        if layup not in LAYUPS:
            raise SpecError(f"this bench has no layup {layup!r}", hint=f"it has {', '.join(LAYUPS)}")
        keys = self._settings
        spread = 0.0 if keys.as_modelled else keys.scatter * keys.noise
        words = [*f"{layup}/{specimen}".encode()]
        of_strip = np.random.default_rng((self._batch, *words))
        of_mounting = np.random.default_rng((self._batch, mounting, *words))
        young, yields, breaks = 1.0 + spread * np.array(_BETWEEN_SPECIMENS) * of_strip.standard_normal(3)
        cross_section = keys.thickness_mm * keys.width_mm / (1e6 * THICKNESS_M * WIDTH_M)
        self._breaks_n = np.inf if keys.as_modelled else breaks * cross_section * LAYUPS[layup].breaks_n
        self._layup, self._specimen, self._mounting = layup, specimen, mounting
        self._slack = _NOMINAL_SLACK + min(spread, 1.0) * (
            of_mounting.uniform(0.0, _MOST_SLACK) - _NOMINAL_SLACK
        )
        model = model_beside(__file__, "bench.toml").with_values(
            {
                "young": young * YOUNG_PA,
                "yield_stress": yields * YIELD_PA,
                "hardening": LAYUPS[layup].hardening,
                "area": 1e-6 * keys.thickness_mm * keys.width_mm,
                "grips": 1e-3 * keys.grips_mm,
            }
        )
        self._model = self._with_errors(model)
        self._hidden = self._inside()
        self._stepper = Stepper(self._model, effects=self._hidden, step_s=self.step_s)
        self._stepper.state = (float(self._inputs_before[0, 0]),) * 2
        self._farthest, self._whole, self._clamped = np.full(1, -np.inf), True, False

    def _advance(self, time_s: FloatArray) -> FloatArray:
        angles = self._drives["pusher"].angles(time_s)
        moved = self._grip(angles)
        first = 0 if self._clamped else self._clamps_at(angles)
        if not self._clamped and first < len(angles):
            self._clamped = True
            self._stepper = Stepper(self._model, effects=self._hidden, step_s=self.step_s)
            self._stepper.state = (float(moved[first]),) * 2
            self._inputs_before = np.array([[moved[first], self._slack, moved[first], 1.0]])
        force = np.zeros(len(moved))
        if first < len(moved):
            farthest = np.maximum.accumulate(np.append(self._farthest, moved[first:]))
            force[first:] = self._pulled(moved[first:], farthest[1:])
            self._farthest = farthest[-1:]
        breaks = np.flatnonzero(force >= self._breaks_n)
        if self._whole and len(breaks):
            self._whole = False
            force[breaks[0] :] = 0.0
        felt = self._cell(force)
        self._told_before = angles[-1:].copy()
        require_finite(self._stepper, "tensile bench")
        return np.column_stack([felt, moved])

    def _clamps_at(self, goals_m: FloatArray) -> int:
        """Return the first moment at which the stage stands still at zero; the number of moments if it never does."""
        still = np.diff(goals_m, prepend=self._told_before) == 0.0
        at_zero = np.flatnonzero(still & (np.abs(goals_m) <= _AT_ZERO_M))
        return int(at_zero[0]) if len(at_zero) else len(goals_m)

    def _pulled(self, moved: FloatArray, farthest: FloatArray) -> FloatArray:
        """Return the force of a clamped strip while the grip moves."""
        slack, whole = np.full(len(moved), self._slack), np.full(len(moved), float(self._whole))
        inputs = np.column_stack([moved, slack, np.maximum(farthest, moved), whole])
        force = self._stepper.advance(np.concatenate([self._inputs_before, inputs]))[:, 0]
        self._inputs_before = inputs[-1:].copy()
        return np.array(force)

    def _recall(self, memory: Mapping[str, Any]) -> None:
        self._batch = memory["batch"]
        self._put(memory["layup"], memory["specimen"], memory["mounting"])
        super()._recall(memory)
