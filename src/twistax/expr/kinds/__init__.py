"""Kinds, frames and units of values: their declaration by leaves, and their inference through the nodes of a system."""
