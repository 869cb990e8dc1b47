"""What a run says where nobody watches a terminal: the notes, a line each, and nothing that moves."""

import sys
from typing import TextIO

from labrun.runner import SilentProgress


class PlainProgress(SilentProgress):
    """Prints notes (a fault that was skipped, why a search ended) to standard error; quiet otherwise.

    Parameters
    ----------
    stream
        Where to print; standard error if None.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream if stream is not None else sys.stderr

    def note(self, text: str) -> None:
        """Print a line."""
        print(f"labrun: {text}", file=self._stream, flush=True)
