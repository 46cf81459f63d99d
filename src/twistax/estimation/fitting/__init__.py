"""Estimation of parameters from data: maximum likelihood by multiple shooting."""
