"""How results are shown: pages by templates, and figures, all in one style."""
