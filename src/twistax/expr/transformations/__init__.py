"""Transformations of expressions: maps over batches, rates, structures without numbers."""
