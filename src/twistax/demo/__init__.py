"""`python -m twistax demo`: a powered descent that is checked, solved, simulated, drawn and written as a table."""
