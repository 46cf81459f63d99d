"""The type of a NumPy array in annotations of this floor."""

import numpy as np

Array = np.ndarray
