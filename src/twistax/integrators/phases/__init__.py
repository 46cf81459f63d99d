"""Integration of phases, one after another."""
