"""Makes `native_sketch` importable, and the golden lines of labline."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "labline"))
