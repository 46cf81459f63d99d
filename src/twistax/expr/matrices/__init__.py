"""Linear algebra on expressions; the public module is `tx.linalg`."""
