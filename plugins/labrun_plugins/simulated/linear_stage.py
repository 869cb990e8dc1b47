"""Stand-in for a stepper stage with a load cell on an HX711."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from labrun.devices import Channel, DeviceContext, DeviceError, DeviceSettings, FloatArray, Trajectory
from labrun.errors import LimitExceededError
from labrun_plugins.linear_stage.settings import FULL_SCALE_COUNTS, LEAST_COUNTS, Line, LinearStageSettings
from labrun_plugins.simulated.device import SimulatedCarriage, SimulatedSettings
from labrun_plugins.simulated.sensor import SimulatedSensor, Timing

_PLACES_M = 1e-8
"""Last digit of a position on the line: the board tells where between two steps it is."""
_HOMING_M_S = 0.005
_NOISE_COUNTS = {80.0: 60.0, 10.0: 20.0}
"""Noise (sd) at 80 and at 10 samples/s: 0.3 and 0.1 mN (chosen: some 17 free bits, as gain 128 allows)."""
_USUAL_CELL = Line(4.676e-6, 21_400.0)
"""1 kg, 1 mV/V, 5 V: 5 mV of the amplifier's 20 mV at 9.8 N. For a file without calibration."""


class SimulatedLinearStageSettings(LinearStageSettings, SimulatedSettings):
    """Keys of the stage, and of its bad days."""


class LoadCell:
    """A load cell with its amplifier, as its calibration describes it."""

    def __init__(self, settings: LinearStageSettings) -> None:
        self.line = settings.calibration.line if settings.calibration is not None else _USUAL_CELL
        self._noise = _NOISE_COUNTS[10.0 if settings.rate_hz <= 10.0 else 80.0]

    def counts(self, force_n: FloatArray, rng: np.random.Generator) -> NDArray[np.int64]:
        """Return what the amplifier makes of forces in N: whole counts, clipped at the ends of 24 bits."""
        read = self.line.counts(force_n) + self._noise * rng.standard_normal(np.shape(force_n))
        return np.clip(np.round(read), LEAST_COUNTS, FULL_SCALE_COUNTS).astype(np.int64)


class SimulatedLinearStage(SimulatedCarriage, SimulatedSensor):
    """Carriage; sensor of its own displacement, the force and the raw counts; and actuator of the joint it bends.

    A screw stage goes where its steps take it: it has no lag and no play. With `home_on_open` it goes to its end
    switch and to zero before anything else, and the beam remembers that; otherwise it stands at zero, and knows it.
    Samples are numbered, and stamped by the board, whose clock is 100 ppm off; one line in 10 000 is lost (both
    chosen). 4 ms is what a line takes at 115 200 baud.
    """

    Settings: ClassVar[type[DeviceSettings]] = SimulatedLinearStageSettings
    model = "stepper stage with load cell (simulated)"
    needs = ("force", "position")
    zero_known = True

    def __init__(self, name: str, settings: SimulatedLinearStageSettings, context: DeviceContext) -> None:
        timing = Timing(
            latency_s=0.004, jitter_s=0.001, lost_share=1e-4,
            clock_offset_s=float(context.rng.uniform(10, 1000)), clock_drift=1e-4,
        )  # fmt: skip
        calibrated = settings.calibration is not None
        force = (Channel("force", "N"),) if calibrated else ()
        super().__init__(
            name, settings, context,
            channels=(Channel("displacement", "m"), *force, Channel("counts", "1")),
            rate_hz=settings.rate_hz, timing=timing, full_scale=np.full(2 + calibrated, np.inf),
        )  # fmt: skip
        self._cell = LoadCell(settings)
        self._calibrated = calibrated
        self._levers_m = settings.levers_m
        self.joints = tuple(self._levers_m)
        self.travel_m = settings.travel_m
        self._homing_to_m = settings.whole_travel_m[0] if settings.home_on_open else None

    def open(self) -> None:
        """Connect. Raises DeviceError: this bench has no pusher."""
        super().open()
        if self._homing_to_m is not None:
            for to_m in (self._homing_to_m, 0.0):
                here_m = self._here_m(self.scene)
                self.scene.tow(here_m, to_m, _HOMING_M_S, self._clock.now())
                self._clock.sleep(abs(to_m - here_m) / _HOMING_M_S)

    def pose(self) -> Mapping[str, float]:
        """Return the equivalent angle, rad: displacement over lever."""
        position_m = self.position_m()
        return {joint: position_m / lever_m for joint, lever_m in self._levers_m.items()}

    def travel(self, to_m: float, speed_m_s: float) -> None:
        """Start a straight move at constant speed.

        Raises
        ------
        LimitExceededError
            Beyond travel or speed: the move is not sent.
        DeviceError
            A speed that is not positive, or no answer.
        """
        self._check_travel(to_m, speed_m_s)
        self._within(np.array([to_m]), "travel")
        self.scene.tow(self._here_m(self.scene), to_m, speed_m_s, self._clock.now())

    def follow(self, trajectory: Trajectory, start_s: float) -> None:
        """Start following the joint's angle at the clock's `start_s`, then hold the last point.

        Raises
        ------
        LimitExceededError
            The motion leaves a limit, as an angle or as a displacement: nothing of it is sent.
        DeviceError
            Another joint, or no answer.
        """
        self._require_answer()
        if trajectory.joints != self.joints:
            raise DeviceError(
                self.name,
                f"got a motion of {', '.join(trajectory.joints)}, but bends {', '.join(self.joints) or 'no joint'}",
            )
        self._limits.require_motion(self.name, trajectory)
        path_m = self._levers_m[self.joints[0]] * trajectory.angle_rad
        self._within(path_m, "the motion")
        speed_m_s = np.abs(np.diff(path_m[:, 0])) / np.diff(trajectory.time_s)
        for excess in self._limits.travel_excess(float(path_m[-1, 0]), float(np.max(speed_m_s, initial=0.0))):
            raise LimitExceededError(self.name, f"{excess}; nothing was sent", hint="slow the gait down")
        self.scene.drive("pusher", Trajectory(("pusher",), trajectory.time_s, path_m), start_s)

    def _within(self, path_m: FloatArray, what: str) -> None:
        low, high = self.travel_m
        least, most = float(path_m.min()), float(path_m.max())
        if least < low - 1e-9 or most > high + 1e-9:
            worst = most if most > high else least
            raise LimitExceededError(
                self.name, f"{what} to {worst:g} m leaves {low:g} ... {high:g} m; nothing was sent",
                hint="change the gait, or limits.travel_m and stroke_mm",
            )  # fmt: skip

    def _measure(self, time_s: FloatArray) -> FloatArray:
        position_m, force_n = self.scene.observe(("position", "force"), time_s).T
        counts = self._cell.counts(force_n, self._rng)
        columns = [_PLACES_M * np.round(position_m / _PLACES_M), counts]
        if self._calibrated:
            columns.insert(1, self._cell.line.force_n(counts))
        return np.column_stack(columns)

    def _with_faults(self, values: FloatArray) -> FloatArray:
        if self._faults.saturate:
            values[:, -1] = FULL_SCALE_COUNTS
            if self._calibrated:
                values[:, 1] = self._cell.line.force_n(values[:, -1])
        return super()._with_faults(values)

    def _clip(self, values: FloatArray) -> int:
        counts = values[:, -1]
        return int(np.sum((counts >= FULL_SCALE_COUNTS) | (counts <= LEAST_COUNTS)))
