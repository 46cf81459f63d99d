"""Kinds, frames, duals and units of values: what leaves declare, and what the nodes of a system make of it."""
