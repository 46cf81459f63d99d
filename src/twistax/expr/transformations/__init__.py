"""What makes one expression of another: maps over batches, rates, structures without numbers."""
