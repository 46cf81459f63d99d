"""Identification of inertial parameters: regressors, identifiable combinations, and parametrisations of physical
inertias.
"""
