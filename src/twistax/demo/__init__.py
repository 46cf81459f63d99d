"""The main job of the command line: a powered descent, checked, solved, simulated again, drawn and tabled."""
