"""How much faster than the bench a dry run of all of fin-params is.

    python benchmarks/dry_run.py [--repeats 3]

The whole command, in a process of its own: 2292 trials of five cycles, reference trials and fresh repeats of
the leaders, with settling, tare, simulated water, every trial durable on disk, packing, verification and the
figure. The simulated time of the bench is divided by the time the command took. Whatever else loads the
machine makes it slower: the least of the repeats counts, and processor time (which waiting for the disk is no
part of) stands beside it. Goal: 1000 times.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from measuring import machine, table

LABRUN = [sys.executable, "-m", "labrun"]


def _timed(arguments: list[str], folder: Path) -> tuple[str, float, float]:
    """Run a command; return its output, its wall time and its processor time, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    done = subprocess.run([*LABRUN, *arguments], cwd=folder, check=True, capture_output=True, text=True)
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return done.stdout, wall, cpu


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _timed(["sweep", "fin-params", "--dry-run", "--seed", "1", "--limit", "1"], folder)  # compiles, once
        for _ in range(repeats):
            out, wall, cpu = _timed(["sweep", "fin-params", "--dry-run", "--seed", "1", "--json"], folder)
            loads = json.loads(out)
            shown, _, _ = _timed(["show", str(folder / loads["run"]), "--json"], folder)
            bench = json.loads(shown)["bench_time_s"]
            trials = sum(loads["trials"].values())
            rows.append((bench / wall, [f"{wall:.1f}", f"{1e3 * wall / trials:.1f}", f"{bench / wall:.0f}",
                         f"{cpu:.1f}", f"{1e3 * cpu / trials:.1f}", f"{bench / cpu:.0f}"]))  # fmt: skip
    print(machine("labrun", "numpy", "h5py", "numba"))
    print(f"fin-params: {trials} trials, {bench / 3600:.1f} h on the bench")
    head = ["", "wall s", "ms a trial", "times the bench", "CPU s", "ms a trial", "times the bench"]
    print(table(head, [[f"run {number}", *cells] for number, (_, cells) in enumerate(rows, start=1)]))
    best = max(times for times, _ in rows)
    print(f"\nbest {best:.0f} times; goal 1000: {'held' if best >= 1000 else 'MISSED'}")


if __name__ == "__main__":
    main()
