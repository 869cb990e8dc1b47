"""The runner's side of the watchdog: starts it, and tells it that the runner lives."""

import json
import os
import select
import subprocess
import sys
from collections.abc import Collection, Sequence

from labrun.errors import ExperimentError, PluginError
from labrun.runner.clock import RealClock
from labrun.runner.resolving import ResolvedDevice
from labrun.runner.watchdog import ARM, BEAT, DISARM, QUIT, READY

_START_S = 30.0
_BEATS_PER_TIMEOUT = 8.0


class Watchdog:
    """A running watchdog process.

    Parameters
    ----------
    process
        The process; its standard input is the pipe.
    timeout_s
        After how long without a sign of life it acts.
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
    process = subprocess.Popen(
        [sys.executable, "-m", "labrun.runner.watchdog"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C in the terminal goes to the runner alone
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    )
    watchdog = Watchdog(process, timeout_s)
    task = {"devices": devices, "timeout_s": timeout_s, "runner_pid": os.getpid()}
    assert process.stdin is not None  # noqa: S101  asked for above
    assert process.stdout is not None  # noqa: S101
    try:
        os.write(process.stdin.fileno(), json.dumps(task).encode() + b"\n")
        ready, _, _ = select.select([process.stdout], [], [], _START_S)
        answer = process.stdout.readline().decode().strip() if ready else ""
    except OSError:
        answer = ""
    if answer != READY:
        watchdog.end()
        raise ExperimentError(
            "the watchdog process did not start",
            hint="its own message stands above; python -m labrun.runner.watchdog must run in this environment",
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
