"""Run as ``python -m benchmarks.withheld`` or as ``python benchmarks/withheld``."""

import os
import sys
from pathlib import Path

# one thread of linear algebra per process: the cases run side by side, and come out the same on any machine
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# started as a folder or as a module of the checkout: the package is always found under its own short name
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from withheld.cli import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
