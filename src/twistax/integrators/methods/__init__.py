"""One-step methods."""
