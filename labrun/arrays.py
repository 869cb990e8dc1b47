"""The array types of measured and computed numbers."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""Floats in SI units and radians; shapes stand in the docstrings."""

IntArray = NDArray[np.int64]
"""Counts, indices and addresses."""
