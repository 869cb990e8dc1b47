"""Bytes of the Net F/T box and back: RDT over UDP, and the two questions it answers over TCP.

Layouts: ATI manuals 9620-05-NET FT (RDT) and 9610-05-Ethernet Axia, chapter 10 (TCP). Everything is big-endian.
"""

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

STOP = 0x0000
STREAM = 0x0002
BUFFERED = 0x0003
RESET_LATCH = 0x0041
BIAS = 0x0042

RECORD_BYTES = 36
MOST_RECORDS = 40
"""In one datagram of the buffered mode."""
RECORD = np.dtype(
    [("rdt_sequence", ">u4"), ("ft_sequence", ">u4"), ("status", ">u4"), ("counts", ">i4", (6,))]
)
Records = NDArray[np.void]
"""An array of `RECORD`."""

_HEADER = 0x1234
_REQUEST = struct.Struct(">HHI")
_TCP_REQUEST_BYTES = 20
_READFT = struct.Struct(">HH6h")
_CALINFO = struct.Struct(">HBBII6H")
READFT_BYTES = _READFT.size
CALINFO_BYTES = _CALINFO.size


def request(command: int, sample_count: int = 0) -> bytes:
    """Return an RDT request; a count of 0 asks for samples without end."""
    return _REQUEST.pack(_HEADER, command, sample_count)


def decode(datagram: bytes) -> Records | None:
    """Return the records of one datagram; None if it is none of the box's."""
    count, rest = divmod(len(datagram), RECORD_BYTES)
    if rest or not 1 <= count <= MOST_RECORDS:
        return None
    return np.frombuffer(datagram, RECORD)


def decode_block(
    slots: NDArray[np.uint8], length: NDArray[np.int64]
) -> tuple[Records, NDArray[np.int64], int]:
    """Return the records of many datagrams.

    Parameters
    ----------
    slots : (n, most bytes)
        A datagram a row.
    length : (n,)
        How many of its bytes are the datagram's.

    Returns
    -------
    records, datagram, malformed
        The records, the number of the datagram each came in, and how many datagrams were none of the box's.
    """
    count, rest = np.divmod(length, RECORD_BYTES)
    good = (rest == 0) & (count >= 1) & (count <= MOST_RECORDS) & (length <= slots.shape[1])
    if good.all() and (count == 1).all():  # by far the most frequent: a sample a datagram
        records = slots[:, :RECORD_BYTES].copy().view(RECORD)[:, 0]
        return records, np.arange(len(records)), 0
    chosen = np.flatnonzero(good)
    parts = [slots[i, : length[i]].tobytes() for i in chosen]
    return (
        np.frombuffer(b"".join(parts), RECORD),
        np.repeat(chosen, count[chosen]),
        int(len(length) - len(chosen)),
    )


@dataclass(frozen=True, slots=True)
class Reading:
    """What READFT answers: the upper half of the status, and six 16-bit values."""

    status: int
    values: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class CalibrationAnswer:
    """What READCALINFO answers: a load is `value * scale / counts per unit`."""

    force_unit: int
    torque_unit: int
    counts_per_force: int
    counts_per_torque: int
    scale: tuple[int, ...]


def read_ft_request() -> bytes:
    """Return the TCP request for one reading."""
    return bytes(_TCP_REQUEST_BYTES)


def calibration_request() -> bytes:
    """Return the TCP request for units and scales."""
    return b"\x01" + bytes(_TCP_REQUEST_BYTES - 1)


def decode_reading(answer: bytes) -> Reading | None:
    """Return what READFT answered; None if that is no such answer."""
    if len(answer) != READFT_BYTES:
        return None
    header, status, *values = _READFT.unpack(answer)
    return Reading(status << 16, tuple(values)) if header == _HEADER else None


def decode_calibration(answer: bytes) -> CalibrationAnswer | None:
    """Return what READCALINFO answered; None if that is no such answer."""
    if len(answer) != CALINFO_BYTES:
        return None
    header, force, torque, cpf, cpt, *scale = _CALINFO.unpack(answer)
    return CalibrationAnswer(force, torque, cpf, cpt, tuple(scale)) if header == _HEADER else None


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
    problems = [text for bit, text in BITS.items() if status & bit]
    if not problems:
        problems = ["error without a reason"] if status & ERROR else ["unknown bits" if status else "healthy"]
    return f"{', '.join(problems)} (status {status:08X})"


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
