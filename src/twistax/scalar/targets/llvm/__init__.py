"""Scalar programs as machine code for this processor, called from JAX on the CPU."""
