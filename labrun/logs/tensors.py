"""Tensors that PyTorch saved (``.pt``), read without PyTorch and without running anything that the file names.

The file is a zip archive: ``data.pkl`` describes the objects, ``data/<key>`` holds the numbers of each storage
(pytorch.org/docs/stable/notes/serialization.html). The unpickler knows the few names that tensors need, and refuses
all others.
"""

import pickle
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np

from labrun.errors import RecordingError
from labrun.logs.arrays import Arrays
from labrun.logs.containers import as_numbers, flat, require_affordable

_STORAGES = {
    "FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "LongStorage": "<i8", "IntStorage": "<i4",
    "ShortStorage": "<i2", "CharStorage": "<i1", "ByteStorage": "<u1", "BoolStorage": "?",
    "BFloat16Storage": "bfloat16",
}  # fmt: skip


@dataclass(frozen=True)
class _StorageType:
    dtype: str


def _tensor(storage: Any, offset: Any, shape: Any, stride: Any, *_: Any) -> Any:
    """Return a tensor as an array; every number that it names has to be in its storage."""
    if not isinstance(storage, np.ndarray):
        raise pickle.UnpicklingError("a tensor without a storage")
    shape, stride, offset = tuple(map(int, shape)), tuple(map(int, stride)), int(offset)
    if min((*shape, *stride, offset), default=0) < 0:
        raise pickle.UnpicklingError("a tensor of negative size")
    if 0 in shape:
        return np.empty(shape, dtype=storage.dtype)
    last = offset + sum((n - 1) * step for n, step in zip(shape, stride, strict=True))
    # a stride of 0 repeats a number without end: what is read must not be more than what is stored
    if last >= len(storage) or int(np.prod([float(n) for n in shape])) > len(storage):
        raise pickle.UnpicklingError("a tensor that is larger than its storage")
    step = storage.dtype.itemsize
    view = np.lib.stride_tricks.as_strided(storage[offset:], shape, tuple(step * count for count in stride))
    return view.copy()


def _parameter(data: Any, *_: Any) -> Any:
    return data


def _device(*_: Any) -> None:
    """Return nothing: where a tensor was kept is not read."""


_NAMES: Mapping[tuple[str, str], Callable[..., Any]] = {
    ("collections", "OrderedDict"): OrderedDict,
    ("torch._utils", "_rebuild_tensor_v2"): _tensor,
    ("torch._utils", "_rebuild_parameter"): _parameter,
    ("torch", "Size"): tuple,
    ("torch", "device"): _device,
}


class _Unpickler(pickle.Unpickler):
    """An unpickler that knows tensors and the containers of the language, and nothing else."""

    def __init__(self, file: Any, storage: Callable[[str, str, int], Any]) -> None:
        super().__init__(file)
        self._storage = storage

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in _NAMES:
            return _NAMES[module, name]
        if module in ("torch", "torch.storage") and name in _STORAGES:
            return _StorageType(_STORAGES[name])
        raise pickle.UnpicklingError(
            f"it names {module}.{name}, which is not a tensor of numbers, and was not run"
        )

    def persistent_load(self, pid: Any) -> Any:
        kind, storage_type, key, _, count = pid
        if kind != "storage" or not isinstance(storage_type, _StorageType):
            raise pickle.UnpicklingError(f"it refers to {kind!r}, which is not a storage of numbers")
        return self._storage(storage_type.dtype, str(key), int(count))


def read_pt(path: Path) -> Arrays:
    """Read the tensors of a file that ``torch.save`` wrote: a tensor, or dictionaries and lists of them."""
    try:
        with ZipFile(path) as archive:
            require_affordable(path, sum(entry.file_size for entry in archive.infolist()) // 8)
            names = archive.namelist()
            description = next((name for name in names if name.endswith("/data.pkl")), None)
            if description is None:
                raise RecordingError(f"{path} holds no tensors: data.pkl is missing", hint=_HINT)
            root = description.removesuffix("data.pkl")

            def storage(dtype: str, key: str, count: int) -> Any:
                data = archive.read(f"{root}data/{key}")
                if dtype == "bfloat16":  # the upper half of a float32
                    return (np.frombuffer(data, "<u2")[:count].astype("<u4") << 16).view("<f4")
                return np.frombuffer(data, dtype)[:count]

            with archive.open(description) as file:
                saved = _Unpickler(file, storage).load()
    except BadZipFile:
        raise RecordingError(
            f"{path} is no zip archive: torch.save before version 1.6 wrote it, or it is cut short",
            hint=_HINT,
        ) from None
    except (
        pickle.UnpicklingError,
        KeyError,
        ValueError,
        TypeError,
        IndexError,
        EOFError,
        AttributeError,
    ) as error:
        raise RecordingError(f"{path} cannot be read as tensors: {error}", hint=_HINT) from None
    arrays = flat("" if isinstance(saved, Mapping) else path.stem, saved)
    return Arrays({name: as_numbers(table) for name, table in arrays if isinstance(table, np.ndarray)})


_HINT = 'save tensors alone: torch.save({"time_s": t, "qpos": q, "ctrl": u}, "log.pt")'
