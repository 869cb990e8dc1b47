"""Where records come from: the box, many datagrams at once, each with the time at which the kernel got it.

At 7000 datagrams a second a call per datagram would hand the interpreter's lock over 7000 times a second, and wait for
it as often while the runner computes. One call of `recvmmsg` takes all that has come, and the kernel's own time stamps
say when: how late this program looks does not matter. The socket's buffer holds more than a second of them meanwhile.
"""

import ctypes
import errno
import os
import socket
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.devices import Clock, DeviceError, FloatArray
from labrun_plugins.ati_netft import codec
from labrun_plugins.ati_netft.pynetft_source import PynetftSource
from labrun_plugins.ati_netft.settings import AtiNetFtSettings

SLOT_BYTES = 1500
"""More than any datagram of the box has: one that fills it is not whole."""
_SLOTS = 512
_CONTROL_BYTES = 64
_RECEIVE_BUFFER = 4 << 20
_SO_TIMESTAMPNS, _SCM_TIMESTAMPNS = 35, 35
_SO_MEMINFO, _MEMINFO_DROPS, _MEMINFO_BYTES = 55, 8, 36
_OLDEST_S = 2.0
_KERNEL_BYTES = 832
"""What Linux charges a socket's buffer for a datagram of 36 bytes (measured, 6.18, x86-64)."""


class _Iovec(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _Msghdr(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_void_p), ("name_length", ctypes.c_uint),
        ("iov", ctypes.POINTER(_Iovec)), ("iov_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p), ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )  # fmt: skip


class _Mmsghdr(ctypes.Structure):
    _fields_ = (("header", _Msghdr), ("length", ctypes.c_uint))


_COUNTED = np.dtype({
    "names": ["control_length", "length"],
    "formats": [np.dtype(ctypes.c_size_t), np.dtype(ctypes.c_uint)],
    "offsets": [_Msghdr.control_length.offset, _Mmsghdr.length.offset],
    "itemsize": ctypes.sizeof(_Mmsghdr),
})  # fmt: skip
"""What the kernel writes into a message's header, as an array sees it."""


@dataclass(frozen=True, slots=True)
class Datagrams:
    """What came since the last look: `slots` (n, bytes), how long each is, and when it came by the run's clock, s."""

    slots: NDArray[np.uint8]
    length: NDArray[np.int64]
    host_time_s: FloatArray

    def __len__(self) -> int:
        return len(self.length)


class DatagramSocket:
    """A UDP socket that hears one box and nobody else.

    Parameters
    ----------
    own, box
        Address of this computer to bind to; address and port of the box.

    Raises
    ------
    DeviceError
        The address is not one of this computer's, or this system has no `recvmmsg`.
    """

    def __init__(self, device: str, clock: Clock, own: str, box: tuple[str, int]) -> None:
        self._device = device
        self._clock = clock
        library = ctypes.CDLL(None, use_errno=True)
        if not hasattr(library, "recvmmsg"):
            raise DeviceError(device, "this system cannot receive datagrams in blocks", hint="use Linux")
        self._receive = library.recvmmsg
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            self._socket.bind((own, 0))
            self._socket.connect(box)
            self._socket.setblocking(False)
        except OSError as error:
            self._socket.close()
            raise DeviceError(
                device,
                f"cannot use address {own} towards {box[0]}: {error.strerror or error}",
                hint="check `interface` and `host` in the file",
            ) from None
        self._slots = np.zeros((_SLOTS, SLOT_BYTES), np.uint8)
        self._control = np.zeros((_SLOTS, _CONTROL_BYTES), np.uint8)
        self._iovecs = (_Iovec * _SLOTS)()
        self._messages = (_Mmsghdr * _SLOTS)()
        self._counted = np.frombuffer(memoryview(self._messages), _COUNTED)
        for i in range(_SLOTS):
            self._iovecs[i] = _Iovec(self._slots[i].ctypes.data, SLOT_BYTES)
            header = self._messages[i].header
            header.iov, header.iov_count = ctypes.pointer(self._iovecs[i]), 1
            header.control, header.control_length = self._control[i].ctypes.data, _CONTROL_BYTES
        self._last_look_s = clock.now()

    def send(self, message: bytes) -> None:
        """Send one datagram; OSError if that cannot be. Any thread."""
        self._socket.send(message)

    def take(self) -> Datagrams:
        """Return what has come, 512 datagrams at most; does not wait. The slots hold until the next call.

        Raises DeviceError: the box's computer says that nobody listens there, or the network is gone.
        """
        looked_s = self._clock.now()
        count = self._receive(self._socket.fileno(), self._messages, _SLOTS, socket.MSG_DONTWAIT, None)
        if count < 0:
            number = ctypes.get_errno()
            count = 0
            if number not in (errno.EAGAIN, errno.EWOULDBLOCK, errno.EINTR):
                raise DeviceError(
                    self._device,
                    f"cannot be received from any more: {os.strerror(number)}",
                    hint="check its power and network cable, then labrun resume",
                )
        length = self._counted["length"][:count].astype(np.int64)
        host_s = self._times(count)
        self._counted["control_length"][:count] = _CONTROL_BYTES  # the kernel wrote there how much it used
        if count < _SLOTS:
            self._last_look_s = looked_s
        return Datagrams(self._slots[:count], length, host_s)

    def dropped(self) -> int:
        """Return how many datagrams reached this computer and found the socket's buffer full."""
        try:
            numbers = self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO_BYTES)
        except OSError:
            return 0
        return int(np.frombuffer(numbers, np.uint32)[_MEMINFO_DROPS])

    def capacity(self) -> int:
        """Return how many datagrams find room while nobody looks."""
        return self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // _KERNEL_BYTES

    def close(self) -> None:
        """Close it."""
        self._socket.close()

    def _times(self, count: int) -> FloatArray:
        """Return when the datagrams came, by the run's clock.

        The kernel stamps by the wall clock alone, so its stamps are used as ages, compared with the wall clock now. An
        age that cannot be, because someone set the clock in between, is bounded by the time of the last look.
        """
        now_s, wall_ns = self._clock.now(), time.clock_gettime_ns(time.CLOCK_REALTIME)
        # cmsghdr: length; level and type; then seconds, nanoseconds
        words = self._control[:count].view(np.int64)
        stamped = (words[:, 1] >> 32) == _SCM_TIMESTAMPNS
        age_s = np.where(stamped, 1e-9 * (wall_ns - (words[:, 2] * 1_000_000_000 + words[:, 3])), 0.0)
        oldest_s = min(max(now_s - self._last_look_s, 0.0), _OLDEST_S)
        return np.maximum.accumulate(now_s - np.clip(age_s, 0.0, oldest_s))


_STOPS = 3


class BoxSource:
    """The own client: one socket for one stream, so that nothing of an earlier stream can come in between.

    Parameters
    ----------
    own
        Address of this computer to bind to.
    """

    def __init__(self, device: str, clock: Clock, settings: AtiNetFtSettings, own: str) -> None:
        self.malformed = 0
        self._device = device
        self._command = codec.BUFFERED if settings.mode == "buffered" else codec.STREAM
        self._socket = DatagramSocket(device, clock, own, (settings.host, settings.rdt_port))

    def start(self) -> None:
        """Ask for the stream."""
        try:
            self._socket.send(codec.request(self._command))
        except OSError as error:
            raise DeviceError(
                self._device,
                f"cannot be reached: {error.strerror or error}",
                hint="check its power and network cable, and host",
            ) from None

    def take(self) -> tuple[codec.Records, FloatArray]:
        """Return what has come since the last time and when, by the run's clock; does not wait."""
        datagrams = self._socket.take()
        if not len(datagrams):
            return np.empty(0, codec.RECORD), np.empty(0)
        records, number, malformed = codec.decode_block(datagrams.slots, datagrams.length)
        self.malformed += malformed
        return records, datagrams.host_time_s[number]

    def dropped(self) -> int:
        """Return how many datagrams reached this computer and found no room."""
        return self._socket.dropped()

    def halt(self) -> None:
        """Ask for the stream's end, more than once: the request is not acknowledged and may get lost."""
        for _ in range(_STOPS):
            try:
                self._socket.send(codec.request(codec.STOP))
            except OSError:
                continue  # an earlier one met nobody; or closed already, or the network is gone

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


Source = BoxSource | PynetftSource
"""One stream of the box, from its start to its end; a new one is made for every start."""
