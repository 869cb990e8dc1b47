"""Numbers as people write them."""

import math

_PLAIN = (1e-4, 1e7)


def significant(value: float, digits: int = 2) -> str:
    """Return a number with so many significant digits, without an exponent where it is of usual size: 8000, 0.012."""
    text = f"{value:.{digits}g}"
    if not math.isfinite(value) or not _PLAIN[0] <= abs(value) < _PLAIN[1]:
        return text
    return f"{float(text):.0f}" if "e" in text else text
