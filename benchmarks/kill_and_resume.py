"""Kill runs at random instants, resume them, and compare with a run that was never killed.

    python benchmarks/kill_and_resume.py [--kills 50] [--kinds sweep,over,each,track,design] [--seed 1]

Dry runs of shipped experiments, made small. Each is run once whole. Then it is started, killed by SIGKILL at a random
instant (one in four within the first second: imports, recovery, replay; the others within 0.4 s of its next sign of
life), and resumed, until it has been killed so often, over several runs if one finishes earlier. Every trial that was
stored before a kill must be there afterwards, byte by byte, and the finished run must have the trials and the result of
the whole one. The script fails where it does not.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from measuring import machine, table

EXPERIMENTS: dict[str, tuple[str, ...]] = {
    "sweep": (
        "sweep", "fin-params", "--set", "sweep.axes.b=[0]", "--set", "sweep.axes.a=[30, 45, 60]",
        "--set", "sweep.axes.f=[0.8, 1.0, 1.2, 1.4]",
    ),
    "over": (
        "cmaes", "min-drag-pose", "--set", "cmaes.population=4", "--set", "cmaes.reevaluate=1",
        "--set", "cmaes.stop.iterations=3", "--set", "leaders={count=2, repeats=2}",
    ),
    "each": (
        "cmaes", "fire-attachment", "--set", 'cmaes.each.attachment=["broad", "short"]',
        "--set", "cmaes.population=4", "--set", "cmaes.reevaluate=1", "--set", "cmaes.stop.iterations=3",
        "--set", "leaders={count=2, repeats=2}",
    ),
    "track": ("track", "force-control", "--set", "trial.repeats=1"),
    "design": (
        "design", "swimmer", "--set", "design.population=20", "--set", "design.stop.iterations=6",
        "--set", "leaders.repeats=5",
    ),
}  # fmt: skip
_SEED = ("--dry-run", "--seed", "7", "--json")
_LABRUN = (sys.executable, "-m", "labrun")


def run_of(folder: Path) -> Path | None:
    """Return the folder of the one run there is; None as long as there is none."""
    result = list(folder.glob("results/*/*/spec.toml"))
    return result[0].parent if result else None


def stored(run: Path | None) -> dict[str, bytes]:
    """Return the trials and generations on disk, by name."""
    if run is None or (run / "run.h5").exists():
        return {}
    paths = [*run.glob("trials/[0-9]*.h5"), *run.glob("search/**/*.json")]
    return {str(path.relative_to(run)): path.read_bytes() for path in paths if not path.name.startswith(".")}


def signs_of_life(folder: Path) -> int:
    """Return a number that grows with what a run writes."""
    journals = [*folder.glob("results/*/*/journal.jsonl"), *folder.glob("results/*/*/search/**/*.json")]
    return sum(path.stat().st_size for path in journals if path.exists())


def kill_one(command: list[str], folder: Path, rng: np.random.Generator) -> bool:
    """Start a command and kill it with all it started; False if it ended by itself before."""
    before = signs_of_life(folder)
    deadline_s = time.monotonic() + rng.uniform(0.0, 1.0)
    early = rng.random() < 0.25
    with subprocess.Popen(
        command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
    ) as process:
        if not early:
            while process.poll() is None and signs_of_life(folder) == before:
                time.sleep(0.005)
            deadline_s = time.monotonic() + rng.uniform(0.0, 0.4)
        while process.poll() is None and time.monotonic() < deadline_s:
            time.sleep(0.001)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            return True
        assert process.stderr is not None
        if process.returncode != 0:
            raise SystemExit(f"{command} failed: {process.stderr.read().decode()}")
        return False


def finish(command: list[str], folder: Path) -> dict[str, Any]:
    """Run a command to its end and return its result."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"{command} failed: {done.stderr}")
    loads: dict[str, Any] = json.loads(done.stdout)
    return {key: loads[key] for key in ("trials", "best") if key in loads}


def check(kind: str, kills: int, folder: Path, rng: np.random.Generator) -> list[str]:
    """Kill runs of one kind so often; return a row of the table."""
    first = [*_LABRUN, *EXPERIMENTS[kind], *_SEED]
    whole = folder / "whole"
    whole.mkdir(parents=True)
    expected = finish(first, whole)
    count = runs = 0
    while count < kills:
        runs += 1
        own = folder / str(runs)
        own.mkdir()
        killed = True
        while killed and count < kills:
            run = run_of(own)
            before = stored(run)
            killed = kill_one(first if run is None else [*_LABRUN, "resume", str(run)], own, rng)
            count += killed
            after = stored(run)
            lost = [name for name, content in before.items() if after and after.get(name) != content]
            if lost:
                raise SystemExit(f"{kind}: lost after kill {count}: {', '.join(lost)}")
        run = run_of(own)
        result = finish(first if run is None else [*_LABRUN, "resume", str(run), "--json"], own)
        if result != expected:
            raise SystemExit(f"{kind}: {result} after kill {count}, expected {expected}")
    return [kind, str(count), str(runs), "none", "yes"]


def main() -> None:
    """Read the options, kill, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--kinds", default=",".join(EXPERIMENTS))
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(machine("labrun", "numpy"))
    rng = np.random.default_rng(options.seed)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for kind in options.kinds.split(","):
            rows.append(check(kind, options.kills, Path(folder, kind), rng))
            sys.stderr.write(f"{' '.join(rows[-1])}\n")
    print(table(["kind", "kills", "runs", "lost", "same result"], rows))


if __name__ == "__main__":
    main()
