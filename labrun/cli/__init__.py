"""The command line: parse, call, print. Each command imports what it needs when it runs."""

import sys

__all__ = ["BY_CTRL_C", "main"]

BY_CTRL_C = "interrupted by Ctrl-C"


def main() -> None:
    """Run the command line. Ctrl-C while it is still being read ends as later: in a line, with 130."""
    try:
        from labrun.cli.app import main as commands

        commands()
    except KeyboardInterrupt:
        sys.stderr.write(f"labrun: {BY_CTRL_C}\n")
        sys.exit(130)  # `labrun.cli.output.INTERRUPTED`, which may be what was being read
