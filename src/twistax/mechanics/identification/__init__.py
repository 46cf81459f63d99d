"""Identification of inertial parameters: regressors, what is identifiable, and inertias that are always physical."""
