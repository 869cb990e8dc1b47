"""The driver of a stepper stage with a load cell: carriage, sensor, and actuator of the joint that it bends."""

import datetime
import threading
from collections.abc import Mapping
from typing import Any, ClassVar

from labrun.devices import (
    Channel,
    Clock,
    DeviceContext,
    DeviceError,
    DeviceSettings,
    Health,
    Identity,
    Pacing,
    Remark,
    Samples,
    Trajectory,
    opened,
    streaming,
)
from labrun_plugins.labline.handshake import probe, stop_from_scratch
from labrun_plugins.labline.session import Hello, LineSession
from labrun_plugins.linear_stage.motion import StageMotion
from labrun_plugins.linear_stage.reception import (
    Flags,
    Reception,
    StageState,
    complaints,
    is_saturated,
    limit_arguments,
    parse_state,
)
from labrun_plugins.linear_stage.settings import LinearStageSettings

_LISTEN_S = 1.0
_RATE_SLACK = 0.15
"""The HX711's own oscillator is good to some ten per cent."""
_OLD_DAYS = 365
_POOR_RESIDUAL = 0.01


def examine(
    stage: "LinearStage",
    hello: Hello,
    state: StageState,
    settings: LinearStageSettings,
    session: LineSession,
    clock: Clock,
) -> list[Remark]:
    """Return what was found; moves nothing, streams for a second."""
    remarks = [
        Remark("ok", "firmware", f"{hello.kind} {hello.firmware}, up to {hello.max_rate_hz:g} samples/s"),
        _watchdog(settings),
        *_state(state, settings),
        _calibration(settings),
    ]
    remarks += _stream(stage, settings, clock)
    if session.counts.rejected:
        remarks.append(
            Remark(
                "warning",
                "line",
                f"{session.counts.rejected} damaged lines of {session.counts.accepted}",
                "shorten the USB cable, and keep it away from the motor's wires",
            )
        )
    return remarks


def _watchdog(settings: LinearStageSettings) -> Remark:
    message = f"stops by itself after {settings.watchdog_ms} ms of silence"
    advice = "watchdog_ms = 100 keeps a stage whose runner died from pushing on"
    return Remark.judged(settings.watchdog_ms <= 100, "watchdog", message, advice)


def _state(state: StageState, settings: LinearStageSettings) -> list[Remark]:
    notes = complaints(state.flags, homes=settings.home_on_open)
    if not notes and Flags.HOMED in state.flags:
        return [Remark("ok", "state", f"homed, at {state.position_mm:.3f} mm, {state.counts} counts")]
    if not notes:
        homing = "not homed yet: a run begins by seeking the lower end switch, and nothing may be in its way"
        return [Remark("ok", "state", f"{homing}; {state.counts} counts")]
    return [Remark("problem", "state", note, "see the README of the plugin linear-stage") for note in notes]


def _calibration(settings: LinearStageSettings) -> Remark:
    calibration = settings.calibration
    if calibration is None:
        return Remark(
            "warning", "calibration", "none: there are counts, and no forces",
            "hang five masses or more on the cell, and put masses_kg and counts into its table",
        )  # fmt: skip
    line = calibration.line
    of_range = settings.limits.force_n or abs(line.slope_n_per_count) * 2.0**22
    law = f"{line.slope_n_per_count:.4g} N/count, {line.offset_counts:.0f} counts without load"
    if line.residual_n is not None and line.residual_n > _POOR_RESIDUAL * of_range:
        return Remark(
            "warning", "calibration", f"{law}; its points scatter by {line.residual_n:.2g} N",
            "calibrate again: the cell creeps, slips or was loaded off its axis",
        )  # fmt: skip
    if calibration.date is None:
        return Remark("warning", "calibration", f"{law}; without a date", "write the date into its table")
    age = (datetime.datetime.now(datetime.UTC).date() - calibration.date).days
    if age > _OLD_DAYS:
        return Remark("warning", "calibration", f"{law}; {age} days old", "calibrate again")
    return Remark("ok", "calibration", f"{law}; of {calibration.date}")


def _stream(stage: "LinearStage", settings: LinearStageSettings, clock: Clock) -> list[Remark]:
    stage.start()
    try:
        clock.sleep(_LISTEN_S)
        samples = stage.read()
    finally:
        stage.stop()
    if len(samples) < 3:
        return [
            Remark(
                "problem",
                "load cell",
                f"{len(samples)} samples in {_LISTEN_S:g} s",
                "check supply, DOUT and SCK of the HX711",
            )
        ]
    device_s = samples.device_time_s
    rate_hz = (len(samples) + samples.lost - 1) / float(device_s[-1] - device_s[0])
    counts = samples.values[:, -1]
    message = (
        f"{rate_hz:.1f} samples/s by its own clock, {samples.lost} lost, "
        f"counts {counts.mean():.0f} with a spread of {counts.std():.0f}"
    )
    if any(is_saturated(int(count)) for count in counts):
        return [
            Remark("problem", "load cell", message, "it is at the end of its range: check its four wires")
        ]
    if abs(rate_hz - settings.rate_hz) > _RATE_SLACK * settings.rate_hz:
        advice = "set rate_hz as the RATE pin of the HX711 says: low 10, high 80"
        return [Remark("warning", "load cell", message, advice)]
    return [Remark("ok", "load cell", message)]


KIND = "labstage"
_FRESH_S = 0.1
"""A sample this young tells where the stage is; otherwise it is asked."""
_RATE = "{:g}"


class LinearStage:
    """A stage that speaks labline (kind ``labstage``), see the README of this folder.

    Position and force come latched together from the board, with its number and its microseconds. Positions are
    displacements from `zero_mm`, m; raw counts are a channel of their own.
    """

    Settings: ClassVar[type[DeviceSettings]] = LinearStageSettings
    zero_known: ClassVar[bool] = True
    """A calibration states the counts at zero force."""

    def __init__(self, name: str, settings: LinearStageSettings, context: DeviceContext) -> None:
        self.name = name
        self._settings = settings
        self._clock = context.clock
        self._line = settings.calibration.line if settings.calibration is not None else None
        force = () if self._line is None else (Channel("force", "N"),)
        self.channels = (Channel("displacement", "m"), *force, Channel("counts", "1"))
        self.rate_hz = settings.rate_hz
        self.travel_m = settings.travel_m
        self.joints = tuple(settings.levers_m)
        self._hello: Hello | None = None
        self._streaming = False
        self._alarmed = False
        self._received = Reception(name, self._line, settings.zero_mm, settings.limits.force_n, self._alarm)
        self._session = LineSession(
            name, settings.port, context.clock,
            boot_wait_s=settings.boot_wait_s, on_sample=self._received.sample, on_event=self._received.event,
        )  # fmt: skip
        self._motion = StageMotion(name, settings, context.clock, self._session, self._state)

    @classmethod
    def probe(cls, port: str) -> Identity | None:
        """Return what the board at a port is, if it is a stage; None otherwise. Moves nothing."""
        return probe(port, KIND)

    def open(self) -> None:
        """Connect, arm the watchdog, hand over the limits, and home the stage if the file asks for it.

        Raises DeviceError: no port, no answer, a board of another kind, or a stage that does not find its end switch.
        """
        self._open(home=self._settings.home_on_open)

    def open_at_rest(self) -> None:
        """Open it without homing it, for `labrun doctor`: who asks how a stage is does not expect it to move.

        Raises DeviceError: as `open`.
        """
        self._open(home=False)

    def _open(self, *, home: bool) -> None:
        settings = self._settings
        self._streaming = self._alarmed = False
        self._received.start()
        # What a limit did before is no news; `home` looks at the state itself.
        self._received.mind_limits(False)
        self._motion.reset()
        self._hello = self._session.open(KIND)
        try:
            self._session.request("STR", 0)
            low, high = (settings.zero_mm + 1e3 * end for end in self.travel_m)
            self._session.request("LIM", *limit_arguments(low, high, settings.most_counts))
            self._motion.start()
            self._session.arm(settings.watchdog_ms)
            state = self._state()
            if home and (Flags.HOMED not in state.flags or Flags.FORCE_LIMIT in state.flags):
                self._motion.home(state)
        except BaseException:
            self.safe_stop()
            self.close()
            raise
        self._received.mind_limits(True)

    def home(self) -> None:
        """Seek the lower end switch, then go to zero; returns when it is there.

        Raises DeviceError: it did not arrive in time, or a limit stopped it.
        """
        self._check()
        self._received.mind_limits(False)
        try:
            self._motion.home(self._state())
        finally:
            self._received.mind_limits(True)

    def identify(self) -> Identity:
        """Say what answered, with calibration, units, rates and limits."""
        hello = self._require_open()
        settings = self._settings
        details = {
            "channels": str(hello.channels),
            "max_rate_hz": _RATE.format(hello.max_rate_hz),
            "rate_hz": _RATE.format(self.rate_hz),
            "zero_mm": f"{settings.zero_mm:g}",
            "travel_m": f"{self.travel_m[0]:g} ... {self.travel_m[1]:g}",
            "watchdog_ms": str(settings.watchdog_ms),
            "force_limit_counts": str(settings.most_counts),
            "units": "displacement m, " + ("" if self._line is None else "force N, ") + "counts 1",
        }
        if self._line is not None and settings.calibration is not None:
            details["slope_n_per_count"] = repr(self._line.slope_n_per_count)
            details["offset_counts"] = repr(self._line.offset_counts)
            residual_n = self._line.residual_n
            details["residual_n"] = "not told" if residual_n is None else f"{residual_n:.3g}"
            details["calibrated"] = str(settings.calibration.date or "not told")
        for joint, lever_m in settings.levers_m.items():
            details[f"lever of {joint}, m"] = f"{lever_m:g}"
        return Identity(
            "stepper stage with load cell (HX711)", firmware=f"{hello.kind} {hello.firmware}", details=details
        )

    def health(self) -> Health:
        """Report what the board says about itself.

        Raises DeviceError: it does not answer, it restarted, its watchdog expired, or a limit stopped it.
        """
        self._check()
        notes = complaints(self._state().flags, homes=self._settings.home_on_open)
        return Health(ok=not notes, notes=notes)

    def examine(self) -> list[Remark]:
        """Look at its set-up for `labrun doctor --hardware`; moves nothing."""
        hello = self._require_open()
        return examine(self, hello, self._state(), self._settings, self._session, self._clock)

    def position_m(self) -> float:
        """Where the pusher is, m from zero: by its latest sample, or by asking."""
        self._check()
        latest = self._received.latest
        if latest is not None and self._clock.now() - latest[1] < _FRESH_S:
            position_mm = latest[0].position_mm
        else:
            position_mm = self._state().position_mm
        return 1e-3 * (position_mm - self._settings.zero_mm)

    def pose(self) -> Mapping[str, float]:
        """Return the equivalent angle, rad: displacement over lever."""
        position_m = self.position_m()
        return {joint: position_m / lever_m for joint, lever_m in self._settings.levers_m.items()}

    def travel(self, to_m: float, speed_m_s: float) -> None:
        """Start a straight move at constant speed; returns at once.

        Raises
        ------
        LimitExceededError
            Beyond travel or speed: the move is not sent.
        DeviceError
            A speed that is not above zero, a stage that is not homed, or no answer.
        """
        token = self._session.motion_token()
        self._check()
        self._motion.travel(to_m, speed_m_s, token)

    def follow(self, trajectory: Trajectory, start_s: float) -> None:
        """Start following the joint's angle at the clock's `start_s`; returns at once, then holds the last point.

        Raises
        ------
        LimitExceededError
            The motion leaves a limit, as an angle or as a displacement: nothing of it is sent.
        DeviceError
            Another joint, a stage that is not homed, or no answer.
        """
        token = self._session.motion_token()
        self._check()
        self._motion.follow(trajectory, start_s, token)

    def restart_pacing(self) -> None:
        """Forget how evenly set-points have gone out so far."""
        self._motion.restart_timing()

    def pacing(self) -> Pacing:
        """Return how evenly set-points have gone out since `restart_pacing`, or since it was opened."""
        return self._motion.timing

    def start(self) -> None:
        """Begin to stream; samples from before are dropped. Raises DeviceError: not open, or no answer."""
        self._check()
        self._received.start()
        self._session.request("STR", _RATE.format(self.rate_hz))
        self._streaming = True

    def read(self) -> Samples:
        """Return all samples since the last call; does not wait.

        Raises DeviceError: not streaming, the load cell's amplifier gives nothing, or what the listening thread met.
        """
        self._check()
        streaming(self.name, self._streaming)
        return self._received.take()

    def stop(self) -> None:
        """End the stream."""
        if self._streaming:
            self._streaming = False
            self._session.request("STR", 0)

    def safe_stop(self) -> None:
        """Stop all motion, and send no more of it. Any thread, any moment, any number of times; never raises."""
        self._motion.halt()
        if self._session.is_open:
            self._session.stop()

    def close(self) -> None:
        """Disconnect; harmless when not connected. A board in motion is stopped by its watchdog."""
        self._motion.end()
        if self._session.is_open:
            try:
                self._session.request("STR", 0)
                self._session.arm(0)
            except DeviceError:  # gone, or in motion: its watchdog, which stays armed, ends that
                pass
        self._session.close()
        self._streaming = False
        self._hello = None

    @classmethod
    def emergency_stop(cls, name: str, settings: Any) -> None:
        """Connect from scratch and stop the stage: the runner is dead."""
        stop_from_scratch(name, settings.port)

    def _alarm(self, failure: DeviceError) -> None:
        """Stop at what a sample tells; from a thread of its own, since the stop waits for an answer."""
        self._session.fail(failure)
        if self._alarmed:  # the next samples tell it again
            return
        self._alarmed = True
        threading.Thread(target=self.safe_stop, daemon=True, name=f"stop {self.name}").start()

    def _require_open(self) -> Hello:
        return opened(self.name, self._hello)

    def _check(self) -> None:
        """Raise what any thread has met, and stop first."""
        self._require_open()
        self._session.check()
        self._motion.check()

    def _state(self) -> StageState:
        answer = self._session.request("ST")
        state = parse_state(answer)
        if state is None:
            raise DeviceError(
                self.name,
                f"reports an unknown state {','.join(answer)!r}",
                hint="flash the firmware that stands in the plugin's folder",
            )
        return state
