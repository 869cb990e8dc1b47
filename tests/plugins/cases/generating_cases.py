"""The generator, where it stands, and how it is run."""

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO

from labrun_plugins.cases.cli import main

from labrun.registry import package_folder

GENERATOR = package_folder("labrun.cases", "sealed")

Done = subprocess.CompletedProcess[str]
Generate = Callable[..., Done]


def generate(*arguments: str) -> Done:
    """Run the generator's command line, in this process."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code = main(arguments)
        except SystemExit as end:
            code = int(end.code or 0)
    return Done(arguments, code, out.getvalue(), err.getvalue())


def generate_apart(*arguments: str) -> Done:
    """Run the generator as a command does: as a folder, in a process of its own."""
    return subprocess.run(
        [sys.executable, str(GENERATOR), *arguments],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
