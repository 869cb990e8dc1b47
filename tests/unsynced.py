"""Files that are not forced onto the disk: a test outlives no power cut, and a disk takes milliseconds each time."""

import os


def leave_files_unsynced() -> None:
    """From now on, `os.fsync` in this process only checks its descriptor."""
    os.fsync = _checked


def _checked(file: int) -> None:
    os.fstat(file)
