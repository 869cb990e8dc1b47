"""The command line: parse, call, print. Each command imports what it needs when it runs."""

import os
import signal
import sys
import threading

__all__ = ["BY_CTRL_C", "main"]

BY_CTRL_C = "interrupted by Ctrl-C"
_AGAIN_S = 0.02
"""After so long a lost Ctrl-C is asked for again: longer than a callback takes to return."""
_unraisable = sys.unraisablehook


def _ctrl_c_again(lost: "sys.UnraisableHookArgs") -> None:
    """Ask for Ctrl-C again where it came in a callback of compiled code, as of a compiler: that drops exceptions."""
    if issubclass(lost.exc_type, KeyboardInterrupt):
        again = threading.Timer(_AGAIN_S, os.kill, (os.getpid(), signal.SIGINT))
        again.daemon = True
        again.start()
    else:
        _unraisable(lost)


def main() -> None:
    """Run the command line. Ctrl-C while it is still being read ends as later: in a line, with 130."""
    sys.unraisablehook = _ctrl_c_again
    try:
        from labrun.cli.app import main as commands

        commands()
    except KeyboardInterrupt:
        sys.stderr.write(f"labrun: {BY_CTRL_C}\n")
        sys.exit(130)  # `labrun.cli.output.INTERRUPTED`, which may be what was being read
