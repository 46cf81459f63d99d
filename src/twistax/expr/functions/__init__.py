"""Functions of arrays as nodes, and parameters that are trees of arrays."""
