"""`python -m twistax report --gpu`: kernels on a CUDA device beside XLA on the same device, and beside the CPU."""
