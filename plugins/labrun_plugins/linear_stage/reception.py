"""What becomes of the stage's samples and events: counted, timed, rows for the runner; what is wrong for the driver."""

from collections.abc import Callable
from dataclasses import dataclass

from labrun.devices import DeviceError, SampleBuffer, Samples
from labrun.errors import LimitExceededError
from labrun_plugins.linear_stage.calibration import Line
from labrun_plugins.linear_stage.codec import Flags, StageSample, parse_sample

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
    device
        The device's name, for messages.
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

        Raises
        ------
        DeviceError
            The amplifier of the load cell has not been ready for long.
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
                    "the board restarted by itself: the numbers of its samples began anew",
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
                    f"force {force_n:.4g} N is beyond the limit of {self._force_n:g} N; it was told to stop",
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

    Parameters
    ----------
    flags
        Of a sample or a state.
    homes
        Whether a run homes it anyway, so that a stage that is not homed is well.
    """
    told = {
        Flags.FORCE_LIMIT: "the force limit has stopped it: relieve the beam",
        Flags.SATURATED: "the load cell is at the end of its range",
        Flags.NOT_READY: "the amplifier of the load cell (HX711) gives nothing",
        Flags.WATCHDOG: "its watchdog has stopped it: labrun resume arms it again",
    }
    found = [words for flag, words in told.items() if flag in flags]
    if Flags.HOMED not in flags and not homes:
        found.insert(
            0, "it is not homed: set home_on_open = true, or move it to its lower end switch by HOME"
        )
    return tuple(found)
