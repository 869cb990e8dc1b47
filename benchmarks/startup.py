"""Processor time of the two commands that only look, beside a Python that does nothing.

    python benchmarks/startup.py [--repeats 25]

Each command runs in a process of its own; user + system time of that process and its children. `labrun list`
looks at a folder that has every shipped experiment and one run. The commands take turns, so that whatever
else loads the machine hits all alike; the first round, which fills the disk cache, does not count. Goals:
0.15 s for `--help`, 0.25 s for `list`.
"""

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from measuring import machine, table

LABRUN = [sys.executable, "-m", "labrun"]
COMMANDS: dict[str, tuple[list[str], float | None]] = {
    "python -c pass": ([sys.executable, "-c", "pass"], None),
    "python -c 'import numpy'": ([sys.executable, "-c", "import numpy"], None),
    "labrun --help": ([*LABRUN, "--help"], 0.15),
    "labrun list": ([*LABRUN, "list"], 0.25),
}


def cpu_s(command: list[str], folder: Path) -> float:
    """Run a command; return its processor time, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=25)
    repeats = parser.parse_args().repeats
    results: dict[str, list[float]] = {name: [] for name in COMMANDS}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        cpu_s([*LABRUN, "init"], folder)
        cpu_s([*LABRUN, "sweep", "fin-params", "--dry-run", "--seed", "1", "--limit", "1"], folder)
        for _ in range(repeats + 1):
            for name, (command, _goal) in COMMANDS.items():
                results[name].append(cpu_s(command, folder))
    rows = []
    for name, (_command, goal) in COMMANDS.items():
        times = sorted(results[name][1:])
        middle = statistics.median(times)
        verdict = "" if goal is None else f"{goal:.2f} {'held' if middle <= goal else 'MISSED'}"
        rows.append([name, f"{times[0]:.3f}", f"{middle:.3f}", f"{times[-1]:.3f}", verdict])
    print(machine("labrun", "typer", "pydantic"))
    print(table([f"CPU s ({repeats} runs each)", "least", "median", "most", "goal"], rows))


if __name__ == "__main__":
    main()
