"""What compiled code asks of Linux, without the interpreter: the time, to wait, to write."""

from typing import Any

import numpy as np
from numba import types

from labrun.compiled import inlined, kernel

_MONOTONIC, _ABSOLUTE = 1, 1
_clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.voidptr))
_clock_nanosleep = types.ExternalFunction(
    "clock_nanosleep", types.int32(types.int32, types.int32, types.voidptr, types.voidptr)
)
_write = types.ExternalFunction("write", types.int64(types.int32, types.voidptr, types.int64))
_poll = types.ExternalFunction("poll", types.int32(types.voidptr, types.int64, types.int32))
_read = types.ExternalFunction("read", types.int64(types.int32, types.voidptr, types.int64))
_ppoll = types.ExternalFunction("ppoll", types.int32(types.voidptr, types.int64, types.voidptr, types.int64))
_POLLIN, _POLLOUT, _POLLERR = 1, 4, 8 | 16 | 32


@inlined
def clock_s() -> float:
    """Return the time of the host's monotonic clock, s, as `labrun.devices.clock.RealClock`."""
    now = np.empty(2, dtype=np.int64)
    _clock_gettime(_MONOTONIC, now.ctypes)
    return float(now[0] + 1e-9 * now[1])


@kernel
def wait_until(due_s: float, spin_s: float) -> float:
    """Sleep until `spin_s` before a time, then look at the clock; return the time, at once if it is over."""
    now_s = clock_s()
    if due_s - spin_s > now_s:
        until = np.empty(2, dtype=np.int64)
        whole = np.floor(due_s - spin_s)
        until[0], until[1] = int(whole), int(1e9 * (due_s - spin_s - whole))
        _clock_nanosleep(_MONOTONIC, _ABSOLUTE, until.ctypes, until.ctypes)
        now_s = clock_s()
    while now_s < due_s:
        now_s = clock_s()
    return now_s


@kernel
def sleep_until_rung(bell: int, until_s: float) -> float:
    """Sleep until a `labrun.devices.listening.Bell` is rung, or was, and to a time at the latest; return the time."""
    left_s = until_s - clock_s()
    if left_s > 0.0:
        asked, span, rung = (
            np.empty(1, dtype=np.int64),
            np.empty(2, dtype=np.int64),
            np.empty(1, dtype=np.int64),
        )
        asked[0] = bell | (_POLLIN << 32)  # struct pollfd: int fd; short events, revents
        span[0], span[1] = int(left_s), int(1e9 * (left_s - int(left_s)))
        if _ppoll(asked.ctypes, 1, span.ctypes, 0) > 0:
            _read(bell, rung.ctypes, 8)
    return float(clock_s())


@kernel
def write_bytes(file: int, data: Any, count: int) -> int:
    """Write to a file that does not block; return how many bytes it took: 0 if it is full, -1 if it is gone."""
    asked = np.zeros(1, dtype=np.int64)
    asked[0] = file | (_POLLOUT << 32)  # struct pollfd: int fd; short events, revents
    ready = _poll(asked.ctypes, 1, 0)
    if ready < 0 or (asked[0] >> 48) & _POLLERR:
        return -1
    if ready == 0:
        return 0
    return int(_write(file, data.ctypes, count))
