"""Groups of a rotation and several vectors."""
