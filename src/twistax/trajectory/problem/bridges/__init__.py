"""Bridges: maps of a statement to a simpler one that the transcription knows, and of its solution back."""
