"""All connections to one arm, and the threads that hear it and keep its watchdog quiet."""

import contextlib
from collections.abc import Callable

from labrun.devices import Clock, DeviceError, Listener, SampleBuffer
from labrun_plugins.ur5.connection import REOPEN_HINT
from labrun_plugins.ur5.dashboard import Dashboard
from labrun_plugins.ur5.line import Line
from labrun_plugins.ur5.programs import Programs
from labrun_plugins.ur5.rtde import RtdeClient
from labrun_plugins.ur5.settings import Ur5Settings
from labrun_plugins.ur5.state import ArmState
from labrun_plugins.ur5.tracking import Tracking

_FIRST_S = 2.0
_SILENT_S = 0.5
_BEAT_S = 0.02
"""Between two signs of life, unless the watchdog is less patient than five of them."""


class Link:
    """The arm as its network services show it.

    Parameters
    ----------
    device, settings
        Name and table in the experiment file.
    clock
        Host time.
    buffer
        Gets the samples.

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

        Raises
        ------
        DeviceError
            Not open, a connection is lost, nonsense was heard, or nothing for too long.
        """
        if not self._is_open:
            raise DeviceError(self._device, "is not open", hint="open() comes before any other call")
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
            said = self._programs.stop_now()
            self.dashboard.stop_now()
            if not said:
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
    said = programs.stop_anew(patience_s)
    try:
        dashboard.open(patience_s)
        heard = dashboard.stop_now() and dashboard.hear_stop()
    except DeviceError:
        heard = False
    finally:
        programs.close()
        dashboard.close()
    return said or heard
