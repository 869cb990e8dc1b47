"""Files of arrays: NumPy archives, HDF5, MATLAB. What a file claims is checked before memory is taken for it."""

import io
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, cast
from zipfile import BadZipFile, ZipFile

import numpy as np

from labrun.errors import RecordingError
from labrun.logs.arrays import Arrays
from labrun.logs.findings import Finding, Statement

_PARTS = re.compile(r"(?i)(joint|axis|axes|motor|servo|link|leg|arm|channel|signal)s?$")
MOST_TIMES, SPARE_BYTES = 3, 256 * 2**20
"""The numbers of a file take at most so many times its size in memory, and this more for small ones."""


def require_affordable(path: Path, count: int) -> None:
    """Raise RecordingError if a file claims so many numbers that reading them takes far more memory than its size."""
    size, needed = path.stat().st_size, 8 * count  # every number is read as a double, however it is stored
    if needed > MOST_TIMES * size + SPARE_BYTES:
        raise RecordingError(
            f"{path} has {size:,} bytes and claims to hold {count:,} numbers, which take {needed:,} bytes of memory",
            hint="it is damaged, or packed very tightly: unpack it, or write less of it",
        )


def as_numbers(given: Any) -> Any:
    """Return an array of numbers as doubles, so that the original is not kept beside it; anything else as it is."""
    return (
        given.astype(np.float64, copy=False)
        if isinstance(given, np.ndarray) and given.dtype.kind in "fiub"
        else given
    )


class BoundedFile(io.BufferedReader):
    """A file of which nobody can ask for more bytes than it has: memory for them would be taken before that shows."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._size = path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        """Return at most what is left of the file."""
        remaining = max(self._size - self.tell(), 0)
        return super().read(remaining if size is None or size < 0 else min(size, remaining))


def read_npz(path: Path) -> Arrays:
    """Read a NumPy archive, or one array: (n,) is a column, (n, k) a vector."""
    from numpy.lib import format as npy

    try:
        if path.suffix.lower() == ".npy":
            with path.open("rb") as file:
                require_affordable(path, _npy_size(npy, file)[0])
            return Arrays({path.stem: as_numbers(np.load(path, allow_pickle=False))})
        with ZipFile(path) as archive:
            total, objects = 0, []
            for entry in archive.infolist():
                with archive.open(entry) as file:
                    count, size, has_objects = _npy_size(npy, file)
                total += count
                if has_objects:
                    objects.append(entry.filename.removesuffix(".npy"))
                elif size > entry.file_size:
                    raise ValueError("an array is longer than the file says")
            require_affordable(path, total)
        left_out = (
            f"{path.name}: {', '.join(objects[:8])} are objects of Python, which are not read; left out"
        )
        findings: tuple[Finding, ...] = (Statement(left_out),) if objects else ()
        with np.load(path, allow_pickle=False) as archive:
            names = [name for name in archive.files if name not in objects]
            return Arrays({name: as_numbers(archive[name]) for name in names}, findings=findings)
    except (OSError, ValueError, EOFError, BadZipFile, KeyError):
        raise RecordingError(
            f"{path} is no whole NumPy archive of numbers", hint="write it again with numpy.savez"
        ) from None


def _npy_size(npy: Any, file: Any) -> tuple[int, int, bool]:
    """Return how many numbers an array has, its bytes, and whether it holds objects instead."""
    version = npy.read_magic(file)
    header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = header(file)
    count = math.prod(map(int, shape))
    return max(count, count * int(dtype.itemsize) // 8), count * int(dtype.itemsize), bool(dtype.hasobject)


def read_h5(path: Path) -> Arrays:
    """Read the datasets of an HDF5 file; ``units`` of a dataset is its unit. MATLAB's own (7.3) is turned round."""
    import h5py

    values: dict[str, Any] = {}
    units: dict[str, str] = {}
    claimed = 0

    def visit(name: str, item: Any) -> None:
        nonlocal claimed
        if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "fiub" or item.ndim not in (1, 2):
            return
        if name.startswith("#refs#"):
            return
        claimed += item.size
        require_affordable(path, claimed)
        from_matlab = "MATLAB_class" in item.attrs
        table = as_numbers(item[()])
        values[name] = _upright(table.T) if from_matlab else table
        unit = item.attrs.get("units", item.attrs.get("unit", ""))
        units[name] = unit.decode(errors="replace") if isinstance(unit, bytes) else str(unit)

    with h5py.File(path) as file:
        file.visititems(visit)
    return Arrays(values, units={name: unit for name, unit in units.items() if unit})


def read_mat(path: Path) -> Arrays:
    """Read the variables of a MATLAB file: matrices, and structures of them, such as Simulink's with time."""
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatlabOpaque

    with path.open("rb") as file:
        start = file.read(128)
    if start[:8] == b"\x89HDF\r\n\x1a\n" or b"MATLAB 7.3" in start:
        return read_h5(path)
    with BoundedFile(path) as bounded:
        listed = whosmat(cast("Any", bounded))
    require_affordable(path, sum(math.prod(shape) for _, shape, _ in listed))
    with BoundedFile(path) as bounded:
        content = loadmat(cast("Any", bounded), simplify_cells=True)
    values: dict[str, Any] = {}
    labels: dict[str, tuple[str, ...] | None] = {}
    unread: list[str] = []
    for name, given in content.items():
        if name.startswith("__"):
            continue
        for key, value in flat(name, given):
            if isinstance(value, MatlabOpaque):
                unread.append(key)
            elif isinstance(value, np.ndarray):
                values[key] = _upright(as_numbers(value))
    findings: tuple[Finding, ...] = ()
    if unread:
        text = f"{path.name}: {', '.join(unread)} are objects of MATLAB (timeseries, table), which only MATLAB reads"
        findings = (Statement(f"{text}; write their Time and Data as matrices"),)
    return Arrays(values, labels, findings=findings)


def flat(name: str, given: Any) -> Iterator[tuple[str, Any]]:
    """Yield path and value of all that mappings and lists hold; mappings in a list are episodes, or its joints."""
    if isinstance(given, np.ndarray) and given.dtype == object:
        given = given.ravel().tolist()
    if isinstance(given, Mapping):
        label = given.get("label")  # of a signal in a structure of Simulink
        for key, value in given.items():
            own = label if key == "values" and isinstance(label, str) and label else key
            yield from flat(f"{name}/{own}" if name else str(own), value)
    elif isinstance(given, list | tuple):
        kind = "" if _PARTS.search(name) else "episode_"
        for index, value in enumerate(given):
            is_table = isinstance(value, Mapping)
            is_labelled = is_table and value.get("label")
            yield from flat(name if is_labelled else f"{name}/{kind if is_table else ''}{index}", value)
    else:
        yield name, given


def _upright(table: Any) -> Any:
    """Return a row or a column as a list: what MATLAB holds over time may lie either way."""
    flat = np.ndim(table) == 2 and 1 in table.shape and table.size > 1
    return table.reshape(-1) if flat else table
