"""The board's side of labline, for emulators: what the firmware does with its lines. Shares nothing with the host's."""

import math
import queue
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from labrun.devices.emulated_ports import PtyEndpoint
from labrun.devices.emulation import EmulatorContext

BUFFER_BYTES = 96
REMEMBERED = 4
"""So many of the last requests are answered again, without acting twice, when they are repeated."""
WATCHDOG_MS = (20, 5000)
_ROUNDING = 1e-6
"""Whole milliseconds stay whole."""


class RefusalError(Exception):
    """A request that is answered ``ERR,<code>[,<detail>]``."""

    def __init__(self, code: str, detail: str = "") -> None:
        super().__init__(code, detail)
        self.code = code
        self.detail = detail


Act = Callable[[Sequence[str], float], Sequence[str]]
"""Takes a word's arguments and the time (s); returns what stands behind ``OK,<word>``, or raises RefusalError."""


@dataclass(frozen=True, slots=True)
class Word:
    """What a board does at one word.

    Attributes
    ----------
    act
        Carries it out.
    arguments
        Fewest and most of them.
    moves
        Whether it is refused while the watchdog is off or has expired.
    """

    act: Act
    arguments: tuple[int, int] = (0, 0)
    moves: bool = False


class LineMachine:
    """One board: lines in, lines out, with its watchdog.

    Parameters
    ----------
    kind, firmware, channels, max_rate
        Of its HELLO, as they stand on the line.
    words
        What it knows besides HELLO, WD, PING and STOP.
    moving
        Tells whether anything moves: the watchdog cannot be turned off then.
    make_safe
        Called with "STOP" or "watchdog" and the time (s): takes the safe state.
    note
        Told every line and event for the emulator's log.
    """

    def __init__(
        self,
        kind: str,
        firmware: str,
        channels: int,
        max_rate: str,
        words: Mapping[str, Word],
        *,
        moving: Callable[[], bool],
        make_safe: Callable[[str, float], None],
        note: Callable[..., None],
    ) -> None:
        self._hello = ("HELLO", kind, firmware, str(channels), max_rate)
        self._firmware = firmware
        self._words = {
            "HELLO": Word(lambda _args, _now: self._hello[1:]),
            "PING": Word(lambda _args, _now: ()),
            "STOP": Word(self._stop),
            "WD": Word(self._arm, (1, 1)),
            **words,
        }
        self._moving = moving
        self._make_safe = make_safe
        self._note = note
        self._buffer = bytearray()
        self._overflow = False
        self._answered: deque[tuple[bytes, bytes]] = deque(maxlen=REMEMBERED)
        self._booted_s = 0.0
        self._last_good_s = 0.0
        self.watchdog_ms = 0
        self.tripped = False
        self.dropped = 0
        self.hardware_fault = ""
        """Told in ERR,HW to every word that moves, until the next reset."""
        self.forced_error = ""
        """Told in place of what a word that moves would do, for example "LIMIT,1"; as long as it is there."""

    def boot(self, now_s: float) -> bytes:
        """Start anew, as after a reset: watchdog off, nothing remembered; return the banner."""
        self._buffer.clear()
        self._overflow = False
        self._answered.clear()
        self._booted_s = self._last_good_s = now_s
        self.watchdog_ms, self.tripped, self.hardware_fault = 0, False, ""
        return self.event("BOOT", self._firmware)

    def millis(self, now_s: float) -> int:
        """Return the board's milliseconds since its start, which wrap after 49.7 days."""
        return int(1000.0 * (now_s - self._booted_s) + _ROUNDING) % 2**32

    def micros(self, now_s: float) -> int:
        """Return the board's microseconds since its start, which wrap after 71.6 minutes."""
        return int(1e6 * (now_s - self._booted_s)) % 2**32

    def take(self, data: bytes, now_s: float) -> list[bytes]:
        """Take bytes from the line; return the lines that answer them. Never raises, whatever comes."""
        answers = []
        for byte in data:
            if byte != 0x0A:
                if len(self._buffer) < BUFFER_BYTES - 1:
                    self._buffer.append(byte)
                else:
                    self._overflow = True
                    if byte == 0x24:  # the beginning of another line: what stood before has lost its end
                        self._buffer[:] = b"$"
                        self._overflow = False
                continue
            answer = None if self._overflow else self._line(bytes(self._buffer), now_s)
            if answer is not None:
                answers.append(answer)
            elif self._buffer:
                self.dropped += 1
            self._buffer.clear()
            self._overflow = False
        return answers

    def tick(self, now_s: float) -> list[bytes]:
        """Look at the watchdog; return its event line if it has expired."""
        silent_ms = self.millis(now_s) - self.millis(self._last_good_s)
        return self.trip(now_s) if self.watchdog_ms and silent_ms > self.watchdog_ms else []

    def trip(self, now_s: float) -> list[bytes]:
        """Let the watchdog expire now."""
        self._note("watchdog", watchdog_ms=self.watchdog_ms, silent_s=now_s - self._last_good_s)
        self.watchdog_ms, self.tripped = 0, True
        self._make_safe("watchdog", now_s)
        return [self.event("WDOG")]

    def due_s(self) -> float:
        """Return when the watchdog expires if nothing comes."""
        return self._last_good_s + (self.watchdog_ms + 1) / 1000.0 if self.watchdog_ms else math.inf

    def event(self, *fields: str) -> bytes:
        """Return an event line."""
        return sealed(",".join(("0", "EV", *fields)))

    def sample(self, *fields: str) -> bytes:
        """Return a sample line."""
        return sealed(",".join(("0", "S", *fields)))

    def _line(self, line: bytes, now_s: float) -> bytes | None:
        """Return the answer to one line; None if it is not whole."""
        body = opened(line)
        if body is None:
            return None
        seq, *fields = body.split(b",")
        if not seq.isdigit() or len(seq) > 5 or not 1 <= int(seq) <= 65_535 or not fields:
            return None
        if any(not 0x20 <= byte < 0x7F for byte in body):
            return None
        self._last_good_s = now_s
        word, *args = (field.decode("ascii") for field in fields)
        # STOP and WD act every time: both can be done twice, and neither may be answered from memory.
        again = next((answer for asked, answer in self._answered if asked == body), None)
        if again is not None and word not in {"STOP", "WD"}:
            self._note("repeated", word=word, seq=int(seq))
            return again
        try:
            reply = ("OK", word, *self._carry_out(word, args, now_s))
        except RefusalError as refusal:
            self._note("refused", word=word, code=refusal.code, detail=refusal.detail)
            reply = ("ERR", refusal.code, *((refusal.detail,) if refusal.detail else ()))
        answer = sealed(f"{int(seq)},{','.join(reply)}")
        self._answered.append((body, answer))
        return answer

    def _carry_out(self, word: str, args: Sequence[str], now_s: float) -> Sequence[str]:
        known = self._words.get(word)
        if known is None:
            raise RefusalError("WORD")
        fewest, most = known.arguments
        if not fewest <= len(args) <= most:
            raise RefusalError("ARGC")
        if known.moves and self.forced_error:
            code, _, detail = self.forced_error.partition(",")
            raise RefusalError(code, detail)
        if known.moves and self.hardware_fault:
            raise RefusalError("HW", self.hardware_fault)
        if known.moves and not self.watchdog_ms:
            raise RefusalError("WDOG")
        return known.act(args, now_s)

    def _stop(self, _args: Sequence[str], now_s: float) -> Sequence[str]:
        self._make_safe("STOP", now_s)
        return ()

    def _arm(self, args: Sequence[str], now_s: float) -> Sequence[str]:
        watchdog_ms = whole(args[0], "0")
        if watchdog_ms == 0 and self._moving():
            raise RefusalError("STATE")
        if watchdog_ms != 0 and not WATCHDOG_MS[0] <= watchdog_ms <= WATCHDOG_MS[1]:
            raise RefusalError("RANGE", "0")
        self.watchdog_ms, self.tripped = watchdog_ms, False
        self._last_good_s = now_s
        self._note("armed", watchdog_ms=watchdog_ms)
        return (str(watchdog_ms),)


def register(data: bytes) -> int:
    """Return the checksum bit by bit: CRC-16/CCITT-FALSE, 29B1 for 123456789."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def sealed(body: str) -> bytes:
    """Return the line of a body."""
    data = body.encode("ascii")
    return b"$" + data + f"*{register(data):04X}\n".encode("ascii")


def opened(line: bytes) -> bytes | None:
    """Return the body of a line without its newline; None if its checksum is not right."""
    start = line.rfind(b"$")
    if start < 0 or len(line) - start < 6 or line[-5:-4] != b"*":
        return None
    body = line[start + 1 : -5]
    return body if f"{register(body):04X}".encode("ascii") == line[-4:] else None


def whole(text: str, detail: str = "") -> int:
    """Return a whole number of a line; RefusalError RANGE with this detail if it is none."""
    digits = text.removeprefix("-")
    if not (digits.isascii() and digits.isdigit()) or len(digits) > 9:
        raise RefusalError("RANGE", detail)
    return int(text)


def decimal(text: str) -> float:
    """Return a decimal number of a line, such as -0.500; RefusalError RANGE if it is none."""
    digits = text.removeprefix("-")
    before, _, after = digits.partition(".")
    if not (digits.isascii() and (before + after).isdigit()) or len(digits) > 12:
        raise RefusalError("RANGE")
    return float(text)


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
