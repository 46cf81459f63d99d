"""Tasks: aims of a motion of a mechanism, each an error with its Jacobian."""
