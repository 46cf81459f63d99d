"""Model-predictive control: a problem that is solved repeatedly from measured states."""
