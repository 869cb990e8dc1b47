"""A solver as a device: one run of a program a condition, its table played as samples."""

import csv
import hashlib
import json
import math
import os
import shlex
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, NoReturn

import numpy as np
from pydantic import Field, PositiveFloat

from labrun.devices import (
    Channel,
    Clock,
    DeviceContext,
    DeviceError,
    DeviceSettings,
    FloatArray,
    Health,
    Identity,
    Samples,
    Trajectory,
)
from labrun.toml import suggest


class CommandSettings(DeviceSettings):
    """Keys of a command.

    Attributes
    ----------
    run
        The program and its arguments, one text each. ``{name}`` stands for a value of the condition, ``{output}`` for
        the CSV file that the program has to write.
    channels
        Columns of that file that are read, with their units.
    time
        Its column of time, s; without it rows follow each other at `rate_hz`.
    rate_hz
        Rows a second, as the trial plays them.
    timeout_s
        How long the program may take.
    keep
        Folder for what was computed: a condition is computed once, also in later runs.
    """

    example: ClassVar[str] = (
        'run = ["python", "solve.py", "--angle", "{angle}", "--output", "{output}"]\n'
        'channels = { moment = "N m" }        # columns of the CSV file, with their units\n'
        "timeout_s = 3600"
    )

    run: list[str] = Field(min_length=1)
    channels: dict[str, str] = Field(min_length=1)
    time: str | None = None
    rate_hz: PositiveFloat = 100.0
    timeout_s: PositiveFloat = 3600.0
    keep: str = "solver"


class TableError(Exception):
    """A file that is not the table asked for."""


def read_table(path: Path, columns: Sequence[str], time: str | None) -> tuple[FloatArray, FloatArray | None]:
    """Return the wanted columns, shape (n, columns), and the times from the first row on, shape (n,), if it has any.

    Raises TableError: there is no such file, column or number; times that do not increase; no row.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.reader(file) if row]
    except FileNotFoundError:
        raise TableError("it wrote no file {output}") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise TableError(f"{path.name} cannot be read as CSV: {error}") from error
    if not rows:
        raise TableError(f"{path.name} is empty")
    header = [name.strip() for name in rows[0]]
    wanted = [*columns, *([] if time is None else [time])]
    for name in wanted:
        if name not in header:
            raise TableError(f"{path.name} has no column {name!r}; {suggest(name, header, kind='columns')}")
    if len(rows) < 2:
        raise TableError(f"{path.name} has a header and no row below it")
    places = [header.index(name) for name in wanted]
    table = np.array([_numbers(path, number, row, header, places) for number, row in enumerate(rows[1:], 2)])
    if time is None:
        return table, None
    times = table[:, -1] - table[0, -1]
    if not (np.diff(times) > 0).all():
        line = int(np.argmin(np.diff(times) > 0)) + 3
        raise TableError(f"{path.name}, line {line}: {time} does not increase")
    return table[:, :-1], times


def _numbers(path: Path, line: int, row: list[str], header: list[str], places: list[int]) -> list[float]:
    if len(row) != len(header):
        raise TableError(f"{path.name}, line {line}: {len(row)} values under {len(header)} headings")
    numbers = []
    for position in places:
        try:
            value = float(row[position])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise TableError(
                f"{path.name}, line {line}: {header[position]} = {row[position][:40]!r} is not a number"
            )
        numbers.append(value)
    return numbers


_LOOK_S = 0.05
_LEAD_S = 0.1
"""The first row comes so long after the sensors have started: by then the recording has begun."""
_LAST_WORDS = 400
_KILL_S = 2.0


class Command:
    """Runs a program for each condition and plays the CSV file it writes; the last row is held to the trial's end.

    What a program wrote is kept under a name made of its arguments, and a condition is not computed twice: repeats,
    resumed runs and later ones find it there. Nothing is kept of a program that failed.

    Parameters
    ----------
    name, settings, context
        As for every device.
    """

    Settings: ClassVar[type[DeviceSettings]] = CommandSettings
    stand_in: ClassVar[str] = "labrun_plugins.command.driver:PlayedCommand"
    joints: tuple[str, ...] = ()
    zero_known: ClassVar[bool] = True

    def __init__(self, name: str, settings: CommandSettings, context: DeviceContext) -> None:
        self.name = name
        self.channels = tuple(Channel(column, unit) for column, unit in settings.channels.items())
        self.rate_hz = settings.rate_hz
        self._settings = settings
        self._clock: Clock = context.clock
        self._process: subprocess.Popen[bytes] | None = None
        self._said: Any = None
        self._line = ""
        self._output = Path()
        self._kept = Path()
        self._began_s = 0.0
        self._stopped = threading.Event()
        self._rows: FloatArray = np.empty((0, len(self.channels)))
        self._times_s: FloatArray = np.empty(0)
        self._start_s = 0.0
        self._played = 0

    def open(self) -> None:
        """See that the program is there. Raises DeviceError: it is not."""
        program = self._settings.run[0]
        if shutil.which(program) is None:
            raise DeviceError(
                self.name, f"cannot find the program {program!r}", hint="is it installed, and on the PATH?"
            )
        self._stopped.clear()

    def identify(self) -> Identity:
        """Say what is run."""
        return Identity("a program", details={"run": " ".join(self._settings.run)})

    def health(self) -> Health:
        """Report that a program is always well until it fails."""
        return Health()

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Start the program for a condition, unless that was computed before; returns at once.

        Raises DeviceError: the command names what the condition does not have, or cannot be started.
        """
        self._rows = np.empty((0, len(self.channels)))
        words = {
            name: value if isinstance(value, str) else f"{value:.12g}" for name, value in condition.items()
        }
        plain = [_filled(part, words) for part in self._settings.run]
        left = [part for part in plain if "{" in part.replace("{output}", "")]
        if left:
            raise DeviceError(
                self.name,
                f"{left[0]!r} names what the condition does not have; it has {', '.join(words) or 'no names'}",
                hint="run takes {name} of the condition, and {output}",
            )
        self._line = shlex.join(_filled(part, {"output": "output.csv"}) for part in plain)
        about = [plain, self._settings.time, sorted(self._settings.channels)]
        digest = hashlib.blake2b(json.dumps(about).encode(), digest_size=8).hexdigest()
        self._kept = Path(self._settings.keep) / f"{self.name}-{digest}.csv"
        if self._kept.is_file():
            self._read(self._kept)
        else:
            self._compute(plain)

    def _compute(self, plain: Sequence[str]) -> None:
        """Start the program; `plain` are its arguments but for the output."""
        self._kept.parent.mkdir(parents=True, exist_ok=True)
        for unfinished in self._kept.parent.glob(f"{self._kept.stem}.partial-*.csv"):
            unfinished.unlink(missing_ok=True)
        # a program of a runner that was killed may still compute, and would write into ours
        self._output = self._kept.with_suffix(f".partial-{os.getpid()}.csv").absolute()
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  (the program writes to it until it ends)
        try:
            self._process = subprocess.Popen(
                [_filled(part, {"output": str(self._output)}) for part in plain],
                stdin=subprocess.DEVNULL,
                stdout=self._said,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C goes to the runner, which stops it
            )
        except OSError as error:
            raise DeviceError(self.name, f"cannot be started: {error}", hint="see run") from error
        self._began_s = time.monotonic()

    def arrived(self) -> bool:
        """Tell whether the program is done; waits a twentieth of a second for it at most.

        Raises DeviceError: it failed, took too long, was stopped, or wrote what is no table.
        """
        process = self._process
        if process is None:
            return True
        with suppress(subprocess.TimeoutExpired):
            process.wait(_LOOK_S)  # of this host's time: a simulated clock does not make a solver faster
        if process.returncode is None:
            if time.monotonic() - self._began_s > self._settings.timeout_s:
                self._end()
                self._fail(
                    f"took longer than timeout_s = {self._settings.timeout_s:g} s and was ended",
                    f"give it more time, or a coarser mesh. By hand: {self._line}",
                )
            return False
        self._process = None
        if self._stopped.is_set():
            self._stopped.clear()
            raise DeviceError(
                self.name, "was stopped while it computed", hint="labrun resume computes it again"
            )
        if process.returncode != 0:
            self._fail(f"ended with code {process.returncode}", f"by hand: {self._line}")
        self._read(self._output)
        self._output.replace(self._kept)
        return True

    def pose(self) -> Mapping[str, float]:
        """Return nothing: it moves nothing."""
        return {}

    def follow(self, trajectory: Trajectory, start_s: float) -> None:
        """Do nothing: it moves nothing."""

    def start(self) -> None:
        """Begin to play the rows."""
        self._start_s = self._clock.now() + _LEAD_S
        self._played = 0

    def read(self) -> Samples:
        """Return the rows that are due; after the last one it is repeated."""
        due = int(max(0.0, self._clock.now() - self._start_s) * self.rate_hz * (1 + 1e-12))
        rows = len(self._rows)
        if rows == 0 or due <= self._played:
            return Samples.empty(len(self.channels))
        if self._played == 0:  # all at once: that they are early harms nobody
            due = max(due, rows)
        numbers = np.arange(self._played, due)
        beyond = np.maximum(numbers - (rows - 1), 0) / self.rate_hz
        inside = np.minimum(numbers, rows - 1)
        times = self._times_s[inside] + beyond
        self._played = due
        return Samples(times, self._start_s + times, self._rows[inside])

    def stop(self) -> None:
        """Play no more."""
        self._played = 0

    def safe_stop(self) -> None:
        """End the program, if it computes."""
        if self._process is not None:
            self._stopped.set()
            self._end()

    def close(self) -> None:
        """End the program; harmless when closed."""
        self._end()
        self._process = None

    @classmethod
    def emergency_stop(cls, name: str, settings: Any) -> None:
        """Nothing to stop: a program moves nothing."""

    def _read(self, path: Path) -> None:
        try:
            rows, times = read_table(path, list(self._settings.channels), self._settings.time)
        except TableError as error:
            self._fail(
                # what was written now is gone when this is read; what was kept before is there
                str(error) if path == self._kept else str(error).replace(path.name, "its {output}"),
                f"it has to write a header and rows of numbers, separated by commas. By hand: {self._line}",
            )
        self._rows = rows
        self._times_s = np.arange(len(rows)) / self.rate_hz if times is None else times

    def _fail(self, what: str, hint: str) -> NoReturn:
        reason = ""
        if self._said is not None:
            size = self._said.seek(0, 2)
            self._said.seek(max(0, size - _LAST_WORDS))
            reason = self._said.read().decode(errors="replace").strip()
        last = f"; it said last: {reason.splitlines()[-1]}" if reason else "; it said nothing"
        self._process = None
        raise DeviceError(self.name, f"{what}{last}", hint=f"{hint}; nothing else is lost")

    def _end(self) -> None:
        process = self._process
        if process is None or process.poll() is not None:
            return
        with suppress(OSError):
            process.terminate()
        try:
            process.wait(_KILL_S)
        except subprocess.TimeoutExpired:
            with suppress(OSError):
                process.kill()


class PlayedCommand(Command):
    """A command in a dry run: starts nothing.

    It sees that the program is there and plays what an earlier run computed for the condition; zeros where none did.
    """

    def identify(self) -> Identity:
        """Say what would be run."""
        return Identity(
            "a program (dry run: not started)",
            details={"run": " ".join(self._settings.run), "plays": "stored results, else zeros"},
        )

    def _compute(self, plain: Sequence[str]) -> None:  # noqa: ARG002
        self._rows = np.zeros((1, len(self.channels)))
        self._times_s = np.zeros(1)


def _filled(text: str, words: Mapping[str, str]) -> str:
    for name, value in words.items():
        text = text.replace(f"{{{name}}}", value)
    return text
