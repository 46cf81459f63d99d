"""Nodes of numbers and arrays: arithmetic, elementwise functions, choices, arrays of parts."""
