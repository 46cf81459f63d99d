"""Mechanics in the language: joints, bodies and the environment around them, all of them expressions."""
