"""What a command prints, and how it ends: 0 done, 1 the experiment failed, 2 the request was wrong.

Asked to stop by a signal, it ends with 128 and the signal's number, as shells say it: 130 after Ctrl-C.
"""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import typer

from labrun.errors import LabrunError
from labrun.interrupts import Interrupted, handled, number_of
from labrun.json_numbers import finite


@contextmanager
def reported(as_json: bool, interrupted: str = "") -> Iterator[None]:
    """Turn an error labrun can explain into its message and its exit code.

    A signal while a run is under way comes as such an error, with what was saved.

    Parameters
    ----------
    interrupted
        What a signal means for any other command, to follow "interrupted by Ctrl-C".
    """
    try:
        try:
            with handled() as interrupts, interrupts.raising():
                yield
        except KeyboardInterrupt as interrupt:
            raise Interrupted(number_of(interrupt), interrupted) from None
    except LabrunError as error:
        if as_json:
            print_json({"error": str(error.args[0]), "hint": error.hint, **error.details})
        typer.echo(f"labrun: {error}", err=True)
        raise typer.Exit(error.exit_code) from None


def print_json(value: Any) -> None:
    """Print one JSON object; a number that does not exist is null, never NaN."""
    typer.echo(json.dumps(finite(value), default=str, allow_nan=False))


def print_result(result: Any, as_json: bool, to_text: Callable[[Any], str] | None = None) -> None:
    """Print what a use case returned: its JSON object, or its lines.

    Parameters
    ----------
    result
        Has `to_json`.
    to_text
        Makes the lines; the result's own `to_text` if None.
    """
    if as_json:
        print_json(result.to_json())
    else:
        typer.echo(result.to_text() if to_text is None else to_text(result))


def to_terminal() -> bool:
    """Tell whether a person is watching: progress goes to standard error."""
    return sys.stderr.isatty()


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Yield a function that prints each new step with the elapsed time."""
    if not to_terminal():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("reading")
        yield lambda text: progress.update(task, description=escape(text))
