"""What writes a scalar program: as operations of JAX, as C99, as machine code; or evaluates it at once."""
