"""The initial barrier parameter of a controller's call."""

#: The ratio of that parameter to the largest move of the measured state, in units of the states, and its limits.
BARRIER_SHARE, BARRIER_LEAST, BARRIER_MOST = 1e-2, 1e-7, 1e-1
