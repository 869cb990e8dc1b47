"""What a long computation is doing, on one line of standard error, where a person is watching."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from labrun.cli.output import to_terminal


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Give what is called with every new step; the line also tells how long it has taken so far."""
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
