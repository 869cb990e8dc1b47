"""The generator, where it stands, and how it is run."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

GENERATOR = Path(__file__).resolve().parents[2] / "benchmarks" / "withheld"
if str(GENERATOR.parent) not in sys.path:
    sys.path.insert(0, str(GENERATOR.parent))

Done = subprocess.CompletedProcess[str]
Generate = Callable[..., Done]


def generate(*arguments: str) -> Done:
    """Run the generator as a command does: as a folder, in a process of its own."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, str(GENERATOR), *arguments],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
