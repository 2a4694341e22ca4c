"""Types of numpy arrays; where one is used, its docstring gives shape and unit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
"""(height, width, 3), rgb8."""
