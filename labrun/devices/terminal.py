"""The terminal as a place to ask a person something, without ever waiting for the answer."""

import os
import select
import sys
from typing import TextIO

from labrun.errors import ExperimentError

_MOST = 4096


class NoTerminalError(ExperimentError):
    """Nobody can be asked: there is no terminal, or it was closed."""


class Terminal:
    """Tells a person what to do, and notices when Enter is pressed.

    Parameters
    ----------
    keys, screen
        What the person types on, and reads; the process's own unless given.
    """

    def __init__(self, keys: TextIO | None = None, screen: TextIO | None = None) -> None:
        self._keys = sys.stdin if keys is None else keys
        self._given_screen = screen

    @property
    def _screen(self) -> TextIO:
        """What texts go to: looked up anew, as a progress display takes its place while it is on."""
        return sys.stderr if self._given_screen is None else self._given_screen

    @property
    def _bell(self) -> TextIO:
        """The terminal itself: a progress display would hold the bell back."""
        return (sys.__stderr__ or sys.stderr) if self._given_screen is None else self._given_screen

    def require(self) -> None:
        """Raise NoTerminalError unless there is a person at both ends."""
        for stream, what in ((self._keys, "input"), (self._bell, "output")):
            if stream is None or stream.closed or not stream.isatty():
                raise NoTerminalError(f"{what} is not a terminal")

    def ask(self, text: str) -> None:
        """Show a text; what was typed before does not count as an answer."""
        self._typed()
        self.show(text)

    def show(self, text: str) -> None:
        """Show a text on a line of its own.

        Raises
        ------
        NoTerminalError
            The terminal was closed.
        """
        _write(self._screen, f"\n{text}\n")

    def tone(self, text: str) -> None:
        """Ring the terminal's bell, then show a text."""
        _write(self._bell, "\a")
        self.show(text)

    def answered(self) -> bool:
        """Tell whether Enter was pressed since `ask`; does not wait.

        Raises
        ------
        NoTerminalError
            The terminal was closed.
        """
        return self.answer() is not None

    def answer(self) -> str | None:
        """Return the line that was typed last since `ask`, without its end; None while there is none. Does not wait.

        Raises
        ------
        NoTerminalError
            The terminal was closed.
        """
        lines = self._typed().decode(errors="replace").splitlines()
        return lines[-1] if lines else None

    def _typed(self) -> bytes:
        """Return what has been typed and not been taken yet."""
        typed = b""
        try:
            file = self._keys.fileno()
            while select.select([file], [], [], 0.0)[0]:
                data = os.read(file, _MOST)
                if not data:
                    raise NoTerminalError("the terminal was closed")
                typed += data
        except (OSError, ValueError) as error:
            raise NoTerminalError(str(error)) from error
        return typed


def _write(stream: TextIO, text: str) -> None:
    try:
        stream.write(text)
        stream.flush()
    except (OSError, ValueError) as error:
        raise NoTerminalError(str(error)) from error
