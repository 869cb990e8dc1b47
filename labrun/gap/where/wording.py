"""Names of channels, conditions and units as a person would say them."""

from collections.abc import Sequence

from labrun.spec import Condition, value_text
from labrun.toml import UNITS, split_unit

_FREQUENCIES = ("frequency", "freq", "f", "drive_frequency")


def plain(name: str) -> str:
    """Return a name without underscores."""
    return name.replace("_", " ")


def channel_text(name: str) -> str:
    """Return "the torque"."""
    return f"the {plain(name)}"


def key_parts(key: str) -> tuple[str, str]:
    """Return what a condition key measures and its unit, both for people; the unit may be empty."""
    stem, suffix = split_unit(key)
    return plain(stem), "" if suffix is None else UNITS[suffix].label


def located(condition: Condition) -> str:
    """Return "at 0.3 Hz", "at amplitude 40 deg and 1 Hz", "at 0.3 Hz (buckling one side)", "with buckling one side"."""
    numbers, words = [], []
    for key, value in condition.items():
        what, unit = key_parts(key)
        if isinstance(value, str):
            words.append(f"{what} {value}")
        elif unit == "Hz" and what in _FREQUENCIES:
            numbers.append(value_text(value, unit))
        else:
            numbers.append(f"{what} {value_text(value, unit)}")
    if not numbers:
        return f"with {join(words)}" if words else ""
    return f"at {join(numbers)}" + (f" ({', '.join(words)})" if words else "")


def threshold_text(key: str, value: float, *, above: bool) -> str:
    """Return "from 0.3 Hz on", "below 0.3 Hz"."""
    what, unit = key_parts(key)
    lead = "" if unit == "Hz" and what in _FREQUENCIES else f"{what} "
    number = value_text(value, unit)
    return f"from {lead}{number} on" if above else f"below {lead}{number}"


def join(words: Sequence[str]) -> str:
    """Return "a, b and c"."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def joined_conditions(labels: Sequence[str]) -> str:
    """Return "at 0.3 and 0.4 Hz" for the labels "frequency_hz = 0.3" and "frequency_hz = 0.4".

    Conditions of several keys are told by the one key that differs between all of them, if there is one.
    """
    pairs = [
        dict(part.partition(" = ")[::2] for part in label.split(", ") if " = " in part) for label in labels
    ]
    keys = [key for key in (pairs[0] if pairs else ()) if all(key in pair for pair in pairs)]
    telling = [key for key in keys if len({pair[key] for pair in pairs}) == len(pairs)]
    if not telling:
        return f"at {join([f'({label})' if ', ' in label else label for label in labels])}"
    what, unit = key_parts(telling[0])
    values = sorted((pair[telling[0]] for pair in pairs), key=_number)
    lead = "" if unit == "Hz" and what in _FREQUENCIES else f"{what} "
    alike = [key for key in keys if key != telling[0] and len({pair[key] for pair in pairs}) == 1]
    also = [f"{key_parts(key)[0]} {pairs[0][key]} {key_parts(key)[1]}".strip() for key in alike]
    return f"at {lead}{join(values)} {unit}".rstrip() + (f" ({', '.join(also)})" if also else "")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0
