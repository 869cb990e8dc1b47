"""Tables in text: which encoding, delimiter and decimal mark, which line is the header, which is a row of units."""

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import NoReturn

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RecordingError
from labrun.logs.arrays import Arrays
from labrun.logs.findings import Finding, Statement
from labrun.logs.stamps import date_seconds, is_date, is_time
from labrun.logs.streams import UNIT_WORDS, is_episode

_EXPECTED = "a log in text has one header line, and a number in each cell below it"
_CHUNK_ROWS = 4_000
_BLANKS = ("", "na", "n/a", "null", "none", "-", "--")
"""What programs write where there is no number, beside nan."""
_MOST_BAD_CELLS = 0.05
_SEPARATOR = re.compile(r"(?i)sep=([,;\t])")
"""A first line that tells Excel the delimiter."""
_THOUSANDS = re.compile(r"-?\d{1,3}(\.\d{3})+,\d+")


def read_text(path: Path) -> Arrays:
    """Read a table of numbers.

    Raises
    ------
    RecordingError
        It is no text of a known encoding, a row has too few or too many cells, or too many cells hold no number; with
        the line.
    """
    encoding, findings = _encoding(path)
    try:
        with path.open(newline="", encoding=encoding) as file:
            return _read(path, file, findings)
    except UnicodeError as error:
        raise RecordingError(
            f"{path}: not text in {encoding}: {error}", hint="save it again as UTF-8"
        ) from None
    except (OSError, csv.Error) as error:
        raise RecordingError(f"{path} cannot be read: {error}", hint=_EXPECTED) from None


def _encoding(path: Path) -> tuple[str, list[Finding]]:
    """Return the encoding by its mark, by zero bytes, or by what can be decoded."""
    with path.open("rb") as file:
        start = file.read(65536)
        if start[:4] in (b"\xff\xfe\x00\x00", b"\x00\x00\xfe\xff"):
            return "utf-32", [Statement(f"{path.name} is text in UTF-32")]
        if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return "utf-16", [Statement(f"{path.name} is text in UTF-16")]
        zeros = [start[index::2].count(0) / max(len(start) // 2, 1) for index in (0, 1)]
        if max(zeros) > 0.4:
            encoding = "utf-16-le" if zeros[1] > zeros[0] else "utf-16-be"
            return encoding, [
                Statement(f"{path.name} is text in {encoding.upper()}, without a mark that says so")
            ]
        if 0 in start:
            line = start[: start.index(0)].count(b"\n") + 1
            raise RecordingError(f"{path}:{line}: a zero byte: this is no text", hint=_EXPECTED)
        file.seek(0)
        try:
            for block in iter(lambda: file.readlines(1 << 20), []):
                b"".join(block).decode("utf-8")
        except UnicodeDecodeError:
            return "cp1252", [
                Statement(f"{path.name} is no UTF-8, and read as Windows-1252 (western European)")
            ]
    return "utf-8-sig", []


def _read(path: Path, file: io.TextIOWrapper, findings: list[Finding]) -> Arrays:
    before, first = _first_line(path, file)
    stated = _SEPARATOR.fullmatch(first.strip().strip('"'))
    if stated:
        skipped, first = _first_line(path, file)
        before += skipped + 1
    delimiter = stated[1] if stated else max(",;\t", key=first.count)
    if not first.count(delimiter) and len(first.split()) > 1 and path.suffix.lower() != ".csv":
        delimiter = " "
    rows = csv.reader(chain([first], file), delimiter=delimiter, skipinitialspace=delimiter == " ")
    header = [name.strip().strip('"').lstrip("# ") for name in next(rows)]
    if header and not header[-1]:
        header.pop()
        findings.append(Statement(f"{path.name}: the delimiter at the end of each line is ignored"))
    _require_names(path, before + 1, header, delimiter)
    body = _numbered(rows, before + 1)
    start = list(islice(body, 1))
    units: dict[str, str] = {}
    if start and _is_unit_row(start[0][1]):
        line, cells = start[0]
        units = {
            name: UNIT_WORDS.get(cell.strip(" []()").lower(), "")
            for name, cell in zip(header, cells, strict=False)
        }
        findings.append(Statement(f"{path.name}:{line}: read as a row of units: {', '.join(cells)[:80]}"))
        start = list(islice(body, 1))
    if not start:
        raise RecordingError(f"{path}: there is a header and no sample below it", hint=_EXPECTED)
    cells = start[0][1][: len(header)]
    dates = [index for index, cell in enumerate(cells) if is_date(cell) and is_time(header[index])]
    episodes = [
        index
        for index, cell in enumerate(cells)
        if is_episode(header[index]) and not _is_number(cell, delimiter)
    ]
    table, texts = _parsed(path, chain(start, body), header, delimiter, [*dates, *episodes], findings)
    for date in dates:
        table[:, date], date_findings = date_seconds(texts[date], header[date])
        units[header[date]] = "s"
        findings += date_findings
    for index in episodes:
        numbers: dict[str, int] = {}
        table[:, index] = [numbers.setdefault(cell.strip(), len(numbers)) for cell in texts[index]]
    words = [name for index, name in enumerate(header) if np.isnan(table[:, index]).all()]
    arrays = {name: table[:, index] for index, name in enumerate(header) if name not in words}
    if not arrays:
        names = ", ".join(header)[:80]
        raise RecordingError(f"{path}: no column holds numbers below the header {names}", hint=_EXPECTED)
    if words:
        texts_in = [f"{name} ({cells[header.index(name)].strip()!r})" for name in words[:8]]
        findings.append(Statement(f"{path.name}: no number in {', '.join(texts_in)}; left out"))
    return Arrays(
        arrays, units={name: unit for name, unit in units.items() if unit}, findings=tuple(findings)
    )


def _first_line(path: Path, file: io.TextIOWrapper) -> tuple[int, str]:
    """Return how many lines of comments there are, and the line of the header after them."""
    for before, line in enumerate(file):
        stripped = line.strip().strip('"')
        # "# time, x" is a header; "# recorded in May" is a comment
        comment = stripped.startswith("#") and not any(mark in stripped for mark in ",;\t")
        if stripped and not comment:
            return before, line
    raise RecordingError(f"{path}: the file is empty", hint=_EXPECTED)


def _require_names(path: Path, line: int, header: Sequence[str], delimiter: str) -> None:
    """Raise RecordingError if a header holds numbers, or a name twice."""
    if header and all(_is_number(cell, delimiter) for cell in header):
        raise RecordingError(
            f"{path}:{line}: numbers where the names of columns were expected", hint=_EXPECTED
        )
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise RecordingError(
            f"{path}:{line}: the name {twice[0]!r} stands twice in the header", hint=_EXPECTED
        )


def _numbered(rows: Iterator[list[str]], before: int) -> Iterator[tuple[int, list[str]]]:
    for line, cells in enumerate(rows, before + 1):
        if any(cell.strip() for cell in cells):
            yield line, cells


def _parsed(
    path: Path,
    rows: Iterator[tuple[int, list[str]]],
    header: Sequence[str],
    delimiter: str,
    dates: Sequence[int],
    findings: list[Finding],
) -> tuple[FloatArray, dict[int, list[str]]]:
    """Return the numbers, (rows, columns), and the text of the columns of dates."""
    width, blocks = len(header), []
    texts: dict[int, list[str]] = {date: [] for date in dates}
    bad: dict[int, tuple[int, int, str]] = {}
    short: tuple[int, int] | None = None
    while chunk := list(islice(rows, _CHUNK_ROWS)):
        if short is not None:
            _refuse_row(path, *short, header, delimiter)
        short = _last_short(path, chunk, header, delimiter)
        block = np.full((len(chunk), width), np.nan)
        for row, (line, cells) in enumerate(chunk):
            for index, cell in enumerate(cells[:width]):
                if index in texts:
                    texts[index].append(cell)
                    continue
                try:
                    block[row, index] = float(cell if delimiter == "," else cell.replace(",", "."))
                except ValueError:
                    if cell.strip().lower() not in _BLANKS:
                        _require_no_thousands(path, line, header[index], cell)
                        count, first, what = bad.get(index, (0, line, cell.strip()))
                        bad[index] = count + 1, first, what
        blocks.append(block)
    table = np.concatenate(blocks)
    if short is not None:
        if not len(table):
            _refuse_row(path, *short, header, delimiter)
        text = f"{path.name}:{short[0]}: the last line has {short[1]} of {width} cells, and is left out"
        findings.append(Statement(text))
    findings += _without_numbers(path, table, header, bad)
    return table, texts


def _last_short(
    path: Path, chunk: list[tuple[int, list[str]]], header: Sequence[str], delimiter: str
) -> tuple[int, int] | None:
    """Take the last row out if it ends early, and return its line and cells; refuse all others that do not fit.

    A logger that was stopped leaves its last line unfinished.
    """
    width = len(header)
    for line, cells in chunk[:-1]:
        if not _fits(cells, width):
            _refuse_row(path, line, len(cells), header, delimiter)
    line, cells = chunk[-1]
    if _fits(cells, width):
        return None
    if len(cells) > width:
        _refuse_row(path, line, len(cells), header, delimiter)
    chunk.pop()
    return line, len(cells)


def _fits(cells: Sequence[str], width: int) -> bool:
    """Tell whether a row has as many cells as the header, but for blank ones behind."""
    return len(cells) == width or (len(cells) > width and not any(cell.strip() for cell in cells[width:]))


def _without_numbers(
    path: Path, table: FloatArray, header: Sequence[str], bad: Mapping[int, tuple[int, int, str]]
) -> list[Finding]:
    """Return what is said of cells that hold no number; refuse a column that has too many of them."""
    findings: list[Finding] = []
    for column, (count, line, what) in bad.items():
        if np.isnan(table[:, column]).all():
            continue
        if count > _MOST_BAD_CELLS * len(table):
            raise RecordingError(
                f"{path}:{line}: column {header[column]!r} holds {what!r}, and no number in {count} of {len(table)} "
                "rows",
                hint=_EXPECTED,
            )
        text = f"column {header[column]} has {count} cells without a number, first {what!r} in line {line}"
        findings.append(Statement(f"{path.name}: {text}"))
    return findings


def _refuse_row(path: Path, line: int, cells: int, header: Sequence[str], delimiter: str) -> NoReturn:
    hint = _EXPECTED
    if len(header) == 1:
        hint = (
            f"the first line, {header[0][:40]!r}, was taken for the header: delete all lines above the header"
        )
    elif delimiter == ",":
        hint += "; if its numbers have decimal commas, columns must be separated by semicolons"
    raise RecordingError(f"{path}:{line}: {cells} cells below a header of {len(header)}", hint=hint)


def _require_no_thousands(path: Path, line: int, name: str, cell: str) -> None:
    if _THOUSANDS.fullmatch(cell.strip()):
        raise RecordingError(
            f"{path}:{line}: {cell.strip()!r} of column {name!r} has points between thousands",
            hint="write 1234,5 or 1234.5",
        )


def _is_unit_row(cells: Sequence[str]) -> bool:
    """Tell whether no cell is a number and some are units."""
    filled = [cell.strip() for cell in cells if cell.strip()]
    named = [
        cell
        for cell in filled
        if cell.strip(" []()").lower() in UNIT_WORDS or cell.strip(" []()") in ("-", "1")
    ]
    return (
        bool(named)
        and not any(_is_number(cell, ";") and cell.strip() != "1" for cell in filled)
        and 2 * len(named) >= len(filled)
    )


def _is_number(cell: str, delimiter: str) -> bool:
    try:
        return math.isfinite(float(cell if delimiter == "," else cell.replace(",", ".")))
    except ValueError:
        return False
