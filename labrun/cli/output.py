"""What a command prints, and how it ends: 0 done, 1 the experiment failed, 2 the request was wrong, 130 Ctrl-C."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer

from labrun.errors import LabrunError
from labrun.json_numbers import finite

INTERRUPTED = 130
"""As shells say it: 128 and the number of the signal."""


@contextmanager
def reported(
    as_json: bool, interrupted: str = "interrupted by Ctrl-C before anything moved or was written"
) -> Iterator[None]:
    """Turn an error labrun can explain into its message and its exit code.

    Ctrl-C while a run is under way comes as such an error, with what was saved; before that there is nothing to save.

    Parameters
    ----------
    interrupted
        What Ctrl-C means here.
    """
    try:
        yield
    except KeyboardInterrupt:
        if as_json:
            print_json({"error": interrupted, "hint": None})
        typer.echo(f"labrun: {interrupted}", err=True)
        raise typer.Exit(INTERRUPTED) from None
    except LabrunError as error:
        if as_json:
            print_json({"error": str(error.args[0]), "hint": error.hint, **error.details})
        typer.echo(f"labrun: {error}", err=True)
        raise typer.Exit(error.exit_code) from None


def print_json(value: Any) -> None:
    """Print one JSON object; a number that does not exist is null, never NaN."""
    typer.echo(json.dumps(finite(value), default=str, allow_nan=False))


def to_terminal() -> bool:
    """Tell whether a person is watching: progress goes to standard error."""
    return sys.stderr.isatty()
