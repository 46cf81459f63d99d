"""Functions of arrays as nodes, and parameters that are pytrees of arrays."""
