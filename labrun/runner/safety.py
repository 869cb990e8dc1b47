"""Stopping everything that moves, first thing on any exit; how a run or a trial ends early; the watchdog."""

import os
import subprocess
import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from types import TracebackType

from labrun.devices import Device, processes
from labrun.devices.clock import RealClock
from labrun.devices.processes.watchdog import (
    ARM,
    BEAT,
    DISARM,
    FIRST_CALL,
    MOST_DEVICES,
    NO_CALL,
    QUIT,
    READY,
)
from labrun.errors import DeviceError, ExperimentError, LabrunError, PluginError
from labrun.runner.resolve import ResolvedDevice


class LimitReached(Exception):  # noqa: N818  a stop that was asked for is not an error
    """The requested number of trials is done; the run can be resumed."""


class SilentDeviceError(DeviceError):
    """A device stopped answering."""


class NonsenseError(DeviceError):
    """A device answered something that cannot be a measurement."""


class HungDeviceError(DeviceError):
    """A call of a device's driver does not return."""


def wrong_answer(device: str, method: str, value: object, expected: str) -> NonsenseError:
    """Return the error for an invalid return value of a driver method."""
    text = "None" if value is None else f"a {type(value).__name__}"
    return NonsenseError(
        device, f"its {method}() returned {text}; expected {expected}", hint="this is a fault of its driver"
    )


class DeviceCalls:
    """Records the device call in progress, to name the cause of a hang.

    Parameters
    ----------
    names
        The devices of the rig, in their order.
    tell
        Called with the device's number when a call begins, and with None when it has returned.
    """

    def __init__(self, names: Sequence[str], tell: Callable[[int | None], object]) -> None:
        self._numbers = {name: number for number, name in enumerate(names)}
        self._tell = tell
        self._clock = RealClock()
        self._current: tuple[str, str, float] | None = None

    def __call__(self, device: str, method: str) -> "blaming":
        """Return the context of one call."""
        return blaming(device, self, method)

    def begin(self, device: str, method: str) -> None:
        """Note that a call begins."""
        self._current = (device, method, self._clock.now())
        self._tell(self._numbers[device])

    def end(self) -> None:
        """Note that it has returned, or raised."""
        self._current = None
        with suppress(LabrunError):  # the watchdog is gone: the next beat says so
            self._tell(None)

    def hung(self, after_s: float) -> HungDeviceError | None:
        """Return what to raise if the call under way has lasted for so long; None if none has."""
        if self._current is None:
            return None
        device, method, since_s = self._current
        passed_s = self._clock.now() - since_s
        if passed_s < after_s:
            return None
        return HungDeviceError(
            device,
            f"its {method}() has not returned for {passed_s:.1f} s",
            hint="check its cable and power; if it stays, this is a fault of its driver, which must not wait",
        )


class blaming:  # noqa: N801  reads as a statement: with blaming(device)
    """Turn whatever a driver raises into a DeviceError that names the device; labrun's own errors pass.

    A class, and no generator: it surrounds every call of a driver, hundreds of times a trial.
    """

    __slots__ = ("_calls", "_device", "_method")

    def __init__(self, device: str, calls: DeviceCalls | None = None, method: str = "") -> None:
        self._device = device
        self._calls = calls
        self._method = method

    def __enter__(self) -> None:
        if self._calls is not None:
            self._calls.begin(self._device, self._method)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._calls is not None:
            self._calls.end()
        if isinstance(error, Exception) and not isinstance(error, LabrunError):
            call = f" in {self._method}()" if self._method else ""
            raise DeviceError(
                self._device,
                f"its driver failed{call}: {type(error).__name__}: {error}",
                hint="check its cable and power; if it stays, this is a fault of its driver",
            ) from error


PATIENCE_S = 2.0
"""How long the devices' stops may take before the others' results are reported without one that hangs."""
_BEAT_S = 0.05


def stop_all(devices: Mapping[str, Device], beat: Callable[[], object] = lambda: None) -> list[str]:
    """Stop every device at the same time; never raises.

    Returns
    -------
    list of str
        One sentence for every device that could not be stopped in time.
    """
    failures = at_once(devices, lambda device: device.safe_stop(), PATIENCE_S, beat)
    return [
        f"{name} did not stop within {PATIENCE_S:g} s"
        if error is None
        else f"{name} could not be stopped: {type(error).__name__}: {error}"
        for name, error in failures.items()
    ]


def at_once(
    devices: Mapping[str, Device],
    action: Callable[[Device], object],
    patience_s: float,
    beat: Callable[[], object] = lambda: None,
) -> dict[str, BaseException | None]:
    """Do something with every device at the same time; never raises.

    Each runs in a thread of its own: a device that hangs cannot keep the others moving, and a driver whose lock
    the interrupted main thread holds gets it as soon as that thread goes on.

    Parameters
    ----------
    beat
        Called while waiting: a device that hangs is no reason for the watchdog to kill the runner with its data.

    Returns
    -------
    dict
        What each device raised that failed; None of one that was not done in `patience_s`.
    """
    failures: dict[str, BaseException | None] = {}

    def act(name: str, device: Device) -> None:
        try:
            action(device)
        except (
            BaseException
        ) as error:  # a driver must not raise here; if it does, the others still get their turn
            failures[name] = error

    threads: dict[str, threading.Thread] = {}
    for name, device in devices.items():
        thread = threading.Thread(target=act, args=(name, device), daemon=True, name=f"labrun {name}")
        try:
            thread.start()
        except RuntimeError:  # no threads any more: the interpreter is going down
            act(name, device)
            continue
        threads[name] = thread
    clock = RealClock()
    deadline_s = clock.now() + patience_s
    for name, thread in threads.items():
        while thread.is_alive() and (left_s := deadline_s - clock.now()) > 0:
            thread.join(min(_BEAT_S, left_s))
            with suppress(LabrunError):  # the watchdog is gone: the stop goes on without it
                beat()
        if thread.is_alive():
            failures[name] = None
    return dict(failures)


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

    def calling(self, number: int | None) -> None:
        """Say which device is waited for from now on; None for none. Counts as a sign of life."""
        if self._armed and (number is None or number < MOST_DEVICES):
            self._send(NO_CALL if number is None else bytes((FIRST_CALL + number,)))

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


def start_watchdog(resolved: Sequence[ResolvedDevice], moving: Collection[str], timeout_s: float) -> Watchdog:
    """Start the watchdog: it minds the calls of all devices, and stops those that move.

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
            "moves": item.name in moving,
        }
        for item in resolved
    ]
    process = processes.start("watchdog")
    watchdog = Watchdog(process, timeout_s)
    try:
        task = {
            "devices": devices,
            "timeout_s": timeout_s,
            "runner_pid": os.getpid(),
            # signals, by which a call that hangs is broken off, are the main thread's
            "may_alarm": threading.current_thread() is threading.main_thread(),
        }
        processes.tell(process, task)
        answer = processes.answer(process, _START_S).decode().strip()
    except OSError:
        answer = ""
    if answer != READY:
        watchdog.end()
        raise ExperimentError(
            "the watchdog process did not start",
            hint="see its message above; python -m labrun.devices.processes.watchdog must run here",
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
