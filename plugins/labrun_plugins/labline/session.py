"""A conversation with one board: requests and their answers, set-points, events, watchdog, stop; what refusals mean."""

import itertools
import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from labrun.devices import Clock, DeviceError, Listener, SerialPort
from labrun_plugins.labline.codec import LAST_SEQ, UNSOLICITED, Line, LineParser, encode

_CODES = {
    "WORD": ("does not know {word}", "flash the firmware that stands in the plugin's folder"),
    "ARGC": ("expects another number of values", "flash the firmware that stands in the plugin's folder"),
    "RANGE": (
        "a value is outside the limits it was given{where}; nothing of it was carried out",
        "keep the motion inside the device's limits in the experiment file",
    ),
    "STATE": ("this cannot be done in its present state{where}", "reset the board, then labrun resume"),
    "WDOG": (
        "its watchdog has expired, so it stopped by itself and refuses to move",
        "the computer or the line stalled: close other programs, look at the cable, or raise watchdog_ms; "
        "then labrun resume",
    ),
    "LIMIT": (
        "a limit switch or a force limit stopped it{where}",
        "look at the bench, bring it back inside its limits, then labrun resume",
    ),
    "HW": (
        "its hardware is at fault{where}",
        "look for a blocked mechanism, a loose wire or a weak supply; reset the board, then labrun resume",
    ),
}
_OTHER = ("it refuses{where}", "see the README of the plugin; labrun resume continues once it is fixed")


class LineRefusedError(DeviceError):
    """A board answered ``ERR``, or said by itself that it stopped.

    Parameters
    ----------
    word
        What it was asked.
    code, detail
        The error code (WORD, ARGC, RANGE, STATE, WDOG, LIMIT, HW), and what stands after it.
    """

    def __init__(self, device: str, word: str, code: str, detail: str = "") -> None:
        why, hint = _CODES.get(code, _OTHER)
        message = why.format(word=word, where=f" ({detail})" if detail else "")
        answer = f"ERR,{code}" + (f",{detail}" if detail else "")
        super().__init__(device, f"{message} (answer {answer} to {word})", hint=hint)
        self.word = word
        self.code = code
        self.detail = detail


class StoppedError(DeviceError):
    """A motion was not sent, because a stop came first."""


_LATE_S = 1.0
"""An answer that comes later than this comes never."""


@dataclass(slots=True)
class Awaited:
    """One request under way.

    Attributes
    ----------
    posted
        Nobody waits for its answer: a set-point, or a sign of life.
    answered, fields
        Set once the answer is there; ``OK`` or ``ERR``, and what stands behind it.
    """

    seq: int
    word: str
    posted: bool
    sent_s: float
    answered: threading.Event = field(default_factory=threading.Event)
    fields: tuple[str, ...] = ()


class Answers:
    """The requests under way.

    No lock guards them: a stop must not wait for a thread that a signal interrupted while it held one. Every single
    operation on numbers and table is atomic.

    Attributes
    ----------
    unanswered
        Set-points that never got their answer.
    waiting_since_s
        Since when set-points have stayed unanswered, s; None if none is.
    """

    def __init__(self, clock: Clock) -> None:
        self.unanswered = 0
        self.waiting_since_s: float | None = None
        self._clock = clock
        self._awaited: dict[int, Awaited] = {}
        self._numbers: Iterator[int] = itertools.count()

    def reset(self) -> None:
        """Await nothing; numbers go on."""
        self._awaited.clear()
        self.unanswered, self.waiting_since_s = 0, None

    def expect(self, word: str, *, posted: bool) -> Awaited:
        """Give a request its number; give up set-points whose answer never came."""
        now_s = self._clock.now()
        for older in list(self._awaited.values()):
            if older.posted and now_s - older.sent_s > _LATE_S:
                self.forget(older)
                self.unanswered += 1
        awaited = Awaited(next(self._numbers) % LAST_SEQ + 1, word, posted, now_s)
        self._awaited[awaited.seq] = awaited
        if posted and self.waiting_since_s is None:
            self.waiting_since_s = now_s
        return awaited

    def take(self, line: Line) -> Awaited | None:
        """Return the request that a line answers; None for a line that answers none under way."""
        awaited = self._awaited.get(line.seq)
        if awaited is None or line.word not in {"OK", "ERR"}:
            return None  # late, repeated or a stranger's: whoever asked has given up
        if line.word == "OK" and line.fields[1:2] != (awaited.word,):
            return None  # the answer to an older request of the same number
        self.waiting_since_s = None
        if awaited.posted:
            self.forget(awaited)
        awaited.fields = line.fields
        awaited.answered.set()
        return awaited

    def withdraw(self, awaited: Awaited) -> None:
        """Take back a set-point that was not sent after all."""
        self.forget(awaited)
        if self.waiting_since_s == awaited.sent_s:
            self.waiting_since_s = None

    def forget(self, awaited: Awaited) -> None:
        """Await an answer no longer."""
        self._awaited.pop(awaited.seq, None)


BAUD = 115_200
BOOT_WAIT_S = 3.0
"""How long a board may take to come up after its port was opened: that resets most of them."""
ANSWER_S = 0.1
"""How long an answer may take; a request is then sent once more."""
SILENT_S = 0.5
"""Set-points and signs of life that stay unanswered for so long mean that the board is gone."""
_STOP_LOCK_S = 0.03
"""How long a stop waits for a line that is being written, before it writes anyway."""
_FEEDS_PER_WATCHDOG = 4.0


@dataclass(frozen=True, slots=True)
class Hello:
    """What a board says it is.

    Attributes
    ----------
    kind, firmware
        Such as ``labservo`` and ``1.0``.
    channels
        How many servos or axes it drives.
    max_rate_hz
        Set-points or samples it takes or gives a second.
    """

    kind: str
    firmware: str
    channels: int
    max_rate_hz: float


class LineSession:
    """The host's end of a labline, with a thread that listens.

    Any thread may call anything. Answers are told apart by their sequence number, so that a stop never waits for the
    answer to something else.

    Parameters
    ----------
    boot_wait_s
        How long `open` waits for the board to come up; 0 for one that opening its port does not reset.
    on_sample, on_event
        Called by the listening thread with the fields behind ``S`` or ``EV`` and the host time of receipt, s. Events
        BOOT (unexpected) and WDOG are made errors by the session itself; `on_event` gets every one all the same.
    """

    def __init__(
        self,
        device: str,
        port: str,
        clock: Clock,
        *,
        boot_wait_s: float = BOOT_WAIT_S,
        on_sample: Callable[[tuple[str, ...], float], None] | None = None,
        on_event: Callable[[tuple[str, ...], float], None] | None = None,
    ) -> None:
        self.device = device
        self.counts = LineParser()
        self.watchdog_ms = 0
        """What the board's watchdog is set to; 0 while it is off."""
        self._clock = clock
        self._boot_wait_s = boot_wait_s
        self._on_sample = on_sample
        self._on_event = on_event
        self._port = SerialPort(device, port, BAUD)
        self._listener = Listener(device, self._receive)
        self._writing = threading.Lock()
        self._answers = Answers(clock)
        self._stops = 0
        self._booted = threading.Event()
        self._opening = False
        self._failure: DeviceError | None = None
        self._written_s = 0.0

    @property
    def unanswered(self) -> int:
        """Set-points that never got their answer."""
        return self._answers.unanswered

    @property
    def is_open(self) -> bool:
        """Tell whether the port is open."""
        return self._port.is_open

    def open(self, kind: str) -> Hello:
        """Open the port, wait for the board to come up, and ask what it is.

        Raises DeviceError: no port, no answer, or a board of another kind; the port is closed again.
        """
        self.close()
        self.counts.reset()
        self._failure, self.watchdog_ms = None, 0
        self._answers.reset()
        self._booted.clear()
        self._opening = True
        self._port.open()
        self._listener.start()
        try:
            if self._boot_wait_s > 0:
                self._booted.wait(self._boot_wait_s)
            hello = self._hello()
            if hello.kind != kind:
                raise DeviceError(
                    self.device,
                    f"the board at {self._port.port} is a {hello.kind!r}, expected a {kind!r}",
                    hint="set the right port (labrun doctor --hardware tells who is where), or flash its firmware",
                )
        except BaseException:
            self.close()
            raise
        finally:
            self._opening = False
        return hello

    def request(self, word: str, *args: str | int, token: int | None = None) -> tuple[str, ...]:
        """Send a request, once more after 100 ms without an answer; return the fields behind ``OK,<word>``.

        Parameters
        ----------
        word, args
            What the line says.
        token
            From `motion_token`, for a request that moves something: it is not sent, nor sent again, after a stop.

        Raises
        ------
        LineRefusedError
            The board answered ``ERR``.
        StoppedError
            A stop came first.
        DeviceError
            No answer, or the port is gone.
        """
        self.check()
        awaited = self._answers.expect(word, posted=False)
        message = encode(awaited.seq, word, *args)
        try:
            for _ in range(2):
                if not self._write(message, token):
                    raise StoppedError(self.device, f"{word} was not sent, because a stop was commanded")
                if awaited.answered.wait(ANSWER_S):
                    return self._result(awaited)
                self.check()
        finally:
            self._answers.forget(awaited)
        raise self._no_answer(word)

    def post(self, word: str, *args: str | int, token: int | None = None) -> bool:
        """Send a set-point or a sign of life without waiting; its answer is looked at when it comes.

        It is not sent again: the next one says it all. An ``ERR``, or none of them answered for 0.5 s, is raised by
        the next call of anything.

        Returns
        -------
        bool
            Whether it was sent: not if a stop came after `token` was taken.
        """
        self.check()
        awaited = self._answers.expect(word, posted=True)
        sent = self._write(encode(awaited.seq, word, *args), token)
        if not sent:
            self._answers.withdraw(awaited)
        return sent

    def motion_token(self) -> int:
        """Return what a motion is sent with, taken at the very beginning of a command: a later stop makes it void."""
        return self._stops

    def stop(self) -> bool:
        """Send ``STOP``, once more if it stays unanswered; return whether it was answered. Never raises.

        From the moment of the call on nothing that moves is sent with an older token. Waits 30 ms at most for a line
        that another thread is writing.
        """
        self._stops += 1
        awaited = self._answers.expect("STOP", posted=False)
        try:
            message = encode(awaited.seq, "STOP")
            for _ in range(2):
                self._write_at_once(message)
                if awaited.answered.wait(ANSWER_S):
                    return awaited.fields[:1] == ("OK",)
        except Exception:  # a stop must not raise; the board's own watchdog covers a line that is cut
            return False
        finally:
            self._answers.forget(awaited)
        return False

    def arm(self, watchdog_ms: int) -> None:
        """Set the board's watchdog: without a good line for so long it stops by itself; 0 turns it off.

        Raises DeviceError: refused (0 while something moves), or the board took another value.
        """
        answer = self.request("WD", watchdog_ms)
        if answer != (str(watchdog_ms),):
            raise DeviceError(
                self.device,
                f"was given a watchdog of {watchdog_ms} ms and answered {','.join(answer) or 'nothing'}",
                hint="flash the firmware that stands in the plugin's folder",
            )
        self.watchdog_ms = watchdog_ms

    def feed(self) -> None:
        """Give the board a sign of life, if nothing was sent for a quarter of its watchdog's time."""
        if self.watchdog_ms and self._clock.now() - self._written_s >= self.feed_every_s:
            self.post("PING")

    @property
    def feed_every_s(self) -> float:
        """How often `feed` has something to send, s."""
        return max(self.watchdog_ms, 20) / 1000.0 / _FEEDS_PER_WATCHDOG

    def check(self) -> None:
        """Raise what the listening thread met: unplugged, watchdog expired, restarted, a set-point refused."""
        if self._failure is not None:
            raise self._failure
        self._listener.check()

    def fail(self, failure: DeviceError) -> None:
        """Make this the error that every later call raises, until `open`; the first one counts."""
        self._fail(failure)

    def close(self) -> None:
        """Close the port; harmless when it is closed. Leaves the board's watchdog as it is. Never raises."""
        self._listener.stop()
        self._port.close()

    def _hello(self) -> Hello:
        answer = self.request("HELLO")
        try:
            kind, firmware, channels, rate = answer
            return Hello(kind, firmware, int(channels), float(rate))
        except ValueError as error:
            raise DeviceError(
                self.device,
                f"its HELLO answered {','.join(answer)!r}, expected kind, firmware, channels and rate",
                hint="flash the firmware that stands in the plugin's folder",
            ) from error

    def _receive(self) -> None:
        data = self._port.read()
        now_s = self._clock.now()
        for line in self.counts.feed(data):
            self._hear(line, now_s)
        since_s = self._answers.waiting_since_s
        if not data and since_s is not None and now_s - since_s > SILENT_S:
            self._fail(self._no_answer("its set-points"))

    def _hear(self, line: Line, now_s: float) -> None:
        if line.seq != UNSOLICITED:
            self._answer(line)
        elif line.word == "S" and self._on_sample is not None:
            self._on_sample(line.fields[1:], now_s)
        elif line.word == "EV":
            self._event(line.fields[1:], now_s)

    def _event(self, fields: tuple[str, ...], now_s: float) -> None:
        what = fields[0] if fields else ""
        if what == "BOOT" and self._opening:
            self._booted.set()
        elif what == "BOOT":
            self.watchdog_ms = 0
            self._fail(
                DeviceError(
                    self.device,
                    "the board restarted by itself; its outputs are off",
                    hint="look at its supply (servos pull it down) and its cable, then labrun resume",
                )
            )
        elif what == "WDOG" and self.watchdog_ms:  # one that was armed before `open` is no news
            limit_ms, self.watchdog_ms = self.watchdog_ms, 0
            self._fail(LineRefusedError(self.device, "the last commands", "WDOG", f"{limit_ms} ms"))
        if self._on_event is not None:
            self._on_event(fields, now_s)

    def _answer(self, line: Line) -> None:
        awaited = self._answers.take(line)
        if awaited is not None and awaited.posted and line.word == "ERR":
            self._fail(self._refusal(awaited))

    def _result(self, awaited: Awaited) -> tuple[str, ...]:
        if awaited.fields[0] == "ERR":
            raise self._refusal(awaited)
        return awaited.fields[2:]

    def _refusal(self, awaited: Awaited) -> LineRefusedError:
        code, *detail = awaited.fields[1:] or ("",)
        return LineRefusedError(self.device, awaited.word, code, ",".join(detail))

    def _write(self, message: bytes, token: int | None) -> bool:
        """Write a line, unless a stop has made its token void; return whether it was written."""
        with self._writing:
            if token is not None and token != self._stops:
                return False
            self._port.write(message)
            self._written_s = self._clock.now()
            return True

    def _write_at_once(self, message: bytes) -> None:
        """Write a line, in the midst of another if that takes long: the board resumes at the last ``$``."""
        if self._writing.acquire(timeout=_STOP_LOCK_S):
            try:
                self._port.write(message)
            finally:
                self._writing.release()
        elif self._port.serial is not None:
            os.write(self._port.serial.fileno(), message)

    def _fail(self, failure: DeviceError) -> None:
        if self._failure is None:
            self._failure = failure

    def _no_answer(self, word: str) -> DeviceError:
        damaged = f", and {self.counts.rejected} damaged lines came" if self.counts.rejected else ""
        return DeviceError(
            self.device,
            f"does not answer {word} at {self._port.port}{damaged}",
            hint="check its cable and power, press the board's reset, then labrun resume",
        )
