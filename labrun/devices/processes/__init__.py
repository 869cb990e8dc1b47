"""Processes that run beside the runner: the watchdog, the simulated bench, emulators."""

import contextlib
import json
import os
import select
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

_PRIORITY_OF_HARDWARE = 5


def stand_for_hardware() -> None:
    """Raise the priority of this process, if permitted.

    Among what has real-time priority it comes after the runner's threads, beside which it stands on one computer.
    """
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY_OF_HARDWARE))


def start(module: str, python: str = sys.executable) -> "subprocess.Popen[bytes]":
    """Start a module of this package as a process, which hears nothing of Ctrl-C in the terminal."""
    return subprocess.Popen(
        [python, "-m", f"{__name__}.{module}"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    )


def tell(process: "subprocess.Popen[bytes]", order: Mapping[str, Any]) -> None:
    """Hand an order to a process, a line of JSON. Raises OSError or ValueError: it is gone."""
    assert process.stdin is not None  # noqa: S101  it was started with a pipe
    os.write(process.stdin.fileno(), json.dumps(order).encode() + b"\n")


def answer(process: "subprocess.Popen[bytes]", within_s: float) -> bytes:
    """Return the line that a process says next; empty if it says none in time."""
    assert process.stdout is not None  # noqa: S101  it was started with a pipe
    ready, _, _ = select.select([process.stdout], [], [], within_s)
    return process.stdout.readline() if ready else b""
