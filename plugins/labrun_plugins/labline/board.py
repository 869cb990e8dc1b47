"""What the emulators of labline boards share: a port, a line machine, and the faults of a board."""

import math
import queue
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from labrun.devices.emulated_ports import PtyEndpoint
from labrun.devices.emulation import EmulatorContext
from labrun_plugins.labline.device import LineMachine, sealed


class BenchHand:
    """Carries out actions one after the other in a thread of its own: a bench that is busy may take long to answer."""

    def __init__(self) -> None:
        self._actions: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._failure: Exception | None = None

    def do(self, action: Callable[[], None]) -> None:
        """Have something done soon; raises what an earlier action raised."""
        if self._failure is not None:
            raise self._failure
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, daemon=True, name="bench")
            self._thread.start()
        self._actions.put(action)

    def close(self) -> None:
        """Do what is left, and end."""
        if self._thread is not None:
            self._actions.put(None)
            self._thread.join(1.0)
            self._thread = None

    def _work(self) -> None:
        while (action := self._actions.get()) is not None:
            try:
                action()
            except Exception as failure:
                self._failure = failure
                return


_BAUD = 115_200.0
_LOOK_S = 0.02
"""How often faults are looked at while nothing else is due."""


class EmulatedBoard:
    """A board behind a pty. What it does is the subclass's: it makes `machine`, and overrides `advance` and `reset`.

    Faults of a board, besides those of the wire (see `emulated_ports`): ``watchdog`` (expires now), ``restart``
    (outputs off, banner in the midst of everything), ``error`` (every word that moves is answered with this text behind
    ``ERR,``; "HW,FAULT" if it is just there), ``wrong-id`` (this many answers carry the next sequence number),
    ``stale`` (before this many answers the previous one comes once more).

    Parameters
    ----------
    name
        The device's name.
    context
        Of the emulator.
    boot_s
        How long it takes from a reset to its banner.
    """

    machine: LineMachine

    def __init__(self, name: str, context: EmulatorContext, *, boot_s: float = 0.05) -> None:
        self.name = name
        self.context = context
        self.note = context.log.note
        self.bench = BenchHand()
        """Carries out what moves the simulated bench."""
        self._boot_s = boot_s
        self._port = PtyEndpoint(context, name, _BAUD)
        self._before = b""
        self._boots_at_s: float | None = None

    def open(self) -> Mapping[str, Any]:
        """Plug it in; return `port`, and `boot_wait_s` 0: opening a pty resets nothing, so no restart is waited for."""
        port = self._port.open()
        self.machine.boot(self.context.clock.now())
        return {"port": port, "boot_wait_s": 0.0}

    def files(self) -> Sequence[int]:
        """Return what to wait on."""
        return self._port.fds

    def step(self, now_s: float) -> float:
        """Take lines, answer them, move on; return when something is due."""
        data = self._port.receive()
        self._misbehave(now_s)
        if self._boots_at_s is not None:  # in the midst of its reset it hears nothing
            if now_s < self._boots_at_s:
                return min(self._boots_at_s, self._port.flush(now_s))
            self._boots_at_s = None
            self._port.send(self.machine.boot(now_s))
            self.note("booted")
        # What waits on the line is taken first: if this process was kept from running, the line was not silent.
        for answer in self.machine.take(data, now_s):
            self._answer(answer)
        for line in self.machine.tick(now_s):
            self._port.send(line)
        due_s = min(self.advance(now_s), self.machine.due_s(), now_s + _LOOK_S)
        return min(due_s, self._port.flush(now_s))

    def close(self) -> None:
        """Unplug it."""
        self._port.close()
        self.bench.close()

    def send(self, line: bytes) -> None:
        """Send a line unasked."""
        self._port.send(line)

    def advance(self, now_s: float) -> float:
        """Do what is due; return when the next thing is."""
        del now_s
        return math.inf

    def reset(self, now_s: float) -> None:
        """Turn all outputs off, as a reset does."""

    def _misbehave(self, now_s: float) -> None:
        faults = self.context.faults
        if faults.active("restart"):
            faults.set("restart", None)
            self.note("restart")
            self._boots_at_s = now_s + self._boot_s
            self.reset(now_s)
        if faults.active("watchdog"):
            faults.set("watchdog", None)
            for line in self.machine.trip(now_s):
                self._port.send(line)
        error = faults.value("error")
        self.machine.forced_error = str(error) if isinstance(error, str) else "HW,FAULT" if error else ""

    def _answer(self, answer: bytes) -> None:
        faults = self.context.faults
        if faults.take("wrong-id"):
            seq, _, rest = answer[1:-6].decode("ascii").partition(",")
            answer = sealed(f"{int(seq) % 65_535 + 1},{rest}")
        if self._before and faults.take("stale"):
            self._port.send(self._before)
        self._before = answer
        self._port.send(answer)
