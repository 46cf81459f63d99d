"""Results of an integration: solutions, their outputs, tables."""
