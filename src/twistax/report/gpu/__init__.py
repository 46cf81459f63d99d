"""`python -m twistax report --gpu`: kernels on a CUDA device compared with XLA on the same device, and with the CPU."""
