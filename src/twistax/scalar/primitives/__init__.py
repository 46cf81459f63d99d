"""The table of primitives: one entry for each, with all information for readers and writers."""
