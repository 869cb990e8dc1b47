"""Names that people type: the nearest known to a wrong one, and the unit at the end of a key."""

import difflib
import math
from collections.abc import Iterable
from typing import NamedTuple


def nearest(name: str, known: Iterable[str], *, cutoff: float = 0.6) -> str | None:
    """Return the known name most like `name`, whatever its case, or None if none is alike.

    Parameters
    ----------
    name
        What was found.
    known
        What there is.
    cutoff
        Least likeness, from 0 (anything) to 1 (equal), as in `difflib.get_close_matches`.
    """
    candidates = list(known)
    folded = {candidate.casefold(): candidate for candidate in reversed(candidates)}
    matches = difflib.get_close_matches(name.casefold(), folded, n=1, cutoff=cutoff)
    if matches:
        return folded[matches[0]]
    # Names of one letter are like nothing: "freq" or "f0" for "f".
    starts = [known for key, known in folded.items() if key and name.casefold().startswith(key)]
    return starts[0] if len(starts) == 1 else None


def suggest(name: str, known: Iterable[str], *, kind: str = "known names") -> str:
    """Return "did you mean ...?", or the list of what there is when nothing is alike."""
    candidates = list(known)
    near = candidates[0] if len(candidates) == 1 else nearest(name, candidates)
    if near is not None:
        return f'did you mean "{near}"?'
    if not candidates:
        return "none is installed" if kind == "installed" else f"no {kind} are known here"
    shown = ", ".join(candidates[:12]) + (", ..." if len(candidates) > 12 else "")
    return f"{kind}: {shown}"


class Unit(NamedTuple):
    """A unit as it stands at the end of a key: how it is written elsewhere, its dimension, and its size in SI."""

    label: str
    dimension: str
    si: float


UNITS: dict[str, Unit] = {
    "deg": Unit("deg", "angle", math.pi / 180),
    "rad": Unit("rad", "angle", 1.0),
    "deg_s": Unit("deg/s", "angular speed", math.pi / 180),
    "rad_s": Unit("rad/s", "angular speed", 1.0),
    "rpm": Unit("rpm", "angular speed", math.pi / 30),
    "s": Unit("s", "time", 1.0),
    "ms": Unit("ms", "time", 1e-3),
    "min": Unit("min", "time", 60.0),
    "hz": Unit("Hz", "frequency", 1.0),
    "khz": Unit("kHz", "frequency", 1e3),
    "n": Unit("N", "force", 1.0),
    "kn": Unit("kN", "force", 1e3),
    "mn": Unit("mN", "force", 1e-3),
    "n_m": Unit("N m", "torque", 1.0),
    "nm": Unit("N m", "torque", 1.0),
    "n_mm": Unit("N mm", "torque", 1e-3),
    "m": Unit("m", "length", 1.0),
    "cm": Unit("cm", "length", 1e-2),
    "mm": Unit("mm", "length", 1e-3),
    "m_s": Unit("m/s", "speed", 1.0),
    "cm_s": Unit("cm/s", "speed", 1e-2),
    "mm_s": Unit("mm/s", "speed", 1e-3),
    "c": Unit("degC", "temperature", 1.0),
    "k": Unit("K", "temperature in kelvin", 1.0),
    "kg": Unit("kg", "mass", 1.0),
    "g": Unit("g", "mass", 1e-3),
}
"""Units by the suffix that stands for them in a key."""

KNOWN_UNITS = (
    *dict.fromkeys(unit.label for unit in UNITS.values()),
    "1", "%", "us", "kg/s", "kg/m^3", "m/s^2", "deg/s^2", "rad/s^2", "Pa", "kPa", "J", "W", "V", "A", "mA", "N/m",
    "N m/rad", "N m s/rad", "kg m^2", "m^2", "cm^2",
)  # fmt: skip
"""Units that a person may give to conditions, for tables and figures; "1" has none."""


def split_unit(key: str) -> tuple[str, str | None]:
    """Split a key into its stem and the longest unit suffix it ends in (None without one)."""
    parts = key.split("_")
    for start in range(1, len(parts)):
        suffix = "_".join(parts[start:])
        if suffix in UNITS:
            return "_".join(parts[:start]), suffix
    return key, None


def unit_of(key: str) -> str | None:
    """Return the unit a key's name states ("deg", "N m"), or None."""
    suffix = split_unit(key)[1]
    return UNITS[suffix].label if suffix is not None else None


def same_quantity(key: str, known: Iterable[str]) -> str | None:
    """Return the known key that names the same quantity in another unit: "timeout_s" for "timeout_ms" or "timeout".

    Of several, such as "speed_m_s" and "speed_deg_s" for "speed_rpm", it is the one of the same dimension.
    """
    stem, suffix = split_unit(key)
    pairs = [
        (candidate, other)
        for candidate in known
        for other_stem, other in [split_unit(candidate)]
        if other is not None and stem == other_stem and suffix != other
    ]
    alike = [
        name
        for name, other in pairs
        if suffix is not None and UNITS[other].dimension == UNITS[suffix].dimension
    ]
    return next(iter([*alike, *(name for name, _ in pairs)]), None)


def convert(value: object, key: str, to_key: str) -> float | None:
    """Return a number given in the unit of `key` in the unit of `to_key`; None if that makes no sense."""
    suffix, to_suffix = split_unit(key)[1], split_unit(to_key)[1]
    if suffix is None or to_suffix is None or isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if UNITS[suffix].dimension != UNITS[to_suffix].dimension:
        return None
    return float(f"{value * UNITS[suffix].si / UNITS[to_suffix].si:.6g}")
