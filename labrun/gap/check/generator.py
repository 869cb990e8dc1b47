"""Have sealed cases made, by code that is no part of labrun, in a process of its own."""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from labrun.errors import LabrunError, RequestError
from labrun.fit.notes import Note

_PLACE = Path("benchmarks") / "withheld"
_TOLD_LINES = 12


def find_generator(given: Path | None, start: Path) -> Path:
    """Return the folder of the generator: the one that was named, or ``benchmarks/withheld`` from `start` upwards.

    Raises
    ------
    RequestError
        There is none, with what to do.
    """
    if given is not None:
        if not (given / "__main__.py").is_file():
            raise RequestError(
                f"{given} makes no cases: it has no __main__.py",
                hint="name the folder benchmarks/withheld of a checkout of labrun",
            )
        return given
    start = start.resolve()
    for folder in (start, *start.parents):
        if (folder / _PLACE / "__main__.py").is_file():
            return folder / _PLACE
    raise RequestError(
        f"no {_PLACE} in {start} or above it: the code that makes the cases is kept apart from the package",
        hint="go into a checkout of labrun, or name that folder with --generator",
    )


def make_cases(
    generator: Path,
    out: Path,
    *,
    cases: int,
    seed: int,
    first: int,
    only: str | None,
    workers: int,
    note: Note,
) -> str:
    """Run the generator; return the line in which it tells the seal.

    Parameters
    ----------
    only
        Kind of all cases; its mixture of kinds if None.

    Raises
    ------
    LabrunError
        It failed, with the last lines of what it said.
    """
    command = [sys.executable, str(generator), "--cases", str(cases), "--seed", str(seed)]
    command += ["--first", str(first), "--workers", str(workers), "--out", str(out)]
    command += [] if only is None else ["--only", only]
    told: list[str] = []
    with tempfile.TemporaryFile("w+", encoding="utf-8") as said:
        process = subprocess.Popen(
            command, stdout=said, stderr=subprocess.PIPE, text=True, encoding="utf-8", env={**os.environ}
        )
        try:
            for line in process.stderr or ():
                told = [*told[1 - _TOLD_LINES :], line.rstrip()]
                if line.startswith("made "):
                    note(f"making the cases: {line.strip()}")
            code = process.wait()
        except BaseException:
            _stop(process)
            raise
        said.seek(0)
        seal = said.read().strip()
    if code != 0 or not seal:
        raise LabrunError(
            f"the generator {generator} ended with exit code {code}:\n    " + "\n    ".join(told),
            hint=f"to see it alone: {' '.join(command)}",
        )
    return seal.splitlines()[0]


def _stop(process: "subprocess.Popen[str]") -> None:
    """Interrupt the generator, so that it takes its half-made folder away."""
    process.send_signal(signal.SIGINT)
    try:
        process.communicate(timeout=20.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
