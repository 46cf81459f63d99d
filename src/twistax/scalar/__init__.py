"""A compiler of small JAX functions: scalar programs as graphs, with derivatives, for XLA, LLVM, C and CasADi."""
