"""The CSV file that a solver writes, read strictly: what is no table of numbers is said with its line."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from labrun.devices import FloatArray
from labrun.toml import suggest


class TableError(Exception):
    """A file that is not the table asked for."""


def read_table(path: Path, columns: Sequence[str], time: str | None) -> tuple[FloatArray, FloatArray | None]:
    """Return the wanted columns, shape (n, columns), and the times from the first row on, shape (n,), if it has any.

    Raises
    ------
    TableError
        There is no such file, column or number; times that do not increase; no row.
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
    found = []
    for place in places:
        try:
            value = float(row[place])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise TableError(f"{path.name}, line {line}: {header[place]} = {row[place][:40]!r} is no number")
        found.append(value)
    return found
