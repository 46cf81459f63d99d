"""Scalar programs as kernels of CUDA devices: LLVM writes PTX, the driver assembles it, JAX calls the kernels."""
