"""Logs in files and folders, each by its reader."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from labrun.errors import LabrunError, RecordingError, RequestError
from labrun.logs.arrays import Arrays, ReadOptions, streams_of
from labrun.logs.containers import read_h5, read_mat, read_npz
from labrun.logs.parquet import read_parquet
from labrun.logs.publishers import separate_publishers
from labrun.logs.px4 import read_ulg
from labrun.logs.ros import read_bag
from labrun.logs.streams import Stream, separate_sparse
from labrun.logs.tensors import read_pt
from labrun.logs.text import read_text
from labrun.toml import nearest

_ARRAYS: dict[str, Callable[[Path], Arrays]] = {
    ".csv": read_text, ".tsv": read_text, ".txt": read_text, ".dat": read_text, ".npz": read_npz, ".npy": read_npz,
    ".h5": read_h5, ".hdf5": read_h5, ".mat": read_mat, ".pt": read_pt, ".pth": read_pt,
}  # fmt: skip
_STREAMS: dict[str, Callable[[Path], list[Stream]]] = {
    ".bag": read_bag, ".mcap": read_bag, ".db3": read_bag, ".ulg": read_ulg,
}  # fmt: skip
KNOWN = (*_STREAMS, *_ARRAYS, ".parquet")


def read_log(
    path: Path, options: ReadOptions | float | None = None, publishers: Mapping[str, int] | None = None
) -> list[Stream]:
    """Return what a log holds, as it is; columns of other rates than the rest have stamps of their own.

    Parameters
    ----------
    path
        A file of one of the endings `KNOWN`, a rosbag2 folder or a LeRobot data set.
    options
        What a person said of its time; a number is the rate of samples without stamps.
    publishers : topic -> number of its writer
        Which of several writers of one topic counts, from 1.

    Raises
    ------
    RequestError
        There is no such log, its kind is not known, or the package that reads it is missing.
    RecordingError
        It cannot be read: damaged, cut short, or no log.
    """
    if not isinstance(options, ReadOptions):
        options = ReadOptions(options)
    if not path.exists():
        entries = [entry.name for entry in path.parent.iterdir()] if path.parent.is_dir() else []
        near = nearest(path.name, entries)
        hint = f'did you mean "{path.with_name(near)}"?' if near else f"looked from {Path.cwd()}"
        raise RequestError(f"cannot find the log {path}", hint=hint)
    suffix = path.suffix.lower()
    if not path.is_dir() and suffix not in KNOWN:
        raise RequestError(
            f"{path} is no log that labrun reads", hint=f"{', '.join(KNOWN)}, a rosbag2 or LeRobot folder"
        )
    try:
        streams = _read(path, suffix, options)
    except LabrunError:
        raise
    except Exception as error:  # readers of other people raise anything on a damaged file
        raise RecordingError(
            f"{path} cannot be read: {type(error).__name__}: {error}", hint="it is damaged, or cut short"
        ) from error
    separated = []
    for stream in streams:
        alone, findings = separate_publishers(stream, publishers or {})
        separated += separate_sparse(replace(alone, findings=(*alone.findings, *findings)))
    streams = separated
    kept = [stream for stream in streams if stream.columns and len(stream.time_s) > 1]
    if not kept:
        raise RecordingError(f"{path} holds no numbers over time")
    left_out = tuple(finding for stream in streams if stream not in kept for finding in stream.findings)
    return [replace(kept[0], findings=(*left_out, *kept[0].findings)), *kept[1:]]


def _read(path: Path, suffix: str, options: ReadOptions) -> list[Stream]:
    if path.is_dir():
        return read_bag(path) if (path / "metadata.yaml").is_file() else read_parquet(path, options)
    if suffix in _STREAMS:
        return _STREAMS[suffix](path)
    if suffix == ".parquet":
        return read_parquet(path, options)
    return streams_of(path.stem, _ARRAYS[suffix](path), options)
