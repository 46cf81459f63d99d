"""A compiler of small JAX functions: their scalars as a graph, with derivatives, for XLA, LLVM, C and CasADi."""
