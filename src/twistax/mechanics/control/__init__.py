"""Task-space controllers of mechanisms."""
