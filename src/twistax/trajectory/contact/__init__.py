"""Contact by complementarity constraints."""
