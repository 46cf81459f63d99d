"""Functions of small arrays as machine code: loops over arrays in memory where scalars would be too many."""
