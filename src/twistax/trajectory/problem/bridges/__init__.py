"""Maps of a statement to one that the transcription knows, and of its solution back."""
