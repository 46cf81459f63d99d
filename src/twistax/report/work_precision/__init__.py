"""Work-precision diagrams: error against run time, for scenes with known solutions and the integrators of this package
and of diffrax.
"""
