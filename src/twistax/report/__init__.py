"""Figures about the library that a command can print: accuracy, stability, speed."""
