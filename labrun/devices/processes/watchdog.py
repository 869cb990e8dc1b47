"""The watchdog: a process of its own that minds the runner, and stops the actuators when it hangs or dies.

Started as ``python -m labrun.devices.processes.watchdog`` by the runner, which talks to it through its standard
input: first one line of JSON, then single bytes. It imports the actuators' plugins at once, so that nothing is left to
load when it matters, and answers ``ready``.
"""

import json
import os
import select
import signal
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from labrun.devices.clock import RealClock
from labrun.interrupts import ignore_signals
from labrun.registry import load

ARM, DISARM, BEAT, QUIT = b"A", b"D", b".", b"Q"
NO_CALL, FIRST_CALL, MOST_DEVICES = b"-", 128, 128
"""No device is waited for; from 128 on, the number of the one that is."""
READY = "ready"
_ALARM_SHARE = 0.8
"""After this share of the time-out the runner is asked to break off the call that hangs; after all of it, killed."""
_DYING_S = 2.0
"""How long a killed runner may take to let go of its ports."""
_RETRY_S = 0.05
"""Pause between two attempts to stop a device."""
_HANGING_S = 10.0
"""How much longer than the attempts the stops may take before one of them counts as hanging."""


@dataclass(frozen=True, slots=True)
class Stoppable:
    """An actuator's plugin class, and what it needs to connect from scratch."""

    name: str
    make: Any
    settings: Any


def load_stoppable(name: str, plugin: str, settings: dict[str, Any]) -> Stoppable:
    """Import an actuator's plugin and check its settings."""
    make = load("labrun.devices", plugin)
    return Stoppable(name, make, make.Settings.model_validate(settings))


def stop_everything(devices: Sequence[Stoppable], why: str, patience_s: float = _DYING_S) -> list[str]:
    """Call every plugin's `emergency_stop`, all at the same time; return one sentence for each device.

    A stop that fails is tried again for `patience_s`: a dying runner may hold its ports a moment longer than its pipe.
    A device that hangs, or whose stop fails, does not keep the others from theirs.
    """
    clock = RealClock()
    results: dict[str, str] = {}

    def stop(device: Stoppable) -> None:
        deadline_s = clock.now() + patience_s
        while True:
            try:
                device.make.emergency_stop(device.name, device.settings)
            except Exception as error:  # a plugin may raise anything
                results[device.name] = f"could not stop {device.name}: {type(error).__name__}: {error}"
            else:
                results[device.name] = f"stopped {device.name}"
                return
            if clock.now() >= deadline_s:
                return
            clock.sleep(_RETRY_S)

    threads = [
        threading.Thread(target=stop, args=(device,), daemon=True, name=f"stop {device.name}")
        for device in devices
    ]
    for thread in threads:
        thread.start()
    deadline_s = clock.now() + patience_s + _HANGING_S
    for thread in threads:
        thread.join(max(0.0, deadline_s - clock.now()))
    return [
        f"labrun watchdog: {why}; "
        + results.get(device.name, f"could not stop {device.name}: its emergency_stop() does not return")
        for device in devices
    ]


def watch(
    pipe: int, timeout_s: float, runner_pid: int, names: Sequence[str], *, may_alarm: bool
) -> str | None:
    """Follow the runner's signs of life; return why the actuators must be stopped, or None at a regular end.

    Only while armed does silence count: a runner that stores or computes for long moves nothing. An end without
    farewell always counts. A runner that hangs in a device's driver is first sent an alarm, at which it breaks the
    call off and keeps its data; one that cannot is killed, so that its ports are free.
    """
    armed, device, alarmed = False, "", False
    while True:
        share = 1.0 if not may_alarm else 1.0 - _ALARM_SHARE if alarmed else _ALARM_SHARE
        ready, _, _ = select.select([pipe], [], [], share * timeout_s if armed else None)
        if not ready and may_alarm and not alarmed:
            alarmed = True
            _signal(runner_pid, signal.SIGALRM)
            continue
        if not ready:
            _kill(pipe, runner_pid)
            hangs = f"the driver of {device} hangs; " if device else ""
            return f"{hangs}the runner gave no sign of life for {timeout_s:g} s and was killed"
        message = os.read(pipe, 4096)
        if not message:
            return "the runner died"
        alarmed = False
        for byte in message:
            sign = bytes((byte,))
            if sign == QUIT:
                return None
            if sign == NO_CALL:
                device = ""
            elif byte >= FIRST_CALL:
                device = names[byte - FIRST_CALL]
            else:
                armed = sign == ARM or (armed and sign != DISARM)


def _signal(runner_pid: int, number: int) -> None:
    if os.getppid() == runner_pid:  # never a stranger that got the number of a runner long gone
        os.kill(runner_pid, number)


def _kill(pipe: int, runner_pid: int) -> None:
    """Kill the runner, and wait until the system has closed its end of the pipe, and with it its ports."""
    _signal(runner_pid, signal.SIGKILL)
    while select.select([pipe], [], [], _DYING_S)[0]:
        if not os.read(pipe, 4096):
            return


def main() -> int:
    """Run the watchdog until the runner ends."""
    ignore_signals()  # Ctrl-C is for the runner; this process outlives it
    pipe = sys.stdin.fileno()
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(pipe, 1)
        if not byte:
            return 0
        line += byte
    task = json.loads(line)
    devices = [
        load_stoppable(item["name"], item["plugin"], item["settings"])
        for item in task["devices"]
        if item["moves"]
    ]
    sys.stdout.write(READY + "\n")
    sys.stdout.flush()
    names = [item["name"] for item in task["devices"]]
    why = watch(pipe, task["timeout_s"], task["runner_pid"], names, may_alarm=task["may_alarm"])
    if why is None:
        return 0
    if not devices:
        sys.stderr.write(f"labrun watchdog: {why}\n")
    for report in stop_everything(devices, why):
        sys.stderr.write(report + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
