"""Driver of a UR5 or UR5e: carriage along a straight line, and sensor of its position with the controller's time."""

import math
from typing import ClassVar

import numpy as np

from labrun.devices import (
    DeviceContext,
    DeviceError,
    DeviceSettings,
    Health,
    Identity,
    Remark,
    SampleBuffer,
    Samples,
    streaming,
)
from labrun.devices.clock import RealClock
from labrun_plugins.ur5.link import Link, Tracking, stop_from_scratch
from labrun_plugins.ur5.motion import (
    STOP,
    Line,
    Move,
    check_order,
    check_place,
    check_speed,
    failure_of,
    move_program,
)
from labrun_plugins.ur5.rtde import RtdeClient
from labrun_plugins.ur5.settings import ACCELERATION_M_S2, REACH_M, Ur5Settings, channels_of
from labrun_plugins.ur5.state import ROBOT_MODES, RUNNING, SAFETY_MODES, ArmState, trouble_of

_RATE_SHARE = 0.02
_LOST_SHARE = 1e-3
_FREE_FORCE_N = 15.0
"""More than this at rest, hanging free, comes of a payload that is not the one set; the estimate is good to a few N."""
_REACH_M = 0.85


def remarks(
    settings: Ur5Settings,
    state: ArmState,
    tracking: Tracking,
    rtde: RtdeClient,
    remote: bool | None,
    travel_m: tuple[float, float],
) -> list[Remark]:
    """Return one remark for each thing looked at."""
    checks = [_mode(state), _rate(tracking, rtde), _losses(tracking), _remote(remote), _slider(state)]
    if rtde.protocol == 1:
        checks.append(Remark("warning", "RTDE", "speaks version 1 only", "update PolyScope"))
    if rtde.missing:
        checks.append(
            Remark("warning", "RTDE", f"the controller has no {', '.join(rtde.missing)}", "update PolyScope")
        )
    checks.append(_payload(state))
    checks += _line(settings, tracking.line, travel_m)
    return checks


def _mode(state: ArmState) -> Remark:
    trouble = trouble_of(state)
    if trouble is None:
        return Remark(
            "ok", "state", "running, safety normal" if state.safety_mode == 1 else "running, reduced"
        )
    return Remark("problem", "state", trouble.message, trouble.hint)


def _rate(tracking: Tracking, rtde: RtdeClient) -> Remark:
    reached = tracking.rate_hz()
    text = f"{reached:.1f} of {rtde.rate_hz:g} packages/s (controller {rtde.version_text})"
    good = math.isfinite(reached) and abs(reached - rtde.rate_hz) <= _RATE_SHARE * rtde.rate_hz
    advice = "close other RTDE clients, use a cable of its own, or ask for a lower rate_hz"
    return Remark.judged(good, "RTDE rate", text, advice)


def _losses(tracking: Tracking) -> Remark:
    made = tracking.received + tracking.lost
    text = f"{tracking.lost} of {made} packages lost, {tracking.stale} repeated"
    advice = "the controller skips packages when it is busy: end URCaps and other clients"
    return Remark.judged(tracking.lost <= max(1.0, _LOST_SHARE * made), "RTDE packages", text, advice)


def _remote(remote: bool | None) -> Remark:
    if remote is None:
        return Remark(
            "ok", "remote control", "not reported by this controller (a CB3 always accepts programs)"
        )
    text, advice = (
        "on" if remote else "off: the arm takes no programs",
        "switch to Remote Control on the pendant",
    )
    return Remark.judged(remote, "remote control", text, advice, "problem")


def _slider(state: ArmState) -> Remark:
    text = f"{100 * state.slider:.0f} %, speed scaling {100 * state.speed_scaling:.0f} %"
    advice = "set it to 100 %: moves are slower than the file says"
    return Remark.judged(state.slider >= 1.0, "speed slider", text, advice, "problem")


def _payload(state: ArmState) -> Remark:
    if state.force is None:
        return Remark("ok", "payload", "not checked: this controller does not tell its tool force")
    force_n = float(np.linalg.norm(state.force[:3]))
    if force_n <= _FREE_FORCE_N:
        return Remark("ok", "payload", f"the arm feels {force_n:.1f} N at its tool")
    return Remark(
        "warning",
        "payload",
        f"the arm feels {force_n:.1f} N at its tool at rest",
        "if it hangs free, set mass and centre of the payload on the pendant (Installation): a wrong one makes "
        "protective stops likely",
    )


def _line(settings: Ur5Settings, line: Line | None, travel_m: tuple[float, float]) -> list[Remark]:
    if line is None:
        return [Remark("warning", "line", "not known while the arm is not running")]
    lines = []
    origin, turn = (
        ", ".join(f"{round(value, 4) + 0.0:.4f}" for value in v)
        for v in (line.origin_m, line.orientation_rad)
    )
    if settings.origin_m is None or settings.orientation_rad is None:
        lines.append(
            Remark(
                "warning",
                "line",
                "position zero is wherever the tool stands when labrun connects: a run that is taken up again would "
                "begin elsewhere",
                f"jog the tool to the start and write down: origin_m = [{origin}], orientation_rad = [{turn}]",
            )
        )
    else:
        lines.append(Remark("ok", "line", f"from [{origin}] m"))
    for end_m in travel_m:
        reach_m = float(np.linalg.norm(line.pose(end_m)[:3]))
        if reach_m > _REACH_M:
            lines.append(
                Remark(
                    "warning",
                    "line",
                    f"its point at {end_m:g} m is {reach_m:.3f} m from the arm's base; a UR5 reaches {_REACH_M:g} m",
                    "shorten limits.travel_m, or move origin_m",
                )
            )
    return lines


_LOOK_S = 1.0


class Ur5:
    """Carriage, and sensor of its position.

    Motion is one ``movel`` per `travel`, sent as a short program to the script port; the state comes by RTDE, in a
    thread that never stops reading. The controller itself ends a move when this process falls silent.
    """

    Settings: ClassVar[type[DeviceSettings]] = Ur5Settings

    def __init__(self, name: str, settings: Ur5Settings, context: DeviceContext) -> None:
        self.name = name
        self.channels = channels_of(settings)
        self.rate_hz = settings.rate_hz or 125.0
        self.travel_m = settings.limits.travel_m or REACH_M
        self._settings = settings
        self._clock = context.clock
        self._buffer = SampleBuffer(len(self.channels))
        self._link = Link(name, settings, context.clock, self._buffer)

    def open(self) -> None:
        """Connect to all services and wait for the first state; the line is taken from it where the file has none.

        Raises DeviceError: a service that does not answer, an old controller, or a register that is taken.
        """
        self._link.open()
        self.rate_hz = self._link.rtde.rate_hz
        self._line(self._link.state())

    def identify(self) -> Identity:
        """Ask the dashboard what it is; the line and the stream's rate are among the details."""
        self._link.state()
        details = {
            "controller": self._link.rtde.version_text,
            "rtde_protocol": str(self._link.rtde.protocol),
            "rate_hz": f"{self.rate_hz:g}",
            "watchdog": f"{self._link.rtde.register}, {self._settings.watchdog_ms:g} ms",
        }
        line = self._link.tracking.line
        if line is not None:
            for key, vector in (
                ("origin_m", line.origin_m),
                ("direction", line.direction),
                ("orientation_rad", line.orientation_rad),
            ):
                details[key] = ", ".join(f"{value:.6f}" for value in vector)
        return Identity(
            model=f"Universal Robots {self._link.dashboard.ask('get robot model')}",
            serial=self._link.dashboard.ask("get serial number"),
            firmware=self._link.dashboard.ask("PolyscopeVersion"),
            details=details,
        )

    def health(self) -> Health:
        """Tell how the arm is.

        Raises DeviceError: it cannot move, its last move failed, it does not answer, or it is under local control.
        """
        self._sound_state()
        try:
            self._check_remote()
        except DeviceError:
            self._link.state()  # an arm that has fallen silent altogether says so rather than that one service did
            raise
        state = self._sound_state()
        notes = [
            f"robot {ROBOT_MODES.get(state.robot_mode, state.robot_mode)}",
            f"safety {SAFETY_MODES.get(state.safety_mode, state.safety_mode)}",
        ]
        if state.slider < 1.0:
            notes.append(f"speed slider at {100 * state.slider:.0f} %")
        tracking = self._link.tracking
        if tracking.lost or tracking.stale:
            notes.append(f"{tracking.lost} packages lost, {tracking.stale} dropped as repeated since opening")
        if self._link.rtde.texts:
            notes.append(f"says {self._link.rtde.texts[-1].message!r}")
        move = tracking.move
        if move is not None and move.samples:
            share = f"{100 * move.constant / move.samples:.0f} % of its samples at constant speed"
            scaled = "" if move.scaling == 1.0 else f", speed scaled to {100 * move.scaling:.0f} %"
            notes.append(f"move to {move.to_m:.4g} m at {move.speed_m_s:g} m/s {move.phase}: {share}{scaled}")
        return Health(notes=tuple(notes))

    def position_m(self) -> float:
        """Return where the tool is along the line; DeviceError as `health`, without its questions."""
        state = self._sound_state()
        return float(self._line(state).position_m(state.pose))

    def travel(self, to_m: float, speed_m_s: float, acceleration_m_s2: float = ACCELERATION_M_S2) -> None:
        """Start a straight move at constant speed; returns once the program is sent.

        Raises
        ------
        LimitExceededError
            Beyond travel or speed: nothing is sent.
        DeviceError
            The arm cannot move now, stands beside the line, is under local control, or its speed slider is not at
            100 %: nothing is sent.
        """
        stops = self._link.stops
        check_order(self.name, self._settings, self.travel_m, to_m, speed_m_s)
        state = self._ready_state()
        line = self._line(state)
        check_place(self.name, self._settings, line, state)
        check_speed(self.name, self._settings, state)
        self._check_remote()
        program = move_program(
            line.pose(to_m),
            speed_m_s=speed_m_s,
            acceleration_m_s2=acceleration_m_s2,
            register=self._link.rtde.register,
            watchdog_s=self._settings.watchdog_ms / 1000.0,
        )
        here_m = float(line.position_m(state.pose))
        self._link.tracking.move = Move(here_m, to_m, speed_m_s, self._clock.now())
        try:
            sent = self._link.send(program, lambda: self._link.stops == stops)
        except BaseException:
            self._link.tracking.move = None
            raise
        if not sent or self._link.stops != stops:
            self._link.stop()  # a stop came in between: it has the last word

    def start(self) -> None:
        """Begin to stream; samples from before are dropped."""
        self._line(self._sound_state())
        self._buffer.clear()
        self._link.tracking.streaming = True

    def read(self) -> Samples:
        """Return the samples since the last call.

        Raises DeviceError: not streaming, the arm cannot move, its move failed, or it has fallen silent.
        """
        streaming(self.name, self._link.tracking.streaming)
        self._sound_state()
        return self._buffer.take()

    def stop(self) -> None:
        """End the stream of samples; the arm is still heard."""
        self._link.tracking.streaming = False

    def safe_stop(self) -> None:
        """Stop the tool where it is: a braking program, the dashboard's stop, and no more signs of life."""
        self._link.stop()

    @classmethod
    def emergency_stop(cls, name: str, settings: Ur5Settings) -> None:
        """Connect from scratch and stop; the runner is dead.

        Raises DeviceError: neither the script port nor the dashboard could be reached.
        """
        if not stop_from_scratch(name, settings, RealClock(), _LOOK_S):
            raise DeviceError(
                name,
                f"could not be stopped ({STOP.strip()}, dashboard stop)",
                hint="press the emergency stop",
            )

    def examine(self) -> list[Remark]:
        """Look for a second at what spoils measurements: rate, losses, remote control, slider, payload, line."""
        self._link.state()
        self._clock.sleep(_LOOK_S)
        return remarks(
            self._settings,
            self._link.state(),
            self._link.tracking,
            self._link.rtde,
            self._link.dashboard.remote_control(),
            self.travel_m,
        )

    def close(self) -> None:
        """Disconnect; harmless when not connected. A move under way ends, since nobody refreshes its watchdog."""
        self._link.close()

    def _ready_state(self) -> ArmState:
        """Return the latest state; DeviceError if the arm cannot move."""
        state = self._link.state()
        trouble = trouble_of(state)
        if trouble is not None:
            raise DeviceError(self.name, trouble.message, hint=trouble.hint)
        return state

    def _sound_state(self) -> ArmState:
        """Return the latest state; DeviceError if the arm cannot move, or its move has failed."""
        state = self._ready_state()
        failure = failure_of(self.name, self._settings, self._link.tracking.move, self._link.complaint())
        if failure is not None:
            raise failure
        return state

    def _line(self, state: ArmState) -> Line:
        """Return the line; taken from the pose the first time the arm is heard running."""
        line = self._link.tracking.line
        if line is None:
            settings = self._settings
            line = Line.through(state.pose, settings.direction, settings.origin_m, settings.orientation_rad)
            if state.robot_mode == RUNNING and all(math.isfinite(value) for value in state.pose):
                self._link.tracking.line = line
        return line

    def _check_remote(self) -> None:
        if self._link.dashboard.remote_control() is False:
            raise DeviceError(
                self.name,
                "is under local control: it takes no programs from outside",
                hint="switch to Remote Control (icon at the top right of the pendant), then labrun resume",
            )
