"""The command line: parse, call, print. Each command imports what it needs when it runs."""

import sys
import threading

from labrun.cli.streams import OutputError, complain, guard_streams
from labrun.interrupts import exit_code, handled, ignore_signals, installed, number_of, signal_name

__all__ = ["main"]

_AGAIN_S = 0.02
"""After so long a lost signal is sent again: longer than a callback takes to return."""
_unraisable = sys.unraisablehook


def _signal_again(lost: "sys.UnraisableHookArgs") -> None:
    """Send a signal again that came in a callback of compiled code, as of a compiler: that drops exceptions."""
    interrupts = installed()
    if interrupts is not None and issubclass(lost.exc_type, KeyboardInterrupt):
        again = threading.Timer(_AGAIN_S, interrupts.raise_again)
        again.daemon = True
        again.start()
    else:
        _unraisable(lost)


def main() -> None:
    """Run the command line. A signal while it is still being read ends it as later: in a line, with its exit code."""
    sys.unraisablehook = _signal_again
    guard_streams()
    with handled() as interrupts:
        try:
            with interrupts.raising():
                from labrun.cli.app import main as commands

            try:
                commands()
            finally:
                if sys.stdout is not None:  # closed from the beginning
                    sys.stdout.flush()
        except OutputError as error:  # of the last words; else the command itself has told
            complain(str(error))
            sys.exit(error.exit_code)
        except KeyboardInterrupt as error:
            complain(f"interrupted by {signal_name(number_of(error))}")
            sys.exit(exit_code(number_of(error)))
        finally:
            ignore_signals()  # what is printed is printed; the process is at its end
