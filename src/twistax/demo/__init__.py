"""The main job of the command line: a powered descent, checked, solved, flown again, drawn and tabled."""
