"""Edits of mechanisms: each function gives the arguments of a new one."""
