"""The status word that comes with every record, in words."""

import numpy as np
from numpy.typing import NDArray

from labrun_plugins.ati_netft.codec import Records

ERROR = 0x8000_0000
CONDITION = 0x0001_0000
SATURATED = 0x0002_0000

BITS = {
    0x4000_0000: "CPU or RAM error",
    0x2000_0000: "digital board error",
    0x1000_0000: "analogue board error",
    0x0800_0000: "serial link error",
    0x0400_0000: "program memory error",
    0x0200_0000: "halted by its configuration",
    0x0100_0000: "settings invalid",
    0x0080_0000: "configuration and calibration do not belong together",
    0x0040_0000: "network error",
    0x0020_0000: "CAN error",
    0x0010_0000: "RDT error",
    0x0008_0000: "EtherNet/IP error",
    0x0004_0000: "DeviceNet error",
    SATURATED: "transducer saturated or A/D error",
    CONDITION: "a monitor condition tripped",
    0x0000_4000: "watchdog reset",
    0x0000_2000: "stack error",
    0x0000_1000: "EEPROM error",
    0x0000_0800: "flash error",
    0x0000_0400: "analogue watchdog",
    0x0000_0200: "strain gauge excitation too high",
    0x0000_0100: "strain gauge excitation too low",
    0x0000_0080: "artificial ground out of range",
    0x0000_0040: "supply too high",
    0x0000_0020: "supply too low",
    0x0000_0010: "serial data unavailable",
    0x0000_0008: "reference voltage out of range",
    0x0000_0004: "temperature out of range",
    0x0000_0002: "HTTP error",
}
"""ATI manual 9620-05-NET FT, section on status codes; 0x80000000 sums the others up."""


def words(status: int) -> str:
    """Return what a status says, for example ``"transducer saturated or A/D error (status 80020000)"``."""
    said = [text for bit, text in BITS.items() if status & bit]
    if not said:
        said = ["error without a reason"] if status & ERROR else ["unknown bits" if status else "healthy"]
    return f"{', '.join(said)} (status {status:08X})"


def status_of(records: Records) -> NDArray[np.int64]:
    """Return the status of each record."""
    return records["status"].astype(np.int64)


def is_serious(status: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which records must not be used: the error summary is set for more than saturation or a monitor condition."""
    others = status & ~(ERROR | CONDITION | SATURATED)
    bare = status == ERROR  # an error that gives no reason is one all the same
    return np.asarray(((status & ERROR) != 0) & ((others != 0) | bare))


def is_saturated(status: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which records stand at the end of the range."""
    return np.asarray((status & SATURATED) != 0)


def is_serious_word(status: int) -> bool:
    """Tell whether a single status says that the box must not be used; saturation passes."""
    return bool(is_serious(np.array([status], dtype=np.int64))[0])
