"""Functions of arrays in parts: straight-line parts as scalars, loops and batches as kernels."""
