"""Numbers, units and conditions in words: every table, page, figure and live display takes them from here."""

import math
from collections.abc import Iterable, Mapping, Sequence

from labrun.estimate import Estimate, rounded, significant
from labrun.experiment import Condition, Value
from labrun.experiment import condition_text as plain_condition_text
from labrun.experiment import value_text as plain_value_text
from labrun.toml import UNITS, split_unit

_DIGITS = 4
_NO_BREAK = "\u00a0"

# Units and names


def unit_text(unit: str) -> str:
    """Return a unit as it is written after a number; "1" is none."""
    return "" if unit == "1" else unit


def with_unit(text: str, unit: str) -> str:
    """Return ``thrust (N)``; without a unit the text alone."""
    return f"{text} ({unit})" if unit_text(unit) else text


def spaced(name: str) -> str:
    """Return a name of a file as words."""
    return name.replace("_", " ")


def label(name: str, units: Mapping[str, str]) -> str:
    """Return an axis label: the name with its unit, as the file states it or as the name's ending says.

    A unit that both say stands there once: ``history (s)`` of ``history_s``.
    """
    stem, suffix = split_unit(name)
    unit = "" if suffix is None else UNITS[suffix].label
    if name in units:
        return with_unit(spaced(stem if unit == units[name] else name), units[name])
    return with_unit(spaced(stem), "°C" if unit == "degC" else unit)


def counted(number: int, word: str) -> str:
    """Return ``1 trial`` or ``12 trials``."""
    return f"{number:,} {word}{'' if number == 1 else 's'}".replace(",", "\u202f")


def listed(parts: Sequence[str], last: str = "and") -> str:
    """Return ``a``, ``a and b``, ``a, b and c``."""
    return f"{', '.join(parts[:-1])} {last} {parts[-1]}" if len(parts) > 1 else "".join(parts)


def aligned(rows: Sequence[Sequence[str]], words: int | None = None) -> list[str]:
    """Return rows of cells as lines whose columns are under each other: the first `words` set to the left, or all."""
    sides = ["<" if words is None or column < words else ">" for column in range(len(rows[0]))]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            f"{cell:{side}{width}}" for cell, side, width in zip(row, sides, widths, strict=True)
        ).rstrip()
        for row in rows
    ]


def capital(text: str) -> str:
    """Return a text that begins with a capital."""
    return text[:1].upper() + text[1:]


# Conditions


def value_text(value: Value, unit: str = "") -> str:
    """Return a condition's value with as many digits as a person can use."""
    return plain_value_text(value, unit, digits=_DIGITS)


def condition_text(
    condition: Condition, units: Mapping[str, str] | None = None, *, unbroken: bool = False
) -> str:
    """Return ``a = 60 deg, f = 1.4 Hz, fin = soft``.

    Parameters
    ----------
    condition
        Its values.
    units
        Of the values; none where they stand elsewhere.
    unbroken
        Whether a line must never end within a value.
    """
    units = units or {}
    if not unbroken:
        return plain_condition_text(condition, units, digits=_DIGITS)
    parts = (
        plain_condition_text({name: value}, units, digits=_DIGITS).replace(" ", _NO_BREAK)
        for name, value in condition.items()
    )
    return ", ".join(parts)


def named_condition(condition: Condition, units: Mapping[str, str]) -> str:
    """Return a condition as a part of a sentence; one without values is the only one there is."""
    return condition_text(condition, units, unbroken=True) or "the only condition"


# Numbers


def quantity_text(value: float, unit: str, digits: int = _DIGITS) -> str:
    """Return a number with its unit; "1" is none."""
    return f"{value:.{digits}g} {unit_text(unit)}".rstrip()


def scatter_text(value: float, unit: str) -> str:
    """Return a standard deviation, of which more than two digits are never known."""
    return quantity_text(value, unit, 2)


def interval_text(value: float, ci95: tuple[float, float] | None, unit: str) -> str:
    """Return ``0.412 [0.398, 0.426] N``."""
    if ci95 is None:
        return quantity_text(value, unit)
    return f"{value:.4g} [{ci95[0]:.4g}, {ci95[1]:.4g}] {unit_text(unit)}".rstrip()


def interval_words(value: float, ci95: tuple[float, float] | None, unit: str) -> tuple[str, str]:
    """Return a value and its interval, both with their unit and with the digits the interval supports."""
    if ci95 is None:
        return quantity_text(value, unit), ""
    middle, low, high = rounded(Estimate(value, ci95, unit))
    return f"{middle} {unit_text(unit)}".rstrip(), f"{low} to {high} {unit_text(unit)}".rstrip()


def slope_words(value: float, ci95: tuple[float, float], unit: str) -> str:
    """Return ``-0.012 N/h (95 % interval -0.106 to 0.083)``."""
    middle, low, high = rounded(Estimate(value, ci95, unit))
    unit = unit_text(unit)
    return (
        f"{middle} {unit}/h (95 % interval {low} to {high})"
        if unit
        else f"{middle} per hour ({low} to {high})"
    )


def decimals_for(errors: Iterable[float | None]) -> int | None:
    """Return how many decimals a column of means deserves: two digits of its typical standard error."""
    known = sorted(error for error in errors if error is not None and math.isfinite(error) and error > 0)
    if not known:
        return None
    return min(max(0, 1 - math.floor(math.log10(known[len(known) // 2]))), 9)


def decimal_text(value: float | None, decimals: int | None) -> str:
    """Return a number of a column with its decimals; four digits where nothing says how many it deserves."""
    if value is None:
        return ""
    if decimals is None or abs(value) >= 1e6 or decimals > 6:
        return f"{value:.4g}"
    text = f"{value:.{decimals}f}"
    return text if float(text) != 0.0 or value == 0.0 else f"{value:.1g}"


def number(value: float, digits: int = 3) -> str:
    """Return a number with so many digits; what has no limit says so."""
    if math.isnan(value):
        return "not known"
    if math.isinf(value):
        return "no limit" if value > 0 else "no lower limit"
    return significant(value, digits)


def share_text(part: float, whole: float = 1.0) -> str:
    """Return a share in per cent, with a digit more where it is small."""
    share = 100 * part / whole if whole else 0.0
    return f"{share:.2g} %" if 0 < share < 10 else f"{share:.0f} %"


def percent(share: float) -> str:
    """Return a share in per cent; what rounds to nothing or to all without being it says so."""
    if not math.isfinite(share):
        return number(share)
    if 0 < share < 0.005:
        return "< 1\u00a0%"
    if 0.995 <= share < 1:
        return f"{math.floor(1000 * share) / 10:g}\u00a0%"
    text = f"{100 * share:.0f}" if abs(share) < 1e4 else f"{100 * share:.2g}"
    return f"{'0' if text == '-0' else text}\u00a0%"


def p_words(p: float | None) -> str:
    """Return ``p = 0.002``, or "" if unknown."""
    if p is None:
        return ""
    level = "< 0.001" if p < 0.001 else f"= {p:.2g}" if p < 0.1 else f"= {p:.1f}"
    return f"p {level}".replace(" ", _NO_BREAK)


def bytes_text(count: float) -> str:
    """Return a number of bytes in a unit that suits it."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} TB"


# Times


def duration_text(duration_s: float) -> str:
    """Return ``12 s``, ``3 min 20 s``, ``5 h 07 min`` or ``2 d 4 h``."""
    seconds = round(duration_s)
    if seconds < 60:
        return f"{seconds} s"
    minutes, seconds = divmod(seconds, 60)
    if minutes < 60:
        return f"{minutes} min {seconds:02d} s"
    hours, minutes = divmod(minutes, 60)
    if hours < 48:
        return f"{hours} h {minutes:02d} min"
    return f"{hours // 24} d {hours % 24} h"


def short_time_text(duration_s: float) -> str:
    """Return a time of seconds with its fractions, ``0.8 s`` or ``12.3 s``; longer ones as `duration_text` does."""
    return f"{duration_s:.3g} s" if duration_s < 60 else duration_text(duration_s)


def milliseconds_text(time_s: float) -> str:
    """Return ``1.25 ms``."""
    return f"{1000 * time_s:.3g} ms"
