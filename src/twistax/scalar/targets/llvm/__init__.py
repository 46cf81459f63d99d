"""Scalar programs as machine code for the processor at hand, called from JAX on the CPU."""
