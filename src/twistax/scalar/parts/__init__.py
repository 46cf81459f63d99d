"""Functions of arrays in parts: straight parts as scalars, loops and batches as kernels."""
