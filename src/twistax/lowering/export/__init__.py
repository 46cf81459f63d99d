"""Compiled systems for other programs: C99, CasADi, files."""
