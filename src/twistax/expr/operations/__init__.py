"""Nodes for numbers and arrays: arithmetic, elementwise functions, choices, array construction."""
