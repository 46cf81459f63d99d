"""Tasks: what a motion of a mechanism should do, each an error and its Jacobian."""
