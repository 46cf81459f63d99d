"""Error against run time: the report of scenes with known answers by integrators, ours and diffrax's."""
