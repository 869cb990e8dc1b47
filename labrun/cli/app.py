"""The application: its commands in the order of a day at the bench."""

import gc
import os
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from labrun.cli import data, experiment, fit, gap, workspace
from labrun.cli.output import reported


class _Commands(TyperGroup):
    """The command group; usage errors are reported without the library's wording.

    A signal is told from the beginning to the end; a command at work says itself what that means there.
    """

    def make_context(self, *args: Any, **named: Any) -> Any:
        with reported(as_json=False):
            return super().make_context(*args, **named)

    def invoke(self, ctx: Any) -> Any:
        try:
            with reported(as_json=False):
                return super().invoke(ctx)
        except typer.BadParameter as error:
            error.message = error.message.removeprefix("Value error, ")  # of pydantic, which typer asks
            raise


app = typer.Typer(
    name="labrun",
    cls=_Commands,
    help="Say why a simulation disagrees with a robot bench, and run the experiments that show it:\n"
    "settled, repeated trials by sweep or CMA-ES, every sample kept, models fitted with their uncertainty;\n"
    "on the bench, or without one (--dry-run).\n\n"
    "Start with:  labrun run hinge --dry-run && labrun gap diagnose hinge",
    no_args_is_help=True,
    rich_markup_mode=None,  # rich would cost half of the time that --help may take
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from labrun import __version__

        typer.echo(f"labrun {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


for commands in (workspace, experiment, fit, data):
    for name, command in commands.COMMANDS.items():
        app.command(name)(command)
app.add_typer(gap.gap)


def main() -> None:
    """Run the command line."""
    # labrun's matrices are small: BLAS threads would spend ten times the time on waiting for one another
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # what imports make stays: looking for garbage there costs a tenth of a dry run
    gc.set_threshold(100_000, 20, 20)
    app()
