"""What happens at the edges: the sections of `python -m twistax report --stability`."""
