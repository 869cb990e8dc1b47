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
