"""Targets of scalar programs: operations of JAX, C99, machine code, and NumPy."""
