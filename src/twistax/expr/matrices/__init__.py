"""Linear algebra on expressions; `tx.linalg` is its public face."""
