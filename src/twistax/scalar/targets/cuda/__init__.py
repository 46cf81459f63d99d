"""Scalar programs as kernels for CUDA devices: LLVM writes PTX, the driver assembles it, JAX calls the kernels."""
