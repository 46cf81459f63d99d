"""The type of a NumPy array in annotations of this floor."""

from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
