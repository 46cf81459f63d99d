"""Bridges: reformulations of a problem into a simpler one that the transcription supports, and of the solution back."""
