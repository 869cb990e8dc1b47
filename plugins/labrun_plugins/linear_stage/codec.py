"""What stands in the stage's lines: arguments of its words, samples and states."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag

from labrun_plugins.linear_stage.calibration import FULL_SCALE_COUNTS, LEAST_COUNTS

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
        """Whether the amplifier is at the end of its range, by its flag or by its value."""
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


def counts_of(raw: bytes) -> int:
    """Return the counts of an HX711's three bytes: two's complement, most significant first.

    Raises
    ------
    ValueError
        Not three bytes.
    """
    if len(raw) != 3:
        raise ValueError(f"an HX711 gives three bytes, not {len(raw)}")
    return int.from_bytes(raw, "big", signed=True)


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


def velocity_argument(speed_mm_s: float) -> str:
    """Return the argument of ``VEL``: a signed speed."""
    return f"{speed_mm_s:.3f}"


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
