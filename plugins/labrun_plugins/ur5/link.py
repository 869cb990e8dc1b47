"""All connections to one arm; the threads that hear it, follow the move under way and keep its watchdog quiet."""

import contextlib
import math
import threading
from collections.abc import Callable

import numpy as np

from labrun.devices import Clock, DeviceError, FloatArray, Listener, SampleBuffer, opened
from labrun_plugins.ur5.connection import REOPEN_HINT
from labrun_plugins.ur5.motion import Line, Move
from labrun_plugins.ur5.programs import Dashboard, Programs
from labrun_plugins.ur5.rtde import RtdeClient
from labrun_plugins.ur5.settings import Ur5Settings
from labrun_plugins.ur5.state import ArmState

_RESTART_S = 1.0
"""A time stamp further back than this is a controller that was restarted; nearer, a package that came late or twice."""
_LEAP_S = 10.0
"""A gap this long would have been noticed as silence; a time stamp beyond is nonsense."""


class Tracking:
    """What a thread makes of the stream of one connection.

    Parameters
    ----------
    buffer
        Gets the samples while `streaming`.
    tool_channels
        Whether samples hold more than the position.
    line
        Along which positions count; known from the start, or set later.

    Attributes
    ----------
    state
        The latest; None until the first package.
    move
        The move under way, or the last one.
    received, lost, stale
        Packages that came, that a step of the time stamp shows to be missing, and that were dropped because they came
        twice or too late.
    first
        The first state, from which the rate is measured.
    """

    def __init__(
        self, device: str, rtde: RtdeClient, buffer: SampleBuffer, *, tool_channels: bool, line: Line | None
    ) -> None:
        self._device = device
        self._rtde = rtde
        self._buffer = buffer
        self._tool_channels = tool_channels
        self.line = line
        self.streaming = False
        self.state: ArmState | None = None
        self.first: ArmState | None = None
        self.move: Move | None = None
        self.received = 0
        self.lost = 0
        self.stale = 0
        self.heard = threading.Event()

    def receive(self) -> None:
        """Take what has arrived; waits briefly.

        Raises DeviceError: the connection is lost, sends nonsense, or the controller was restarted.
        """
        sample, host_s = self._rtde.receive()
        times: list[float] = []
        rows: list[FloatArray] = []
        lost = 0
        for values in sample:
            state = ArmState.of(values, host_s)
            missing = self._missing(state)
            if missing is None:
                self.stale += 1
                continue
            lost += missing
            self.received += 1
            self.state = state
            if self.first is None:
                self.first = state
            line = self.line
            if line is None:
                continue
            rows.append(self._row(state, line))
            times.append(state.time_s)
        self.lost += lost
        if self.streaming and times:
            self._buffer.put(times, np.full(len(times), host_s), np.array(rows), lost=lost)
        if self.state is not None:
            self.heard.set()

    def rate_hz(self) -> float:
        """Return packages per second of the controller's clock since the first one; NaN before the second."""
        first, last = self.first, self.state
        if first is None or last is None or last.time_s <= first.time_s:
            return math.nan
        return (self.received - 1) / (last.time_s - first.time_s)

    def _missing(self, state: ArmState) -> int | None:
        """Return how many packages are missing before this one; None if it is not newer than the last."""
        if not math.isfinite(state.time_s):
            raise DeviceError(self._device, "its time stamp is not a number", hint=REOPEN_HINT)
        last = self.state
        if last is None:
            return 0
        step_s = state.time_s - last.time_s
        if step_s < -_RESTART_S:
            raise DeviceError(
                self._device,
                f"its controller was restarted: its clock went from {last.time_s:.3f} s back to {state.time_s:.3f} s",
                hint=REOPEN_HINT,
            )
        if step_s > _LEAP_S:
            raise DeviceError(
                self._device,
                f"its controller's clock leapt from {last.time_s:.3f} s to {state.time_s:.6g} s",
                hint=REOPEN_HINT,
            )
        if step_s <= 0.0:
            return None
        return max(0, round(step_s * self._rtde.rate_hz) - 1)

    def _row(self, state: ArmState, line: Line) -> FloatArray:
        position = float(line.position_m(state.pose))
        move = self.move
        constant = move is not None and move.follow(state, position)
        if not self._tool_channels:
            return np.array([position])
        speeds = (line.speed_m_s(state.target_twist), line.speed_m_s(state.actual_twist))
        return np.array([position, *state.pose, *speeds, state.speed_scaling, float(constant)])


_FIRST_S = 2.0
_SILENT_S = 0.5
_BEAT_S = 0.02
"""Between two signs of life, unless the watchdog is less patient than five of them."""


class Link:
    """The arm as its network services show it.

    Parameters
    ----------
    clock
        Host time.

    Attributes
    ----------
    dashboard, rtde
        The services that are asked.
    tracking
        What has been heard over the present connection.
    stops
        How often a stop was asked for; tells whoever sends a program that one came in between.
    """

    def __init__(self, device: str, settings: Ur5Settings, clock: Clock, buffer: SampleBuffer) -> None:
        self._device = device
        self._settings = settings
        self._clock = clock
        self._buffer = buffer
        self.rtde = RtdeClient(device, settings, clock)
        self.dashboard = Dashboard(device, settings, clock)
        self._programs = Programs(device, settings)
        self.tracking = self._new_tracking(None)
        self._listener = Listener(device, self._hear)
        self._heart = Listener(f"{device} watchdog", self._beat)
        self._beating = False
        self._is_open = False
        self.stops = 0

    def open(self) -> None:
        """Connect to all services, and wait for the first state; DeviceError if one of them fails."""
        self.close()
        self.tracking = self._new_tracking(self.tracking.line)  # position zero outlives a lost connection
        try:
            self.dashboard.open()
            self.rtde.open()
            self._programs.open()
            self._listener.start()
            self._heart.start()
            self._is_open = True
            if not self.tracking.heard.wait(_FIRST_S):
                self._listener.check()
                raise DeviceError(
                    self._device, "its RTDE service starts a stream but sends nothing", hint=REOPEN_HINT
                )
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Disconnect; harmless when not connected. A move under way ends, since nobody refreshes its watchdog."""
        self._is_open = False
        self._beating = False
        self.tracking.streaming = False
        self._heart.stop()
        self._listener.stop()
        self._programs.close()
        self.rtde.close()
        self.dashboard.close()

    def state(self) -> ArmState:
        """Return the latest state.

        Raises DeviceError: not open, a connection is lost, nonsense was heard, or nothing for too long.
        """
        opened(self._device, self._is_open)
        self._listener.check()
        self._heart.check()
        state = self.tracking.state
        if state is None:
            raise DeviceError(self._device, "has not sent anything yet", hint=REOPEN_HINT)
        quiet_s = self._clock.now() - state.host_s
        if quiet_s > max(_SILENT_S, 5.0 / self.rtde.rate_hz):
            raise DeviceError(
                self._device,
                f"has sent nothing for {quiet_s:.2g} s (expected {self.rtde.rate_hz:g} packages/s)",
                hint="check the network cable and the controller's power, then labrun resume",
            )
        return state

    def send(self, program: str, wanted: Callable[[], bool]) -> bool:
        """Give signs of life from now on, and send a program; tell whether it was (see `Programs.send`)."""
        self._beating = True
        return self._programs.send(program, wanted)

    def complaint(self) -> str:
        """Return what the controller says is wrong with the last program; empty if nothing."""
        return self._programs.complaint()

    def stop(self) -> None:
        """Stop the tool: a braking program, the dashboard's stop, and no more signs of life. Never raises."""
        self.stops += 1
        self._beating = False
        self.tracking.move = None
        if not self._is_open:
            return
        with contextlib.suppress(Exception):  # a stop never raises; each way has been tried by then
            stopped = self._programs.stop_now()
            self.dashboard.stop_now()
            if not stopped:
                self._programs.stop_anew()

    def _new_tracking(self, line: Line | None) -> Tracking:
        return Tracking(
            self._device, self.rtde, self._buffer, tool_channels=self._settings.tool_channels, line=line
        )

    def _hear(self) -> None:
        self.tracking.receive()  # of the connection of now

    def _beat(self) -> None:
        self._clock.sleep(min(_BEAT_S, self._settings.watchdog_ms / 5000.0))
        if self._beating:
            self.rtde.beat()


def stop_from_scratch(device: str, settings: Ur5Settings, clock: Clock, patience_s: float) -> bool:
    """Connect and stop the tool, without anything that is open already; tell whether it was told."""
    programs = Programs(device, settings)
    dashboard = Dashboard(device, settings, clock)
    stopped = programs.stop_anew(patience_s)
    try:
        dashboard.open(patience_s)
        heard = dashboard.stop_now() and dashboard.hear_stop()
    except DeviceError:
        heard = False
    finally:
        programs.close()
        dashboard.close()
    return stopped or heard
