"""`python -m twistax demo`: a powered descent, checked, solved, simulated again, drawn and written as a table."""
