"""Hears the arm's stream: the latest state, samples for the runner, losses, and the move under way."""

import math
import threading

import numpy as np

from labrun.devices import DeviceError, FloatArray, SampleBuffer
from labrun_plugins.ur5.connection import REOPEN_HINT
from labrun_plugins.ur5.line import Line
from labrun_plugins.ur5.motion import Move
from labrun_plugins.ur5.rtde import RtdeClient
from labrun_plugins.ur5.state import ArmState

_RESTART_S = 1.0
"""A time stamp further back than this is a controller that was restarted; nearer, a package that came late or twice."""
_LEAP_S = 10.0
"""A gap this long would have been noticed as silence; a time stamp beyond is nonsense."""


class Tracking:
    """What a thread makes of the stream of one connection.

    Parameters
    ----------
    device
        Name in the experiment file.
    rtde
        The open stream.
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

        Raises
        ------
        DeviceError
            The connection is lost, sends nonsense, or the controller was restarted.
        """
        found, host_s = self._rtde.receive()
        times: list[float] = []
        rows: list[FloatArray] = []
        lost = 0
        for values in found:
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
            raise DeviceError(self._device, "its time stamp is no number", hint=REOPEN_HINT)
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
