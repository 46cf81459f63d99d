"""The table of primitives: one entry for each, with all that readers and writers know of it."""
