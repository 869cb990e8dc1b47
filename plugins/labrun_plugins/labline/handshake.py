"""Two short talks with a board from scratch, without a session: is one there, and stop."""

from collections.abc import Callable

from labrun.devices import DeviceError, Identity, SerialPort
from labrun.devices.clock import RealClock
from labrun_plugins.labline.codec import UNSOLICITED, Line, LineParser, encode
from labrun_plugins.labline.session import BAUD, BOOT_WAIT_S

_READ_S = 0.05
"""Time is counted in reads that wait this long at most for the first byte."""
_ANSWER_READS = 4
_BOOT_READS = round(BOOT_WAIT_S / _READ_S)
_DYING_S = 2.0
"""So long a program that was killed may take to let go of its port."""
_REMEMBERED_S = 10.0
_asked: dict[str, tuple[float, Line | None]] = {}
"""Port -> when it was asked for a board last, and what it answered."""
_STRANGE_BYTES = 256
"""So many bytes without a single line of this protocol are another kind of device."""


def probe(port: str, kind: str) -> Identity | None:
    """Return what the board at a port is, if it speaks labline and is of this kind; takes 3.5 s at most.

    Something that talks all the time without a labline among it is left alone: nothing is sent to it. What a port has
    answered is remembered for a moment, so that a doctor who asks for each kind in turn resets a board once only.
    """
    now_s = RealClock().now()
    asked_s, answer = _asked.get(port, (-_REMEMBERED_S, None))
    if now_s - asked_s >= _REMEMBERED_S:
        talk = _Talk("probe", port)
        try:
            answer = talk.hello()
        except DeviceError:
            return None
        finally:
            talk.close()
        _asked[port] = now_s, answer
    if answer is None or answer.fields[:3] != ("OK", "HELLO", kind) or len(answer.fields) != 6:
        return None
    _, _, _, firmware, channels, rate = answer.fields
    return Identity(kind, firmware=firmware, details={"channels": channels, "max_rate_hz": rate})


def stop_from_scratch(device: str, port: str) -> None:
    """Open a port and stop what the board there moves.

    Opening the port resets most boards, which turns their outputs off; the others answer ``STOP``.

    Raises
    ------
    DeviceError
        No port, or neither an answer nor a restart.
    """
    talk = _Talk(device, port)
    talk.open(patience_s=_DYING_S)
    try:
        for seq in (1, 2):
            if talk.ask(seq, "STOP") is not None or talk.booted:
                return
        if talk.wait(_is_boot, _BOOT_READS) and talk.ask(3, "STOP") is not None:
            return
        if not talk.booted:
            raise DeviceError(
                device,
                f"STOP stays unanswered at {port}",
                hint="switch its supply off by hand; its own watchdog should have stopped it",
            )
    finally:
        talk.close()


class _Talk:
    """A port, and the lines that come from it."""

    def __init__(self, device: str, port: str) -> None:
        self._port = SerialPort(device, port, BAUD, timeout_s=_READ_S)
        self._parser = LineParser()
        self._received = 0
        self.booted = False

    @property
    def strange(self) -> bool:
        """Tell whether what comes is not of this protocol."""
        return self._received > _STRANGE_BYTES and self._parser.accepted == 0

    def open(self, patience_s: float = 0.0) -> None:
        """Open the port; tries again for so long if it cannot be opened."""
        clock = RealClock()
        deadline_s = clock.now() + patience_s
        while True:
            try:
                return self._port.open()
            except DeviceError:
                if clock.now() >= deadline_s:
                    raise
                clock.sleep(_READ_S)

    def close(self) -> None:
        self._port.close()

    def hello(self) -> Line | None:
        """Open the port and ask who is there; None if nobody answers, or something else talks."""
        self.open()
        if not self.wait(_is_boot, _BOOT_READS) and self.strange:
            return None
        return self.ask(1, "HELLO") or self.ask(1, "HELLO")

    def ask(self, seq: int, word: str) -> Line | None:
        """Send a request; return its good answer, None without one."""
        self._port.write(encode(seq, word))

        def is_answer(line: Line) -> bool:
            return line.seq == seq and line.fields[:2] == ("OK", word)

        return self.wait(is_answer, _ANSWER_READS)

    def wait(self, wanted: Callable[[Line], bool], reads: int) -> Line | None:
        """Return the first line that is wanted; None after so many reads without one, or among strange bytes."""
        for _ in range(reads):
            data = self._port.read()
            self._received += len(data)
            previous = None
            for line in self._parser.feed(data):
                self.booted = self.booted or _is_boot(line)
                previous = previous or (line if wanted(line) else None)
            if previous is not None:
                return previous
            if self.strange:
                return None
        return None


def _is_boot(line: Line) -> bool:
    return line.seq == UNSOLICITED and line.fields[:2] == ("EV", "BOOT")
