"""How much faster than the bench a dry run is, and what the command line costs.

    python benchmarks/dry_run.py

Runs all of fin-params (2292 trials of five cycles, reference trials, fresh repeats) in a process of its own, and
compares the simulated time of the bench with the time the run took; then the processor time of the two commands
that only look.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

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
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _timed(["sweep", "fin-params", "--dry-run", "--seed", "1", "--limit", "1"], folder)  # compiles, once
        out, wall, cpu = _timed(["sweep", "fin-params", "--dry-run", "--seed", "1", "--json"], folder)
        found = json.loads(out)
        run = folder / found["run"]
        shown, _, _ = _timed(["show", str(run), "--json"], folder)
        bench = json.loads(shown)["bench_time_s"]
        trials = sum(found["trials"].values())
        print(f"fin-params: {trials} trials, {bench / 3600:.1f} h on the bench")
        print(f"  wall {wall:.1f} s = {bench / wall:.0f} times faster; {1e3 * wall / trials:.1f} ms a trial")
        print(f"  CPU  {cpu:.1f} s = {bench / cpu:.0f} times faster; {1e3 * cpu / trials:.1f} ms a trial")
        for command in ("--help", "list"):
            cpus = sorted(_timed([command], folder)[2] for _ in range(9))
            print(f"labrun {command}: {cpus[len(cpus) // 2]:.3f} s of CPU (median of {len(cpus)})")


if __name__ == "__main__":
    main()
