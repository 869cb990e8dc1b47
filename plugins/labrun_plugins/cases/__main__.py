"""Run as ``python -m labrun_plugins.cases``, or as a folder: then nothing of the package around it is imported."""

import os
import sys
from importlib import import_module
from pathlib import Path

# one thread of linear algebra per process: the cases run side by side, and come out the same on any machine
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# However it is started, it goes by the name of its folder, also in the processes that it starts. The parent folder is
# the last to be searched: its packages must not replace modules of the same names in the standard library.
_HERE = Path(__file__).resolve().parent
sys.path.append(str(_HERE.parent))

if __name__ == "__main__":
    sys.exit(import_module(f"{_HERE.name}.cli").main())
