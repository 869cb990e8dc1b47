"""Stopping everything that moves, first thing on any exit; how a run or a trial ends early; the watchdog."""

import os
import subprocess
import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from types import TracebackType

from labrun.devices import Device, processes
from labrun.devices.clock import RealClock
from labrun.devices.processes.watchdog import ARM, BEAT, DISARM, QUIT, READY
from labrun.errors import DeviceError, ExperimentError, LabrunError, PluginError
from labrun.runner.resolve import ResolvedDevice


class LimitReached(Exception):  # noqa: N818  a stop that was asked for is not an error
    """The number of trials asked for is done; the run can be resumed."""


class SilentDeviceError(DeviceError):
    """A device stopped answering."""


class NonsenseError(DeviceError):
    """A device answered something that cannot be a measurement."""


class blaming:  # noqa: N801  reads as a statement: with blaming(device)
    """Turn whatever a driver raises into a DeviceError that names the device; labrun's own errors pass.

    A class, and no generator: it surrounds every call of a driver, hundreds of times a trial.
    """

    __slots__ = ("_device",)

    def __init__(self, device: str) -> None:
        self._device = device

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, Exception) and not isinstance(error, LabrunError):
            raise DeviceError(
                self._device,
                f"its driver failed: {type(error).__name__}: {error}",
                hint="check its cable and power; if it stays, this is a fault of its driver",
            ) from error


PATIENCE_S = 2.0
"""How long the devices' stops may take before the others' results are reported without one that hangs."""
_BEAT_S = 0.05


def stop_all(devices: Mapping[str, Device], beat: Callable[[], object] = lambda: None) -> list[str]:
    """Stop every device at the same time; never raises.

    Each stop runs in a thread of its own: a device that hangs cannot keep the others moving, and a driver whose lock
    the interrupted main thread holds gets it as soon as that thread goes on.

    Parameters
    ----------
    beat
        Called while waiting: a stop that hangs is no reason for the watchdog to kill the runner with its data.

    Returns
    -------
    list of str
        One sentence for every device that could not be stopped in time.
    """
    failures: dict[str, str] = {}

    def stop(name: str, device: Device) -> None:
        try:
            device.safe_stop()
        except BaseException as error:  # a driver must not raise here; if it does, the others still stop
            failures[name] = f"{name} could not be stopped: {type(error).__name__}: {error}"

    threads: dict[str, threading.Thread] = {}
    for name, device in devices.items():
        thread = threading.Thread(target=stop, args=(name, device), daemon=True, name=f"stop {name}")
        try:
            thread.start()
        except RuntimeError:  # no threads any more: the interpreter is going down
            stop(name, device)
            continue
        threads[name] = thread
    clock = RealClock()
    deadline_s = clock.now() + PATIENCE_S
    for name, thread in threads.items():
        while thread.is_alive() and (left_s := deadline_s - clock.now()) > 0:
            thread.join(min(_BEAT_S, left_s))
            with suppress(LabrunError):  # the watchdog is gone: the stop goes on without it
                beat()
        if thread.is_alive():
            failures[name] = f"{name} did not stop within {PATIENCE_S:g} s"
    return list(failures.values())


_START_S = 30.0
_BEATS_PER_TIMEOUT = 8.0


class Watchdog:
    """A running watchdog process.

    `process`: the process; its standard input is the pipe. `timeout_s`: after how long without a sign of life it acts.
    """

    def __init__(self, process: "subprocess.Popen[bytes]", timeout_s: float) -> None:
        self.process = process
        self._clock = RealClock()
        self._every_s = timeout_s / _BEATS_PER_TIMEOUT
        self._due_s = 0.0
        self._armed = False

    def arm(self) -> None:
        """From now on silence counts as a hang."""
        self._armed = True
        self._send(ARM)

    def disarm(self) -> None:
        """From now on silence is fine. Never raises: it is called while the rig is being stopped."""
        self._armed = False
        try:
            self._send(DISARM)
        except ExperimentError:
            return

    def beat(self) -> None:
        """Give a sign of life, a few times per timeout at most."""
        now_s = self._clock.now()
        if self._armed and now_s >= self._due_s:
            self._due_s = now_s + self._every_s
            self._send(BEAT)

    def end(self) -> None:
        """Say farewell and wait for the process to end; never raises."""
        if self.process.stdin is None:
            return
        try:
            self._send(QUIT)
            self.process.stdin.close()
            self.process.wait(timeout=5.0)
        except (OSError, ExperimentError):
            self.process.kill()
        except subprocess.TimeoutExpired:
            self.process.kill()
        if self.process.stdout is not None:
            self.process.stdout.close()
        self.process.wait()

    def abandon(self) -> None:
        """Leave without farewell, so that the watchdog stops every actuator from scratch; never raises.

        For a runner that could not stop one itself. A stop that takes long goes on after the runner's end.
        """
        try:
            if self.process.stdin is not None:
                self.process.stdin.close()
            self.process.wait(timeout=5.0)
        except (OSError, subprocess.TimeoutExpired):
            pass
        if self.process.stdout is not None:
            self.process.stdout.close()

    def _send(self, sign: bytes) -> None:
        assert self.process.stdin is not None  # noqa: S101  it was started with a pipe
        try:
            os.write(self.process.stdin.fileno(), sign)
        except (OSError, ValueError) as error:
            raise ExperimentError(
                "the watchdog process is gone, so nothing would stop the actuators if this one died",
                hint="labrun resume starts a new one",
            ) from error


def start_watchdog(
    resolved: Sequence[ResolvedDevice], moving: Collection[str], timeout_s: float
) -> Watchdog | None:
    """Start the watchdog for the devices that move; None if there are none.

    Raises
    ------
    PluginError
        The plugin of one that moves offers no emergency stop, so nothing could stop it if the runner died.
    ExperimentError
        The process did not get ready.
    """
    _require_emergency_stop([item for item in resolved if item.name in moving])
    devices = [
        {
            "name": item.name,
            "plugin": item.plugin,
            "settings": item.settings.model_dump(mode="json", exclude_unset=True),
        }
        for item in resolved
        if item.name in moving
    ]
    if not devices:
        return None
    process = processes.start("watchdog")
    watchdog = Watchdog(process, timeout_s)
    try:
        processes.tell(process, {"devices": devices, "timeout_s": timeout_s, "runner_pid": os.getpid()})
        answer = processes.answer(process, _START_S).decode().strip()
    except OSError:
        answer = ""
    if answer != READY:
        watchdog.end()
        raise ExperimentError(
            "the watchdog process did not start",
            hint="its own message stands above; python -m labrun.devices.processes.watchdog must run here",
        )
    return watchdog


def _require_emergency_stop(moving: Sequence[ResolvedDevice]) -> None:
    lacking = [item for item in moving if not callable(getattr(item.make, "emergency_stop", None))]
    if not lacking:
        return
    named = ", ".join(f"device {item.name} (plugin {item.plugin!r})" for item in lacking)
    raise PluginError(
        f"{named} moves, but has no emergency stop: nothing would stop it if this process died or hung",
        hint="add a class method emergency_stop(cls, name, settings) to the plugin's class, which connects from "
        "scratch and stops all motion; --dry-run works without it",
    )
