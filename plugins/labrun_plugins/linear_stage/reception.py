"""What stands in the stage's lines, and what becomes of its samples and events: counted, timed, rows for the runner."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntFlag

from labrun.devices import DeviceError, SampleBuffer, Samples
from labrun.errors import LimitExceededError
from labrun_plugins.linear_stage.settings import FULL_SCALE_COUNTS, LEAST_COUNTS, Line

WORD_BITS = 32
_SAMPLE_FIELDS = 5
_STATE_FIELDS = 4
_MOST_DIGITS = 12


class Flags(IntFlag):
    """What the board says about itself with every sample."""

    MOVING = 1
    HOMED = 2
    LOW_LIMIT = 4
    HIGH_LIMIT = 8
    FORCE_LIMIT = 16
    SATURATED = 32
    NOT_READY = 64
    WATCHDOG = 128


@dataclass(frozen=True, slots=True)
class StageSample:
    """Position and force, latched together when the load cell's amplifier was ready.

    Attributes
    ----------
    n, micros
        Number of the sample and the board's microseconds; both wrap at 2^32.
    position_mm
        From the lower end switch.
    counts
        Of the amplifier.
    flags
        As the board has them; see also `saturated`.
    """

    n: int
    micros: int
    position_mm: float
    counts: int
    flags: Flags

    @property
    def saturated(self) -> bool:
        """Tell whether the amplifier is at the end of its range, by its flag or by its value."""
        return is_saturated(self.counts) or Flags.SATURATED in self.flags


@dataclass(frozen=True, slots=True)
class StageState:
    """Answer to ``ST``: flags, position, latest counts, and the board's milliseconds."""

    flags: Flags
    position_mm: float
    counts: int
    millis: int


def is_saturated(counts: int) -> bool:
    """Tell whether these counts are at or beyond either end of 24 bits."""
    return counts >= FULL_SCALE_COUNTS or counts <= LEAST_COUNTS


def parse_sample(fields: Sequence[str]) -> StageSample | None:
    """Return the sample of the fields behind ``S``; None for anything that is none."""
    if len(fields) != _SAMPLE_FIELDS:
        return None
    n, micros = _whole(fields[0]), _whole(fields[1])
    position_mm, counts, flags = _decimal(fields[2]), _whole(fields[3]), _whole(fields[4])
    if n is None or micros is None or position_mm is None or counts is None or flags is None:
        return None
    if not (0 <= n < 2**WORD_BITS and 0 <= micros < 2**WORD_BITS and 0 <= flags <= 0xFF):
        return None
    if not LEAST_COUNTS <= counts <= FULL_SCALE_COUNTS:
        return None
    return StageSample(n, micros, position_mm, counts, Flags(flags))


def parse_state(fields: Sequence[str]) -> StageState | None:
    """Return the state of the fields behind ``OK,ST``; None for anything that is none."""
    if len(fields) != _STATE_FIELDS:
        return None
    flags, position_mm = _whole(fields[0]), _decimal(fields[1])
    counts, millis = _whole(fields[2]), _whole(fields[3])
    if flags is None or position_mm is None or counts is None or millis is None:
        return None
    if not (
        0 <= flags <= 0xFF and 0 <= millis < 2**WORD_BITS and LEAST_COUNTS <= counts <= FULL_SCALE_COUNTS
    ):
        return None
    return StageState(Flags(flags), position_mm, counts, millis)


def move_arguments(position_mm: float, speed_mm_s: float) -> tuple[str, str]:
    """Return the arguments of ``MV``: an absolute position and a speed above zero, in thousandths.

    A speed is rounded up, so that a slow one does not become none.
    """
    return f"{position_mm:.3f}", f"{max(1, math.ceil(1e3 * speed_mm_s - 1e-6)) / 1e3:.3f}"


def limit_arguments(low_mm: float, high_mm: float, most_counts: int) -> tuple[str, str, str]:
    """Return the arguments of ``LIM``; positions are rounded inwards."""
    low = math.ceil(1e3 * low_mm - 1e-6) / 1e3
    high = math.floor(1e3 * high_mm + 1e-6) / 1e3
    return f"{low:.3f}", f"{high:.3f}", str(most_counts)


def _whole(text: str) -> int | None:
    digits = text[1:] if text[:1] in {"-", "+"} else text
    if not (digits.isascii() and digits.isdigit()) or len(digits) > _MOST_DIGITS:
        return None
    return int(text)


def _decimal(text: str) -> float | None:
    digits = text[1:] if text[:1] in {"-", "+"} else text
    before, _, after = digits.partition(".")
    if not ((before + after).isascii() and (before + after).isdigit()) or len(digits) > _MOST_DIGITS:
        return None
    return float(text)


_WORD = 2**32
_HALF = 2**31
_RESTART_SAMPLES = 8
"""So many samples in a row that count up from behind the last one are no stragglers: the count began anew."""


def ahead(value: int, reference: int) -> int:
    """Return how far a 32-bit counter is ahead of a reference, negative behind it."""
    return (value - reference + _HALF) % _WORD - _HALF


@dataclass
class SampleCounter:
    """Takes the numbers of samples as they come; a sample that came twice or too late is not taken again.

    Attributes
    ----------
    repeated
        Samples that were not taken: duplicates and stragglers. A straggler was counted as lost before.
    restarted
        Whether the numbers began anew.
    """

    repeated: int = 0
    restarted: bool = False
    _last: int | None = None
    _behind: int = 0
    _behind_at: int = 0

    def take(self, n: int) -> int | None:
        """Return how many samples are missing before this one; None if it is not to be taken."""
        if self._last is None:
            self._last = n
            return 0
        step = ahead(n, self._last)
        if step > 0:
            self._last, self._behind = n, 0
            return step - 1
        self.repeated += 1
        self._behind = self._behind + 1 if self._behind and ahead(n, self._behind_at) == 1 else 1
        self._behind_at = n
        self.restarted = self.restarted or self._behind >= _RESTART_SAMPLES
        return None


@dataclass
class DeviceClock:
    """The board's microseconds without their wrap every 71.6 minutes."""

    _micros: int | None = None
    _whole_us: int = 0

    def time_s(self, micros: int) -> float:
        """Return the time of a sample, s on the board's clock."""
        self._whole_us = micros if self._micros is None else self._whole_us + ahead(micros, self._micros)
        self._micros = micros
        return 1e-6 * self._whole_us


_NOT_READY_S = 0.5
_SWITCHES = {"LOW": "the lower end switch", "HIGH": "the upper end switch"}


class Reception:
    """Takes samples and events in the listening thread.

    Parameters
    ----------
    line
        Calibration; None leaves the column of the force out.
    zero_mm
        Where displacement is zero.
    force_n
        Limit of the force; None for none.
    on_fault
        Called with the error at the first sample or event that must not go on.
    """

    def __init__(
        self,
        device: str,
        line: Line | None,
        zero_mm: float,
        force_n: float | None,
        on_fault: Callable[[DeviceError], None],
    ) -> None:
        self._device = device
        self._line = line
        self._zero_mm = zero_mm
        self._force_n = force_n
        self._on_fault = on_fault
        self._buffer = SampleBuffer(2 if line is None else 3)
        self._minding = True
        self._counter = SampleCounter()
        self._clock = DeviceClock()
        self._latest: tuple[StageSample, float] | None = None
        self._not_ready_from_s: float | None = None
        self._not_ready_s = 0.0

    @property
    def latest(self) -> tuple[StageSample, float] | None:
        """The latest good sample and its host time, s; None before any."""
        return self._latest

    def start(self) -> None:
        """Forget what came before."""
        self._counter = SampleCounter()
        self._clock = DeviceClock()
        self._latest = None
        self._not_ready_from_s, self._not_ready_s = None, 0.0
        self._buffer.clear()

    def mind_limits(self, mind: bool) -> None:
        """Say whether a limit that has stopped the board is a fault, or is just being backed out of."""
        self._minding = mind

    def take(self) -> Samples:
        """Return the samples since the last call.

        Raises DeviceError: the amplifier of the load cell has not been ready for long.
        """
        if self._not_ready_s > _NOT_READY_S:
            raise DeviceError(
                self._device,
                f"the amplifier of the load cell (HX711) has given nothing for {self._not_ready_s:.2g} s",
                hint="check its supply and the wires DOUT and SCK, then labrun resume",
            )
        return self._buffer.take()

    def sample(self, fields: tuple[str, ...], host_s: float) -> None:
        """Take the fields of a sample line."""
        sample = parse_sample(fields)
        if sample is None:
            return
        missing = self._counter.take(sample.n)
        if self._counter.restarted:
            self._on_fault(
                DeviceError(
                    self._device,
                    "the board restarted by itself: its sample numbers started again",
                    hint="look at its supply and its cable, then labrun resume",
                )
            )
        if missing is None:
            return
        if Flags.NOT_READY in sample.flags:  # its counts are those of an earlier sample: no measurement
            if self._not_ready_from_s is None:
                self._not_ready_from_s = host_s
            self._not_ready_s = host_s - self._not_ready_from_s
            self._buffer.count_lost(missing + 1)
            return
        self._not_ready_from_s, self._not_ready_s = None, 0.0
        self._latest = (sample, host_s)
        row = [1e-3 * (sample.position_mm - self._zero_mm), float(sample.counts)]
        if self._line is not None:
            row.insert(1, float(self._line.force_n(sample.counts)))
        device_s = self._clock.time_s(sample.micros)
        self._buffer.put(device_s, host_s, row, lost=missing, saturated=int(sample.saturated))
        self._mind(sample, row[1])

    def event(self, fields: tuple[str, ...], _host_s: float) -> None:
        """Take the fields of an event line: a limit that stopped the stage."""
        if fields[:1] != ("LIMIT",) or not self._minding:
            return
        self._on_fault(limit_error(self._device, fields[1] if len(fields) > 1 else "", None))

    def _mind(self, sample: StageSample, force_n: float) -> None:
        if not self._minding:
            return
        if Flags.FORCE_LIMIT in sample.flags:
            self._on_fault(limit_error(self._device, "FORCE", None if self._line is None else force_n))
        elif self._force_n is not None and abs(force_n) > self._force_n:
            self._on_fault(
                LimitExceededError(
                    self._device,
                    f"force {force_n:.4g} N is beyond the limit of {self._force_n:g} N; a stop was commanded",
                    hint="look at the bench before labrun resume, or change limits.force_n in the file",
                )
            )


def limit_error(device: str, which: str, force_n: float | None) -> LimitExceededError:
    """Return the error for a stop by the board itself."""
    if which == "FORCE":
        felt = "" if force_n is None else f" at {force_n:.3g} N"
        return LimitExceededError(
            device,
            f"the board stopped{felt}: the force limit it was given is exceeded",
            hint="look at the beam; relieve it (the stage only moves back), then labrun resume",
        )
    if which == "CELL":
        return LimitExceededError(
            device,
            "the board stopped: the amplifier of the load cell (HX711) gives nothing, so that nobody feels the force",
            hint="check its supply and the wires DOUT and SCK, then labrun resume",
        )
    return LimitExceededError(
        device,
        f"the board stopped at {_SWITCHES.get(which, 'a limit of its travel')}",
        hint="stroke_mm does not fit the stage, or it lost steps: home it again, then labrun resume",
    )


def complaints(flags: Flags, *, homes: bool = False) -> tuple[str, ...]:
    """Return what is not well by the board's flags, in words.

    `flags`: of a sample or a state. `homes`: whether a run homes it anyway, so that a stage that is not homed is well.
    """
    hints = {
        Flags.FORCE_LIMIT: "the force limit has stopped it: relieve the beam",
        Flags.SATURATED: "the load cell is at the end of its range",
        Flags.NOT_READY: "the amplifier of the load cell (HX711) gives nothing",
        Flags.WATCHDOG: "its watchdog has stopped it: labrun resume arms it again",
    }
    active_hints = [words for flag, words in hints.items() if flag in flags]
    if Flags.HOMED not in flags and not homes:
        active_hints.insert(
            0, "it is not homed: set home_on_open = true, or move it to its lower end switch by HOME"
        )
    return tuple(active_hints)
