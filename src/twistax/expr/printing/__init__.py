"""Printing of expressions: text, LaTeX, MathML, SVG."""
