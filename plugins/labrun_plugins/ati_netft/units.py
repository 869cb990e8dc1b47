"""Units of force and torque, as the box and its calibration files spell them."""

FORCE_N = {
    "n": 1.0, "newton": 1.0, "newtons": 1.0,
    "kn": 1e3, "kilonewton": 1e3, "kilonewtons": 1e3,
    "lb": 4.4482216152605, "lbf": 4.4482216152605, "lbs": 4.4482216152605, "poundforce": 4.4482216152605,
    "klb": 4448.2216152605, "klbf": 4448.2216152605,
    "kg": 9.80665, "kgf": 9.80665,
    "g": 9.80665e-3, "gf": 9.80665e-3,
}  # fmt: skip
_INCH_M, _FOOT_M = 0.0254, 0.3048
TORQUE_N_M = {
    "nm": 1.0, "newtonmeter": 1.0, "newtonmeters": 1.0, "newtonmetre": 1.0, "newtonmetres": 1.0,
    "nmm": 1e-3, "newtonmillimeter": 1e-3, "newtonmillimeters": 1e-3,
    "newtonmillimetre": 1e-3, "newtonmillimetres": 1e-3,
    "knm": 1e3,
    "lbfin": 4.4482216152605 * _INCH_M, "lbin": 4.4482216152605 * _INCH_M, "inlb": 4.4482216152605 * _INCH_M,
    "inlbf": 4.4482216152605 * _INCH_M,
    "lbfft": 4.4482216152605 * _FOOT_M, "lbft": 4.4482216152605 * _FOOT_M, "ftlb": 4.4482216152605 * _FOOT_M,
    "ftlbf": 4.4482216152605 * _FOOT_M,
    "kgfcm": 0.0980665, "kgcm": 0.0980665,
}  # fmt: skip
"""SI value of one unit, by its name without anything but letters, in lower case."""

FORCE_CODES = ("lbf", "N", "klbf", "kN", "kgf", "gf")
TORQUE_CODES = ("lbf-in", "lbf-ft", "N-m", "N-mm", "kgf-cm", "kN-m")
"""Numbers of units from 1 on, as READCALINFO gives them."""


def newtons_per(unit: str) -> float | None:
    """Return how many newtons one unit of force is; None if its name is not known."""
    return FORCE_N.get(_plain(unit))


def newton_metres_per(unit: str) -> float | None:
    """Return how many newton metres one unit of torque is; None if its name is not known."""
    return TORQUE_N_M.get(_plain(unit))


def unit_of_code(codes: tuple[str, ...], code: int) -> str:
    """Return the name of a numbered unit; empty if there is no such number."""
    return codes[code - 1] if 1 <= code <= len(codes) else ""


def _plain(unit: str) -> str:
    return "".join(letter for letter in unit if letter.isalpha()).lower()
