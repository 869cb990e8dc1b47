"""One emulator in a process of its own.

Started as ``python -m labrun.devices.processes.emulator``; its standard input gives first the task, one line of
JSON, then orders, one line each: ``{"fault": name, "value": value}``, ``{"log": path}``, ``{"quit": true}``. It answers
with one line: the settings by which a driver reaches it.
"""

import contextlib
import json
import math
import os
import select
import sys
import traceback
from pathlib import Path
from typing import Any

import numpy as np

from labrun.devices.clock import RealClock
from labrun.devices.emulation import Emulator, EmulatorContext, EmulatorLog, Faults
from labrun.devices.processes import stand_for_hardware
from labrun.devices.processes.scene import LINGER_S, RemoteScene
from labrun.errors import LabrunError
from labrun.interrupts import ignore_signals
from labrun.registry import load

_LONGEST_WAIT_S = 0.05


class _Orders:
    """Lines from the runner, taken as they come."""

    def __init__(self, pipe: int) -> None:
        self.pipe = pipe
        self._rest = b""
        self._kept: list[dict[str, Any]] = []
        self.ended = False

    @property
    def waiting(self) -> bool:
        """Tell whether orders came along with the first one."""
        return bool(self._kept)

    def take(self) -> list[dict[str, Any]]:
        """Return the orders that have arrived; call it when the pipe is readable."""
        if self._kept:
            kept, self._kept = self._kept, []
            return kept
        data = os.read(self.pipe, 65_536)
        if not data:
            self.ended = True
            return []
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [json.loads(line) for line in lines if line]

    def first(self) -> dict[str, Any]:
        """Wait for the first order and return it."""
        while True:
            orders = self.take()
            if orders:
                first, *self._kept = orders
                return first
            if self.ended:
                sys.exit(0)


def make_emulator(task: dict[str, Any]) -> tuple[Emulator, EmulatorContext]:
    """Return the emulator of a task, not yet open, and its environment."""
    clock = RealClock()
    scene = None
    if task["scene"] is not None:
        scene = RemoteScene(task["scene"]["address"], bytes.fromhex(task["scene"]["key"]))
    rng = np.random.default_rng(np.random.SeedSequence(task["seed"]))
    context = EmulatorContext(
        clock,
        rng,
        Path(task["folder"]),
        scene,
        Faults(task["faults"]),
        log=EmulatorLog(Path(task["log"]), clock),
    )
    settings = load("labrun.devices", task["stand_in"]).Settings.model_validate(task["settings"])
    emulator: Emulator = load("labrun.emulators", task["plugin"])(task["name"], settings, context)
    return emulator, context


def run(emulator: Emulator, context: EmulatorContext, orders: _Orders) -> None:
    """Serve until told to quit, or until a little after the runner's end."""
    clock = context.clock
    end_s = math.inf
    while clock.now() < end_s:
        due_s = emulator.step(clock.now())
        wait_s = min(max(due_s - clock.now(), 0.0), _LONGEST_WAIT_S)
        files = [*emulator.files(), *(() if orders.ended else (orders.pipe,))]
        readable, _, _ = select.select(files, [], [], wait_s)
        if orders.pipe not in readable and not orders.waiting:
            continue
        for order in orders.take():
            if "quit" in order:
                return
            if "log" in order:
                context.log.move(Path(order["log"]))
            if "fault" in order:
                context.faults.set(order["fault"], order["value"])
                context.log.note("fault", name=order["fault"], value=order["value"])
        if orders.ended:
            end_s = clock.now() + LINGER_S


def main() -> int:
    """Run the emulator that standard input asks for."""
    ignore_signals()  # a bench does not go away because of Ctrl-C
    orders = _Orders(sys.stdin.fileno())
    task = orders.first()
    try:
        emulator, context = make_emulator(task)
        reached_by = dict(emulator.open())
    except LabrunError as error:
        _answer({"error": str(error)})
        return 1
    context.log.note("open", **reached_by)
    stand_for_hardware()
    _answer({"settings": reached_by})
    try:
        run(emulator, context, orders)
    except Exception:
        context.log.note("crashed", trace=traceback.format_exc())
        raise
    finally:
        emulator.close()
        if orders.ended:
            _tidy_up(context)
    return 0


def _answer(line: dict[str, Any]) -> None:
    """Answer the runner; a killed runner is noticed when its orders end."""
    with contextlib.suppress(BrokenPipeError):
        os.write(sys.stdout.fileno(), json.dumps(line).encode() + b"\n")


def _tidy_up(context: EmulatorContext) -> None:
    """Remove what a killed runner left: an unwanted log, and the folder of the bench.

    The folder goes with the last one that leaves something in it.
    """
    path = context.log.path
    if path is not None and path.parent == context.folder:
        path.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        context.folder.rmdir()


if __name__ == "__main__":
    sys.exit(main())
