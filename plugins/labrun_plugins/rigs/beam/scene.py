"""A curved beam between a linear stage and a load cell (section 7.2 of the source work)."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat

from labrun.devices import FloatArray
from labrun.effects import Scale, load_effect
from labrun.errors import SpecError
from labrun.models import Stepper, kernel
from labrun_plugins.simulated.bench import (
    Bench,
    BenchSettings,
    described,
    model_beside,
    require_finite,
    unpacked,
)

Beam = Literal["long", "short", "polyester", "steel"]
"""Long (31.75 mm) and short (3.6 mm) of section 7.5.1, 25.4 mm wide and curved by 180 degrees; those of section 7.2."""

BUCKLED_SHARE = 0.05
"""Stiffness of the buckled beam, as a share of its stiffness before (chosen; the source's values are in a figure)."""
LIMITS_N_M: dict[Beam, tuple[float, float]] = {
    "long": (0.10, 0.76), "short": (0.65, 1.02), "polyester": (0.10, 0.76), "steel": (0.15, 0.90),
}  # fmt: skip
"""Torque at which each beam buckles in equal and in opposite sense. Of long and short the source measured it (section
7.5.1); polyester and steel tape it shows in a picture only (section 7.2): chosen."""
STIFFNESS_N_M: dict[Beam, float] = {"long": 2.0, "short": 3.0, "polyester": 2.0, "steel": 3.0}
"""Before buckling, N m/rad (chosen: the limits are then reached at 3 and 22 degrees, and at 12 and 19)."""
HYSTERESIS: dict[Beam, float] = {"long": 0.03, "short": 0.03, "polyester": 0.03, "steel": 0.12}
"""Half the width of the loop, as a share of the limit in equal sense (chosen: steel deforms plastically, and its loop
is the larger one in the source, section 7.2.1)."""
_SCALE = Scale(coordinate=0.2, rate=0.01, acceleration=0.05, force=0.2, signal=2.0, time_s=10.0)
_PUSHER_SCALE = Scale(signal=0.02, time_s=10.0)
_YIELD_RAD = 0.01
"""Half a millimetre of the pusher's way at 50 mm: how far a turn of the motion takes to show (chosen)."""
_BETWEEN_MOUNTINGS = (0.01, 0.02)
"""Relative scatter of stiffness and limits from mounting to mounting (chosen)."""


class BeamBenchSettings(BenchSettings):
    """The beam, and where the pusher touches it.

    Attributes
    ----------
    beam
        Which of them; a condition ``beam`` changes it.
    lever_mm
        From the beam's clamp to the pusher. The source bends over 50 mm of way and gives no lever; 100 mm keeps the
        long beam's opposite-sense limit out of reach of 25 mm (chosen).
    hysteresis
        Half the width of the loop between loading and unloading, as a share of the torque at which the beam buckles in
        equal sense (chosen; the source names pusher slip and friction, section 7.2.1). By default the beam's own.
    after_share
        What the beam carries after it has snapped in opposite sense, as a share of the limit it snapped at (chosen); 1
        for a beam that goes on as before.
    damaged_share
        What is left of both limits once a beam has snapped in opposite sense (chosen; that it is damaged for good, the
        source says in section 7.1). Another beam of the name is a new one.
    scatter
        Factor on the scatter between mountings.
    """

    beam: Beam = "long"
    lever_mm: PositiveFloat = 100.0
    hysteresis: float | None = Field(default=None, ge=0.0, le=1.0)
    after_share: float = Field(default=0.3, gt=0.0, le=1.0)
    damaged_share: float = Field(default=0.7, gt=0.0, le=1.0)
    scatter: NonNegativeFloat = 1.0


class BeamBench(Bench):
    """Force on a curved beam over the displacement of a pusher on a linear stage.

    The pusher holds the arm on the beam, so that it pushes and pulls. Its displacement is counted from where the beam
    is at rest; positive is the opposite sense, in which the beam is stiff. Physics and sources: see ``bench.toml``.
    Loading and unloading differ by a small loop. In opposite sense the beam snaps at its limit, carries less from there
    on, comes back on that path, and is damaged: its limits are lower ever after. With `as_modelled` there is no
    loop, no snap, no damage, and no scatter.

    The joint ``pusher`` is driven in metres: what a trajectory calls an angle is its displacement.

    Signals: ``force`` of the pusher on the beam (N), ``position`` of the pusher (m), and ``bend``, the equivalent angle
    of the beam (rad), displacement over lever: the source converts so, too (section 7.5.1).
    """

    Settings: ClassVar[type[BenchSettings]] = BeamBenchSettings
    step_s = 0.005
    scale = _SCALE
    joints = ("pusher",)
    sensed = ("force",)
    remembered = ("beam", "factors", "inputs_before", "snapped", "damaged", "pusher", "cell", "stepper")
    signals: Mapping[str, str] = {"force": "N", "position": "m", "bend": "rad"}

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        spread = 0.0 if self._settings.as_modelled else self._settings.scatter * self._settings.noise
        self._spread = spread * np.array(_BETWEEN_MOUNTINGS)
        self._pusher, self._cell = self._passage(self.joints, _PUSHER_SCALE), self._passage(self.sensed)
        self._snapped, self._damaged = False, False
        self._inputs_before = np.array([[0.0, 1.0, 1.0]])
        self._put(self._settings.beam, self._mounted())

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Mount the beam that the condition names; what is mounted already stays as it is."""
        wanted = condition.get("beam", self._beam)
        if wanted not in STIFFNESS_N_M:
            raise SpecError(f"this bench has no beam {wanted!r}", hint=f"it has {', '.join(STIFFNESS_N_M)}")
        if wanted != self._beam:
            state = self._stepper.state
            self._put(wanted, self._mounted())
            self._stepper.state = state

    def mount(self, number: int) -> None:  # noqa: ARG002  (every mounting is another specimen of the same beam)
        """Clamp a new specimen of the beam that is asked for."""
        state = self._stepper.state
        self._put(self._beam, self._mounted())
        self._stepper.state = state

    def tow(self, from_m: float, to_m: float, speed_m_s: float, start_s: float) -> None:
        """Move the pusher at constant speed from `start_s` on; a slow stage starts and stops within a step."""
        self._push("pusher", from_m, to_m, speed_m_s, start_s)

    def truth(self) -> dict[str, Any]:
        """Return the mounted beam, parameters as they are on the bench, and hidden effects."""
        hidden = (*self._hidden, *self._pusher.effects, *self._cell.effects)
        return self._truth(hidden, beam=self._beam, damaged=self._damaged, built_in=[described(self._loop)])

    def _mounted(self) -> FloatArray:
        """Return the factors on stiffness and limits that one mounting has."""
        factors: FloatArray = 1.0 + self._spread * self._rng.standard_normal(2)
        return factors

    def _put(self, beam: Beam, factors: FloatArray) -> None:
        self._beam, self._factors = beam, factors
        self._snapped, self._damaged = False, False
        stiffness, (equal, opposite) = factors[0] * STIFFNESS_N_M[beam], LIMITS_N_M[beam]
        model = model_beside(__file__, "bench.toml").with_values(
            {
                "stiffness": stiffness,
                "buckled_stiffness": BUCKLED_SHARE * stiffness,
                "equal_limit": factors[1] * equal,
                "opposite_limit": factors[1] * opposite,
                "lever": 1e-3 * self._settings.lever_mm,
            }
        )
        self._model = self._with_errors(model)
        share = HYSTERESIS[beam] if self._settings.hysteresis is None else self._settings.hysteresis
        share = 0.0 if self._settings.as_modelled else share
        limit = self._model.named_values["equal_limit"]
        self._loop = load_effect("hysteresis").attach(
            "beam", force=share * limit, yield_displacement=_YIELD_RAD
        )
        self._hidden = self._inside()
        self._stepper = Stepper(self._model, effects=[self._loop, *self._hidden], step_s=self.step_s)

    def _advance(self, time_s: FloatArray) -> FloatArray:
        angles = self._drives["pusher"].angles(time_s)
        moved = self._pusher(angles)
        inputs = np.concatenate([self._inputs_before, self._driven(moved)])
        force = self._stepper.advance(inputs)[:, 0]
        self._inputs_before = inputs[-1:].copy()
        felt = self._cell(force)
        require_finite(self._stepper, "beam bench")
        return np.column_stack([felt, moved, moved / (1e-3 * self._settings.lever_mm)])

    def _driven(self, moved: FloatArray) -> FloatArray:
        """Return the model's inputs while the pusher moves: its displacement, and what the beam has been through."""
        inputs = np.ones((len(moved), 3))
        inputs[:, 0] = moved
        if self._settings.as_modelled or self._settings.after_share == 1.0:
            return inputs
        stiffness, _, opposite, buckled = (float(value) for value in self._model.values[:4])
        after, left = self._settings.after_share, self._settings.damaged_share
        self._snapped, self._damaged = _history(
            moved / (1e-3 * self._settings.lever_mm),
            np.array([stiffness, opposite, buckled, after, left]),
            self._snapped,
            self._damaged,
            inputs,
        )
        return inputs

    def _recall(self, memory: Mapping[str, Any]) -> None:
        self._put(memory["beam"], unpacked(memory["factors"]))
        super()._recall(memory)


@kernel
def _history(
    angle: FloatArray, beam: FloatArray, snapped: bool, damaged: bool, inputs: FloatArray
) -> tuple[bool, bool]:
    """Write which share of the limits is left, and which of them a snapped beam carries, at every angle.

    A beam that snaps is damaged from when it has come back: on its way there and back it is on the path after the snap.
    """
    stiffness, new_limit, buckled, after, left = beam
    for i in range(len(angle)):
        limit = new_limit * (left if damaged else 1.0)
        if not snapped:
            snapped = stiffness * angle[i] > limit
        elif stiffness * angle[i] < after * limit + buckled * (angle[i] - limit / stiffness):
            snapped, damaged = False, True
            limit = new_limit * left
        inputs[i, 1] = limit / new_limit
        inputs[i, 2] = after if snapped else 1.0
    return snapped, damaged
