"""Runs a board's firmware on this machine: the sketch itself, compiled against a few headers in place of Arduino's."""

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

STUBS = Path(__file__).parent / "arduino_stubs"
COMPILER = shutil.which("g++")
WARNINGS = ("-Wall", "-Wextra", "-Werror", "-Wshadow")


def compile_sketch(sketch: Path, into: Path, *defines: str) -> Path:
    """Return the program made of a sketch."""
    program = into / sketch.stem
    command = [str(COMPILER), "-std=c++17", "-O1", *WARNINGS, f"-I{STUBS}", f'-DSKETCH="{sketch}"']
    command += [*(f"-D{define}" for define in defines), "-o", str(program), str(STUBS / "run_sketch.cpp")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program


class NativeSketch:
    """A running sketch, whose clock and serial port are in the test's hands."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process
        self.banner = bytes.fromhex(self._line())

    def receive(self, data: bytes) -> bytes:
        """Let bytes arrive; return what is sent."""
        return bytes.fromhex(self._order(f"B {data.hex()}")) if data else b""

    def wait(self, duration_ms: int) -> bytes:
        """Let time pass; return what is sent."""
        return bytes.fromhex(self._order(f"T {duration_ms}"))

    def read_analog(self, reading: int) -> None:
        """Set what the analogue input reads."""
        self._order(f"A {reading}")

    def close_switches(self, *pins: int) -> None:
        """Connect these pins to ground, and no others."""
        self._order(f"S {sum(1 << pin for pin in pins)}")

    def pins(self) -> list[tuple[int, int]]:
        """Return pin (-1 if there are no pulses) and pulse width of each channel."""
        pairs = (pair.split(":") for pair in self._order("P").split())
        return [(int(pin), int(pulse_us)) for pin, pulse_us in pairs]

    def chip_watchdog(self) -> tuple[int, int]:
        """Return the chip's watchdog's setting, and how often it was fed."""
        setting, fed = self._order("W").split()
        return int(setting), int(fed)

    def _order(self, order: str) -> str:
        assert self._process.stdin is not None
        self._process.stdin.write(order + "\n")
        self._process.stdin.flush()
        return self._line()

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()


@contextmanager
def running(program: Path) -> Iterator[NativeSketch]:
    """Start a sketch."""
    with subprocess.Popen(
        [str(program)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield NativeSketch(process)
        finally:
            process.kill()
