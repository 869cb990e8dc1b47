"""Which reader a log is for."""

from pathlib import Path

from labrun.errors import RecordingError, RequestError
from labrun.logs.files import read_csv, read_h5, read_npz, read_parquet
from labrun.logs.ros import read_bag
from labrun.logs.streams import Stream

_FILES = {
    ".csv": read_csv, ".txt": read_csv, ".npz": read_npz, ".h5": read_h5, ".hdf5": read_h5, ".parquet": read_parquet,
}  # fmt: skip
_BAGS = (".bag", ".mcap", ".db3")


def read_log(path: Path, rate_hz: float | None = None) -> list[Stream]:
    """Return what a log holds, as it is.

    Parameters
    ----------
    path
        ``.mcap``, ``.bag``, ``.db3``, a rosbag2 folder, a LeRobot dataset folder, ``.parquet``, ``.csv``, ``.npz`` or
        ``.h5``.
    rate_hz
        Of a table without stamps.

    Raises
    ------
    RequestError
        There is no such log, its kind is not known, or the package that reads it is missing.
    RecordingError
        It cannot be read.
    """
    if not path.exists():
        raise RequestError(f"there is no log {path}")
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return _held(path, read_bag(path))
        return _held(path, read_parquet(path, rate_hz))
    suffix = path.suffix.lower()
    if suffix in _BAGS:
        return _held(path, read_bag(path))
    if suffix not in _FILES:
        known = ", ".join((*_BAGS, *_FILES))
        raise RequestError(
            f"{path} is no log that labrun reads", hint=f"{known}, a rosbag2 or LeRobot folder"
        )
    return _held(path, _FILES[suffix](path, rate_hz))


def _held(path: Path, streams: list[Stream]) -> list[Stream]:
    kept = [stream for stream in streams if stream.columns and len(stream.time_s) > 1]
    if not kept:
        raise RecordingError(f"{path} holds no numbers over time")
    return kept
