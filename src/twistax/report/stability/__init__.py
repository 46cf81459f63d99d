"""Behaviour at extreme inputs: the sections of `python -m twistax report --stability`."""
