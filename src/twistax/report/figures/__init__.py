"""Measurements in docs/measured.md: the sections of `python -m twistax report --figures`."""
