"""Numbers as people read them."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from labrun.spec.experiment import Value

if TYPE_CHECKING:
    from labrun.report.statistics import StreamHealth

_UNIT_OF_SUFFIX = {
    "deg": "deg",
    "hz": "Hz",
    "rad": "rad",
    "s": "s",
    "m": "m",
    "mm": "mm",
    "n": "N",
    "kg": "kg",
    "c": "°C",
}


def condition_text(condition: Mapping[str, Value]) -> str:
    """Return ``a = 60, f = 1.4, fin = soft``."""
    return ", ".join(f"{name} = {value_text(value)}" for name, value in condition.items())


def value_text(value: Value) -> str:
    """Return a value with as many digits as a person can use."""
    return value if isinstance(value, str) else f"{value:.4g}"


def value_with_unit(value: Value, unit: str) -> str:
    """Return a condition's value with its unit; "1" is none, and words have none."""
    return value if isinstance(value, str) else quantity_text(value, unit)


def quantity_text(value: float, unit: str) -> str:
    """Return a number with its unit; "1" is none."""
    return f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}".rstrip()


def interval_text(value: float, ci95: tuple[float, float] | None, unit: str) -> str:
    """Return ``0.412 [0.398, 0.426] N``."""
    if ci95 is None:
        return quantity_text(value, unit)
    return f"{value:.4g} [{ci95[0]:.4g}, {ci95[1]:.4g}] {'' if unit == '1' else unit}".rstrip()


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


def clock_text(stream: "StreamHealth") -> tuple[str, str]:
    """Return a device's clock offset and drift: ``12.03 s``, ``5.2 ppm``; empty where they are not known."""
    offset_s, drift_ppm = stream.clock_offset_s, stream.clock_drift_ppm
    return (
        "" if offset_s is None else f"{offset_s:.4g} s",
        "" if drift_ppm is None else f"{drift_ppm:.3g} ppm",
    )


def label(name: str, units: Mapping[str, str]) -> str:
    """Return an axis label: the name with its unit, as the file states it or as the name's ending says."""
    stem, _, ending = name.rpartition("_")
    if name not in units and stem and ending in _UNIT_OF_SUFFIX:
        return f"{stem.replace('_', ' ')} ({_UNIT_OF_SUFFIX[ending]})"
    unit = units.get(name, "")
    unit = "" if unit == "1" else unit
    shown = name.replace("_", " ")
    return f"{shown} ({unit})" if unit else shown
