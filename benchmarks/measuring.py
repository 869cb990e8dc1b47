"""What every benchmark prints: the machine it ran on, and a table of figures measured side by side."""

import os
import platform
import resource
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Cost:
    """Wall and processor time, s."""

    wall_s: float
    cpu_s: float


class Stopwatch:
    """Wall time, and the processor time of all threads of this process, from its making on."""

    def __init__(self) -> None:
        self._wall_s, self._cpu_s = time.perf_counter(), time.process_time()

    def read(self) -> Cost:
        """Return what has passed."""
        return Cost(time.perf_counter() - self._wall_s, time.process_time() - self._cpu_s)


def machine(*packages: str) -> str:
    """Return processor, cores, load and versions: what figures mean nothing without."""
    cpuinfo = Path("/proc/cpuinfo")
    model = platform.processor() or platform.machine()
    if cpuinfo.is_file():
        names = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        model = names[0].partition(":")[2].strip() if names else model
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    versions = ", ".join(f"{name} {version(name)}" for name in packages)
    return (
        f"machine  {model}, {os.cpu_count()} cores, {platform.system()} {platform.release()}; load {load}\n"
        f"versions Python {platform.python_version()}, {versions}\n"
    )


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table: the first column to the left, numbers to the right."""
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    lines = []
    for row in [head, ["-" * width for width in widths], *rows]:
        cells = [
            row[0].ljust(widths[0]),
            *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True)),
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def peak_mb() -> float:
    """Return the greatest resident memory of this process so far, MB (1e6 bytes)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
