"""Edits of mechanisms: each function returns the arguments of an edited mechanism."""
