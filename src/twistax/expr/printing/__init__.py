"""How expressions print: text, LaTeX, MathML, SVG."""
