"""Functions of matrices as kernels: loops over the entries of arrays in memory."""
