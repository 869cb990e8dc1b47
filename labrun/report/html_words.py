"""Numbers, conditions and counts as a report writes them."""

import math
from collections.abc import Iterable, Mapping

from labrun.fit.estimate import Estimate, rounded
from labrun.report.words import value_with_unit
from labrun.spec.experiment import Value


def condition_with_units(condition: Mapping[str, Value], units: Mapping[str, str]) -> str:
    """Return ``b = 0 deg, f = 1.4 Hz``, with spaces that do not break within a value."""
    parts = (f"{name} = {value_with_unit(value, units.get(name, ''))}" for name, value in condition.items())
    return ", ".join(part.replace(" ", "\u00a0") for part in parts) or "the only condition"


def interval_words(value: float, ci95: tuple[float, float] | None, unit: str) -> tuple[str, str]:
    """Return a value and its interval, both with their unit and with the digits the interval supports."""
    if ci95 is None:
        return f"{value:.4g} {unit}".rstrip(), ""
    middle, low, high = rounded(Estimate(value, ci95, unit))
    return f"{middle} {unit}".rstrip(), f"{low} to {high} {unit}".rstrip()


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


def scatter_text(value: float, unit: str) -> str:
    """Return a standard deviation, of which more than two digits are never known."""
    return f"{value:.2g} {unit}".rstrip()


def slope_words(value: float, ci95: tuple[float, float], unit: str) -> str:
    """Return ``-0.012 N/h (95 % interval -0.106 to 0.083)``."""
    middle, low, high = rounded(Estimate(value, ci95, unit))
    return (
        f"{middle} {unit}/h (95 % interval {low} to {high})"
        if unit
        else f"{middle} per hour ({low} to {high})"
    )


def counted(number: int, word: str) -> str:
    """Return ``1 trial`` or ``12 trials``."""
    return f"{number:,} {word}{'' if number == 1 else 's'}".replace(",", "\u202f")


def share_text(part: float, whole: float) -> str:
    """Return a share in per cent, with a digit more where it is small."""
    share = 100 * part / whole if whole else 0.0
    return f"{share:.2g} %" if 0 < share < 10 else f"{share:.0f} %"


def spaced(name: str) -> str:
    """Return a name of a file as words."""
    return name.replace("_", " ")
